//! The thread that holds the devices, from opening to closing.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::Receiver;

use super::ports::{BenchPorts, Opened};
use super::shared::{Command, SetOnDrop, Shared};
use super::stage::{self, Ended};
use super::state::CameraFacts;
use super::{camera, stop};
use crate::device::{Camera, DeviceError, LightStage};
use crate::fault::Fault;

/// Opens and closes the devices as commanded, until the bench ends.
pub(super) fn obey(shared: &Arc<Shared>, ports: &BenchPorts, commands: &Receiver<Command>) {
    while let Ok(command) = commands.recv() {
        match command {
            Command::Connect => {
                let connection = || connected(shared, ports, commands);
                // A defect of a driver ends the connection, not the console. What it held is
                // dropped, and the guardian sees to a lamp.
                let ended = catch_unwind(AssertUnwindSafe(connection)).unwrap_or_else(|_| {
                    let fact = "a defect of this program ended the connection to the bench";
                    Err(Fault::new(fact))
                });
                shared.set_stop(None);
                let is_over = matches!(ended, Ok(Ended::ForGood));
                shared.let_go(ended.err());
                if is_over {
                    return;
                }
            }
            Command::End => return,
            // What came too late.
            Command::Disconnect | Command::Act(..) => {}
        }
    }
}

/// One connection: opens the devices, uses them until that is to end, and closes them.
fn connected(
    shared: &Arc<Shared>,
    ports: &BenchPorts,
    commands: &Receiver<Command>,
) -> Result<Ended, Fault> {
    let ended = match (ports.open)()? {
        Opened::Rig(mut devices) => {
            let stage = &mut *devices.stage;
            let ended = used(shared, ports, commands, Some(stage), &mut *devices.camera);
            // No stop holds it any longer than the stage lives.
            shared.set_stop(None);
            ended
        }
        Opened::Camera(mut camera) => used(shared, ports, commands, None, &mut *camera),
    };
    ended.map_err(|error| ports.advisor.fault(&error))
}

fn used(
    shared: &Arc<Shared>,
    ports: &BenchPorts,
    commands: &Receiver<Command>,
    mut stage: Option<&mut dyn LightStage>,
    camera: &mut dyn Camera,
) -> Result<Ended, DeviceError> {
    // What they are and do now.
    let applied = camera.configure(ports.settings)?;
    let mut is_stopped = false;
    let facts = match &mut stage {
        Some(stage) => {
            is_stopped = shared.set_stop(Some(stage.stop_handle()?));
            Some(stage::facts(&stage.status()?, None, stage.reports_lamp()))
        }
        None => None,
    };
    shared.change(|state| {
        state.connected = true;
        state.busy = None;
        state.camera = Some(CameraFacts::from(camera.info()));
        state.settings = Some(applied.into());
        state.stage = facts;
    });
    if is_stopped {
        stop::stop(shared, &ports.advisor);
    }

    // Camera and stage each on a thread of its own: the picture goes on while the stage moves.
    let leave = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let leave = &leave;
        let watching = std::thread::Builder::new()
            .name("live picture".to_owned())
            .spawn_scoped(scope, move || {
                let _leave = SetOnDrop(leave);
                camera::show(camera, applied, shared, ports, leave)
            });
        let leaving = SetOnDrop(leave);
        let watcher = std::thread::Builder::new()
            .name("lamp timer".to_owned())
            .spawn_scoped(scope, move || {
                stage::stop_unwatched(shared, ports, leave, |shared| {
                    stop::stop(shared, &ports.advisor);
                });
            });
        let io = |source| DeviceError::Io {
            device: "the bench".to_owned(),
            source,
        };
        let (watching, _watcher) = (watching.map_err(io)?, watcher.map_err(io)?);
        let ended = match stage {
            Some(stage) => {
                let ended = stage::obey(stage, shared, ports, commands, leave);
                // The camera may be in a long frame.
                shared.change(|state| state.stage = None);
                ended
            }
            None => Ok(stage::wait(commands, leave)),
        };
        drop(leaving);
        let seen = watching.join();
        shared.change(|state| state.camera = None);
        let seen = match seen {
            Ok(seen) => seen,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        // The stage's error matters more.
        let ended = ended?;
        seen.map(|()| ended)
    })
}
