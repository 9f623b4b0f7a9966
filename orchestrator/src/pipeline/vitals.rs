//! Tells a process that hangs from one that does not get the processor.
//!
//! A process without a sign of life is taken for frozen once it had time to give one and did not: it slept or was
//! stopped for so long, or it used so much processor time. The time that it was ready to run and waited for a processor
//! is not held against it: a loaded machine is slow, not broken.

use std::fs;

/// What the system counts of a process, or of a process with all that it started.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Vitals {
    /// Processor time that it used.
    pub(crate) used_ns: u64,
    /// Time that it was ready to run and waited for a processor, up to when it last got one.
    pub(crate) waited_ns: u64,
    /// Whether it runs, is ready to run, or waits for a disk.
    pub(crate) runnable: bool,
}

impl Vitals {
    /// Of the main thread of a process: the one that gives signs of life in our own services. None once it is gone.
    pub(crate) fn of_main_thread(pid: u32) -> Option<Self> {
        Self::of_task(&format!("/proc/{pid}/task/{pid}"))
    }

    /// Of a process, its threads and all that it started: which of them gives signs of life is not known.
    pub(crate) fn of_tree(pid: u32) -> Option<Self> {
        let mut all: Option<Self> = None;
        let mut processes = vec![pid];
        // Bounded, so that a program that starts others without end does not keep us here.
        while let Some(pid) = processes.pop().filter(|_| processes.len() < 1000) {
            let Ok(tasks) = fs::read_dir(format!("/proc/{pid}/task")) else { continue };
            for task in
                tasks.flatten().filter_map(|task| task.path().into_os_string().into_string().ok())
            {
                if let Some(vitals) = Self::of_task(&task) {
                    all.get_or_insert_default().add(vitals);
                }
                let children = fs::read_to_string(format!("{task}/children")).unwrap_or_default();
                processes
                    .extend(children.split_whitespace().filter_map(|pid| pid.parse::<u32>().ok()));
            }
        }
        all
    }

    fn add(&mut self, other: Self) {
        self.used_ns += other.used_ns;
        self.waited_ns += other.waited_ns;
        self.runnable |= other.runnable;
    }

    fn of_task(folder: &str) -> Option<Self> {
        let stat = fs::read_to_string(format!("{folder}/stat")).ok()?;
        let schedstat = fs::read_to_string(format!("{folder}/schedstat")).ok()?;
        Self::parse(&stat, &schedstat)
    }

    /// From `stat` and `schedstat` of a task; see proc(5).
    fn parse(stat: &str, schedstat: &str) -> Option<Self> {
        // The name in front is in parentheses, and may hold any character.
        let state = stat.rsplit_once(')')?.1.trim_start().chars().next()?;
        let mut numbers = schedstat.split_whitespace();
        let mut number = || numbers.next()?.parse().ok();
        Some(Self {
            used_ns: number()?,
            waited_ns: number()?,
            runnable: matches!(state, 'R' | 'D'),
        })
    }

    /// Whether a process hangs that had these vitals when it gave its last sign of life, `elapsed_ns` ago, and has
    /// `now`; it has `limit_ns` for each of the two ways to hang.
    pub(crate) fn hangs(self, now: Self, elapsed_ns: u64, limit_ns: u64) -> bool {
        let used_ns = now.used_ns.saturating_sub(self.used_ns);
        let waited_ns = now.waited_ns.saturating_sub(self.waited_ns);
        // It ran, and had nothing to say.
        if used_ns >= limit_ns {
            return true;
        }
        // It may have waited since it last ran, which is not counted yet.
        if now.runnable {
            return false;
        }
        elapsed_ns.saturating_sub(used_ns).saturating_sub(waited_ns) >= limit_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::process::{Pid, Signal};
    use std::os::unix::process::CommandExt;
    use std::process::{Child, Command, Stdio};
    use std::time::{Duration, Instant};

    const LIMIT_NS: u64 = 500;

    fn vitals(used_ns: u64, waited_ns: u64, runnable: bool) -> Vitals {
        Vitals { used_ns, waited_ns, runnable }
    }

    #[test]
    fn who_sleeps_or_computes_without_a_sign_hangs_and_who_waits_for_a_processor_does_not() {
        let before = vitals(1000, 2000, false);
        let check = |now: Vitals, elapsed_ns: u64, hangs: bool| {
            assert_eq!(
                before.hangs(now, elapsed_ns, LIMIT_NS),
                hangs,
                "{now:?} after {elapsed_ns}"
            );
        };
        check(vitals(1000, 2000, false), 499, false);
        check(vitals(1000, 2000, false), 500, true);
        // Waited nearly all the time, and slept a little.
        check(vitals(1010, 11_500, false), 10_000, false);
        check(vitals(1010, 11_500, false), 10_011, true);
        // Ready to run: it has waited since, and nobody knows yet for how long.
        check(vitals(1000, 2000, true), 60_000, false);
        // Computes for ever.
        check(vitals(1500, 2000, true), 600, true);
        // Numbers of another process: never a panic.
        check(vitals(0, 0, false), 500, true);
    }

    #[test]
    fn a_task_s_lines_are_read_whatever_its_name_is() {
        let line = |state: char| format!("12 (a ) R (b) {state} 1 12 12 0");
        assert_eq!(Vitals::parse(&line('S'), "5 6 7\n"), Some(vitals(5, 6, false)));
        assert_eq!(Vitals::parse(&line('R'), "5 6 7\n"), Some(vitals(5, 6, true)));
        assert_eq!(Vitals::parse(&line('T'), "5 6 7\n"), Some(vitals(5, 6, false)));
        assert_eq!(Vitals::parse("12 a R", "5 6 7"), None);
        assert_eq!(Vitals::parse(&line('S'), "5"), None);
    }

    fn start(command: &str) -> Child {
        let mut shell = Command::new("sh");
        shell.args(["-c", command]).process_group(0).stdin(Stdio::null()).spawn().unwrap()
    }

    #[test]
    fn a_process_that_sleeps_hangs_and_its_busy_child_is_seen() {
        let mut sleeper = start("exec sleep 60");
        let mut busy = start("(while :; do :; done) & wait");
        std::thread::sleep(Duration::from_millis(100));
        let of = |child: &Child| Vitals::of_main_thread(child.id()).unwrap();
        let (before, since) = (of(&sleeper), Instant::now());
        std::thread::sleep(Duration::from_millis(50));
        let elapsed_ns = since.elapsed().as_nanos() as u64;
        assert!(before.hangs(of(&sleeper), elapsed_ns, 40_000_000));
        assert!(!of(&busy).runnable);
        assert!(Vitals::of_tree(busy.id()).unwrap().runnable);
        sleeper.kill().unwrap();
        sleeper.wait().unwrap();
        assert_eq!(Vitals::of_main_thread(sleeper.id()), None);
        // The child that computes is in its group, too.
        rustix::process::kill_process_group(Pid::from_child(&busy), Signal::KILL).unwrap();
        let _ = busy.wait();
    }
}
