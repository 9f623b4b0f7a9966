//! The loop that joins everything: it listens to the processes, sequences the drives, and restarts what died.
//!
//! [`Pipeline::run_to_end`] is the main loop.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use config::launch::Role;
use ipc_types::{
    Attempt, BatchHeader, DriveOutcome, LearnerProgress, Proposal, Safety, Status, WakeRole,
    WirePose, has,
};
use outcome::RecordingFacts;
use runtime::chaos::{self, Script};
use runtime::clock::now_ns;
use runtime::observer::CORE_FILE;
use runtime::run::RunNames;
use runtime::{Alarm, Attachment, Inlet, Outlet, Waiting};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::time::Timespec;
use signal_hook::consts::SIGINT;

use crate::pipeline::cores::Placement;
use crate::pipeline::gate_log::{GateLog, StopWords};
use crate::pipeline::interrupts::Interrupts;
use crate::pipeline::member::{Member, RefusedSamples, State};
use crate::pipeline::observers::ObserverCare;
use crate::pipeline::plan::{PipelineFacts, Plan};
use crate::pipeline::process::clean_up_behind;
use crate::pipeline::progress::Progress;
use crate::pipeline::recovery::{RandomKills, Recoveries};
use crate::pipeline::restart::Decision;
use crate::pipeline::ring::Ring;
use crate::pipeline::sequencer::Sequencer;
use crate::pipeline::standing::{Due, Standing};
use crate::runs::state::RunState;
use crate::words::Failure;

/// So many stops of a fleet in lockstep are told one by one.
const STOPS_TOLD: u64 = 4;

/// A batch without a tick for this long has lost a message; each sign of life reports progress.
const STALLED_AFTER_NS: u64 = 500_000_000;
/// And one without a tick for this long has lost one even on a machine where the processes wait for a processor most
/// of the time.
const STALLED_AT_LAST_NS: u64 = 10_000_000_000;
/// How many stalls in a row of one batch end the run: driving it again repairs a lost message, but by then it has not
/// helped, and will not.
const STALLS_IN_A_ROW: u32 = 100;
/// How often a drive is made again because the vehicle was stopped for what does not lie in the drive, such as odometry
/// that did not come.
pub(crate) const STOPS_IN_A_ROW: u32 = 3;
/// A vehicle that has been on its way to a stop for so long is taken for one that stands: without odometry nobody knows.
const STOPS_WITHIN_NS: u64 = 20_000_000_000;
/// How long a process may take to stop.
const STOPS_WITHIN: Duration = Duration::from_secs(5);
/// How long the recorder may take to write what waits for the disk, at most some ten megabytes.
const WRITES_WITHIN: Duration = Duration::from_secs(60);
/// Longest sleep of the orchestrator: deaths and messages wake it, deadlines do not.
const NAP_NS: i64 = 20_000_000;
/// Time between two looks for cut logs, and for warnings of a vehicle in real time.
const WARN_EVERY_NS: u64 = 1_000_000_000;
/// Time between two checks for dead children while messages flow.
const REAP_EVERY_NS: u64 = 1_000_000;

/// A running pipeline.
pub(crate) struct Pipeline<'a> {
    attachment: Attachment,
    alarm: Alarm,
    proposals: Inlet<Proposal>,
    learner_progress: Inlet<LearnerProgress>,
    outcomes: Outlet<DriveOutcome>,
    rings: Vec<Ring>,
    members: Vec<Member>,
    sequencer: Sequencer,
    progress: &'a mut Progress,
    interrupted: Interrupts,
    /// The vehicle must pace by the clock. Then nothing is driven again: a restarted process joins the drive.
    realtime: bool,
    /// The vehicle does pace by the clock.
    by_clock: bool,
    /// Stops of a fleet in lockstep.
    stops_told: u64,
    /// For what a vehicle waits, and the reasons of the stop that ended the drive because nobody came.
    standing: Standing,
    out_of_patience: Option<u32>,
    stops: StopWords,
    random_kills: RandomKills,
    recoveries: Recoveries,
    observers: ObserverCare,
    state_file: StateFile,
    /// The trainer has written its outcome.
    is_over: bool,
    /// Time and ticks of all batches that have ended.
    driving_ns: u64,
    driving_ticks: u64,
    reaped_ns: u64,
    warned_ns: u64,
    started_ns: u64,
}

impl<'a> Pipeline<'a> {
    /// Creates the run's topics; starts nothing yet.
    pub(crate) fn new(
        plan: &Plan,
        names: &RunNames,
        progress: &'a mut Progress,
    ) -> Result<Self, Failure> {
        let config = &plan.config;
        let max_len = config.fleet().max(config.drivers());
        let realtime = plan.sweep.as_ref().is_some_and(|sweep| sweep.realtime);
        let placements = Placement::of_rings(plan, realtime || config.run.realtime);
        let wait = placements[0].wait;
        let cores: Vec<String> =
            placements.iter().flat_map(Placement::cores).map(|core| core.to_string()).collect();
        if !cores.is_empty() {
            // Observers do not touch them.
            let _ = fs::write(names.root.join(CORE_FILE), cores.join(" "));
        }
        tracing::info!(waiting = wait.name(), ?cores, rings = placements.len(), "placed");
        let count = placements.len();
        let rings: Vec<Ring> = placements
            .into_iter()
            .enumerate()
            .map(|(number, placement)| Ring::create(names, max_len, (number, count), placement))
            .collect::<Result<_, _>>()?;
        let bus = &rings[0].bus;
        let random_kills = match &plan.chaos {
            None => RandomKills::new(0.0, 1),
            Some((script, seed)) => {
                let script = Script::parse(script)
                    .map_err(|why| Failure::User(format!("--chaos: {why}")))?;
                RandomKills::new(script.random_per_s, *seed)
            }
        };
        // Each drive of a list has a learner's number of its own.
        let learners = if plan.sweep.is_some() { u32::MAX } else { config.drivers() as u32 };
        let start = config.path.start;
        let start = WirePose { x_m: start.x_m, y_m: start.y_m, yaw_rad: start.yaw_rad };
        let mut sequencer = Sequencer::new(names.run, start, config.fleet(), rings.len(), learners);
        if plan.launch.is_recorded() {
            sequencer.log_all();
        }
        let of_ring = |ring: usize| {
            let members =
                plan.launch.process.iter().map(move |entry| Member::new(entry, plan, ring));
            members.filter(move |member| ring == 0 || member.place_in_ring().is_some())
        };
        let members = (0..rings.len()).flat_map(of_ring).collect();
        Ok(Self {
            attachment: Attachment {
                names: names.clone(),
                folder: plan.folder.clone(),
                max_len,
                ring: 0,
                incarnation: 0,
                core: None,
                wait,
                fifo: plan.fifo,
                parent: std::process::id() as i32,
                chaos: plan.chaos.clone(),
            },
            alarm: bus.alarm(WakeRole::Orchestrator)?,
            proposals: bus.inlet()?,
            learner_progress: bus.inlet()?,
            outcomes: bus.outlet()?,
            members,
            sequencer,
            progress,
            interrupted: plan.interrupted.clone(),
            realtime,
            by_clock: false,
            stops_told: 0,
            standing: Standing::new(config),
            out_of_patience: None,
            stops: StopWords::new(config, realtime),
            random_kills,
            recoveries: Recoveries::default(),
            observers: ObserverCare::default(),
            state_file: StateFile::new(names, plan, rings.len()),
            rings,
            is_over: false,
            driving_ns: 0,
            driving_ticks: 0,
            reaped_ns: 0,
            warned_ns: 0,
            started_ns: now_ns(),
        })
    }

    /// The main loop: from the first start to the trainer's outcome, to a signal that ends it early, or to the reason why
    /// there is no outcome.
    pub(crate) fn run_to_end(&mut self) -> Result<PipelineFacts, Failure> {
        let result = self.loop_until_over();
        self.stop_all();
        Ok(PipelineFacts {
            stopped_by: result?,
            out_of_patience: self.out_of_patience,
            counts: self.sequencer.counts(),
            recovery: self.recoveries.sum_up(chaos::fired(&self.attachment.names.root)),
            processes: self.members.iter().map(Member::facts).collect(),
            wall_s: (now_ns() - self.started_ns) as f64 / 1e9,
            tick_ns: self.driving_ns as f64 / self.driving_ticks.max(1) as f64,
            recording: self.recording(),
            waiting: self.rings[0].placement.wait.name(),
            rings: self.rings.len(),
        })
    }

    /// What the recorder passes on when it has ended.
    fn recording(&self) -> Option<RecordingFacts> {
        let bytes = fs::read(self.attachment.names.root.join(RecordingFacts::FILE)).ok()?;
        serde_json::from_slice(&bytes).ok()
    }

    /// Returns the signal that has ended it early, if one has.
    fn loop_until_over(&mut self) -> Result<Option<i32>, Failure> {
        let mut waiting = Waiting::default();
        loop {
            let stopped_by = match self.interrupted.signal() {
                None if self.state_file.is_stop_requested(now_ns()) => Some(SIGINT),
                signal => signal,
            };
            if stopped_by.is_some() {
                return Ok(stopped_by);
            }
            let mut heard = self.hear_status()?;
            self.look_after_members()?;
            self.look_after_batches()?;
            heard |= self.hear_trainer()?;
            heard |= self.hear_controllers()?;
            heard |= self.hear_gates()?;
            self.look_after_waiting();
            if self.is_over || self.out_of_patience.is_some() {
                return Ok(None);
            }
            self.drive()?;
            if heard {
                waiting.progress();
            } else if waiting.may_sleep() {
                self.sleep();
            }
        }
    }

    /// Takes signs of life: which processes are ready, and still alive.
    fn hear_status(&mut self) -> Result<bool, Failure> {
        let mut heard = false;
        for ring in 0..self.rings.len() {
            heard |= self.hear_status_of(ring)?;
        }
        Ok(heard)
    }

    fn hear_status_of(&mut self, ring: usize) -> Result<bool, Failure> {
        let (mut heard, mut ticked) = (false, false);
        while let Some(message) = self.rings[ring].status.receive()? {
            heard = true;
            let Some(status) = message.items().first().copied() else { continue };
            let from_this_run = message.header().attempt.is_of(self.attachment.names.run);
            let member = self.members.iter_mut().find(|member| {
                (member.ring, member.wire_role(), member.incarnation)
                    == (ring, status.role, status.incarnation)
            });
            let Some(member) = member.filter(|_| from_this_run && status.state == Status::READY)
            else {
                continue;
            };
            let Status { dropped, rejected, late, .. } = status;
            if !member.take_counts(RefusedSamples { dropped, rejected, late }, now_ns()) {
                self.progress.notice(&format!(
                    "{} reports counts in its Status that no process can have; the result holds the last ones before",
                    member.name
                ));
            }
            // Each process is compared with itself: they are at different ticks even when all have stopped.
            let is_known = status.batch <= self.sequencer.batch(ring);
            if is_known && (status.batch, status.tick) != member.seen {
                member.seen = (status.batch, status.tick);
                let ring = &mut self.rings[ring];
                ring.seen = ring.seen.max(member.seen);
                ring.seen_ns = now_ns();
                ticked = true;
            }
            if self.realtime && member.is_ready() {
                // There are no ends of batches that would show that all is well.
                member.policy.works();
            }
            if member.beat(now_ns()) {
                tracing::info!(process = member.name, pid = member.pid, "ready");
                if self.realtime {
                    self.recoveries.mended(ring, now_ns());
                }
                if member.entry.role == Role::Vehicle {
                    self.sequencer.limit_fleet(status.capacity as usize);
                    if has(status.pacing, Status::REAL_TIME) {
                        self.sequencer.pace_by_clock();
                        self.by_clock = true;
                    } else if self.realtime {
                        let why = "--realtime: the vehicle waits for commands instead of pacing by the clock \
                                   (its Status lacks REAL_TIME); omit the option, or see ipc_types/CONTRACT.md";
                        return Err(Failure::User(why.to_owned()));
                    }
                }
            }
        }
        if ticked {
            self.rings[ring].seen_waited_ns = self.waited_ns(ring);
        }
        Ok(heard)
    }

    /// Takes the trainer's proposals and its progress.
    fn hear_trainer(&mut self) -> Result<bool, Failure> {
        if let Some(progress) = self.learner_progress.receive_newest()? {
            let flags = progress.header().flags;
            self.progress.show(flags, progress.items(), self.sequencer.counts());
        }
        let mut heard = false;
        while let Some(message) = self.proposals.receive()? {
            heard = true;
            let header = message.header();
            if !header.attempt.is_of(self.attachment.names.run) {
                continue;
            }
            if has(header.flags, Proposal::FINISHED) {
                self.is_over = true;
                return Ok(true);
            }
            let missed = self.sequencer.propose(message.items());
            self.tell_trainer(&missed)?;
        }
        Ok(heard)
    }

    /// Takes the reports of batches that have ended.
    fn hear_controllers(&mut self) -> Result<bool, Failure> {
        let mut heard = false;
        for number in 0..self.rings.len() {
            while let Some(message) = self.rings[number].reports.receive()? {
                heard = true;
                let outcomes = self.sequencer.report(number, message.header(), message.items());
                let Some(outcomes) = outcomes else { continue };
                let ring = &mut self.rings[number];
                ring.batch_is_broken = false;
                ring.stalls_in_a_row = 0;
                (ring.stops_in_a_row, ring.stopping) = (0, None);
                self.driving_ns += now_ns() - ring.issued_ns;
                self.driving_ticks +=
                    outcomes.iter().map(|outcome| outcome.report.ticks).max().unwrap_or_default();
                for member in self.members.iter_mut().filter(|it| it.works_for(number)) {
                    member.policy.gets_on();
                }
                self.tell_trainer(&outcomes)?;
            }
        }
        Ok(heard)
    }

    /// Tells the user when a gate has stopped its vehicle, or lets it drive again.
    fn hear_gates(&mut self) -> Result<bool, Failure> {
        let mut heard = false;
        for ring in 0..self.rings.len() {
            heard |= self.hear_gate_of(ring)?;
        }
        Ok(heard)
    }

    fn hear_gate_of(&mut self, number: usize) -> Result<bool, Failure> {
        let mut heard = false;
        let ring = &mut self.rings[number];
        while let Some(message) = ring.safety.receive()? {
            heard = true;
            let fleet = message.items().len();
            ring.gates.resize_with(fleet, GateLog::default);
            let mut stopped = None;
            for (slot, (gate, now)) in ring.gates.iter_mut().zip(message.items()).enumerate() {
                let begins = gate.begins(now.reasons & Safety::TOLD);
                if begins != 0 {
                    let what = describe_reasons(begins);
                    self.progress.notice(&format!("vehicle {slot}: {what}"));
                }
                self.standing.see(slot, now.state, now.reasons, now_ns());
                if !gate.changes_to(now.state) {
                    continue;
                }
                // Of a fleet in lockstep, each stop is that drive's result, and a training makes thousands of them.
                if !self.by_clock && !self.realtime && fleet > 1 {
                    self.stops_told += u64::from(now.state == Safety::STOPPING);
                    if self.stops_told > STOPS_TOLD {
                        continue;
                    }
                    if self.stops_told == STOPS_TOLD && now.state == Safety::STOPPING {
                        self.progress.notice(
                            "more drives are being stopped; each counts as one that did not arrive",
                        );
                        continue;
                    }
                }
                let of_the_drive = now.reasons & Safety::OF_THE_DRIVE != 0;
                let why = describe_reasons(now.reasons);
                let is_stopping = now.state == Safety::STOPPING && !of_the_drive;
                ring.stopping = is_stopping.then(|| (now_ns(), now.reasons));
                match now.state {
                    Safety::STOPPING => {
                        let how = self.stops.words(now.reasons);
                        self.progress
                            .notice(&format!("vehicle {slot} is being stopped: {why}; {how}"));
                    }
                    Safety::STOPPED => {
                        self.progress.notice(&format!("vehicle {slot} stands"));
                        // There is nobody to rearm the vehicle: the drive is made again from the start. A stop for how
                        // it drove is the drive's result instead.
                        let drives = self.sequencer.is_driving(number);
                        if self.by_clock && !self.realtime && !of_the_drive && drives {
                            stopped = Some(why);
                        }
                    }
                    state => {
                        if let Some(untold) = gate.line_due(now_ns()) {
                            tracing::info!(slot, state, why, untold, "gate");
                        }
                    }
                }
            }
            if let Some(why) = stopped {
                ring.drive_again(&why)?;
            }
        }
        Ok(heard)
    }

    /// A drive by the clock waits for people, but not for ever.
    fn look_after_waiting(&mut self) {
        // By the clock there is one ring.
        if !self.realtime || !self.sequencer.is_driving(0) {
            return;
        }
        let (now_ns, ring) = (now_ns(), &self.rings[0]);
        let begins = ring.seen.0 == self.sequencer.batch(0) && ring.seen.1 > 0;
        let due = match self.standing.due(now_ns, describe_reasons) {
            None if !begins => self.standing.due_at_start(now_ns, ring.issued_ns),
            due => due,
        };
        match due {
            Some(Due::Notice(text)) => self.progress.notice(&text),
            Some(Due::End(reasons)) => self.out_of_patience = Some(reasons),
            None => {}
        }
    }

    fn tell_trainer(&self, outcomes: &[DriveOutcome]) -> Result<(), Failure> {
        if !outcomes.is_empty() {
            let run = self.attachment.names.run;
            let attempt = Attempt::between_batches(run);
            let header = BatchHeader { attempt, sent_ns: now_ns(), ..BatchHeader::default() };
            self.outcomes.send(header, outcomes.len(), |index| outcomes[index])?;
        }
        Ok(())
    }

    /// Whether all processes that a batch of this ring needs are ready.
    fn is_ready(&self, ring: usize) -> bool {
        self.members.iter().filter(|it| it.works_for(ring)).all(Member::is_ready)
    }

    /// Issues the next batch of each ring, or reissues the broken one, once all of its processes are ready.
    fn drive(&mut self) -> Result<(), Failure> {
        let ready: Vec<usize> = (0..self.rings.len()).filter(|ring| self.is_ready(*ring)).collect();
        let mut free = ready.iter().filter(|ring| !self.sequencer.is_driving(**ring)).count();
        for number in ready {
            let was_free = !self.sequencer.is_driving(number);
            self.drive_in(number, free)?;
            free -= usize::from(was_free);
        }
        Ok(())
    }

    /// As [`Pipeline::drive`], in one ring; `free` rings could begin a batch now.
    fn drive_in(&mut self, number: usize, free: usize) -> Result<(), Failure> {
        let ring = &mut self.rings[number];
        let broken = std::mem::take(&mut ring.batch_is_broken);
        let batch = if broken { self.sequencer.reissue(number) } else { None };
        if let Some((header, _)) = batch {
            let Attempt { batch, attempt, .. } = header.attempt;
            tracing::info!(batch, attempt, "reissued");
        }
        let Some((header, drives)) = (match batch {
            Some(batch) => Some(batch),
            None => self.sequencer.next_batch(number, free),
        }) else {
            return Ok(());
        };
        let header = BatchHeader { sent_ns: now_ns(), ..header };
        ring.requests.send(header, drives.len(), |index| drives[index])?;
        ring.issued_ns = header.sent_ns;
        ring.seen_ns = header.sent_ns;
        self.recoveries.mended(number, now_ns());
        Ok(())
    }

    /// Drives batches again that have stalled, and tells how far the first one is.
    fn look_after_batches(&mut self) -> Result<(), Failure> {
        let now = now_ns();
        let (seen, batch) = (self.rings[0].seen, self.sequencer.batch(0));
        self.state_file.write(now, &self.members, &self.sequencer, seen);
        if self.sequencer.is_driving(0) && seen.0 == batch {
            self.progress.show_tick(seen.1, self.sequencer.ticks(0));
        }
        if now.saturating_sub(self.warned_ns) >= WARN_EVERY_NS {
            self.warned_ns = now;
            self.tell_cut_logs();
            if self.by_clock {
                self.tell_warnings();
            }
        }
        (0..self.rings.len()).try_for_each(|ring| self.look_after_batch(ring, now))
    }

    /// Drives a batch again if it has stalled: without a tick for so long, it has lost a message.
    ///
    /// A vehicle that may take its time to come to the start has no such deadline for its first tick.
    fn look_after_batch(&mut self, number: usize, now: u64) -> Result<(), Failure> {
        let is_training = self.by_clock && !self.realtime && self.sequencer.is_driving(number);
        let ring = &mut self.rings[number];
        let is_overdue = |it: &mut (u64, u32)| now.saturating_sub(it.0) > STOPS_WITHIN_NS;
        if is_training && let Some((_, reasons)) = ring.stopping.take_if(is_overdue) {
            ring.drive_again(&describe_reasons(reasons))?;
        }
        let ring = &self.rings[number];
        let patient = self.members.iter().any(|member| !member.entry.is_deterministic());
        let waits_for_start = patient && ring.seen_ns <= ring.issued_ns;
        if self.realtime
            || !self.sequencer.is_driving(number)
            || ring.batch_is_broken
            || waits_for_start
            || now.saturating_sub(ring.seen_ns) < STALLED_AFTER_NS
            || !self.is_ready(number)
        {
            return Ok(());
        }
        // A loaded machine is slow, not broken: the time that the ring waited for a processor does not count.
        let excused_ns = self.waited_ns(number).saturating_sub(ring.seen_waited_ns);
        let silent_ns = now.saturating_sub(ring.seen_ns);
        if silent_ns.saturating_sub(excused_ns) < STALLED_AFTER_NS && silent_ns < STALLED_AT_LAST_NS
        {
            return Ok(());
        }
        let ring = &mut self.rings[number];
        ring.stalls_in_a_row += 1;
        let batch = self.sequencer.batch(number);
        if ring.stalls_in_a_row > STALLS_IN_A_ROW {
            return Err(Failure::GaveUp(format!(
                "gave up: batch {batch} stalled {STALLS_IN_A_ROW} times in a row, the last time at tick {}, \
                 although every process shows signs of life; look into {}",
                ring.seen.1,
                self.attachment.folder.join("logs").display(),
            )));
        }
        tracing::warn!(batch, seen = ?ring.seen, "stalled");
        self.recoveries.stalls += 1;
        self.recoveries.broken(number, ring.seen_ns);
        ring.batch_is_broken = true;
        Ok(())
    }

    /// Time that all processes that work for a ring have waited for a processor.
    fn waited_ns(&self, ring: usize) -> u64 {
        self.members.iter().filter(|it| it.works_for(ring)).map(Member::waited_ns).sum()
    }

    /// Says once of each process that its log is longer than what is kept of it.
    fn tell_cut_logs(&mut self) {
        for member in &mut self.members {
            if member.is_newly_cut() {
                let log = member.log.display();
                self.progress.notice(&format!(
                    "{} writes a long log: only the end is kept, in {log} and {log}.old",
                    member.name
                ));
            }
        }
    }

    /// Passes on the vehicle's warnings: in real time it may be waiting for something that only the user can provide.
    fn tell_warnings(&mut self) {
        for member in self.members.iter_mut().filter(|it| it.entry.role == Role::Vehicle) {
            for warning in member.new_warnings() {
                self.progress.notice(&format!("{}: {warning}", member.name));
            }
        }
    }

    /// Starts the processes that are due, in order; replaces those that died or froze.
    fn look_after_members(&mut self) -> Result<(), Failure> {
        let now = now_ns();
        if now - self.reaped_ns < REAP_EVERY_NS {
            return Ok(());
        }
        self.reaped_ns = now;
        self.observers.look(&self.attachment, now);
        if let Some(index) = self.random_kills.due(now, self.members.len())
            && let Some(process) = self.members[index].state.process()
        {
            process.kill();
            self.recoveries.killed_at_random += 1;
            self.recoveries.broken(self.members[index].ring, now);
        }
        for index in 0..self.members.len() {
            if let Some(why) = self.members[index].trouble(now) {
                if let Some(mistake) = self.members[index].mistake() {
                    return Err(mistake);
                }
                self.replace(index, &why)?;
            }
        }
        // One at a time, so that half-made files can only belong to the process that is starting.
        let Some(member) = self.members.iter_mut().find(|member| !member.is_ready()) else {
            return Ok(());
        };
        if let State::Down { due_ns } = member.state
            && now >= due_ns
        {
            member.start(&self.attachment, &self.rings[member.ring])?;
        }
        Ok(())
    }

    /// A process died, froze or did not become ready: removes what it left, and decides what to do next.
    fn replace(&mut self, index: usize, why: &str) -> Result<(), Failure> {
        let member = &mut self.members[index];
        if let Some(process) = member.state.process() {
            process.kill();
        }
        let pid = member.pid;
        let (now, jitter) = (now_ns(), f64::from(pid % 97) / 97.0);
        self.recoveries.broken(member.ring, now);
        let decision = member.policy.died(now, jitter);
        tracing::warn!(process = member.name, pid, why, ?decision, "replacing");
        self.observers.stand_back();
        clean_up_behind(&self.attachment, pid).map_err(Failure::Other)?;
        if member.entry.role != Role::Trainer {
            let ring = member.ring;
            self.rings[ring].batch_is_broken = self.sequencer.is_driving(ring) && !self.realtime;
        }
        let wait = match decision {
            Decision::Restart(wait) => wait,
            Decision::GiveUp => return Err(member.given_up(why)),
        };
        self.progress.notice(&format!("{} (pid {pid}) {why}; it is restarted", member.name));
        member.state = State::Down { due_ns: now_ns() + wait.as_nanos() as u64 };
        // The clean-up took a while, during which no messages were read: do not take other processes for frozen.
        self.hear_status()?;
        Ok(())
    }

    fn look_for_readers(&self) {
        self.rings.iter().for_each(|ring| ring.bus.look_for_readers());
    }

    /// Sleeps until a message, a death or the next deadline.
    fn sleep(&mut self) {
        self.look_for_readers();
        let mut fds = vec![PollFd::new(&self.alarm, PollFlags::IN)];
        for member in &mut self.members {
            if let Some(process) = member.state.process() {
                fds.push(PollFd::new(&process.pidfd, PollFlags::IN));
            }
        }
        let until_kill = self
            .random_kills
            .next_ns()
            .map_or(NAP_NS, |due_ns| due_ns.saturating_sub(now_ns()).min(NAP_NS as u64) as i64);
        let nap = Timespec { tv_sec: 0, tv_nsec: until_kill };
        // A signal ends it early, which is as good as a message.
        let _ = poll(&mut fds, Some(&nap));
        self.alarm.clear();
        self.look_for_readers();
        self.reaped_ns = 0;
    }

    /// Stops all processes, the last started first.
    fn stop_all(&mut self) {
        for member in self.members.iter_mut().rev() {
            if let Some(process) = member.state.process()
                && !process.stop(match member.entry.role {
                    Role::Recorder => WRITES_WITHIN,
                    _ => STOPS_WITHIN,
                })
            {
                self.progress.notice(&format!("{} did not stop, and was killed", member.name));
            }
            member.state = State::Down { due_ns: u64::MAX };
        }
    }
}

/// Describes what is wrong with a vehicle, from the bits of [`Safety::reasons`].
pub(crate) fn describe_reasons(reasons: u32) -> String {
    let there = Safety::describe(reasons);
    if there.is_empty() { "nothing is wrong".to_owned() } else { there.join(", ") }
}

/// What `pathtune status` reads: one file in the run's private folder.
struct StateFile {
    path: PathBuf,
    state: RunState,
    written_ns: u64,
    looked_ns: u64,
}

impl StateFile {
    /// Time between two writes.
    const EVERY_NS: u64 = 200_000_000;
    /// Time between two looks for a request to stop.
    const LOOK_EVERY_NS: u64 = 50_000_000;

    fn new(names: &RunNames, plan: &Plan, rings: usize) -> Self {
        let state = RunState {
            run: format!("{:016x}", names.run),
            pid: std::process::id(),
            maneuver: plan.config.maneuver.clone(),
            folder: plan.folder.clone(),
            resumable: plan.sweep.is_none(),
            batch: 0,
            attempt: 0,
            tick: 0,
            rings,
            processes: Vec::new(),
        };
        Self { path: names.root.join(RunState::FILE), state, written_ns: 0, looked_ns: 0 }
    }

    fn write(&mut self, now_ns: u64, members: &[Member], sequencer: &Sequencer, seen: (u64, u64)) {
        if now_ns - self.written_ns < Self::EVERY_NS {
            return;
        }
        self.written_ns = now_ns;
        let state = &mut self.state;
        (state.batch, state.attempt) = (sequencer.batch(0), sequencer.attempt(0));
        state.tick = if seen.0 == state.batch { seen.1 } else { 0 };
        state.processes = members.iter().map(Member::state).collect();
        // Only people read it: a failure to write it is no reason to stop a training.
        let _ = state.write(&self.path);
    }

    /// Whether `pathtune stop` has asked for it, by a file beside this one.
    fn is_stop_requested(&mut self, now_ns: u64) -> bool {
        if now_ns - self.looked_ns < Self::LOOK_EVERY_NS {
            return false;
        }
        self.looked_ns = now_ns;
        self.path.with_file_name(RunState::STOP_FILE).exists()
    }
}

/// The orchestrator's own log, in the same folder as those of its processes.
pub(crate) fn log_of_orchestrator(folder: &Path) -> PathBuf {
    folder.join("logs").join("orchestrator.log")
}
