//! Replaces a vehicle's file as a whole: whichever process is killed at whatever time, a reader finds either the old
//! file or the new one.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use config::{open_regular, read_small};

use crate::words::Failure;

/// How long to wait for another promotion to finish.
const PATIENCE: Duration = Duration::from_secs(5);

/// A vehicle's file, which nobody else replaces while this exists.
pub(crate) struct VehicleFile {
    /// Its text.
    pub(crate) text: String,
    /// As the user named it.
    named: PathBuf,
    /// The file itself, with all symbolic links followed.
    path: PathBuf,
    file: File,
}

impl VehicleFile {
    /// Opens and locks it.
    pub(crate) fn lock(named: &Path) -> Result<Self, Failure> {
        let fail = |why: String| Failure::User(format!("{}: {why}", named.display()));
        // A link stays a link: the file that it points to is replaced.
        let path = fs::canonicalize(named).map_err(|error| fail(error.to_string()))?;
        let until = Instant::now() + PATIENCE;
        loop {
            let file = open_regular(&path).map_err(|error| fail(error.to_string()))?;
            while file.try_lock().is_err() {
                if Instant::now() > until {
                    return Err(fail("another promotion is using it; try again".to_owned()));
                }
                std::thread::sleep(Duration::from_millis(2));
            }
            // The previous holder of the lock may have put another file in its place.
            let (ours, there) = (file.metadata()?, fs::metadata(&path)?);
            if (ours.dev(), ours.ino()) != (there.dev(), there.ino()) {
                continue;
            }
            let text = read_small(&path).map_err(|error| fail(error.to_string()))?;
            // What a killed predecessor left: whoever holds the lock is the only one to write.
            let _ = fs::remove_file(part_of(&path));
            return Ok(Self { text, named: named.to_owned(), path, file });
        }
    }

    /// Replaces it by a file with this text and the same permissions.
    pub(crate) fn replace(&self, text: &str) -> Result<(), Failure> {
        let fail = |why: String| Failure::User(format!("{}: {why}", self.named.display()));
        let meta = self.file.metadata()?;
        // Renaming would succeed all the same.
        if meta.permissions().readonly() || OpenOptions::new().write(true).open(&self.path).is_err()
        {
            return Err(fail("is read-only; `chmod u+w` makes it writable".to_owned()));
        }
        let part = part_of(&self.path);
        let result = self.put_in_place(&part, text, &meta);
        result.map_err(|error| {
            let _ = fs::remove_file(&part);
            fail(format!("cannot be written: {}: {error}", part.display()))
        })
    }

    fn put_in_place(&self, part: &Path, text: &str, meta: &fs::Metadata) -> io::Result<()> {
        match fs::remove_file(part) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        // Created anew, so that no link is followed; nobody else can open it until it has its permissions.
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(part)?;
        file.write_all(text.as_bytes())?;
        // Only root may change a file's owner, and only root needs to.
        let _ = std::os::unix::fs::fchown(&file, Some(meta.uid()), Some(meta.gid()));
        file.set_permissions(meta.permissions())?;
        file.sync_all()?;
        fs::rename(part, &self.path)?;
        let folder = self.path.parent().unwrap_or(Path::new("/"));
        File::open(folder)?.sync_all()
    }
}

/// Where the new text stands until it takes the file's place: always the same name, so that what a killed predecessor
/// left is found.
fn part_of(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}.part"))
}
