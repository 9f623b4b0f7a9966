//! Files of a run, written so that no link and no kill does harm.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use config::read_small;
use rustix::fs::OFlags;

/// Writes a file as a whole: whoever reads it, and whenever this process is killed, there is the old text or the new
/// one. A file that holds the text already is left alone.
pub(crate) fn write_whole(path: &Path, text: &str) -> io::Result<()> {
    let is_link = fs::symlink_metadata(path).is_ok_and(|meta| meta.is_symlink());
    if !is_link && read_small(path).is_ok_and(|there| there == text) {
        return Ok(());
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // Always the same name, so that what a killed predecessor left is removed here.
    let part = path.with_file_name(format!(".{name}.part"));
    match fs::remove_file(&part) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    // Made anew, so that no link is followed.
    let mut file = OpenOptions::new().write(true).create_new(true).open(&part)?;
    file.write_all(text.as_bytes())?;
    drop(file);
    fs::rename(part, path)
}

/// Opens or makes a file to be locked, whose content does not matter and is left alone. Follows no link.
pub(crate) fn open_lock(path: &Path) -> io::Result<fs::File> {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false).custom_flags(flags).open(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn files_are_replaced_as_a_whole_and_links_are_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (file, other) = (folder.path().join("file"), folder.path().join("other"));
        fs::write(&other, "mine").unwrap();
        symlink(&other, &file).unwrap();
        // What a killed predecessor left, or somebody put there.
        symlink(&other, folder.path().join(".file.part")).unwrap();
        write_whole(&file, "new").unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
        assert_eq!(fs::read_to_string(&other).unwrap(), "mine");
        let before = fs::metadata(&file).unwrap().modified().unwrap();
        write_whole(&file, "new").unwrap();
        assert_eq!(fs::metadata(&file).unwrap().modified().unwrap(), before);
        let link = folder.path().join("lock");
        symlink(&other, &link).unwrap();
        assert!(open_lock(&link).is_err());
        open_lock(&file).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
    }
}
