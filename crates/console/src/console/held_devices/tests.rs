//! The bench on devices that do what a test wants, without a server.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use super::state::{Busy, LampWord, State};
use super::*;
use crate::capture::open::Devices;
use crate::console::hub::Hub;
use crate::console::picture::Marks;
use crate::console::picture::levels::SensorLevels;
use crate::device::*;
use crate::fault::{Advisor, Fault};
use crate::units::{Seconds, StageAngles};

/// What nothing here should ever take.
const PATIENCE: Duration = Duration::from_secs(30);
const TARGET: StageAngles = StageAngles::new(10.0, 45.0);

/// What the devices share with the test.
#[derive(Default)]
struct World {
    lit: AtomicBool,
    stopped: AtomicBool,
    stops: AtomicU32,
    /// Devices that are open.
    open: AtomicU32,
    is_busy: AtomicBool,
    stage_is_gone: AtomicBool,
    camera_is_gone: AtomicBool,
    camera_panics: AtomicBool,
    /// Stops are not confirmed.
    is_deaf: AtomicBool,
    /// Only a stop turns the lamp off.
    lamp_sticks: AtomicBool,
    /// Nobody knows of the lamp.
    lamp_is_unseen: AtomicBool,
    /// The stage answers nothing any more.
    stage_hangs: AtomicBool,
    /// The devices are not open yet.
    opens_late: AtomicBool,
}

impl World {
    fn is(flag: &AtomicBool) -> bool {
        flag.load(Ordering::SeqCst)
    }
    fn set(flag: &AtomicBool) {
        flag.store(true, Ordering::SeqCst);
    }
}

fn gone(device: &str) -> DeviceError {
    DeviceError::Disconnected {
        device: device.to_owned(),
    }
}

/// A stage whose moves last until they are stopped.
struct Stage(Arc<World>, StageInfo);

impl Drop for Stage {
    fn drop(&mut self) {
        self.0.lit.store(false, Ordering::SeqCst);
        self.0.open.fetch_sub(1, Ordering::SeqCst);
    }
}

impl LightStage for Stage {
    fn info(&self) -> &StageInfo {
        &self.1
    }
    fn home(&mut self) -> Result<StageStatus, DeviceError> {
        self.status()
    }
    fn move_to(&mut self, _: StageAngles) -> Result<StageAngles, DeviceError> {
        self.0.stopped.store(false, Ordering::SeqCst);
        while !World::is(&self.0.stopped) {
            std::thread::sleep(Duration::from_millis(1));
        }
        Err(DeviceError::NotHomed {
            device: "stage".to_owned(),
            since: "it was stopped".to_owned(),
        })
    }
    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError> {
        if lamp == LampState::On(LampChannel(9)) {
            return Err(DeviceError::Refused {
                device: "stage".to_owned(),
                command: "lamp channel 9".to_owned(),
                reason: "there is none".to_owned(),
            });
        }
        if World::is(&self.0.lamp_sticks) && World::is(&self.0.lit) {
            return Err(DeviceError::NotApplied {
                device: "stage".to_owned(),
                what: "the lamp".to_owned(),
                is: "lit".to_owned(),
                wanted: "another".to_owned(),
            });
        }
        self.0.lit.store(lamp != LampState::Off, Ordering::SeqCst);
        Ok(lamp)
    }
    fn reports_lamp(&self) -> bool {
        !World::is(&self.0.lamp_is_unseen)
    }
    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        if World::is(&self.0.stage_is_gone) {
            return Err(gone("stage"));
        }
        while World::is(&self.0.stage_hangs) {
            std::thread::sleep(Duration::from_millis(1));
        }
        let lamp = match World::is(&self.0.lit) {
            true => LampState::On(LampChannel(0)),
            false => LampState::Off,
        };
        Ok(StageStatus {
            activity: StageActivity::Idle,
            position: Some(TARGET),
            lamp: self.reports_lamp().then_some(lamp),
        })
    }
    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError> {
        Ok(Box::new(Stop(Arc::clone(&self.0))))
    }
}

struct Stop(Arc<World>);

impl StopHandle for Stop {
    fn stop(&mut self) -> Result<(), DeviceError> {
        self.0.stops.fetch_add(1, Ordering::SeqCst);
        World::set(&self.0.stopped);
        self.0.lit.store(false, Ordering::SeqCst);
        match World::is(&self.0.is_deaf) {
            true => Err(gone("stage")),
            false => Ok(()),
        }
    }
}

struct Eye(Arc<World>, CameraInfo);

impl Drop for Eye {
    fn drop(&mut self) {
        self.0.open.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Camera for Eye {
    fn info(&self) -> &CameraInfo {
        &self.1
    }
    fn configure(&mut self, wanted: CameraSettings) -> Result<CameraSettings, DeviceError> {
        // In steps of 1 ms.
        let exposure = Seconds((wanted.exposure.0 * 1e3).round() * 1e-3);
        Ok(CameraSettings { exposure, ..wanted })
    }
    fn set_shutter(&mut self, _: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }
    fn grab(&mut self, _: FrameKey) -> Result<RawFrame, DeviceError> {
        assert!(!World::is(&self.0.camera_panics), "a defect");
        if World::is(&self.0.camera_is_gone) {
            return Err(gone("camera"));
        }
        let dn = if World::is(&self.0.lit) { 3000 } else { 64 };
        Ok(RawFrame::new(8, 6, vec![dn; 48]))
    }
}

fn devices(world: &Arc<World>) -> Devices {
    world.open.fetch_add(2, Ordering::SeqCst);
    let stage = StageInfo {
        driver: "test".to_owned(),
        firmware: String::new(),
        port: "none".to_owned(),
        has_watchdog: false,
    };
    let camera = CameraInfo {
        driver: "test".to_owned(),
        model: "eye".to_owned(),
        serial: "1".to_owned(),
        resolution_px: [8, 6],
        bit_depth: 12,
        mosaic: Mosaic::None,
        exposure_range: [Seconds(1e-3), Seconds(1.0)],
        exposure_step: Seconds(1e-3),
    };
    Devices::new(
        Box::new(Stage(Arc::clone(world), stage)),
        Box::new(Eye(Arc::clone(world), camera)),
    )
}

fn bench(world: &Arc<World>) -> HeldDevices {
    let world = Arc::clone(world);
    let ports = BenchPorts {
        open: Box::new(move || match World::is(&world.is_busy) {
            true => Err(Fault {
                error: "the port is in use".to_owned(),
                hint: Some("end the other program".to_owned()),
            }),
            false => {
                while World::is(&world.opens_late) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Ok(Opened::Rig(devices(&world)))
            }
        }),
        advisor: Advisor::new(|error| error.is::<Unstopped>().then(|| "the button".to_owned())),
        levels: Box::new(|_| SensorLevels::default()),
        settings: CameraSettings::new(Seconds(10e-3), 1.0),
        silence: Box::new(|| None),
    };
    HeldDevices::new(Hub::default(), ports).unwrap()
}

#[track_caller]
fn wait_for(bench: &HeldDevices, what: &str, is: impl Fn(&State) -> bool) -> State {
    let began = Instant::now();
    loop {
        let state = bench.state();
        if is(&state) {
            return state;
        }
        assert!(began.elapsed() < PATIENCE, "not {what}: {state:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Connected, with the lamp on, in the middle of a move.
fn lit_and_moving(world: &Arc<World>) -> HeldDevices {
    let bench = connected(world);
    light(world, &bench);
    bench.move_to(TARGET).unwrap();
    wait_for(&bench, "moving", |state| state.busy == Some(Busy::Moving));
    bench
}

#[track_caller]
fn connected(world: &Arc<World>) -> HeldDevices {
    let bench = bench(world);
    bench.connect().unwrap();
    wait_for(&bench, "connected", |state| state.view.is_some());
    bench
}

fn picture_number(bench: &HeldDevices) -> u64 {
    let marks = Marks {
        limits: true,
        peaking: false,
    };
    let picture = bench.live().picture(marks).unwrap();
    picture.map_or(0, |picture| picture.number)
}

#[test]
fn a_page_connects_sees_switches_and_disconnects() {
    let world = Arc::<World>::default();
    let bench = connected(&world);
    let state = bench.state();
    assert!(state.connected && state.busy.is_none() && state.error.is_none());
    assert_eq!(state.camera.unwrap().model, "eye");
    assert!(bench.connect().is_err(), "it is connected already");
    assert!(picture_number(&bench) > 0);

    // The picture shows the lamp; the settings are those that the camera applied.
    bench.set_lamp(Some(LampChannel(0))).unwrap();
    let lit = |state: &State| {
        state
            .view
            .as_ref()
            .is_some_and(|v| v.figures.framing.mean_dn > 1e3)
    };
    let state = wait_for(&bench, "lit", lit);
    assert!(
        state
            .lamp_off_in_s
            .is_some_and(|left| (0.0..=30.0).contains(&left))
    );
    let wanted = CameraSettings::new(Seconds(20.4e-3), 2.0);
    bench.set_exposure(wanted).unwrap();
    let applied = |state: &State| state.settings.is_some_and(|s| s.gain == 2.0);
    let state = wait_for(&bench, "applied", applied);
    assert_eq!(state.settings.unwrap().exposure_s, Seconds(0.02));

    bench.disconnect();
    let state = wait_for(&bench, "disconnected", |state| {
        !state.connected && state.busy.is_none()
    });
    assert!(state.error.is_none() && state.view.is_none(), "{state:?}");
    assert!(!World::is(&world.lit));
    assert_eq!(
        world.open.load(Ordering::SeqCst),
        0,
        "devices are still open"
    );
    assert_eq!(picture_number(&bench), 0);
    assert!(bench.home().is_err() && bench.set_exposure(wanted).is_err());
}

#[test]
fn a_stop_waits_behind_no_move_and_the_picture_goes_on() {
    let world = Arc::<World>::default();
    let bench = lit_and_moving(&world);
    assert!(bench.home().is_err(), "one action at a time");
    let before = picture_number(&bench);
    wait_for(&bench, "going on", |_| picture_number(&bench) > before + 2);
    let began = Instant::now();
    assert_eq!(bench.stop(), Ok(Stopping("the stage")));
    let state = wait_for(&bench, "stopped", |state| state.busy.is_none());
    assert!(
        began.elapsed() < Duration::from_secs(5),
        "{:?}",
        began.elapsed()
    );
    assert!(state.connected && state.error.is_none(), "{state:?}");
    assert!(!World::is(&world.lit));
    // And is there for the next command.
    bench.home().unwrap();
    wait_for(&bench, "homed", |state| state.busy.is_none());
}

#[test]
fn a_stop_that_is_not_confirmed_is_an_error_with_advice() {
    let world = Arc::<World>::default();
    let bench = connected(&world);
    World::set(&world.is_deaf);
    assert!(bench.stop().is_ok());
    let state = wait_for(&bench, "reported", |state| state.error.is_some());
    let fault = state.error.unwrap();
    assert!(
        fault.error.contains("did not confirm that it stopped"),
        "{fault:?}"
    );
    assert_eq!(fault.hint.as_deref(), Some("the button"));
}

#[test]
fn a_stop_says_what_it_has_reached() {
    let world = Arc::<World>::default();
    let bench = bench(&world);
    assert_eq!(bench.stop(), Err(NotStopped::NotConnected));
    // Devices that are being opened are stopped when they are open.
    World::set(&world.opens_late);
    bench.connect().unwrap();
    assert_eq!(
        bench.stop(),
        Ok(Stopping("the bench, as soon as it is connected"))
    );
    world.opens_late.store(false, Ordering::SeqCst);
    wait_for(&bench, "stopped", |_| {
        world.stops.load(Ordering::SeqCst) >= 1
    });
    wait_for(&bench, "connected", |state| {
        state.connected && state.busy.is_none()
    });
    assert_eq!(bench.stop(), Ok(Stopping("the stage")));
    // What they are lent to may be ended or not.
    let loan = bench.lend("a capture", PATIENCE).unwrap();
    assert_eq!(bench.stop(), Err(NotStopped::Lent("a capture")));
    bench.stop_borrower_by(Box::new(|| true));
    assert_eq!(bench.stop(), Ok(Stopping("a capture")));
    drop(loan);
    assert_eq!(bench.stop(), Err(NotStopped::NotConnected));
}

fn light(world: &World, bench: &HeldDevices) {
    bench.set_lamp(Some(LampChannel(0))).unwrap();
    wait_for(bench, "lit", |state| {
        state.busy.is_none() && World::is(&world.lit)
    });
}

#[test]
fn a_lamp_that_does_not_obey_is_stopped() {
    for channel in [None, Some(LampChannel(1))] {
        let world = Arc::<World>::default();
        let bench = connected(&world);
        light(&world, &bench);
        World::set(&world.lamp_sticks);
        bench.set_lamp(channel).unwrap();
        let state = wait_for(&bench, "reported", |state| {
            state.busy.is_none() && state.error.is_some()
        });
        let stage = state.stage.unwrap();
        assert!(state.connected && !World::is(&world.lit), "{channel:?}");
        assert_eq!(stage.lamp, LampState::Off, "{channel:?}");
        let fact = state.error.unwrap().error;
        assert!(
            fact.ends_with("was stopped and reports its lamp off now"),
            "{fact}"
        );
    }
    // Also when the devices are closed, and where the stop is not confirmed.
    for (is_deaf, fact) in [(false, "reports its lamp off now"), (true, "disconnected")] {
        let world = Arc::<World>::default();
        let bench = connected(&world);
        light(&world, &bench);
        World::set(&world.lamp_sticks);
        world.is_deaf.store(is_deaf, Ordering::SeqCst);
        bench.disconnect();
        let state = wait_for(&bench, "closed", |state| !state.connected);
        assert!(!World::is(&world.lit));
        assert!(state.error.unwrap().error.ends_with(fact), "{fact}");
    }
}

#[test]
fn a_lamp_that_is_not_reported_is_said_to_be_sent() {
    let world = Arc::<World>::default();
    World::set(&world.lamp_is_unseen);
    let bench = connected(&world);
    let word = |state: State| state.stage.unwrap().lamp_word;
    assert_eq!(word(bench.state()), None);
    light(&world, &bench);
    assert_eq!(word(bench.state()), Some(LampWord::Sent));
    bench.set_lamp(None).unwrap();
    let state = wait_for(&bench, "off", |state| state.busy.is_none());
    assert_eq!(word(state), Some(LampWord::Sent));
    world.lamp_is_unseen.store(false, Ordering::SeqCst);
    let reported = |state: &State| state.stage.unwrap().lamp_word == Some(LampWord::Reported);
    wait_for(&bench, "reported", reported);
}

#[test]
fn a_stage_that_hangs_is_stopped_and_not_waited_for() {
    let world = Arc::<World>::default();
    let bench = connected(&world);
    light(&world, &bench);
    World::set(&world.stage_hangs);
    let began = Instant::now();
    assert!(!bench.end(PATIENCE, || false) || !World::is(&world.lit));
    assert!(!World::is(&world.lit), "the stop reaches it");
    assert!(
        began.elapsed() < Duration::from_secs(5),
        "{:?}",
        began.elapsed()
    );
    world.stage_hangs.store(false, Ordering::SeqCst);
}

#[test]
fn what_a_stage_refuses_leaves_it_connected() {
    let world = Arc::<World>::default();
    let bench = connected(&world);
    bench.set_lamp(Some(LampChannel(9))).unwrap();
    let state = wait_for(&bench, "refused", |state| state.error.is_some());
    assert!(state.connected && state.busy.is_none(), "{state:?}");
    assert!(state.error.unwrap().error.contains("there is none"));
    bench.home().unwrap();
    assert!(bench.state().error.is_none(), "the next command clears it");
}

#[test]
fn devices_that_fail_are_closed_and_can_be_connected_again() {
    type Blow = fn(&World) -> &AtomicBool;
    let blows: [(Blow, &str); 4] = [
        (|world| &world.stage_is_gone, "stage was disconnected"),
        (|world| &world.camera_is_gone, "camera was disconnected"),
        (|world| &world.camera_panics, "a defect of this program"),
        (|world| &world.is_busy, "the port is in use"),
    ];
    for (blow, fact) in blows {
        let world = Arc::<World>::default();
        let bench = connected(&world);
        World::set(blow(&world));
        if fact.contains("port") {
            bench.disconnect();
            wait_for(&bench, "disconnected", |state| {
                !state.connected && state.busy.is_none()
            });
            bench.connect().unwrap();
        } else {
            bench.set_lamp(Some(LampChannel(0))).ok();
        }
        let state = wait_for(&bench, fact, |state| {
            state.error.is_some() && !state.connected
        });
        assert!(state.error.unwrap().error.contains(fact), "{fact}");
        assert!(!World::is(&world.lit), "{fact}");
        assert_eq!(world.open.load(Ordering::SeqCst), 0, "{fact}");
        blow(&world).store(false, Ordering::SeqCst);
        let began = Instant::now();
        while let Err(fault) = bench.connect() {
            assert!(began.elapsed() < PATIENCE, "{fault:?}");
            std::thread::sleep(Duration::from_millis(2));
        }
        wait_for(&bench, "connected again", |state| state.view.is_some());
    }
}

#[test]
fn lent_devices_are_closed_and_stay_so() {
    let world = Arc::<World>::default();
    let bench = connected(&world);
    bench.move_to(TARGET).unwrap();
    let loan = bench.lend("a capture", PATIENCE).unwrap();
    assert_eq!(world.open.load(Ordering::SeqCst), 0);
    let refused = bench.connect().unwrap_err();
    assert!(refused.error.contains("in use by a capture"), "{refused:?}");
    assert!(bench.lend("another", PATIENCE).is_err());
    drop(loan);
    bench.connect().unwrap();
    wait_for(&bench, "connected", |state| state.view.is_some());
}

#[test]
fn the_end_closes_the_devices_whatever_they_do() {
    let world = Arc::<World>::default();
    let bench = lit_and_moving(&world);
    let began = Instant::now();
    assert!(bench.end(PATIENCE, || false));
    assert!(
        began.elapsed() < Duration::from_secs(5),
        "{:?}",
        began.elapsed()
    );
    assert!(!World::is(&world.lit));
    assert_eq!(world.open.load(Ordering::SeqCst), 0);
    assert!(
        bench.end(PATIENCE, || false),
        "a second end finds nothing to do"
    );
}
