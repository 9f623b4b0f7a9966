//! Reads the files that a user names.

use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// The largest text that is read.
const MOST_BYTES: u64 = 16 << 20;
/// The most values and tables in a text: a parser takes some 400 bytes for each, so that a text of 16 MiB could take
/// gigabytes. The longest path that is driven has less.
const MOST_VALUES: usize = 1_000_000;

/// Reads a text, if it is a regular file of a sensible size: a pipe would keep the reader waiting, and a device never end.
///
/// # Errors
/// If it is another kind of file, larger than 16 MiB, holds more than a million values, cannot be read, or is not UTF-8.
pub fn read_small(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    open_regular(path)?.take(MOST_BYTES + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MOST_BYTES {
        return Err(io::Error::other(format!("it holds more than {} MiB", MOST_BYTES >> 20)));
    }
    if text.bytes().filter(|byte| b",=[{".contains(byte)).count() > MOST_VALUES {
        return Err(io::Error::other(format!("it holds more than {MOST_VALUES} values")));
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
        return Err(match bag_in(path) {
            Some(bag) => {
                io::Error::other(format!("it is a folder; name the bag in it, {}", bag.display()))
            }
            None => io::ErrorKind::IsADirectory.into(),
        });
    }
    if !meta.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    fs::File::open(path)
}

/// The first bag in a folder: `ros2 bag record` makes a folder, and people name that.
fn bag_in(folder: &Path) -> Option<PathBuf> {
    let files = fs::read_dir(folder).ok()?.take(1000).filter_map(|entry| Some(entry.ok()?.path()));
    files.filter(|file| file.extension().is_some_and(|it| it == "mcap")).min()
}

/// Reads a table in text form, and fails at a line that is longer than any sensible one: a reader of such tables keeps a
/// whole line in memory.
#[derive(Debug)]
pub struct BoundedLines<R> {
    inner: R,
    /// Bytes since the last line feed.
    length: usize,
}

impl<R: Read> BoundedLines<R> {
    /// The longest line.
    pub const LONGEST: usize = 1 << 20;

    /// Reads from `inner`, at the beginning of a line.
    pub fn new(inner: R) -> Self {
        Self { inner, length: 0 }
    }
}

impl<R: Read> Read for BoundedLines<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(bytes)?;
        let mut lines = bytes[..count].split(|byte| *byte == b'\n');
        self.length += lines.next().map_or(0, <[u8]>::len);
        let mut longest = self.length;
        for line in lines {
            self.length = line.len();
            longest = longest.max(line.len());
        }
        if longest > Self::LONGEST {
            let problem = format!("a line is longer than {} MiB", Self::LONGEST >> 20);
            return Err(io::Error::other(problem));
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_have_a_bound_and_whole_texts_have_none() {
        let read = |text: &[u8]| {
            let mut all = Vec::new();
            BoundedLines::new(text).read_to_end(&mut all).map(|_| all)
        };
        let line = [vec![b'x'; BoundedLines::<&[u8]>::LONGEST], vec![b'\n']].concat();
        let text = line.repeat(3);
        assert!(read(&text).unwrap() == text);
        let longer = [&text[..], b"y", &line].concat();
        assert!(read(&longer).unwrap_err().to_string().contains("longer than 1 MiB"));
        assert!(read(&vec![0; 2 << 20]).is_err());
        assert!(read(b"").unwrap().is_empty());
    }

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
        fs::write(&file, "[],".repeat(MOST_VALUES / 2)).unwrap();
        assert!(read_small(&file).is_ok());
        fs::write(&file, "[],".repeat(MOST_VALUES / 2 + 1)).unwrap();
        assert!(read_small(&file).unwrap_err().to_string().contains("1000000 values"));
    }
}
