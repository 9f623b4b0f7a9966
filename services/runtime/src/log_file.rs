//! A log of bounded size: of what a program writes without end, the beginning is left out.
//!
//! A log is two files of at most half its limit each. When `NAME.log` is full it becomes `NAME.log.old`, in place of
//! the one that was there, and a new one begins, which says how much was left out before it.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;
use rustix::stdio::{dup2_stderr, dup2_stdout};

/// The variable with the limit of a log in MiB; see [`limit`].
pub(crate) const LIMIT_VARIABLE: &str = "PATHTUNE_LOG_MIB";
/// How many MiB a log holds unless it says otherwise.
const USUAL_MIB: u64 = 16;

/// The end of the line with which a log begins after a cut.
const CUT: &str = "were left out; PATHTUNE_LOG_MIB sets the limit";

/// How many bytes a log may hold: 16 MiB, or as many as the environment's `PATHTUNE_LOG_MIB` says.
///
/// # Errors
/// If that is not a whole number of MiB above 0.
pub fn limit() -> Result<u64, String> {
    let Some(text) = std::env::var_os(LIMIT_VARIABLE) else { return Ok(USUAL_MIB << 20) };
    let number = text.to_str().and_then(|text| text.parse::<u64>().ok());
    number.filter(|mib| (1..=1 << 20).contains(mib)).map(|mib| mib << 20).ok_or_else(|| {
        format!("{LIMIT_VARIABLE}={}: give a number of MiB, as in 16", text.display())
    })
}

/// A log that is being written.
#[derive(Debug)]
pub struct LogFile {
    path: PathBuf,
    file: File,
    /// How many bytes the file holds, and may hold.
    held: u64,
    limit: u64,
    /// How many bytes were left out so far.
    left_out: u64,
    /// The process's standard output and error lead to this file, and must follow it.
    is_standard: bool,
}

impl LogFile {
    /// Adds to the log at `path`, which is kept below its [`limit`].
    ///
    /// # Errors
    /// If the file cannot be opened.
    pub fn open(path: &Path) -> io::Result<Self> {
        // The orchestrator has checked it, and processes that it starts have no better place to complain.
        Self::with_limit(path, limit().unwrap_or(USUAL_MIB << 20))
    }

    fn with_limit(path: &Path, limit: u64) -> io::Result<Self> {
        let file = open(path)?;
        let held = file.metadata()?.len();
        let path = path.to_owned();
        Ok(Self { path, file, held, limit: limit / 2, left_out: 0, is_standard: false })
    }

    /// The log in `folder` to which this process's standard error leads, if it leads to one.
    pub fn of_standard_error(folder: &Path) -> Option<Self> {
        let path = fs::read_link("/proc/self/fd/2").ok()?;
        if path.parent() != Some(folder) || path.extension()? != "log" {
            return None;
        }
        Some(Self { is_standard: true, ..Self::open(&path).ok()? })
    }

    fn begin_anew(&mut self) -> io::Result<()> {
        let old = older_half(&self.path);
        self.left_out += fs::metadata(&old).map_or(0, |meta| meta.len());
        fs::rename(&self.path, &old)?;
        self.file = open(&self.path)?;
        self.held = 0;
        if self.is_standard {
            dup2_stdout(&self.file)?;
            dup2_stderr(&self.file)?;
        }
        if self.left_out > 0 {
            let line =
                format!("pathtune: {} bytes before {} {CUT}\n", self.left_out, old.display());
            self.file.write_all(line.as_bytes())?;
        }
        Ok(())
    }
}

impl Write for LogFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.held > 0 && self.held + bytes.len() as u64 > self.limit {
            self.begin_anew()?;
        }
        let written = self.file.write(bytes)?;
        self.held += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Whether something was left out of the log at `path`.
pub fn is_cut(path: &Path) -> bool {
    if !older_half(path).exists() {
        return false;
    }
    let mut line = Vec::new();
    let read = File::open(path).and_then(|file| file.take(4096).read_to_end(&mut line));
    read.is_ok()
        && String::from_utf8_lossy(&line).lines().next().is_some_and(|it| it.ends_with(CUT))
}

/// The file with the older half of the log at `path`.
fn older_half(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".old");
    PathBuf::from(name)
}

/// Follows no link: others may write to the folder that the user has named.
fn open(path: &Path) -> io::Result<File> {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
    OpenOptions::new().create(true).append(true).custom_flags(flags).open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_is_kept_and_what_is_left_out_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("some.log");
        let mut log = LogFile::with_limit(&path, 2000).unwrap();
        let lines: Vec<String> = (0..200).map(|number| format!("line {number:04}\n")).collect();
        for line in &lines[..190] {
            log.write_all(line.as_bytes()).unwrap();
        }
        // Both halves hold it all.
        assert!(!is_cut(&path));
        for line in &lines[190..] {
            log.write_all(line.as_bytes()).unwrap();
        }
        assert!(!is_cut(&path), "2000 bytes fit");
        log.write_all(b"the last\n").unwrap();
        assert!(is_cut(&path));
        let (old, new) =
            (fs::read_to_string(older_half(&path)).unwrap(), fs::read_to_string(&path).unwrap());
        assert!(old.len() <= 1000 && new.len() <= 1200, "{} {}", old.len(), new.len());
        assert!(old.ends_with("line 0199\n") && new.ends_with("the last\n"), "{new}");
        assert!(new.starts_with("pathtune: 1000 bytes before "), "{new}");
        // A successor goes on where this one stopped.
        let mut log = LogFile::with_limit(&path, 2000).unwrap();
        log.write_all(&[b'x'; 5000]).unwrap();
        assert!(fs::read_to_string(older_half(&path)).unwrap().ends_with("the last\n"));
    }
}
