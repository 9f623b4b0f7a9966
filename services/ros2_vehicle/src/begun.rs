//! What a restarted process finds about the drive under way: a small file in the run's folder.

use std::path::Path;

use anyhow::Result;
use ipc_types::Attempt;
use serde::{Deserialize, Serialize};

use crate::car::Begun;
use crate::frames::Alignment;

/// The file's contents.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct BatchFile {
    /// In hexadecimal digits, as everywhere, because TOML has no numbers that large.
    run: String,
    batch: u64,
    attempt: u32,
    alignment: Alignment,
}

impl BatchFile {
    pub(crate) fn read(path: &Path) -> Option<Begun> {
        let text = std::fs::read_to_string(path).ok()?;
        let Self { run, batch, attempt, alignment } = toml::from_str(&text).ok()?;
        let run = u64::from_str_radix(&run, 16).ok()?;
        Some(Begun { attempt: Attempt { run, batch, attempt, reserved: 0 }, alignment })
    }

    pub(crate) fn write(path: &Path, begun: Begun) -> Result<()> {
        let Begun { attempt: Attempt { run, batch, attempt, .. }, alignment } = begun;
        let run = format!("{run:016x}");
        let text = toml::to_string(&Self { run, batch, attempt, alignment })?;
        // By rename, so that there is never half a file.
        let new = path.with_extension("new");
        std::fs::write(&new, text)?;
        Ok(std::fs::rename(&new, path)?)
    }
}
