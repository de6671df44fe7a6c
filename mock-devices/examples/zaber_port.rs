//! Simulated Zaber devices on a pseudo-terminal for other programs: writes the
//! port's path and runs until its input ends.

use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::clock::Clock;
use mock_devices::zaber::{LampWiring, ZaberConfig, ZaberSimulator};
use std::io::{Read, Write};

fn main() -> std::io::Result<()> {
    let bench = BenchConfig {
        start_mm: [7.0, 3.0, 0.0],
        ..BenchConfig::default()
    };
    let config = ZaberConfig {
        lamp: LampWiring::Illuminator,
        ..ZaberConfig::default()
    };
    let simulator = ZaberSimulator::spawn(config, Bench::new(bench, Clock::real_time()))?;
    let mut out = std::io::stdout();
    writeln!(out, "{}", simulator.path().display())?;
    out.flush()?;
    std::io::stdin().read_to_end(&mut Vec::new())?;
    Ok(())
}
