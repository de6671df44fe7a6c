//! Light transport against an independent renderer, closed forms, and itself.

mod even_points;
mod gradient;
mod materials;
mod point_spread;
mod references;
mod statistics;
