//! Numbers on the command line, within their ranges.

use std::fmt::Display;
use std::str::FromStr;

/// Reads a number from `low` to `high`.
pub fn within<T>(low: T, high: T) -> impl Fn(&str) -> Result<T, String> + Clone
where
    T: FromStr + PartialOrd + Display + Copy,
{
    move |text| match text.trim().parse() {
        Ok(number) if (low..=high).contains(&number) => Ok(number),
        _ => Err(format!("not a number in {low} to {high}")),
    }
}
