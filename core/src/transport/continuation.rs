//! Where a camera path goes on: a proposal, in which a path may keep to one part, mixed with
//! a guide towards the lamps.
//!
//! A chain of n narrow reflections, each drawn from a mixture that gives the narrow lobe
//! the probability p, comes with p⁻ⁿ times the weight that it deserves. A part of the paths
//! therefore draws from one part all the way. Which kind a path is stays open: its density is
//! that of the prefix over all kinds, so that a chain weighs at most 1/p over that part
//! (docs/adr/0030).

use std::sync::Arc;

use glam::Vec3;

use super::guide::Guide;
use super::proposal::{PARTS, Proposal, mixed};
use super::scene::{Scene, Surface};
use crate::random::Uniform;

/// What leads paths to light that their proposal alone would seldom find.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steering {
    /// Part of the continuations that go to where mirrors send the lamps' light, as far as
    /// any is known to arrive, 0.0..1.0.
    pub guided: f32,
    /// Part of the paths that keep to one part of the proposal, 0.0..=1.0.
    pub constant: f32,
}

impl Steering {
    /// The proposal alone.
    pub const NONE: Self = Self {
        guided: 0.0,
        constant: 0.0,
    };

    /// What guides the paths of a scene, if any are to be guided.
    pub fn guide(&self, scene: &Scene, seed: u64) -> Option<Arc<Guide>> {
        (self.guided > 0.0).then(|| Arc::new(Guide::new(scene, seed)))
    }
}

impl Default for Steering {
    fn default() -> Self {
        Self {
            guided: 0.25,
            constant: 0.5,
        }
    }
}

/// Draws the continuations of camera paths.
pub struct Continuations<'a> {
    proposal: &'a Proposal,
    probabilities: [f32; PARTS],
    steering: Steering,
    guide: Option<Arc<Guide>>,
}

/// Posterior probabilities, given the directions drawn so far, that a path draws from the whole
/// mixture each time (`anew`) or keeps to one of its parts (`keeps`).
#[derive(Clone, Copy, Debug)]
pub struct PathMode {
    anew: f32,
    keeps: [f32; PARTS],
}

impl<'a> Continuations<'a> {
    /// Continuations by a proposal, steered with the guide of [`Steering::guide`].
    pub fn new(proposal: &'a Proposal, steering: Steering, guide: Option<Arc<Guide>>) -> Self {
        Self {
            proposal,
            probabilities: proposal.probabilities(),
            steering,
            guide,
        }
    }

    /// The same by another proposal.
    pub fn by<'b>(&self, proposal: &'b Proposal) -> Continuations<'b> {
        Continuations::new(proposal, self.steering, self.guide.clone())
    }

    /// A path at its beginning.
    #[inline]
    pub fn begin(&self) -> PathMode {
        let constant = self.steering.constant;
        PathMode {
            anew: 1.0 - constant,
            keeps: self.probabilities.map(|probability| constant * probability),
        }
    }

    /// A local direction in which a path goes on, and its density given all directions
    /// before, 1/sr, by four numbers or less where no table is drawn from. `None` below the
    /// horizon.
    #[inline]
    pub fn draw(
        &self,
        mode: &mut PathMode,
        surface: &Surface,
        to_viewer: Vec3,
        numbers: &mut impl Uniform,
    ) -> Option<(Vec3, f32)> {
        let guide = self.guide.as_deref().filter(|_| surface.is_sample());
        let arrivals = guide.and_then(|guide| guide.around(surface));
        let guided = arrivals.map_or(0.0, |_| self.steering.guided);
        let (local, arriving) = match arrivals {
            Some(arrivals) if numbers.uniform_f32() < guided => {
                let direction = arrivals.sample(numbers);
                let local = surface.local(direction);
                (local, guided * arrivals.pdf(direction))
            }
            _ => {
                let mut parts = mode.keeps;
                for (part, probability) in parts.iter_mut().zip(self.probabilities) {
                    *part += mode.anew * probability;
                }
                let local = self.proposal.draw(&parts, to_viewer, numbers)?;
                let arriving = arrivals.map_or(0.0, |a| guided * a.pdf(surface.world(local)));
                (local, arriving)
            }
        };
        if local.z <= 0.0 {
            return None;
        }
        let densities = self.proposal.densities(to_viewer, local);
        let anew = mixed(&self.probabilities, &densities);
        let density = |proposed: f32| arriving + (1.0 - guided) * proposed;
        mode.anew *= density(anew);
        let mut pdf = mode.anew;
        for (keeps, proposed) in mode.keeps.iter_mut().zip(densities) {
            *keeps *= density(proposed);
            pdf += *keeps;
        }
        mode.anew /= pdf;
        mode.keeps.iter_mut().for_each(|keeps| *keeps /= pdf);
        Some((local, pdf))
    }
}
