//! One process of the pipeline across its starts and deaths: its state, its signs of life, and what is wrong with it.

use std::collections::HashSet;
use std::path::PathBuf;

use config::launch::{ProcessEntry, Role};
use ipc_types::Status;
use outcome::ProcessFacts;
use runtime::Attachment;
use runtime::clock::now_ns;
use runtime::log_file::is_cut;

use crate::pipeline::plan::Plan;
use crate::pipeline::process::{Process, Program, before_backtrace, describe, last_lines};
use crate::pipeline::restart::{Budget, RestartPolicy};
use crate::pipeline::ring::Ring;
use crate::pipeline::vitals::Vitals;
use crate::runs::state::ProcessState;
use crate::words::Failure;

/// A process must be ready this soon after its start, the time left out in which it waited for a processor: it opens a
/// dozen files.
const READY_WITHIN_NS: u64 = 5_000_000_000;
/// A ready process that gives no sign of life for this long, which is five beats, is taken for frozen; see [`Vitals`].
const BEATS_WITHIN_NS: u64 = 500_000_000;
/// Who is taken for frozen is looked at again this much later, and must have hung for most of that time too. Two beats: this
/// process may have been off the processor itself, with its mail unread, and what a process waited for on a disk is
/// counted nowhere.
const LOOK_AGAIN_AFTER_NS: u64 = 250_000_000;
/// Exit code of a process that ends because of a user's mistake.
const USERS_MISTAKE: i32 = 64;

/// A process of the pipeline, alive or not.
pub(crate) struct Member {
    pub(crate) entry: ProcessEntry,
    program: Program,
    /// The ring that it belongs to; the first one for who serves all of them.
    pub(crate) ring: usize,
    /// The name of its service or role, with the number of its ring if that is not the first one.
    pub(crate) name: String,
    pub(crate) log: PathBuf,
    pub(crate) state: State,
    pub(crate) policy: RestartPolicy,
    pub(crate) incarnation: u64,
    pub(crate) pid: u32,
    /// When it was first found without a sign of life, and what the system counted of it then.
    suspected: Option<(u64, Vitals)>,
    /// The batch and tick that it reported last.
    pub(crate) seen: (u64, u64),
    /// The user knows that its log is cut.
    cut_is_told: bool,
    /// What it has warned of, with the numbers removed.
    warned: HashSet<String>,
    /// When it was started last.
    started_ns: u64,
    /// The user knows that it reports counts which cannot be.
    counts_are_odd: bool,
    /// Samples that its earlier incarnations refused; `refused` has those of this one.
    refused_before: RefusedSamples,
    refused: RefusedSamples,
}

/// Samples that a process refused.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct RefusedSamples {
    /// They did not match run, batch, attempt and tick.
    pub(crate) dropped: u64,
    /// They were not finite or out of range.
    pub(crate) rejected: u64,
    /// They came too late (in real time).
    pub(crate) late: u64,
}

impl RefusedSamples {
    fn and(self, other: Self) -> Self {
        Self {
            dropped: self.dropped + other.dropped,
            rejected: self.rejected + other.rejected,
            late: self.late + other.late,
        }
    }

    /// Whether a process that reported these counts may report `next` when it has run for `elapsed_ns`: counts do not
    /// fall, and no process takes a message in less than 100 ns.
    fn may_become(self, next: Self, elapsed_ns: u64) -> bool {
        [(self.dropped, next.dropped), (self.rejected, next.rejected), (self.late, next.late)]
            .into_iter()
            .all(|(before, now)| now >= before && now <= elapsed_ns / 100)
    }
}

pub(crate) enum State {
    /// To be started at this time.
    Down { due_ns: u64 },
    /// Up, and not ready yet.
    Starting { process: Process, since_ns: u64, vitals: Vitals },
    /// All its ports exist.
    Ready { process: Process, beat_ns: u64, vitals: Vitals },
}

impl State {
    pub(crate) fn process(&mut self) -> Option<&mut Process> {
        match self {
            State::Down { .. } => None,
            State::Starting { process, .. } | State::Ready { process, .. } => Some(process),
        }
    }
}

impl Member {
    pub(crate) fn new(entry: &ProcessEntry, plan: &Plan, ring: usize) -> Self {
        let program = plan.services.program(entry);
        let name = match program {
            Program::Command(_) => entry.role.name(),
            Program::Service(name) => name,
        };
        let name = match ring {
            0 => name.to_owned(),
            ring => format!("{name}-{}", ring + 1),
        };
        Self {
            entry: entry.clone(),
            program,
            ring,
            log: plan.folder.join("logs").join(format!("{name}.log")),
            name,
            state: State::Down { due_ns: 0 },
            policy: RestartPolicy::new(Budget {
                restarts: entry.restart_budget.unwrap_or(plan.budget.restarts),
                ..plan.budget
            }),
            incarnation: 0,
            pid: 0,
            suspected: None,
            seen: (0, 0),
            cut_is_told: false,
            warned: HashSet::new(),
            started_ns: 0,
            counts_are_odd: false,
            refused_before: RefusedSamples::default(),
            refused: RefusedSamples::default(),
        }
    }

    pub(crate) fn wire_role(&self) -> u32 {
        match self.entry.role {
            Role::Vehicle => Status::VEHICLE,
            Role::Supervisor => Status::SUPERVISOR,
            Role::Controller => Status::CONTROLLER,
            Role::Trainer => Status::TRAINER,
            Role::Recorder => Status::RECORDER,
        }
    }

    pub(crate) fn is_ready(&self) -> bool {
        matches!(self.state, State::Ready { .. })
    }

    /// Its place in the ring, if it belongs to it. Only the ring has cores: the trainer works while the ring
    /// rests, and the recorder runs alongside it.
    pub(crate) fn place_in_ring(&self) -> Option<usize> {
        match self.entry.role {
            Role::Vehicle => Some(0),
            Role::Controller => Some(1),
            Role::Supervisor => Some(2),
            Role::Trainer | Role::Recorder => None,
        }
    }

    /// Whether the drives of this ring need it.
    pub(crate) fn works_for(&self, ring: usize) -> bool {
        self.ring == ring || self.place_in_ring().is_none()
    }

    pub(crate) fn start(&mut self, attachment: &Attachment, ring: &Ring) -> Result<(), Failure> {
        self.incarnation += 1;
        self.refused_before = self.all_refused();
        self.refused = RefusedSamples::default();
        self.warned.clear();
        let place = self.place_in_ring();
        let attachment = Attachment {
            ring: self.ring,
            max_len: if place.is_some() { ring.max_len } else { attachment.max_len },
            incarnation: self.incarnation,
            core: place.and_then(|place| ring.placement.core_of(place)),
            fifo: attachment.fifo.filter(|_| place.is_some()),
            ..attachment.clone()
        };
        let process = Process::start(&self.program, &attachment, &self.log).map_err(|error| {
            anyhow::Error::new(error).context(format!("failed to start the {}", self.name))
        })?;
        self.pid = process.id();
        tracing::info!(process = self.name.as_str(), pid = self.pid, "started");
        self.suspected = None;
        let vitals = self.vitals().unwrap_or_default();
        self.started_ns = now_ns();
        self.state = State::Starting { process, since_ns: self.started_ns, vitals };
        Ok(())
    }

    /// What the system counts of it; none once it is gone. Of a foreign program nobody knows which of its processes and
    /// threads gives the signs of life.
    fn vitals(&self) -> Option<Vitals> {
        match self.program {
            Program::Service(_) => Vitals::of_main_thread(self.pid),
            Program::Command(_) => Vitals::of_tree(self.pid),
        }
    }

    /// Time that it has been ready to run and waited for a processor, since it started.
    pub(crate) fn waited_ns(&self) -> u64 {
        self.vitals().unwrap_or_default().waited_ns
    }

    /// Takes the counts of a sign of life, if a process can have them. Returns false the first time that it cannot.
    pub(crate) fn take_counts(&mut self, counts: RefusedSamples, now_ns: u64) -> bool {
        if self.refused.may_become(counts, now_ns.saturating_sub(self.started_ns)) {
            self.refused = counts;
            return true;
        }
        std::mem::replace(&mut self.counts_are_odd, true)
    }

    /// Notes a sign of life; returns whether it was the first.
    pub(crate) fn beat(&mut self, now_ns: u64) -> bool {
        self.suspected = None;
        let vitals = self.vitals().unwrap_or_default();
        match std::mem::replace(&mut self.state, State::Down { due_ns: now_ns }) {
            State::Starting { process, .. } => {
                self.state = State::Ready { process, beat_ns: now_ns, vitals };
                true
            }
            State::Ready { process, .. } => {
                self.state = State::Ready { process, beat_ns: now_ns, vitals };
                false
            }
            down @ State::Down { .. } => {
                self.state = down;
                false
            }
        }
    }

    /// What is wrong with the process, if anything.
    pub(crate) fn trouble(&mut self, now_ns: u64) -> Option<String> {
        if let Some(status) = self.state.process()?.try_wait() {
            return Some(describe(status));
        }
        let (since_ns, vitals, limit_ns) = match self.state {
            State::Down { .. } => return None,
            State::Starting { since_ns, vitals, .. } => (since_ns, vitals, READY_WITHIN_NS),
            State::Ready { beat_ns, vitals, .. } => (beat_ns, vitals, BEATS_WITHIN_NS),
        };
        if !self.hangs(now_ns, since_ns, vitals, limit_ns) {
            return None;
        }
        Some(match self.state {
            State::Ready { .. } => {
                format!("gave no sign of life for {} ms", BEATS_WITHIN_NS / 1_000_000)
            }
            _ => format!("was not ready within {} s", READY_WITHIN_NS / 1_000_000_000),
        })
    }

    /// Whether it hangs, at the second look: since it had these vitals, for `limit_ns`, and since the first look, too.
    fn hangs(&mut self, now_ns: u64, since_ns: u64, vitals: Vitals, limit_ns: u64) -> bool {
        let Some(now) = self.vitals() else { return true };
        if !vitals.hangs(now, now_ns.saturating_sub(since_ns), limit_ns) {
            self.suspected = None;
            return false;
        }
        let (first_ns, then) = *self.suspected.get_or_insert((now_ns, now));
        let again_ns = now_ns.saturating_sub(first_ns);
        if again_ns < LOOK_AGAIN_AFTER_NS {
            return false;
        }
        let hangs = then.hangs(now, again_ns, LOOK_AGAIN_AFTER_NS * 4 / 5);
        if !hangs {
            // It did something since: the next look is a first one.
            self.suspected = None;
        }
        hangs
    }

    /// The user's mistake because of which the process ended at its first start, in its own last words. Another start
    /// would end the same way.
    pub(crate) fn mistake(&mut self) -> Option<Failure> {
        if self.incarnation > 1 || self.state.process()?.try_wait()?.code() != Some(USERS_MISTAKE) {
            return None;
        }
        let said = last_lines(&self.log, 1).pop().unwrap_or_default();
        let said = said.strip_prefix("pathtune: ").unwrap_or(&said);
        Some(Failure::User(format!("{}: {said}", self.name)))
    }

    /// New warnings in the log of this incarnation, each reported once, even if the numbers in it change.
    pub(crate) fn new_warnings(&mut self) -> Vec<String> {
        let lines = last_lines(&self.log, 20);
        // After the time, the level and the source.
        let warnings = lines.iter().filter_map(|line| {
            let (_, rest) = line.split_once(" WARN ")?;
            Some(rest.split_once(": ").map_or(rest, |(_, text)| text).to_owned())
        });
        let is_new =
            |text: &String| self.warned.insert(text.replace(|c: char| c.is_ascii_digit(), ""));
        warnings.filter(is_new).collect()
    }

    /// Whether something was left out of its log, the first time that this is so.
    pub(crate) fn is_newly_cut(&mut self) -> bool {
        let is_new = !self.cut_is_told && is_cut(&self.log);
        self.cut_is_told |= is_new;
        is_new
    }

    pub(crate) fn given_up(&self, why: &str) -> Failure {
        let lines = before_backtrace(last_lines(&self.log, 60), 5);
        let said = if lines.is_empty() { "nothing".to_owned() } else { lines.join(" | ") };
        Failure::GaveUp(format!(
            "gave up: the {} {why}, too often in too short a time; its last words: {said}; \
             look into {}",
            self.name,
            self.log.display(),
        ))
    }

    pub(crate) fn state(&self) -> ProcessState {
        let state = match self.state {
            State::Down { .. } => "down",
            State::Starting { .. } => "starting",
            State::Ready { .. } => "ready",
        };
        ProcessState { state: state.to_owned(), facts: self.facts() }
    }

    /// Samples that all incarnations refused, as far as they reported them.
    fn all_refused(&self) -> RefusedSamples {
        self.refused_before.and(self.refused)
    }

    pub(crate) fn facts(&self) -> ProcessFacts {
        let RefusedSamples { dropped, rejected, late } = self.all_refused();
        ProcessFacts {
            name: self.name.clone(),
            pid: self.pid,
            restarts: self.incarnation.saturating_sub(1) as u32,
            dropped,
            rejected,
            late,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_that_fall_or_rise_faster_than_messages_come_are_no_counts() {
        let counts = |dropped| RefusedSamples { dropped, rejected: 3, late: 0 };
        assert!(counts(5).may_become(counts(5), 1_000));
        assert!(counts(5).may_become(counts(10), 1_000));
        assert!(!counts(5).may_become(counts(4), 1_000_000_000));
        assert!(!counts(5).may_become(counts(11), 1_000));
        assert!(!counts(5).may_become(counts(u64::MAX), u64::MAX));
    }
}
