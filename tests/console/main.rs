//! The operator's console over HTTP: pages, controls, captures, attacks. Most of these wait.

#[path = "../support/command.rs"]
mod command_support;
#[path = "../support/signals.rs"]
mod signals;
#[path = "../support/small_bench/mod.rs"]
mod small_bench;

mod attack_table;
mod attacks;
mod bench;
mod capture;
mod support;
