//! Light transport against an independent renderer, closed forms, and itself.

mod gradient;
mod materials;
mod references;
mod statistics;
