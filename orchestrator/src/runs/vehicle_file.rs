//! A vehicle's file, replaced as a whole: whoever reads it, whenever anybody is killed, finds the old one or the new.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::words::Failure;

/// How long another promotion is waited for.
const PATIENCE: Duration = Duration::from_secs(5);

/// A vehicle's file, which nobody else replaces as long as this lives.
pub(crate) struct VehicleFile {
    /// What stands in it.
    pub(crate) text: String,
    /// As the user named it.
    named: PathBuf,
    /// The file itself, behind all symbolic links.
    path: PathBuf,
    file: File,
}

impl VehicleFile {
    /// Opens and locks it.
    pub(crate) fn lock(named: &Path) -> Result<Self, Failure> {
        let fail = |why: String| Failure::User(format!("{}: {why}", named.display()));
        // A link stays a link: what it points to is replaced.
        let path = fs::canonicalize(named).map_err(|error| fail(error.to_string()))?;
        let until = Instant::now() + PATIENCE;
        loop {
            let mut file = File::open(&path).map_err(|error| fail(error.to_string()))?;
            while file.try_lock().is_err() {
                if Instant::now() > until {
                    return Err(fail("another promotion holds it; try again".to_owned()));
                }
                std::thread::sleep(Duration::from_millis(2));
            }
            // Whoever held it may have put another file in its place.
            let (ours, there) = (file.metadata()?, fs::metadata(&path)?);
            if (ours.dev(), ours.ino()) != (there.dev(), there.ino()) {
                continue;
            }
            let mut text = String::new();
            file.read_to_string(&mut text).map_err(|error| fail(error.to_string()))?;
            return Ok(Self { text, named: named.to_owned(), path, file });
        }
    }

    /// Puts a file with this text in its place, with the same permissions.
    pub(crate) fn replace(&self, text: &str) -> Result<(), Failure> {
        let fail = |why: String| Failure::User(format!("{}: {why}", self.named.display()));
        let meta = self.file.metadata()?;
        // Renaming would not mind.
        if meta.permissions().readonly() || OpenOptions::new().write(true).open(&self.path).is_err()
        {
            return Err(fail("is read-only; `chmod u+w` makes it writable".to_owned()));
        }
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        // Always the same name: what a killed predecessor left is taken away here.
        let part = self.path.with_file_name(format!(".{name}.part"));
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
        // New, so that no link is followed; open to nobody else until it has its permissions.
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(part)?;
        file.write_all(text.as_bytes())?;
        // Only root may give a file away, and only root needs to.
        let _ = std::os::unix::fs::fchown(&file, Some(meta.uid()), Some(meta.gid()));
        file.set_permissions(meta.permissions())?;
        file.sync_all()?;
        fs::rename(part, &self.path)?;
        let folder = self.path.parent().unwrap_or(Path::new("/"));
        File::open(folder)?.sync_all()
    }
}
