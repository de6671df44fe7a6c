//! The driver against simulated domes on pseudo-terminals.

use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::clock::Clock;
use mock_devices::dmx::{DmxConfig, DmxSimulator};
use mock_devices::dome::DomeSimulator;
use mock_devices::proxy::Proxy;

use super::*;
use crate::device::{DeviceError, LampChannel, LampState, LightStage, guardian};
use crate::units::StageAngles;

const LIGHTS: [[f64; 2]; 4] = [[0.0, 90.0], [0.0, 45.0], [120.0, 45.0], [-120.0, 30.0]];

fn angles([azimuth_deg, elevation_deg]: [f64; 2]) -> StageAngles {
    StageAngles {
        azimuth_deg,
        elevation_deg,
    }
}

fn bench() -> Bench {
    Bench::new(BenchConfig::default(), Clock::instant())
}

fn config(path: &std::path::Path, wiring: DomeWiring) -> DomeConfig {
    DomeConfig {
        port: path.display().to_string(),
        baud: 115_200,
        lights: FixedLights {
            directions: LIGHTS.map(angles).to_vec(),
            tolerance_deg: 1.0,
        },
        wiring,
        channels: 3,
        level: 255,
        connect_timeout: Seconds(5.0),
        reply_timeout: Seconds(2.0),
    }
}

fn dome() -> (DomeSimulator, DomeStage) {
    let config_of_dome = mock_devices::dome::DomeConfig::of_lights(LIGHTS.to_vec());
    let simulator = DomeSimulator::spawn(config_of_dome, bench()).unwrap();
    let stage = DomeStage::open(config(simulator.path(), DomeWiring::Line)).unwrap();
    (simulator, stage)
}

const ADDRESSES: [u16; 4] = [1, 4, 100, 510];

fn dmx() -> (DmxSimulator, DomeStage) {
    let lights = LIGHTS.into_iter().zip(ADDRESSES.map(usize::from)).collect();
    let simulator = DmxSimulator::spawn(DmxConfig { lights }, bench()).unwrap();
    let wiring = DomeWiring::Dmx {
        addresses: ADDRESSES.to_vec(),
    };
    let stage = DomeStage::open(config(simulator.path(), wiring)).unwrap();
    (simulator, stage)
}

/// A dome that knows its temperature says it; firmware of before is asked once.
#[test]
fn a_temperature_is_read_where_there_is_one() {
    let (simulator, mut stage) = dome();
    stage.home().unwrap();
    assert_eq!(stage.temperature_c(), Some(31.5));
    simulator.warm_to(68.25);
    assert!(
        stage
            .temperature_c()
            .is_some_and(|c| (c - 68.25).abs() < 0.06)
    );

    let of_before = mock_devices::dome::DomeConfig {
        temperature_c: None,
        ..mock_devices::dome::DomeConfig::of_lights(LIGHTS.to_vec())
    };
    let simulator = DomeSimulator::spawn(of_before, bench()).unwrap();
    let mut stage = DomeStage::open(config(simulator.path(), DomeWiring::Line)).unwrap();
    stage.home().unwrap();
    for _ in 0..3 {
        assert_eq!(stage.temperature_c(), None);
    }
    assert_eq!(simulator.requests("temperature"), 1);
    stage.move_to(angles(LIGHTS[1])).unwrap();
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();

    let (_packets, mut stage) = dmx();
    assert_eq!(stage.temperature_c(), None);
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
    let (line, line_stage) = dome();
    let (packets, dmx_stage) = dmx();
    for (bench, mut stage) in [
        (line.bench().clone(), line_stage),
        (packets.bench().clone(), dmx_stage),
    ] {
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
            assert!(there, "{}: light {light}", stage.info().driver);
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
}

#[test]
fn what_the_dome_says_is_what_is_told() {
    let (simulator, mut stage) = dome();
    assert!(stage.info().has_watchdog);
    assert_eq!(stage.info().firmware, "1.0");
    stage.home().unwrap();
    stage.move_to(angles(LIGHTS[2])).unwrap();
    stage.set_lamp(LampState::On(LampChannel(2))).unwrap();
    let status = stage.status().unwrap();
    assert_eq!(status.lamp, Some(LampState::On(LampChannel(2))));
    assert_eq!(status.position, Some(angles(LIGHTS[2])));
    simulator.break_light(1);
    let dark = stage.move_to(angles(LIGHTS[1])).unwrap_err();
    assert!(
        matches!(&dark, DeviceError::NotApplied { is, .. } if is.contains("without current")),
        "{dark}"
    );
    simulator.restart();
    let restarted = (0..1000).find_map(|_| match stage.status() {
        Ok(status) if status.position.is_some() => None,
        _ => Some(stage.move_to(angles(LIGHTS[0])).unwrap_err()),
    });
    assert!(
        matches!(&restarted, Some(DeviceError::NotHomed { since, .. }) if since.contains("restarted")),
        "{restarted:?}"
    );
    stage.home().unwrap();
    stage.move_to(angles(LIGHTS[0])).unwrap();
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
    let wiring = DomeWiring::Dmx {
        addresses: ADDRESSES.to_vec(),
    };
    let config = DomeConfig {
        connect_timeout: Seconds(0.2),
        ..config(simulator.path(), wiring)
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
    let wiring = DomeWiring::Dmx {
        addresses: ADDRESSES.to_vec(),
    };
    let config = config(proxy.path(), wiring);
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
    let config_of_dome = mock_devices::dome::DomeConfig {
        watchdog_s: 0.0,
        ..mock_devices::dome::DomeConfig::of_lights(LIGHTS.to_vec())
    };
    let line = DomeSimulator::spawn(config_of_dome, bench()).unwrap();
    let line_stage = DomeStage::open(config(line.path(), DomeWiring::Line)).unwrap();
    let (packets, dmx_stage) = dmx();
    let half_packet = &super::widget::packet(&[255; super::widget::SLOTS])[..200];
    for (bench, mut stage, begun) in [
        (line.bench().clone(), line_stage, &b"7 light 2 0 25"[..]),
        (packets.bench().clone(), dmx_stage, half_packet),
    ] {
        stage.home().unwrap();
        stage.move_to(angles(LIGHTS[1])).unwrap();
        stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
        assert!(settled(&bench, |bench| bench.lamp_drive() != [0.0; 3]));
        let stop = stage.port_stop().unwrap().unwrap();
        assert_eq!(stop.reports_lamp, stage.info().driver == "dome");
        stage.port.line().send(begun).unwrap();
        let watch = guardian::stand_guard(closed_socket(), stop.port, &stop.exchanges, &mut |_| {});
        assert!(matches!(watch, guardian::Watch::Acted(Ok(()))), "{watch:?}");
        assert_eq!(bench.lamp_drive(), [0.0; 3], "{}", stage.info().driver);
    }
}

#[test]
fn another_dome_than_the_rig_file_s_is_refused() {
    let (simulator, stage) = dome();
    drop(stage);
    let mut config = config(simulator.path(), DomeWiring::Line);
    config.lights.directions.pop();
    let Err(error) = DomeStage::open(config) else {
        panic!("another dome was accepted");
    };
    assert!(
        error
            .to_string()
            .contains("4 lights of 3 channels, not 3 of 3"),
        "{error}"
    );
}

#[test]
fn a_stop_handle_turns_the_lights_off() {
    let (simulator, mut stage) = dome();
    stage.home().unwrap();
    stage.move_to(angles(LIGHTS[0])).unwrap();
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    let mut handle = stage.stop_handle().unwrap();
    handle.stop().unwrap();
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);
    let stopped = stage.move_to(angles(LIGHTS[1])).unwrap_err();
    assert!(
        matches!(&stopped, DeviceError::NotHomed { since, .. } if since.contains("stopped")),
        "{stopped}"
    );
    let config = config(simulator.path(), DomeWiring::Line);
    drop(stage);
    handle.stop().unwrap();
    stop_port(&config).unwrap();
}

/// The dome's patience is 3 s of real time, long enough for a busy machine to
/// keep; the driver does nothing for longer.
#[test]
fn a_lit_dome_is_kept_awake() {
    let bench = Bench::new(BenchConfig::default(), Clock::real_time());
    let mut dome = mock_devices::dome::DomeConfig::of_lights(LIGHTS.to_vec());
    dome.watchdog_s = 3.0;
    let simulator = DomeSimulator::spawn(dome, bench).unwrap();
    let mut stage = DomeStage::open(config(simulator.path(), DomeWiring::Line)).unwrap();
    stage.home().unwrap();
    stage.move_to(angles(LIGHTS[0])).unwrap();
    stage.set_lamp(LampState::On(LampChannel(0))).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(4500));
    assert_eq!(simulator.bench().lamp_drive()[0], 1.0);
}
