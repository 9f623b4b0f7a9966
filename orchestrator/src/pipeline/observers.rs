//! Cleans up after observers that died, while the pipeline drives on.
//!
//! The clean-up helper may take a while, or hang on what a process that was killed during its start has left. So the
//! main loop does not block on it, but checks on it time after time. After the death of a member of the pipeline it may
//! block, because then nothing drives anyway.

use std::process::Child;

use runtime::observer::{dead_observers, forget_observer};
use runtime::{Attachment, cleanup};

use crate::pipeline::process::spawn_cleaner;

/// Time between two looks for dead observers.
const LOOK_EVERY_NS: u64 = 500_000_000;
/// A helper that takes longer than this is hanging.
const HELPER_NS: u64 = 3_000_000_000;

/// Looks after the observers of a run.
#[derive(Default)]
pub(crate) struct ObserverCare {
    looked_ns: u64,
    cleaning: Option<Cleaning>,
}

/// A clean-up under way.
struct Cleaning {
    helper: Child,
    since_ns: u64,
    /// Observers that died, and helpers that failed before this one.
    dead: Vec<u32>,
}

impl ObserverCare {
    /// Takes one look: starts a clean-up, ends it, or goes on waiting for it.
    pub(crate) fn look(&mut self, attachment: &Attachment, now_ns: u64) {
        if let Some(cleaning) = self.cleaning.take() {
            self.cleaning = cleaning.go_on(attachment, now_ns);
            return;
        }
        if now_ns - self.looked_ns < LOOK_EVERY_NS {
            return;
        }
        self.looked_ns = now_ns;
        let dead = dead_observers(&attachment.names);
        if !dead.is_empty() {
            tracing::info!(?dead, "observers died; cleaning up after them");
            self.cleaning = Cleaning::start(attachment, now_ns, dead);
        }
    }

    /// Ends a clean-up that is under way: another one is about to begin.
    pub(crate) fn stand_back(&mut self) {
        if let Some(mut cleaning) = self.cleaning.take() {
            cleaning.end_helper();
        }
    }
}

impl Drop for ObserverCare {
    fn drop(&mut self) {
        self.stand_back();
    }
}

impl Cleaning {
    fn start(attachment: &Attachment, now_ns: u64, dead: Vec<u32>) -> Option<Self> {
        for pid in &dead {
            cleanup::remove_half_made(&attachment.names, *pid);
        }
        // A helper that cannot be started now is started with the next look.
        let helper = spawn_cleaner(attachment).ok()?;
        Some(Self { helper, since_ns: now_ns, dead })
    }

    fn go_on(mut self, attachment: &Attachment, now_ns: u64) -> Option<Self> {
        let names = &attachment.names;
        match self.helper.try_wait() {
            Ok(Some(status)) if status.success() => {
                // Only now: until the node is removed, its own files say whose places are free again.
                for pid in self.dead {
                    cleanup::remove_leftovers(names, pid);
                    forget_observer(names, pid);
                }
                None
            }
            Ok(None) if now_ns - self.since_ns < HELPER_NS => Some(self),
            _ => {
                let failed = self.end_helper();
                tracing::warn!(pid = failed, "the clean-up helper failed, and is run again");
                self.dead.push(failed);
                Self::start(attachment, now_ns, self.dead)
            }
        }
    }

    fn end_helper(&mut self) -> u32 {
        let _ = self.helper.kill();
        let _ = self.helper.wait();
        self.helper.id()
    }
}
