//! Whether DDS is still at work.
//!
//! RustDDS does everything in two threads, each of which sleeps in `epoll_wait`. When that is interrupted (EINTR), which
//! happens whenever this process is stopped and continued, the thread ends, and no call fails from then on: messages are
//! accepted, and never sent.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::Path;

const ALL: &str = "/proc/self/task";

/// The threads that DDS has started.
pub(crate) struct Threads(Vec<OsString>);

impl Threads {
    /// What `start` returns, and the threads that it has started.
    pub(crate) fn of<T>(start: impl FnOnce() -> T) -> std::io::Result<(T, Self)> {
        let before = all()?;
        let started = start();
        let threads = all()?.difference(&before).cloned().collect();
        Ok((started, Self(threads)))
    }

    /// Whether none of them has ended.
    pub(crate) fn all_live(&self) -> bool {
        self.0.iter().all(|thread| Path::new(ALL).join(thread).exists())
    }
}

fn all() -> std::io::Result<BTreeSet<OsString>> {
    std::fs::read_dir(ALL)?.map(|entry| Ok(entry?.file_name())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;
    use std::time::Duration;

    #[test]
    fn a_thread_that_ends_is_missed() {
        let (end, ended) = channel::<()>();
        let (thread, threads) =
            Threads::of(|| std::thread::spawn(move || ended.recv().is_err())).unwrap();
        assert!(threads.all_live());
        drop(end);
        assert!(thread.join().unwrap());
        // Its entry goes a moment later.
        while threads.all_live() {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
