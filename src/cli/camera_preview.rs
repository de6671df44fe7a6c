//! `rig camera preview`: the console with a bench of a camera alone.

use super::context::Context;
use super::error::CliError;
use crate::config::ResolvedRig;
use crate::device::{Camera, CameraSettings};

/// The camera to be shown.
#[cfg_attr(not(feature = "console"), allow(dead_code))]
pub(super) struct Shown {
    /// Open.
    pub(super) camera: Box<dyn Camera>,
    /// Opens it anew, where a page connects again.
    pub(super) reopen: Reopen,
    /// The rig whose camera it is, if it is one's.
    pub(super) rig: Option<ResolvedRig>,
    /// Requested of it.
    pub(super) settings: CameraSettings,
}

/// Opens a camera.
pub(super) type Reopen = Box<dyn Fn() -> Result<Box<dyn Camera>, CliError> + Send + Sync>;

/// Shows the camera's pictures until a signal ends it.
#[cfg(feature = "console")]
pub(super) fn serve(shown: Shown, port: u16, context: &Context) -> Result<(), CliError> {
    console::serve(shown, port, context)
}

/// There is no page without the console.
#[cfg(not(feature = "console"))]
pub(super) fn serve(_: Shown, _: u16, _: &Context) -> Result<(), CliError> {
    let fact = "this program was built without the console, which shows the pictures";
    Err(CliError::new(fact).hint("build it with the feature `console`, or take --json"))
}

#[cfg(feature = "console")]
mod console {
    use std::net::Ipv4Addr;
    use std::sync::Mutex;
    use std::time::Duration;

    use serde_json::{Value, json};

    use super::super::bench_ports::{advisor, fault};
    use super::super::error::HintExt;
    use super::super::exit::Exit;
    use super::super::interrupt;
    use super::*;
    use crate::console::control::Control;
    use crate::console::held_devices::{self, BenchPorts, HeldDevices, Opened};
    use crate::console::hub::Hub;
    use crate::console::picture::levels::{SensorLevels, SensorRecords};
    use crate::console::picture::outline_routes;
    use crate::console::server::{ListenOptions, Parts, Server};
    use crate::interrupt::{Signal, StopLevel};
    use crate::out;

    /// How often signals and errors are looked at.
    const LOOK: Duration = Duration::from_millis(50);
    /// The camera is closed in this time, or the process ends without.
    const CLOSING: Duration = Duration::from_secs(15);

    pub(super) fn serve(shown: Shown, port: u16, context: &Context) -> Result<(), CliError> {
        let interrupt = interrupt::listen()?;
        let options = ListenOptions {
            address: (Ipv4Addr::LOCALHOST, port).into(),
            ..ListenOptions::default()
        };
        let mut server =
            Server::bind(&options).hint("choose another --port, or 0 for a free one")?;

        // A bench of the camera alone, which is open already.
        let hub = Hub::default();
        let control = Control::new(hub.clone());
        let facts = facts(shown.rig.as_ref(), shown.camera.info().model.as_str());
        let config = shown.rig.as_ref().map(|rig| rig.config.clone());
        let ports = ports(shown);
        let bench = HeldDevices::new(hub.clone(), ports)?;
        // The first page finds its picture; it cannot fail before.
        drop(bench.connect());
        let address = server.address();
        let routes = held_devices::routes(bench.clone()).merge(outline_routes(config, advisor()));
        server.serve(Parts {
            hub,
            control,
            facts,
            routes,
        })?;
        out!("{address}")?;
        context.note("the page is for this machine alone; Ctrl-C ends it");

        // Until a signal ends it. Errors are for who sits at the terminal, too.
        let mut warned = None;
        while interrupt.level() == StopLevel::Continue {
            if interrupt.take_pause() {
                interrupt::suspend();
            }
            let error = bench.state().error;
            if error != warned {
                if let Some(fault) = &error {
                    context.warn(&fault.error);
                }
                warned = error;
            }
            std::thread::sleep(LOOK);
        }
        drop(server);
        bench.end(CLOSING, || interrupt.level() == StopLevel::Now);
        // As it was asked to.
        let signal = interrupt.signal().unwrap_or(Signal::Interrupt);
        Err(CliError::stated(Exit::Signal(signal)))
    }

    /// The camera that is open serves the first connection; later ones open it anew.
    fn ports(shown: Shown) -> BenchPorts {
        let Shown {
            camera,
            reopen,
            rig,
            settings,
        } = shown;
        let first = Mutex::new(Some(camera));
        let records = rig.as_ref().map(SensorRecords::of);
        BenchPorts {
            open: Box::new(move || {
                let first = first.lock().ok().and_then(|mut first| first.take());
                let camera = match first {
                    Some(camera) => camera,
                    None => reopen().map_err(fault)?,
                };
                Ok(Opened::Camera(camera))
            }),
            advisor: advisor(),
            levels: Box::new(move |gain| {
                let records = records.as_ref();
                records.map_or_else(SensorLevels::default, |records| records.levels(gain))
            }),
            settings,
            silence: Box::new(|| None),
        }
    }

    /// The topic `console`.
    fn facts(rig: Option<&ResolvedRig>, model: &str) -> Value {
        json!({
            "version": env!("CARGO_PKG_VERSION"),
            "mode": "camera",
            "folder": null,
            "rig": {
                "name": rig.map_or(model, |rig| rig.config.name.as_str()),
                "file": rig.map(|rig| rig.file.as_str()),
                "simulated": rig.is_some_and(|rig| rig.config.is_simulated()),
                "channels": [],
                "azimuth_range_deg": null,
                "elevation_range_deg": null,
                "has_stage": false,
                "camera_direction": null,
            },
        })
    }
}
