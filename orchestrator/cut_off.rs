//! Recordings that end before their end: damaged, or cut off by a crash or a full disk.

use anyhow::{Result, anyhow};

/// Lets an error that may follow from what was not read say so. `cut_off` is why reading ended, as in
/// [`recorder::reading::Recording::cut_off`].
pub(crate) fn blame<T>(result: Result<T>, cut_off: Option<&str>) -> Result<T> {
    result.map_err(|error| match cut_off {
        Some(why) => anyhow!("{error:#}; it {why}, and what comes after that was not read"),
        None => error,
    })
}
