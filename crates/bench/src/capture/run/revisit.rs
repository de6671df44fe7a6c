//! Back to the first light when all others are done: whether the lamp is still what it was
//! when the capture began. Between two lights nothing else tells: they show different images.

use std::collections::BTreeMap;

use super::Run;
use super::between::Kept;
use super::frame::{Reference, Shot, Taken};
use crate::capture::CaptureError;
use crate::device::FrameKind;
use crate::session::{FrameEntry, REVISIT_ROUND, Session};

impl Run<'_> {
    /// One exposure of the first light's bracket once more under each channel, if the plan
    /// wants it. What it shows is noted and never suspends: nothing is left to be spoilt.
    pub(super) async fn revisit_first_light(&mut self) -> Result<(), CaptureError> {
        if !self.plan.revisit_first || self.lights < 2 {
            return Ok(());
        }
        let frames = self.first_light().await?.map_or(Vec::new(), Kept::frames);
        self.clock.begin_revisit();
        for (channel, before) in frames.iter().enumerate() {
            let shot = Shot {
                // No part of the bracket.
                pilot: true,
                ..self.light_shot(0, REVISIT_ROUND, channel, 0, before.requested_s)
            };
            self.take(shot, Reference::Revisit(before)).await?;
        }
        Ok(())
    }

    /// The frames of the first light that are most informative about the lamp, from the disk: a run that
    /// was interrupted has them nowhere else.
    async fn first_light(&mut self) -> Result<Option<Kept>, CaptureError> {
        self.disk.settle().await?;
        let session = Session::open(self.session.root())?;
        let states = self.plan.channels.len() as u32 + 1;
        let mut rounds: BTreeMap<u32, Vec<FrameEntry>> = BTreeMap::new();
        for entry in session.frames() {
            let key = entry.key;
            if (key.light, key.repeat, key.kind) == (0, 0, FrameKind::Light) {
                rounds.entry(key.exposure / states).or_default().push(entry);
            }
        }
        let mut kept = None;
        for mut entries in rounds.into_values() {
            entries.sort_by_key(|entry| entry.key.exposure);
            let mut taken = Vec::new();
            for entry in &entries {
                let (frame, sidecar) = session.read_frame(entry)?;
                if !sidecar.pilot {
                    taken.push(Taken {
                        frame: frame.into(),
                        requested_s: sidecar.requested.exposure.0,
                        exposure_s: sidecar.applied.exposure.0,
                        homing: 0,
                    });
                }
            }
            if taken.len() == self.plan.channels.len() {
                self.keep_for_drift(&mut kept, taken);
            }
        }
        Ok(kept)
    }
}
