//! A run: its names, its private folder, and how they reach its processes.
//!
//! Each run has its own random prefix for names in `/dev/shm`, and its own folder for everything else the
//! transport keeps, so that runs never meet and can be removed whole.

use std::ffi::OsString;
use std::fs;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Name of the file in a run's folder that its orchestrator keeps locked for as long as it lives.
pub const LOCK_FILE: &str = "lock";

/// What names a run on its machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunNames {
    /// The run's number; every message carries it.
    pub run: u64,
    /// Private folder of the transport's files.
    pub root: PathBuf,
}

impl RunNames {
    /// The names of a new run, whose private folder is created.
    ///
    /// # Errors
    /// If the folder cannot be created, or belongs to another user.
    pub fn create() -> io::Result<Self> {
        while_others_end(|| Self::create_in(&base_folder()))
    }

    /// The names of a new run, as [`RunNames::create`] makes them, with the lock that keeps it alive.
    ///
    /// # Errors
    /// As [`RunNames::create`].
    pub fn start() -> io::Result<(Self, fs::File)> {
        while_others_end(|| Self::start_in(&base_folder()))
    }

    fn create_in(base: &Path) -> io::Result<Self> {
        // Each RandomState is keyed afresh from the system's randomness.
        let run = RandomState::new().build_hasher().finish() | 1;
        make_private(base)?;
        let root = base.join(format!("{run:016x}"));
        make_private(&root)?;
        Ok(Self { run, root })
    }

    fn start_in(base: &Path) -> io::Result<(Self, fs::File)> {
        let names = Self::create_in(base)?;
        match names.lock() {
            Ok(lock) => Ok((names, lock)),
            Err(error) => {
                names.remove();
                Err(error)
            }
        }
    }

    /// Makes the run's lock, which is locked before it has its name: an unlocked one is that of a dead run.
    fn lock(&self) -> io::Result<fs::File> {
        let born = self.root.join(".lock");
        let lock = fs::File::create_new(&born)?;
        lock.lock()?;
        // Fails if the run has been taken for a dead one, because it took so long to come here.
        fs::hard_link(&born, self.root.join(LOCK_FILE)).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => io::ErrorKind::NotFound.into(),
            _ => error,
        })?;
        let _ = fs::remove_file(born);
        Ok(lock)
    }

    /// Takes the lock of a dead run, if nobody else has taken it meanwhile.
    fn take_over(&self) -> Option<fs::File> {
        let path = self.root.join(LOCK_FILE);
        let lock = fs::File::create_new(&path).or_else(|_| fs::File::open(&path)).ok()?;
        lock.try_lock().ok()?;
        Some(lock)
    }

    /// Prefix of the run's names in `/dev/shm`.
    pub fn prefix(&self) -> String {
        prefix(self.run)
    }

    /// Removes everything of the run: its segments, its folder, and the folder above if that is empty.
    pub fn remove(&self) {
        remove_segments(&self.prefix());
        let _ = fs::remove_dir_all(&self.root);
        if let Some(base) = self.root.parent() {
            let _ = fs::remove_dir(base);
        }
    }
}

/// Tries again if the folder above the run's own has just been removed by another run that ended.
fn while_others_end<T>(mut create: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    for _ in 1..ATTEMPTS {
        match create() {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            made => return made,
        }
    }
    create()
}

/// How often to try: each time, another run must have ended at just that moment.
const ATTEMPTS: u32 = 100;

/// Prefix of a run's names in `/dev/shm`.
pub fn prefix(run: u64) -> String {
    format!("pathtune_{run:016x}_")
}

/// The run whose prefix a name in `/dev/shm` has.
fn run_of_segment(name: &str) -> Option<u64> {
    let digits = name.strip_prefix("pathtune_")?.get(..16)?;
    u64::from_str_radix(digits, 16).ok()
}

/// Bytes in the path of a runtime folder: a socket's path has room for 108, of which the transport's names take 90.
const LONGEST_FOLDER: usize = 18;

/// The folder that holds the runs of this user.
pub fn base_folder() -> PathBuf {
    let named = named_folder().filter(|folder| why_not(folder).is_none());
    match named {
        Some(folder) => folder.join("pathtune"),
        None => {
            let mut name = OsString::from("pathtune-");
            name.push(rustix::process::geteuid().as_raw().to_string());
            PathBuf::from("/tmp").join(name)
        }
    }
}

/// Why the folder that XDG_RUNTIME_DIR names is not used, and which one is: `None` if it is used, or names none.
pub fn passed_over() -> Option<String> {
    let folder = named_folder()?;
    let why = why_not(&folder)?;
    let base = base_folder();
    Some(format!("XDG_RUNTIME_DIR={} {why}: runs are in {}", folder.display(), base.display()))
}

fn named_folder() -> Option<PathBuf> {
    let folder = std::env::var_os("XDG_RUNTIME_DIR").filter(|folder| !folder.is_empty())?;
    Some(PathBuf::from(folder))
}

fn why_not(folder: &Path) -> Option<String> {
    let bytes = folder.as_os_str().len();
    if bytes > LONGEST_FOLDER {
        let room = format!("has {bytes} bytes, and a socket's path has room for {LONGEST_FOLDER}");
        return Some(room);
    }
    (!folder.is_dir()).then(|| "is no folder".to_owned())
}

/// Makes a folder that only this user can enter, or checks that it is one.
fn make_private(folder: &Path) -> io::Result<()> {
    match fs::DirBuilder::new().mode(0o700).create(folder) {
        Ok(()) => return Ok(()),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
        Err(error) => {
            let message =
                format!("{} cannot be created: {error}; set XDG_RUNTIME_DIR", folder.display());
            return Err(io::Error::new(error.kind(), message));
        }
    }
    let meta = fs::symlink_metadata(folder)?;
    let refused = |why: &str| {
        let message = format!("{} {why}; remove it, or set XDG_RUNTIME_DIR", folder.display());
        Err(io::Error::new(io::ErrorKind::PermissionDenied, message))
    };
    if !meta.is_dir() {
        return refused("is not a folder");
    }
    if meta.uid() != rustix::process::geteuid().as_raw() {
        return refused("belongs to another user");
    }
    if meta.mode() & 0o077 != 0 {
        fs::set_permissions(folder, fs::Permissions::from_mode(0o700))?;
    }
    Ok(())
}

/// Whether this is a folder of this user that nobody else can enter.
pub fn is_private(folder: &Path) -> bool {
    fs::symlink_metadata(folder).is_ok_and(|meta| {
        let is_ours = meta.uid() == rustix::process::geteuid().as_raw();
        meta.is_dir() && is_ours && meta.mode() & 0o077 == 0
    })
}

fn remove_segments(prefix: &str) {
    for name in segments() {
        if name.starts_with(prefix) {
            let _ = fs::remove_file(Path::new("/dev/shm").join(name));
        }
    }
}

/// Names in `/dev/shm`.
fn segments() -> Vec<String> {
    let Ok(entries) = fs::read_dir("/dev/shm") else { return Vec::new() };
    entries.flatten().filter_map(|entry| entry.file_name().into_string().ok()).collect()
}

/// Removes what dead runs of this user left behind, and returns those runs. Before that, each of them is shown to `end`,
/// which ends processes that live on.
///
/// A run is alive exactly as long as its orchestrator holds the lock in its folder.
pub fn sweep_dead_runs(end: impl Fn(&RunNames)) -> Vec<RunNames> {
    let mut swept = Vec::new();
    for names in dead_runs() {
        if let Some(_lock) = names.take_over() {
            end(&names);
            names.remove();
            swept.push(names);
        }
    }
    swept
}

/// Runs of this user whose orchestrator is gone.
pub fn dead_runs() -> Vec<RunNames> {
    runs().into_iter().filter(|names| is_dead(&names.root)).collect()
}

/// Runs of this user whose orchestrator lives.
pub fn living_runs() -> Vec<RunNames> {
    runs().into_iter().filter(|names| !is_dead(&names.root)).collect()
}

/// Runs of this user. A folder that somebody else made, or a link, is none: nothing in it is read, and nothing that it
/// names is swept or stopped.
fn runs() -> Vec<RunNames> {
    let base = base_folder();
    if !is_private(&base) {
        return Vec::new();
    }
    let Ok(entries) = fs::read_dir(base) else { return Vec::new() };
    let name_run = |entry: fs::DirEntry| {
        let name = entry.file_name();
        let name = name.to_str().filter(|name| name.len() == 16)?;
        let run = u64::from_str_radix(name, 16).ok()?;
        is_private(&entry.path()).then(|| RunNames { run, root: entry.path() })
    };
    entries.flatten().filter_map(name_run).collect()
}

/// Segments of this user that belong to no run with a folder or a process: their run was removed while one
/// of its processes was still dying, or lived under another XDG_RUNTIME_DIR.
pub fn stale_segments() -> Vec<String> {
    let known: Vec<u64> = runs().into_iter().map(|names| names.run).collect();
    let in_use = runs_with_processes();
    let uid = rustix::process::geteuid().as_raw();
    segments()
        .into_iter()
        .filter(|name| {
            let Some(run) = run_of_segment(name) else { return false };
            let old = fs::metadata(Path::new("/dev/shm").join(name)).is_ok_and(|meta| {
                let age = meta.modified().ok().and_then(|made| made.elapsed().ok());
                meta.uid() == uid && age.is_some_and(|age| age.as_secs() > 10)
            });
            old && !known.contains(&run) && !in_use.contains(&run)
        })
        .collect()
}

/// Runs that a living process names in its environment.
fn runs_with_processes() -> Vec<u64> {
    let Ok(entries) = fs::read_dir("/proc") else { return Vec::new() };
    entries
        .flatten()
        .filter_map(|entry| fs::read(entry.path().join("environ")).ok())
        .filter_map(|environ| {
            let run = environ.split(|byte| *byte == 0).find_map(|variable| {
                std::str::from_utf8(variable).ok()?.strip_prefix("PATHTUNE_RUN=")
            })?;
            u64::from_str_radix(run, 16).ok()
        })
        .collect()
}

fn is_dead(root: &Path) -> bool {
    match fs::File::open(root.join(LOCK_FILE)) {
        Ok(file) => file.try_lock().is_ok(),
        // Being created just now, or never finished: dead once it is old enough.
        Err(_) => fs::metadata(root)
            .and_then(|meta| meta.modified())
            .ok()
            .and_then(|made| made.elapsed().ok())
            .is_some_and(|age| age.as_secs() > 10),
    }
}

/// Names in `/dev/shm` that belong to a run.
pub fn segments_of(run: u64) -> Vec<String> {
    segments().into_iter().filter(|name| run_of_segment(name) == Some(run)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prefix_names_its_run() {
        assert_eq!(run_of_segment(&format!("{}rest", prefix(0xab))), Some(0xab));
        assert_eq!(run_of_segment("iox2_1234"), None);
        assert_eq!(run_of_segment("pathtune_é"), None);
    }

    #[test]
    fn a_run_that_starts_is_not_swept_and_outlives_the_end_of_the_others() {
        let folder = tempfile::tempdir().unwrap();
        let base = folder.path().join("runs");
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..200 {
                        let (names, _lock) =
                            while_others_end(|| RunNames::start_in(&base)).unwrap();
                        assert!(!is_dead(&names.root));
                        names.remove();
                    }
                });
            }
        });
        // One that is taken for dead before it has its lock does not come to life.
        let names = RunNames::create_in(&base).unwrap();
        let _sweeper = names.take_over().unwrap();
        assert_eq!(names.lock().unwrap_err().kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn a_private_folder_is_closed_and_no_link_is_taken_for_one() {
        let folder = tempfile::tempdir().unwrap();
        let open = folder.path().join("open");
        fs::create_dir(&open).unwrap();
        fs::set_permissions(&open, fs::Permissions::from_mode(0o755)).unwrap();
        make_private(&open).unwrap();
        assert_eq!(fs::metadata(&open).unwrap().mode() & 0o777, 0o700);
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&open, &link).unwrap();
        assert!(make_private(&link).unwrap_err().to_string().contains("is not a folder"));
        assert!(is_private(&open) && !is_private(&link));
        fs::set_permissions(&open, fs::Permissions::from_mode(0o770)).unwrap();
        assert!(!is_private(&open));
    }
}
