//! What goes wrong at the device and on its network.

use std::time::Duration;

use mock_devices::random::stream;

use mock_devices::failing::Failing;

/// What goes wrong.
#[derive(Debug, Default)]
pub struct Faults {
    /// So many packets of the stream in a thousand are lost.
    pub lost_per_thousand: u32,
    /// So many frames are the one before, sent once more.
    pub late: u32,
    /// So many frames have half the height.
    pub halved: u32,
    /// So many frames are not sent.
    pub silent: u32,
    /// So many frames come in another pixel format than the one that was set.
    pub other_format: u32,
    /// The next frame is so long on its way.
    pub delay: Option<Duration>,
    /// It exposes for so long whatever its register is set to, microseconds.
    pub stuck_exposure_us: Option<f64>,
    /// It confirms exposures and keeps the one that it has.
    pub ignores_exposure: bool,
    /// The exposure can only be set while no acquisition is under way.
    pub locks_settings: bool,
    /// It takes its controller for gone, once, as after a silence longer than the heartbeat
    /// time-out.
    pub forgets_controller: bool,
    /// Another controller has it.
    pub is_held: bool,
    /// It is unplugged. It comes back as when it was switched on.
    pub is_gone: bool,
    packets: u64,
}

impl Faults {
    /// Whether the next packet is lost.
    pub(super) fn loses_packet(&mut self) -> bool {
        self.packets += 1;
        let drawn = stream(&[31, self.packets]).uniform();
        drawn * 1000.0 < f64::from(self.lost_per_thousand)
    }
}

/// Handle by which a test makes the device fail.
pub type GigeFaults = Failing<Faults>;
