//! What is checked before anything is started, so that a mistake leaves nothing behind.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use config::RunConfig;
use config::launch::Launch;
use config::{open_regular, read_small};
use runtime::{limits, log_file, waiting};
use rustix::mm::munlockall;

use crate::runs::files::open_lock;
use crate::words::Failure;
use crate::words::terminal::tell;

/// Checks that the programs of a launch file exist.
pub(crate) fn check_commands(launch: &Launch) -> Result<(), Failure> {
    for entry in &launch.process {
        let Some(command) = &entry.command else { continue };
        let fail = |why: String| {
            Err(Failure::User(format!(
                "the command of the {}: {command}: {why}",
                entry.role.name()
            )))
        };
        let words = match shell_words::split(command) {
            Ok(words) => words,
            Err(error) => return fail(format!("{error}")),
        };
        let Some(program) = words.first() else { return fail("is empty".to_owned()) };
        if which::which(program).is_err() {
            return fail(format!("{program} is not an executable file, nor in the PATH"));
        }
    }
    Ok(())
}

/// Checks that the objective needs no drives of the grid that only our simulator could make before the first drive.
pub(crate) fn check_scales(config: &RunConfig, launch: &Launch) -> Result<(), Failure> {
    let (Some(key), Some(role)) = (config.scale_from_grid(), launch.first_of_ring_not_ours())
    else {
        return Ok(());
    };
    let name = role.name();
    Err(Failure::User(format!(
        "{key}: is 0, which stands for the least value in the grid of our own vehicle, controller and supervisor, but \
         another {name} drives here; give a scale (`pathtune grid` with the same {name} prints the least values)"
    )))
}

/// Checks whether first-in-first-out scheduling and locked memory will be allowed, and prints a warning if not. On a
/// machine that has nothing else to do, the drive is the same without them.
pub(crate) fn ask_for_fifo(priority: u8, realtime: bool) -> Result<(), Failure> {
    if !realtime {
        let why = "--fifo is for driving by the clock: add --realtime";
        return Err(Failure::User(why.to_owned()));
    }
    // Tried in a thread that ends at once, so that the orchestrator itself does not change.
    let allowed = std::thread::spawn(move || waiting::use_fifo(priority)).join();
    if let Ok(Err(why)) = allowed {
        tell!(
            "pathtune: --fifo {priority} is refused here ({why}), and the drive goes on without it; grant rtprio in \
             /etc/security/limits.conf, see pathtune doctor"
        );
    }
    if let Err(why) = waiting::lock_memory() {
        tell!("pathtune: memory cannot be locked here ({why}); grant memlock, see pathtune doctor");
    }
    let _ = munlockall();
    Ok(())
}

/// Makes the output folder, or takes an empty one.
pub(crate) fn make_folder(folder: &Path) -> Result<PathBuf, Failure> {
    let fail = |why: String| Failure::User(format!("--out {}: {why}", folder.display()));
    match fs::read_dir(folder) {
        Ok(mut entries) => {
            if entries.next().is_some() {
                return Err(fail("holds files already; name another folder".to_owned()));
            }
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            fs::create_dir_all(folder)
                .map_err(|error| fail(format!("cannot be created: {error}")))?;
        }
        Err(error) => return Err(fail(format!("cannot be used: {error}"))),
    }
    let folder =
        fs::canonicalize(folder).map_err(|error| fail(format!("cannot be used: {error}")))?;
    fs::create_dir(folder.join("logs"))
        .map_err(|error| fail(format!("cannot be written: {error}")))?;
    Ok(folder)
}

/// Locks an output folder: two trainings in one would write the same journal.
pub(crate) fn lock_folder(folder: &Path) -> Result<fs::File, Failure> {
    let path = folder.join("lock");
    let fail = |why: String| Failure::User(format!("{}: {why}", folder.display()));
    let file = open_lock(&path).map_err(|error| match error.raw_os_error() {
        Some(code) if code == rustix::io::Errno::LOOP.raw_os_error() => {
            fail(format!("{} is a link; remove it", path.display()))
        }
        _ => fail(format!("cannot be written: {error}")),
    })?;
    // The last child of a killed predecessor may hold the lock until it has executed its program.
    let until = Instant::now() + Duration::from_secs(1);
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(file),
            Err(fs::TryLockError::WouldBlock) if Instant::now() < until => {
                std::thread::sleep(Duration::from_millis(5));
            }
            Err(fs::TryLockError::WouldBlock) => {
                let why = "a living run trains in this folder; `pathtune status` lists it";
                return Err(fail(why.to_owned()));
            }
            Err(fs::TryLockError::Error(error)) => {
                return Err(fail(format!("cannot be locked: {error}")));
            }
        }
    }
}

/// Prevents others from resuming the training in a folder, without leaving a trace; refused if a living run uses it.
pub(crate) fn look_into(folder: &Path) -> Result<Option<fs::File>, Failure> {
    let Ok(file) = open_regular(&folder.join("lock")) else { return Ok(None) };
    let fail = |why: &str| Err(Failure::User(format!("{}: {why}", folder.display())));
    match file.try_lock_shared() {
        Ok(()) => Ok(Some(file)),
        Err(fs::TryLockError::WouldBlock) => fail(
            "a living run trains in this folder; wait for its end, or stop it with `pathtune stop`",
        ),
        Err(fs::TryLockError::Error(error)) => fail(&format!("cannot be locked: {error}")),
    }
}

/// Removes an output folder in which nothing has happened yet.
pub(crate) fn unmake_folder(folder: &Path) {
    for name in ["config.toml", "launch.toml", "sweep.toml", "lock", "logs/orchestrator.log"] {
        let _ = fs::remove_file(folder.join(name));
    }
    let _ = fs::remove_dir(folder.join("logs"));
    let _ = fs::remove_dir(folder);
}

/// Checks that this process may open enough files, and that `/dev/shm` has room for a run whose messages carry `max_len`
/// elements.
pub(crate) fn check_resources(max_len: usize) -> Result<(), Failure> {
    let advice = "take a smaller --fleet";
    check_limits()?;
    check_shared_memory(&format!("a run with {max_len} vehicles"), needed_bytes(max_len), advice)
}

/// Whether `/dev/shm` has room for so many rings; each of them has topics of its own.
pub(crate) fn has_room_for_rings(rings: usize, max_len: usize) -> bool {
    let needed = needed_bytes(max_len) + (rings as u64 - 1) * needed_bytes(0);
    check_shared_memory("", needed, "").is_ok()
}

/// The same for as many pipelines at once, their main memory included.
pub(crate) fn check_resources_of_pipelines(count: usize, max_len: usize) -> Result<(), Failure> {
    let who = if count == 1 { "a job".to_owned() } else { format!("running {count} jobs at once") };
    check_limits()?;
    check_shared_memory(&who, count as u64 * needed_bytes(max_len), "take a smaller -j")?;
    let needed = count as u64 * PIPELINE_BYTES;
    match free_memory() {
        Some(free) if free < needed => Err(Failure::User(format!(
            "memory is short: {who} needs {} MiB, and {} MiB are free; end other programs, or take a smaller -j",
            needed.div_ceil(1 << 20),
            free >> 20,
        ))),
        _ => Ok(()),
    }
}

/// Main memory that a pipeline and its orchestrator use besides shared memory: more than twice what was found.
const PIPELINE_BYTES: u64 = 128 << 20;

/// Bytes of main memory that programs may still take, as far as this machine tells: those of the system, or of the control
/// group if these are fewer.
fn free_memory() -> Option<u64> {
    let number = |text: String| text.trim().parse::<u64>().ok();
    let of_group =
        |name: &str| read_small(&Path::new("/sys/fs/cgroup").join(name)).ok().and_then(number);
    let group = of_group("memory.max")
        .zip(of_group("memory.current"))
        .map(|(most, taken)| most.saturating_sub(taken));
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let machine = number(line.trim_end_matches("kB").to_owned())?.saturating_mul(1 << 10);
    Some(group.map_or(machine, |group| group.min(machine)))
}

/// The same for an observer of a run. What it lacks, the run's own processes would lack, too, when they connect to it.
pub(crate) fn check_resources_of_observer() -> Result<(), Failure> {
    check_limits()?;
    check_shared_memory("an observer", OBSERVER_BYTES, "end other runs")
}

/// Checks the limits that the user has set for processes.
fn check_limits() -> Result<(), Failure> {
    limits::check_files().map_err(Failure::User)?;
    log_file::limit().map(|_| ()).map_err(Failure::User)
}

/// Checks that `/dev/shm` has room: if it fills up later, the result is a bus error, not one that could be handled.
fn check_shared_memory(who: &str, needed: u64, advice: &str) -> Result<(), Failure> {
    let stat = rustix::fs::statvfs("/dev/shm")
        .map_err(|error| Failure::User(format!("/dev/shm cannot be used: {error}")))?;
    let free = stat.f_bavail.saturating_mul(stat.f_frsize);
    if free >= needed {
        return Ok(());
    }
    Err(Failure::User(format!(
        "/dev/shm is too small: {who} needs {} MiB, and {} MiB are free; free some of it, enlarge it \
         (mount -o remount,size=… /dev/shm), or {advice}",
        needed.div_ceil(1 << 20),
        free >> 20,
    )))
}

/// Shared memory that an observer and the ports that are connected to it use: twice what was found.
const OBSERVER_BYTES: u64 = 4 << 20;

/// Shared memory that a run may use.
fn needed_bytes(max_len: usize) -> u64 {
    (4 << 20) + max_len as u64 * (64 << 10)
}
