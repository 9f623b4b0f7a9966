//! Folders of runs whose files nobody wants afterwards. What a killed one leaves is removed by the next.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

use runtime::run::is_private;
use tempfile::TempDir;

use crate::runs::preflight::{look_into, make_folder};
use crate::words::Failure;

const PREFIX: &str = "pathtune-replay-";
/// Marks a folder that is kept for its logs.
const KEPT: &str = "kept";
/// A folder may be as old as this before its run has locked it.
const LOCKED_WITHIN: Duration = Duration::from_secs(2);

/// A folder that is removed when this is dropped.
pub(crate) struct TemporaryFolder(TempDir);

impl TemporaryFolder {
    /// Makes one anew, under a name that nobody else knows beforehand, and closed to other users.
    ///
    /// # Errors
    /// If there is no room, or no right to make one.
    pub(crate) fn make() -> Result<Self, Failure> {
        let made = tempfile::Builder::new()
            .prefix(PREFIX)
            .permissions(fs::Permissions::from_mode(0o700))
            .tempdir()
            .map_err(|why| Failure::User(format!("no temporary folder can be made: {why}")))?;
        make_folder(made.path())?;
        Ok(Self(made))
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    /// Leaves it where it is: its logs say more.
    pub(crate) fn keep(self) {
        let _ = fs::write(self.0.path().join(KEPT), "");
        let _ = self.0.keep();
    }
}

/// The folders of this user that killed runs left.
pub(crate) fn left_behind() -> Vec<std::path::PathBuf> {
    let Ok(entries) = fs::read_dir(std::env::temp_dir()) else { return Vec::new() };
    let is_left = |folder: &Path| {
        let is_old = fs::metadata(folder)
            .and_then(|meta| meta.modified())
            .is_ok_and(|made| made.elapsed().is_ok_and(|age| age > LOCKED_WITHIN));
        is_private(folder) && is_old && !folder.join(KEPT).exists() && look_into(folder).is_ok()
    };
    entries
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(PREFIX))
        .map(|entry| entry.path())
        .filter(|folder| is_left(folder))
        .collect()
}

/// Removes the folders of this user that killed runs left; returns how many.
pub(crate) fn sweep() -> usize {
    left_behind().into_iter().filter(|folder| fs::remove_dir_all(folder).is_ok()).count()
}
