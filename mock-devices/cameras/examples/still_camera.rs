//! A simulated still camera behind PTP/IP before an evenly lit card, for trying `gphoto2`:
//! prints the value of gphoto2's option `--port` and runs until it is ended. An argument is
//! the number of files that it has room for.

use std::sync::Arc;

use mock_cameras::ptp::{Body, BodyConfig, PtpServer};
use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::camera::{CameraConfig, SimulatedCamera};
use mock_devices::clock::Clock;
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};

const SIZE: [u32; 2] = [640, 480];

struct Card;

impl RadianceSource for Card {
    fn resolution_px(&self) -> [u32; 2] {
        SIZE
    }
    fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
        Arc::new(vec![0.05; (SIZE[0] * SIZE[1]) as usize])
    }
}

fn main() -> std::io::Result<()> {
    let config = CameraConfig {
        settings_latency_frames: 0,
        ..CameraConfig::default()
    };
    let camera = SimulatedCamera::new(
        config,
        Bench::new(BenchConfig::default(), Clock::real_time()),
        SensorModel::new(SensorConfig::typical(SIZE, 1)),
        Arc::new(Card),
    );
    let mut body = BodyConfig::default();
    if let Some(room) = std::env::args().nth(1) {
        body.room = room.parse().map_err(std::io::Error::other)?;
    }
    let server = PtpServer::start(Body::new(body, camera))?;
    println!("{}", server.port());
    loop {
        std::thread::park();
    }
}
