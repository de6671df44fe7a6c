//! Many independent jobs on many machines: [`Shard`] is a part of them, [`JobArray`] a script
//! that hands the parts to Slurm.

mod shard;
mod slurm;

pub use shard::Shard;
pub use slurm::{JobArray, LineBreak, MOST_TASKS, Resources};
