//! Cleans up behind observers that died, while the pipeline drives on.
//!
//! The helper that cleans may take a while, or hang on what a killed starter left. So it is waited for from the
//! main loop, one look at a time, unlike the helper behind a member of the pipeline: then nothing drives anyway.

use std::process::Child;

use runtime::observer::{dead_observers, forget_observer};
use runtime::{Attachment, cleanup};

use crate::pipeline::process::spawn_cleaner;

/// Between two looks for dead observers.
const LOOK_EVERY_NS: u64 = 500_000_000;
/// A helper that takes longer than this hangs.
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
    /// Takes one look: starts, ends or goes on waiting for a clean-up.
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
            tracing::info!(?dead, "observers died; cleaning up behind them");
            self.cleaning = Cleaning::start(attachment, now_ns, dead);
        }
    }

    /// Ends a clean-up under way: somebody else is about to clean.
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
        // Who cannot be started now is tried again with the next look.
        let helper = spawn_cleaner(attachment).ok()?;
        Some(Self { helper, since_ns: now_ns, dead })
    }

    fn go_on(mut self, attachment: &Attachment, now_ns: u64) -> Option<Self> {
        let names = &attachment.names;
        match self.helper.try_wait() {
            Ok(Some(status)) if status.success() => {
                // Only now: until the node is cleaned, its own files tell whose places are free again.
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
