//! A part of many independent jobs: every n-th of them.

use std::fmt;
use std::str::FromStr;

/// Shard `number` of `of`: the jobs number, number + of, number + 2·of, … of a list that counts
/// from 1. Written `3/8`.
///
/// ```
/// use rig_desk::cluster::Shard;
/// let shard: Shard = "2/3".parse().unwrap();
/// let own: Vec<usize> = (1..=7).filter(|&job| shard.has(job)).collect();
/// assert_eq!(own, [2, 5]);
/// assert!("4/3".parse::<Shard>().is_err());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    number: usize,
    of: usize,
}

impl Shard {
    /// More shards than this are taken for a mistake.
    pub const MOST: usize = 100_000;

    /// Which one it is, from 1.
    pub fn number(self) -> usize {
        self.number
    }

    /// How many there are.
    pub fn of(self) -> usize {
        self.of
    }

    /// Whether the job of this number, from 1, is one of the shard's.
    pub fn has(self, job: usize) -> bool {
        job % self.of == self.number % self.of
    }
}

impl FromStr for Shard {
    type Err = String;

    /// `i/n` with 1 ≤ i ≤ n.
    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text
            .split_once('/')
            .and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        let Some((number, of)) = parts else {
            return Err("a shard is written i/n, such as 3/8".to_owned());
        };
        if !(1..=Self::MOST).contains(&of) {
            return Err(format!("there are 1 to {} shards, not {of}", Self::MOST));
        }
        if !(1..=of).contains(&number) {
            return Err(format!(
                "of {of} shards the first is 1/{of} and the last {of}/{of}"
            ));
        }
        Ok(Self { number, of })
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}/{}", self.number, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_have_every_job_once() {
        for of in 1..=9 {
            let shards: Vec<Shard> = (1..=of).map(|number| Shard { number, of }).collect();
            for job in 1..=30 {
                assert_eq!(shards.iter().filter(|shard| shard.has(job)).count(), 1);
            }
        }
    }

    #[test]
    fn what_is_no_shard_is_refused() {
        for text in [
            "0/4", "5/4", "1/0", "3", "/", "a/b", "-1/2", "1/200000", "1/2/3",
        ] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }
}
