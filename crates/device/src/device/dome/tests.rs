//! The driver against a simulated interface on a pseudo-terminal.

use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::clock::Clock;
use mock_devices::dmx::{DmxConfig, DmxSimulator};
use mock_devices::proxy::Proxy;

use super::*;
use crate::device::{DeviceError, LampChannel, LampState, LightStage, guardian};
use crate::units::StageAngles;

const LIGHTS: [[f64; 2]; 4] = [[0.0, 90.0], [0.0, 45.0], [120.0, 45.0], [-120.0, 30.0]];

fn angles([azimuth_deg, elevation_deg]: [f64; 2]) -> StageAngles {
    StageAngles::new(azimuth_deg, elevation_deg)
}

fn bench() -> Bench {
    Bench::new(BenchConfig::default(), Clock::instant())
}

fn config(path: &std::path::Path) -> DomeConfig {
    DomeConfig {
        port: path.display().to_string(),
        baud: 115_200,
        lights: FixedLights {
            directions: LIGHTS.map(angles).to_vec(),
            tolerance_deg: 1.0,
        },
        addresses: ADDRESSES.to_vec(),
        channels: 3,
        level: 255,
        connect_timeout: Seconds(5.0),
    }
}

const ADDRESSES: [u16; 4] = [1, 4, 100, 510];

fn dmx() -> (DmxSimulator, DomeStage) {
    let lights = LIGHTS.into_iter().zip(ADDRESSES.map(usize::from)).collect();
    let simulator = DmxSimulator::spawn(DmxConfig { lights }, bench()).unwrap();
    let stage = DomeStage::open(config(simulator.path())).unwrap();
    (simulator, stage)
}

/// A DMX packet isn't answered, so the test waits until it has arrived.
fn settled(bench: &Bench, wanted: impl Fn(&Bench) -> bool) -> bool {
    (0..2000).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(2));
        wanted(bench)
    })
}

#[test]
fn every_light_shines_from_its_direction() {
    let (packets, mut stage) = dmx();
    let bench = packets.bench().clone();
    let refused = stage.move_to(angles(LIGHTS[0])).unwrap_err();
    assert!(matches!(refused, DeviceError::NotHomed { .. }), "{refused}");
    stage.home().unwrap();
    let nowhere = stage.set_lamp(LampState::On(LampChannel(0))).unwrap_err();
    assert!(matches!(nowhere, DeviceError::Refused { .. }), "{nowhere}");
    for (light, direction) in LIGHTS.into_iter().enumerate() {
        let near = [direction[0], direction[1] - 0.5];
        assert_eq!(stage.move_to(angles(near)).unwrap(), angles(direction));
        let channel = (light % 3) as u8;
        let on = LampState::On(LampChannel(channel));
        assert_eq!(stage.set_lamp(on).unwrap(), on);
        let mut drive = [0.0; 3];
        drive[usize::from(channel)] = 1.0;
        let there = settled(&bench, |bench| {
            let is = bench.stage_angles_deg();
            let off_deg = (is[0] - direction[0])
                .abs()
                .max((is[1] - direction[1]).abs());
            bench.lamp_drive() == drive && off_deg < 1e-6
        });
        assert!(there, "light {light}");
    }
    let outside = stage.move_to(angles([60.0, 45.0])).unwrap_err();
    assert!(
        matches!(outside, DeviceError::OutOfReach { .. }),
        "{outside}"
    );
    stage.set_lamp(LampState::Off).unwrap();
    assert!(settled(&bench, |bench| bench.lamp_drive() == [0.0; 3]));
    // A lit lamp goes on at the next place, and off where its driver ends.
    stage.set_lamp(LampState::On(LampChannel(1))).unwrap();
    stage.move_to(angles(LIGHTS[1])).unwrap();
    assert!(settled(&bench, |bench| {
        bench.lamp_drive()[1] == 1.0 && (bench.stage_angles_deg()[1] - 45.0).abs() < 1e-6
    }));
    drop(stage);
    assert!(settled(&bench, |bench| bench.lamp_drive() == [0.0; 3]));
}

#[test]
fn dmx_says_that_it_verifies_nothing() {
    let (simulator, mut stage) = dmx();
    assert_eq!(stage.info().driver, "dmx");
    assert_eq!(
        stage.info().firmware,
        "1.44 (DMX interface 87654321; lights unverified)"
    );
    assert!(!stage.info().has_watchdog);
    stage.home().unwrap();
    assert_eq!(stage.status().unwrap().lamp, None);
    assert!(settled(simulator.bench(), |_| simulator.packets() > 0));
    drop(stage);
    simulator.mute();
    let config = DomeConfig {
        connect_timeout: Seconds(0.2),
        ..config(simulator.path())
    };
    let Err(silent) = DomeStage::open(config) else {
        panic!("a mute interface was accepted");
    };
    assert!(matches!(silent, DeviceError::NoReply { .. }), "{silent}");
}

/// The interface is unplugged with a light on, which goes on shining: what is sent
/// fails, and the next connection lights nothing and turns it off.
#[test]
fn a_dmx_interface_that_was_unplugged_comes_back_dark() {
    let lights = LIGHTS.into_iter().zip(ADDRESSES.map(usize::from)).collect();
    let simulator = DmxSimulator::spawn(DmxConfig { lights }, bench()).unwrap();
    let proxy = Proxy::to_packets(simulator.path(), super::widget::END).unwrap();
    let config = config(proxy.path());
    let mut stage = DomeStage::open(config.clone()).unwrap();
    stage.home().unwrap();
    stage.move_to(angles(LIGHTS[2])).unwrap();
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    let lit = |bench: &Bench| bench.lamp_drive() != [0.0; 3];
    assert!(settled(simulator.bench(), lit));
    proxy.unplug();
    let gone = stage.set_lamp(LampState::Off).unwrap_err();
    assert!(matches!(gone, DeviceError::Disconnected { .. }), "{gone}");
    let still_gone = stage.home().unwrap_err();
    assert!(
        matches!(still_gone, DeviceError::Disconnected { .. }),
        "{still_gone}"
    );
    drop(stage);
    assert!(DomeStage::open(config.clone()).is_err());
    proxy.plug_in().unwrap();
    let mut stage = DomeStage::open(config).unwrap();
    assert!(settled(simulator.bench(), |bench| !lit(bench)));
    let refused = stage.move_to(angles(LIGHTS[2])).unwrap_err();
    assert!(matches!(refused, DeviceError::NotHomed { .. }), "{refused}");
    stage.home().unwrap();
    stage.move_to(angles(LIGHTS[2])).unwrap();
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    assert!(settled(simulator.bench(), lit));
}

/// The guardian's end of a socket whose other end is gone.
fn closed_socket() -> std::os::unix::net::UnixStream {
    std::os::unix::net::UnixStream::pair().unwrap().0
}

/// The driver's process is gone in the middle of a request, and its port is all
/// that is left.
#[test]
fn a_guardian_turns_the_lights_off_over_the_open_port() {
    let (packets, mut stage) = dmx();
    let bench = packets.bench().clone();
    let half_packet = &super::widget::packet(&[255; super::widget::SLOTS])[..200];
    stage.home().unwrap();
    stage.move_to(angles(LIGHTS[1])).unwrap();
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    assert!(settled(&bench, |bench| bench.lamp_drive() != [0.0; 3]));
    let stop = stage.port_stop().unwrap().unwrap();
    assert!(!stop.reports_lamp);
    stage.port.line().send(half_packet).unwrap();
    let watch = guardian::stand_guard(closed_socket(), stop.port, &stop.exchanges, &mut |_| {});
    assert!(matches!(watch, guardian::Watch::Acted(Ok(()))), "{watch:?}");
    assert_eq!(bench.lamp_drive(), [0.0; 3]);
}

#[test]
fn a_stop_handle_turns_the_lights_off() {
    let (simulator, mut stage) = dmx();
    let dark = |bench: &Bench| bench.lamp_drive() == [0.0; 3];
    stage.home().unwrap();
    stage.move_to(angles(LIGHTS[0])).unwrap();
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    assert!(settled(simulator.bench(), |bench| !dark(bench)));
    let mut handle = stage.stop_handle().unwrap();
    handle.stop().unwrap();
    assert!(settled(simulator.bench(), dark));
    let stopped = stage.move_to(angles(LIGHTS[1])).unwrap_err();
    assert!(
        matches!(&stopped, DeviceError::NotHomed { since, .. } if since.contains("stopped")),
        "{stopped}"
    );
    drop(stage);
    handle.stop().unwrap();
    stop_port(&config(simulator.path())).unwrap();
}
