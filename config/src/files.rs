//! Reads the files that a user names.

use std::fs;
use std::io::{self, Read};
use std::path::Path;

/// The largest text that is read.
const MOST_BYTES: u64 = 16 << 20;

/// Reads a text, if it is a regular file of a sensible size: a pipe would keep the reader waiting, and a device never end.
///
/// # Errors
/// If it is another kind of file, larger than 16 MiB, cannot be read, or is not UTF-8.
pub fn read_small(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    open_regular(path)?.take(MOST_BYTES + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MOST_BYTES {
        return Err(io::Error::other(format!("it holds more than {} MiB", MOST_BYTES >> 20)));
    }
    Ok(text)
}

/// Opens a regular file.
///
/// # Errors
/// If it is another kind of file, or cannot be opened.
pub fn open_regular(path: &Path) -> io::Result<fs::File> {
    // Before it is opened: opening a pipe would wait for somebody who writes.
    let meta = fs::metadata(path)?;
    if meta.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    if !meta.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    fs::File::open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_of_a_sensible_size_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "text").unwrap();
        assert_eq!(read_small(&file).unwrap(), "text");
        let pipe = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        for path in [&pipe, Path::new("/dev/zero"), folder.path()] {
            assert!(read_small(path).is_err(), "{path:?}");
        }
        let large = fs::File::create(&file).unwrap();
        large.set_len(MOST_BYTES + 1).unwrap();
        assert!(read_small(&file).unwrap_err().to_string().contains("16 MiB"));
    }
}
