//! Captures on a bench in memory: whole, interrupted, broken and resumed.

use std::sync::Arc;

use crate::capture_support::*;
use rig::capture::{CaptureError, Outcome};
use rig::device::temperature::{Part, TemperatureLimits};
use rig::device::{FrameKind, LampState, ReferenceCheck};
use rig::session::commit::SystemDisk;
use rig::session::faults::{Fault, FaultyDisk, SmallDisk, UnsyncedDisk};
use rig::session::{Event, Journal, Session, SessionWriter, layout, verify};

/// An uninterrupted session: its content and how many frames were grabbed.
fn whole() -> (std::collections::BTreeMap<std::path::PathBuf, Vec<u8>>, u32) {
    let parent = tempfile::tempdir().unwrap();
    let bench = Bench::new();
    let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
    let root = session.root().to_owned();
    assert_eq!(capture(&bench, session).0.unwrap(), Outcome::Complete);
    let grabs = bench.world().grabs;
    (content(&root), grabs)
}

#[test]
fn a_capture_keeps_its_promises() {
    let parent = tempfile::tempdir().unwrap();
    let bench = Bench::new();
    let session = create(Arc::new(SystemDisk), parent.path()).unwrap();
    let root = session.root().to_owned();
    let (result, heard) = capture(&bench, session);
    assert_eq!(result.unwrap(), Outcome::Complete);
    assert_eq!(heard.warnings, [""; 0]);
    assert!(heard.done.is_sorted() && *heard.done.last().unwrap() > 0.8);
    {
        let world = bench.world();
        assert_eq!((world.lamp, world.stops), (LampState::Off, 0));
        assert_eq!((world.homings, world.moves), (1, 2));
    }
    let found = verify::verify(&root).unwrap();
    assert!(found.is_intact() && found.complete);

    let session = Session::open(&root).unwrap();
    let rules = session.record().plan.exposure;
    for light in 0..2 {
        assert!(session.light_is_finished(light));
        assert!(session.read_file(&layout::radiance_file(light)).is_ok());
        let frames: Vec<_> = session
            .frames()
            .filter(|entry| entry.key.light == light)
            .map(|entry| session.read_frame(&entry).unwrap())
            .collect();
        let of_kind = |kind| {
            frames
                .iter()
                .filter(move |(_, s)| s.key.kind == kind && !s.pilot)
        };
        let shortest_s = of_kind(FrameKind::Light)
            .map(|(_, s)| s.applied.exposure.0)
            .fold(f64::INFINITY, f64::min);
        for (frame, sidecar) in &frames {
            assert_eq!(sidecar.frames_discarded, 2, "{:?}", sidecar.key);
            assert_eq!(sidecar.stage_position, sidecar.stage_target);
            if sidecar.applied.exposure.0 == shortest_s && !sidecar.pilot {
                assert!(
                    frame.counts.iter().all(|&count| count < 4095),
                    "{:?}",
                    sidecar.key
                );
            }
            if let Some(ratio) = sidecar.exposure_ratio {
                assert!((ratio - 1.0).abs() < 0.03, "{:?}: {ratio}", sidecar.key);
            }
        }
        assert!(
            frames
                .iter()
                .filter(|(_, s)| s.exposure_ratio.is_some())
                .count()
                >= 4
        );
        // As many frames without the lamp as with each channel, at every exposure.
        let exposures = |kind, lamp: Option<LampState>| {
            let mut all: Vec<f64> = of_kind(kind)
                .filter(|(_, s)| lamp.is_none_or(|lamp| s.lamp == lamp))
                .map(|(_, s)| s.applied.exposure.0)
                .collect();
            all.sort_by(f64::total_cmp);
            all
        };
        let ambient = exposures(FrameKind::Ambient, None);
        for &channel in &session.record().plan.channels {
            assert_eq!(
                exposures(FrameKind::Light, Some(LampState::On(channel))),
                ambient
            );
        }
        let mut dark = ambient.clone();
        dark.dedup();
        assert_eq!(exposures(FrameKind::Dark, None), dark);
        assert!(
            ambient
                .iter()
                .all(|&s| s >= rules.shortest_s.0 && s <= rules.longest_s.0)
        );
        // The darkest lit pixels of the weaker channel reach the stated SNR in the longest exposure.
        assert!(ambient.last().unwrap() / ambient[0] > 10.0, "{ambient:?}");
    }
}

/// Ctrl-C at every frame that is grabbed: it is kept, the lamp is off, and the
/// resumed session is the uninterrupted one.
#[test]
fn interrupted_at_any_frame_it_resumes_to_the_same_session() {
    let (expected, grabs) = whole();
    // After the last frame nothing is left to interrupt.
    for at in 1..grabs {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::with(|world| world.interrupt_at_grab = Some(at));
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let root = session.root().to_owned();
        let (result, _) = capture(&bench, session);
        assert_eq!(result.unwrap(), Outcome::Interrupted, "at frame {at}");
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 0));
        // The frame is finished first, with those that must be thrown away for it.
        assert!(bench.world().grabs <= at + 2, "at frame {at}");
        let finished = Session::open(&root).unwrap().frames().count();
        assert!(verify::verify(&root).unwrap().is_intact());
        let heard = resume(Arc::new(UnsyncedDisk), &root);
        assert_eq!(heard.resumed, finished);
        assert_eq!(content(&root), expected, "at frame {at}");
    }
}

/// A fault at every n-th operation of the disk, of every kind: finished frames
/// stay, and the resumed session is the uninterrupted one.
#[test]
fn a_fault_at_any_write_loses_no_finished_frame() {
    let (expected, _) = whole();
    // Coprime strides so that the kinds together meet all phases of a commit.
    for (fault, stride) in Fault::ALL.into_iter().zip([53, 47, 41, 23]) {
        for at in (0..).step_by(stride) {
            let parent = tempfile::tempdir().unwrap();
            let disk = Arc::new(FaultyDisk::over(Arc::new(UnsyncedDisk), at, fault));
            let bench = Bench::new();
            let result = create(disk.clone(), parent.path())
                .map_err(CaptureError::from)
                .and_then(|session| capture(&bench, session).0);
            assert_eq!(bench.world().lamp, LampState::Off, "{fault:?} at {at}");
            if result.is_ok() {
                assert!(disk.operations() <= at, "{fault:?} at {at} went unnoticed");
                break;
            }
            let Some(root) = session_in(parent.path()) else {
                assert_eq!(bench.world().moves, 0, "{fault:?} at {at}");
                continue;
            };
            let finished: Vec<_> = Journal::read(&root)
                .unwrap()
                .files()
                .into_iter()
                .filter(|file| !layout::is_derived(&file.path))
                .cloned()
                .collect();
            resume(Arc::new(UnsyncedDisk), &root);
            assert_eq!(content(&root), expected, "{fault:?} at {at}");
            for file in finished {
                verify::check(&root, &file).unwrap();
            }
        }
    }
}

#[test]
fn a_device_that_fails_leaves_the_lamp_off_the_stage_stopped_and_a_session_to_resume() {
    let (expected, _) = whole();
    let cases: [fn(&mut World); 4] = [
        |world| world.fail_at_move = Some(1),
        |world| world.fail_at_move = Some(2),
        |world| world.fail_at_grab = Some(1),
        |world| world.fail_at_grab = Some(40),
    ];
    for (case, change) in cases.into_iter().enumerate() {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::with(change);
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let root = session.root().to_owned();
        let (result, _) = capture(&bench, session);
        assert!(
            matches!(result, Err(CaptureError::Device(_))),
            "case {case}: {result:?}"
        );
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 1), "case {case}");
        let journal = Journal::read(&root).unwrap();
        let last = &journal.records.last().unwrap().event;
        assert!(
            matches!(last, Event::Interrupted { .. }),
            "case {case}: {last:?}"
        );
        resume(Arc::new(UnsyncedDisk), &root);
        assert_eq!(content(&root), expected, "case {case}");
    }
}

/// A panic in a driver's thread or in the capture's own.
#[test]
fn a_defect_leaves_the_lamp_off_and_the_stage_stopped() {
    let parent = tempfile::tempdir().unwrap();
    let bench = Bench::with(|world| world.panic_at_grab = Some(40));
    let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
    let root = session.root().to_owned();
    let result = capture(&bench, session).0;
    assert!(
        matches!(result, Err(CaptureError::WorkerGone { name: "camera" })),
        "{result:?}"
    );
    assert_eq!(bench.lamp_and_stops(), (LampState::Off, 1));
    resume(Arc::new(UnsyncedDisk), &root);

    let parent = tempfile::tempdir().unwrap();
    let bench = Bench::with(|world| world.panic_at_frame = Some(3));
    let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
    let unwound = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        capture(&bench, session).0.map(|_| ())
    }));
    assert!(unwound.is_err());
    assert_eq!(bench.lamp_and_stops(), (LampState::Off, 1));
}

/// Asked once or twice, a stage in motion is stopped beside its driver, which
/// waits.
#[test]
fn asked_in_mid_motion_it_stops_at_once_while_the_driver_waits() {
    for requests in [1, 2] {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::with(|world| world.hang_in_move = requests);
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let root = session.root().to_owned();
        assert_eq!(capture(&bench, session).0.unwrap(), Outcome::Interrupted);
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 1));
        // Those that its new settings cost are nobody's.
        assert_eq!(Session::open(&root).unwrap().frames().count(), 0);
        resume(Arc::new(UnsyncedDisk), &root);
    }
}

/// A stop that the stage does not confirm is the error, whatever led to it.
#[test]
fn a_stage_that_does_not_confirm_its_stop_is_told() {
    let cases: [fn(&mut World); 3] = [
        |world| world.hang_in_move = 1,
        |world| world.fail_at_move = Some(2),
        |world| world.fail_at_grab = Some(9),
    ];
    for change in cases {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::with(|world| {
            world.stop_fails = true;
            change(world);
        });
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let (result, _) = capture(&bench, session);
        assert!(
            matches!(result, Err(CaptureError::NotStopped { .. })),
            "{result:?}"
        );
    }
}

/// In a pause the lamp is off and every frame is on the disk; afterwards the
/// stage is homed, and the session becomes what it would have been.
#[test]
fn a_pause_at_any_frame_changes_only_the_journal() {
    let (expected, grabs) = whole();
    for at in (1..grabs - 6).step_by(11) {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::with(|world| world.pause_at_grab = Some(at));
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let root = session.root().to_owned();
        let (result, heard) = capture(&bench, session);
        assert_eq!(result.unwrap(), Outcome::Complete, "at frame {at}");
        let [(lamp, frames)] = heard.pauses[..] else {
            panic!("at frame {at}: {:?}", heard.pauses);
        };
        assert_eq!(lamp, LampState::Off, "at frame {at}");
        let events = Journal::read(&root).unwrap().records;
        let is_frame = |event: &Event| matches!(event, Event::Frame { .. });
        let paused = events.iter().position(|r| r.event == Event::Paused);
        let before = &events[..paused.unwrap()];
        assert_eq!(before.iter().filter(|r| is_frame(&r.event)).count(), frames);
        assert!(events.iter().any(|r| r.event == Event::Continued));
        assert_eq!(bench.world().homings, 2, "at frame {at}");
        assert_eq!(content(&root), expected, "at frame {at}");
    }
}

#[test]
fn a_disk_that_fills_suspends_before_it_is_full() {
    let (expected, _) = whole();
    for free_bytes in [50_000, 60_000, 75_000] {
        let parent = tempfile::tempdir().unwrap();
        let disk = SmallDisk::over(Arc::new(UnsyncedDisk), free_bytes);
        let bench = Bench::with(|world| world.reserve_bytes = 20_000);
        let session = create(Arc::new(disk), parent.path()).unwrap();
        let root = session.root().to_owned();
        let (result, heard) = capture(&bench, session);
        let Err(CaptureError::LowDisk { free_bytes, .. }) = result else {
            panic!("{result:?}");
        };
        assert!(free_bytes > 20_000, "{free_bytes}");
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 0));
        let session = Session::open(&root).unwrap();
        assert_eq!(session.frames().count(), heard.done.len());
        let last = &session.journal().records.last().unwrap().event;
        assert!(
            matches!(last, Event::Interrupted { reason } if reason.contains(" free, and ")),
            "{last:?}"
        );
        resume(Arc::new(UnsyncedDisk), &root);
        assert_eq!(content(&root), expected);
    }
}

/// Temperatures stand in the sidecars; near its limit a part is warned of once, above it
/// the capture is suspended with the lamp off, and goes on when all is cool.
#[test]
fn a_hot_device_suspends() {
    let (expected, _) = whole();
    for (part, temperatures_c) in [
        (Part::Sensor, [Some(50.0), None]),
        (Part::Lamp, [Some(20.0), Some(50.0)]),
    ] {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::with(|world| {
            world.temperatures_c = temperatures_c;
            world.warming_c = 0.5;
        });
        let mut record = record();
        record.plan.limits = TemperatureLimits {
            sensor_c: Some(60.0),
            lamp_c: Some(60.0),
            margin_c: 5.0,
        };
        let session = create_from(Arc::new(UnsyncedDisk), parent.path(), &record).unwrap();
        let root = session.root().to_owned();
        let (result, heard) = capture(&bench, session);
        assert!(
            matches!(result, Err(CaptureError::TooHot { part: hot, temperature_c, limit_c: 60.0, .. })
                if hot == part && temperature_c > 60.0),
            "{result:?}"
        );
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 0));
        let warned = heard.warnings.iter().filter(|w| w.contains("suspended"));
        assert_eq!(warned.count(), 1, "{:?}", heard.warnings);
        let session = Session::open(&root).unwrap();
        let said: Vec<_> = session
            .frames()
            .map(|entry| session.read_frame(&entry).unwrap().1.time)
            .collect();
        assert!(said.len() > 5);
        for time in said {
            assert!(time.sensor_c.is_some_and(|c| c <= 60.0), "{time:?}");
            assert_eq!(time.lamp_c.is_some(), part == Part::Lamp, "{time:?}");
        }
        let cool = Bench::with(|world| world.temperatures_c = [Some(25.0); 2]);
        let session = SessionWriter::resume(Arc::new(UnsyncedDisk), &root).unwrap();
        let (result, _) = capture(&cool, session);
        assert_eq!(result.unwrap(), Outcome::Complete);
        let mut found = content(&root);
        // The plan differs by its limits.
        let name = std::path::Path::new("session.toml");
        assert!(found.remove(name).is_some());
        let mut expected = expected.clone();
        expected.remove(name);
        assert_eq!(found, expected);
    }
}

/// Settings that come later than the camera says are waited for; the frames so
/// lost are counted.
#[test]
fn late_settings_are_waited_for_and_ignored_ones_refused() {
    let run = |bench: &Bench| {
        let parent = tempfile::tempdir().unwrap();
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let root = session.root().to_owned();
        let (result, heard) = capture(bench, session);
        let discarded: Vec<(f64, u32)> = match Session::open(&root) {
            Ok(session) => {
                let sidecars = session.frames().map(|e| session.read_frame(&e).unwrap().1);
                sidecars
                    .filter(|s| !s.pilot)
                    .map(|s| (s.applied.exposure.0, s.frames_discarded))
                    .collect()
            }
            Err(error) => panic!("{error}"),
        };
        (result, heard, discarded)
    };
    let (result, _, discarded) = run(&Bench::with(|world| world.extra_latency = 3));
    assert_eq!(result.unwrap(), Outcome::Complete);
    assert!(
        discarded.iter().all(|&(_, frames)| frames == 5),
        "{discarded:?}"
    );

    let (result, _, _) = run(&Bench::with(|world| world.exposure_factor = 1.2));
    assert!(
        matches!(result, Err(CaptureError::ExposureNotApplied { ratio, .. }) if (1.1..1.3).contains(&ratio)),
        "{result:?}"
    );
}

/// What the camera needs after a change of settings goes by while the stage moves.
#[test]
fn a_change_of_settings_does_not_wait_for_the_stage() {
    let parent = tempfile::tempdir().unwrap();
    let bench = Bench::with(|world| world.moves_wait_for_settings = true);
    let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
    let (result, heard) = capture(&bench, session);
    assert_eq!(result.unwrap(), Outcome::Complete);
    assert_eq!(heard.warnings, [""; 0]);
    assert_eq!(bench.world().moves, 2);
}

#[test]
fn a_lamp_that_stays_dark_is_noticed() {
    let parent = tempfile::tempdir().unwrap();
    let bench = Bench::with(|world| {
        world.lamp_is_dead = true;
        world.brightness_e_s = 0.0;
    });
    let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
    let (result, _) = capture(&bench, session);
    assert!(result.is_err(), "{result:?}");
    assert_eq!(bench.world().lamp, LampState::Off);
}

#[test]
fn a_scene_that_is_too_bright_is_captured_with_a_warning() {
    let parent = tempfile::tempdir().unwrap();
    let bench = Bench::with(|world| world.brightness_e_s = 5e8);
    let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
    let root = session.root().to_owned();
    let (result, heard) = capture(&bench, session);
    assert_eq!(result.unwrap(), Outcome::Complete);
    assert!(
        heard.warnings.iter().any(|text| text.contains("saturated")),
        "{:?}",
        heard.warnings
    );
    let journal = Journal::read(&root).unwrap();
    assert!(
        journal
            .records
            .iter()
            .any(|r| matches!(r.event, Event::Warning { .. }))
    );
}

/// A complete session asks nothing of the devices; one whose merged image was
/// lost only merges.
#[test]
fn resuming_a_complete_session_takes_no_frame() {
    let parent = tempfile::tempdir().unwrap();
    let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
    let root = session.root().to_owned();
    capture(&Bench::new(), session).0.unwrap();
    let before = content(&root);
    for lose in [false, true] {
        if lose {
            std::fs::write(root.join(layout::radiance_file(1)), b"broken").unwrap();
        }
        let bench = Bench::new();
        let session = SessionWriter::resume(Arc::new(UnsyncedDisk), &root).unwrap();
        assert_eq!(capture(&bench, session).0.unwrap(), Outcome::Complete);
        assert_eq!(bench.homings_and_grabs(), (0, 0), "lose {lose}");
        assert_eq!(content(&root), before, "lose {lose}");
    }
}

/// After the last light the stage seeks its switches; where steps were lost, the
/// session says so for good.
#[test]
fn lost_steps_make_a_session_suspect() {
    for (off, suspect) in [([0.01, -0.04], false), ([0.01, -0.06], true)] {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::with(|world| {
            world.reference = Some(ReferenceCheck { off, allowed: 0.05 });
        });
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let root = session.root().to_owned();
        let (result, heard) = capture(&bench, session);
        assert_eq!(result.unwrap(), Outcome::Complete);
        let events = Journal::read(&root).unwrap().records;
        let checks = events
            .iter()
            .filter(|record| record.event == Event::Reference { off, suspect });
        assert_eq!(checks.count(), 1);
        let found = verify::verify(&root).unwrap();
        assert!(found.is_intact() && found.complete);
        assert_eq!(found.suspicion.is_some(), suspect);
        assert_eq!(Session::open(&root).unwrap().summary().suspect, suspect);
        assert_eq!(heard.warnings.len(), usize::from(suspect));
        if suspect {
            assert!(
                heard.warnings[0].contains("-0.0600"),
                "{:?}",
                heard.warnings
            );
        }
        // What is complete is not moved again.
        let homings = bench.world().homings;
        let again = SessionWriter::resume(Arc::new(UnsyncedDisk), &root).unwrap();
        assert_eq!(capture(&bench, again).0.unwrap(), Outcome::Complete);
        assert_eq!(bench.world().homings, homings);
    }
}
