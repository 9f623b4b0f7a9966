//! The test stand: a run with the vehicle as its only process. The stand plays the processes that the vehicle talks to.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::Duration;

use config::RunConfig;
use ipc_types::{
    Attempt, BatchHeader, Command, Credit, DriveRequest, Odometry, Status, TickHeader, WirePose,
    has,
};
use runtime::clock::now_ns;
use runtime::{Attachment, Bus, Inlet, Outlet};

use crate::pipeline::interrupts::Interrupts;
use crate::pipeline::process::{Process, Program, clean_up_behind, describe};
use crate::pipeline::vitals::Vitals;
use crate::words::Failure;

/// The largest number of slots that are driven at once.
pub(super) const MAX_SLOTS: usize = 16;
/// If nothing comes for this long, the vehicle is silent.
pub(super) const SILENCE: Duration = Duration::from_millis(80);
/// How long an answer may take: it is one tick of lockstep.
pub(super) const ANSWER: Duration = Duration::from_secs(1);

/// One odometry message that was received.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    pub(super) header: TickHeader,
    pub(super) items: Vec<Odometry>,
    pub(super) heard_ns: u64,
}

impl Seen {
    pub(super) fn first(&self) -> Odometry {
        self.items.first().copied().unwrap_or_default()
    }

    /// Whether any slot has a bit.
    pub(super) fn has(&self, bit: u32) -> bool {
        self.items.iter().any(|item| has(item.status, bit))
    }
}

/// What is noted of all odometry, whichever request led to it.
#[derive(Debug, Default)]
pub(super) struct Oddities {
    pub(super) heard: u64,
    pub(super) not_finite: Option<String>,
    pub(super) elements: Option<String>,
    pub(super) stamps: Option<String>,
}

/// The ports that send to the vehicle, on a bus of their own, so that they can disappear and come back.
struct Sides {
    requests: Outlet<DriveRequest>,
    commands: Outlet<Command>,
    credits: Outlet<Credit>,
    bus: Bus,
}

impl Sides {
    fn new(attachment: &Attachment) -> Result<Self, Failure> {
        let bus = Bus::attach(&attachment.names, attachment.max_len)?;
        Ok(Self { requests: bus.outlet()?, commands: bus.outlet()?, credits: bus.outlet()?, bus })
    }
}

/// The stand.
pub(super) struct Stand {
    pub(super) config: RunConfig,
    pub(super) realtime: bool,
    program: Program,
    log: PathBuf,
    pub(super) attachment: Attachment,
    /// Holds the topics.
    _bus: Bus,
    status: Inlet<Status>,
    odometry: Inlet<Odometry>,
    /// `None` only while new ones take their place.
    sides: Option<Sides>,
    interrupted: Interrupts,
    pub(super) process: Option<Process>,
    /// How the process died, if it was not asked to stop.
    pub(super) died: Option<String>,
    pub(super) started_ns: u64,
    /// The last sign of life of this incarnation, with its header and time.
    pub(super) beat: Option<(BatchHeader, Status, u64)>,
    /// The longest gap between two signs of life, without the time that the vehicle waited for a processor. `None`
    /// before the first sign of life.
    pub(super) longest_gap_ns: Option<u64>,
    /// What the system counted of the vehicle at its last sign of life.
    vitals: Vitals,
    pub(super) heard: VecDeque<Seen>,
    pub(super) oddities: Oddities,
    /// The batch under way.
    pub(super) header: BatchHeader,
    pub(super) slots: usize,
    last: TickHeader,
}

impl Stand {
    pub(super) fn new(
        config: RunConfig,
        program: Program,
        attachment: Attachment,
        interrupted: Interrupts,
    ) -> Result<Self, Failure> {
        let bus = Bus::create(&attachment.names, attachment.max_len)?;
        let log = attachment.folder.join("logs").join("vehicle.log");
        Ok(Self {
            realtime: config.run.realtime,
            config,
            program,
            log,
            status: bus.inlet()?,
            odometry: bus.observe()?,
            sides: Some(Sides::new(&attachment)?),
            _bus: bus,
            interrupted,
            process: None,
            died: None,
            started_ns: 0,
            beat: None,
            longest_gap_ns: None,
            vitals: Vitals::default(),
            heard: VecDeque::new(),
            oddities: Oddities::default(),
            header: BatchHeader {
                attempt: Attempt::between_batches(attachment.names.run),
                ..BatchHeader::default()
            },
            attachment,
            slots: 0,
            last: TickHeader::default(),
        })
    }

    /// Starts the vehicle, or starts it again.
    pub(super) fn start(&mut self) -> Result<(), Failure> {
        self.attachment.incarnation += 1;
        self.beat = None;
        let process = Process::start(&self.program, &self.attachment, &self.log)?;
        self.process = Some(process);
        self.started_ns = now_ns();
        Ok(())
    }

    /// Kills the vehicle, and cleans up after it as the orchestrator does.
    pub(super) fn kill(&mut self) -> Result<(), Failure> {
        if let Some(mut process) = self.process.take() {
            process.kill();
            clean_up_behind(&self.attachment, process.id()).map_err(Failure::Other)?;
        }
        self.pump()?;
        self.heard.clear();
        Ok(())
    }

    pub(super) fn ticks_of(&self, time_s: f64) -> u64 {
        (time_s / self.config.drive.tick_s).ceil() as u64
    }

    pub(super) fn tick(&self) -> Duration {
        Duration::from_secs_f64(self.config.drive.tick_s)
    }

    /// Receives all messages that have arrived.
    pub(super) fn pump(&mut self) -> Result<bool, Failure> {
        if let Some(signal) = self.interrupted.signal() {
            let left = "the vehicle was stopped".to_owned();
            return Err(Failure::Interrupted(signal, left));
        }
        if let Some(process) = &mut self.process
            && let Some(status) = process.try_wait()
        {
            self.died = Some(describe(status));
            self.process = None;
        }
        let mut any = false;
        while let Some(message) = self.status.receive()? {
            let Some(status) = message.items().first().copied() else { continue };
            // A beat of an earlier incarnation may still be in the buffer.
            if self.attachment.incarnation > 1 && status.incarnation < self.attachment.incarnation {
                continue;
            }
            let (header, now) = (message.header(), now_ns());
            // The time at which it was sent: the stand itself may have been busy.
            let is_stamped = header.sent_ns <= now && now - header.sent_ns < 5_000_000_000;
            let at_ns = if is_stamped { header.sent_ns } else { now };
            let vitals = self.vitals_now();
            self.note_gap(at_ns, vitals);
            self.vitals = vitals;
            self.beat = Some((header, status, at_ns));
            any = true;
        }
        while let Some(message) = self.odometry.receive()? {
            let (header, items) = (message.header(), message.items().to_vec());
            self.look_at(header, &items);
            self.heard.push_back(Seen { header, items, heard_ns: now_ns() });
            any = true;
        }
        Ok(any)
    }

    fn vitals_now(&self) -> Vitals {
        let process = self.process.as_ref();
        process.and_then(|process| Vitals::of_tree(process.id())).unwrap_or_default()
    }

    /// Notes the gap between the last sign of life and `at_ns`, at which the system counted `now` of the vehicle. A
    /// loaded machine is slow, not silent: the time that the vehicle waited for a processor is left out.
    fn note_gap(&mut self, at_ns: u64, now: Vitals) {
        let elapsed_ns = self.beat.map_or(0, |(_, _, before_ns)| at_ns.saturating_sub(before_ns));
        let waited_ns = now.waited_ns.saturating_sub(self.vitals.waited_ns);
        let gap_ns = elapsed_ns.saturating_sub(waited_ns);
        self.longest_gap_ns = Some(self.longest_gap_ns.unwrap_or_default().max(gap_ns));
    }

    /// Notes the gap since the last sign of life, which is not over yet.
    pub(super) fn note_open_gap(&mut self) {
        let Some((_, _, before_ns)) = self.beat else { return };
        let now = self.vitals_now();
        // What is ready to run may have waited since it last ran, and nobody knows for how long: then only the time
        // counts that it did run.
        let used_ns = now.used_ns.saturating_sub(self.vitals.used_ns);
        self.note_gap(if now.runnable { before_ns + used_ns } else { now_ns() }, now);
    }

    /// What must hold for every odometry message.
    fn look_at(&mut self, header: TickHeader, items: &[Odometry]) {
        let tick = header.tick;
        self.oddities.heard += 1;
        for item in items {
            let WirePose { x_m, y_m, yaw_rad } = item.measured;
            let numbers =
                [x_m, y_m, yaw_rad, item.speed_mps, item.yaw_rate_radps, item.steering_rad];
            let truth = [item.truth.x_m, item.truth.y_m, item.truth.yaw_rad];
            let is_finite = numbers.iter().chain(&truth).all(|number| number.is_finite());
            if !is_finite || item.reserved != 0 || header.attempt.reserved != 0 {
                let seen = format!("tick {tick}: {item:?}");
                self.oddities.not_finite.get_or_insert(seen);
            }
        }
        if names_same(header.attempt, self.header.attempt) && items.len() != self.slots {
            let seen =
                format!("tick {tick}: {} elements where {} are due", items.len(), self.slots);
            self.oddities.elements.get_or_insert(seen);
        }
        let (before, now) = (self.last, now_ns());
        let follows = names_same(before.attempt, header.attempt);
        let sent_ns = header.odometry_sent_ns;
        if sent_ns > now || now - sent_ns > 5_000_000_000 {
            let seen = format!("tick {tick}: {sent_ns}, received at {now}");
            self.oddities.stamps.get_or_insert(seen);
        } else if follows && sent_ns <= before.odometry_sent_ns {
            let seen = format!("tick {tick}: {sent_ns} after {}", before.odometry_sent_ns);
            self.oddities.stamps.get_or_insert(seen);
        }
        self.last = header;
    }

    /// Waits until a condition holds; returns whether it did in time. Does not wait for a dead vehicle.
    pub(super) fn wait(
        &mut self,
        at_most: Duration,
        mut holds: impl FnMut(&mut Self) -> bool,
    ) -> Result<bool, Failure> {
        let until_ns = now_ns() + at_most.as_nanos() as u64;
        let mut looks = 0u32;
        loop {
            let any = self.pump()?;
            if holds(self) {
                return Ok(true);
            }
            if now_ns() >= until_ns || self.process.is_none() {
                return Ok(false);
            }
            looks += 1;
            if looks.is_multiple_of(64) {
                self.sides().bus.look_for_readers();
            }
            if !any {
                // The vehicle may run on this core.
                std::thread::sleep(Duration::from_micros(if looks < 20 { 20 } else { 200 }));
            }
        }
    }

    /// Lets this much time pass.
    pub(super) fn pass(&mut self, time: Duration) -> Result<(), Failure> {
        self.wait(time, |_| false).map(|_| ())
    }

    /// Whether no odometry comes for a while.
    pub(super) fn is_silent(&mut self) -> Result<bool, Failure> {
        Ok(!self.wait(SILENCE, |stand| !stand.heard.is_empty())?)
    }

    /// Where slot `index` must stand: slot 0 at the start in the configuration, the others next to it.
    pub(super) fn start_of(&self, index: usize) -> WirePose {
        let start = self.config.path.start;
        WirePose { x_m: start.x_m, y_m: start.y_m + 5.0 * index as f64, yaw_rad: start.yaw_rad }
    }

    /// Asks for a new batch.
    pub(super) fn request(&mut self, slots: usize, flags: u32) -> Result<(), Failure> {
        self.header.attempt.batch += 1;
        self.header.attempt.attempt = 1;
        self.send_request(slots, flags)
    }

    /// Asks for the batch again.
    pub(super) fn reissue(&mut self, flags: u32) -> Result<(), Failure> {
        self.header.attempt.attempt += 1;
        self.send_request(self.slots, flags)
    }

    fn send_request(&mut self, slots: usize, flags: u32) -> Result<(), Failure> {
        self.pump()?;
        self.heard.clear();
        self.slots = slots;
        self.header.sent_ns = now_ns();
        let flags = flags | if self.realtime { DriveRequest::REAL_TIME } else { 0 };
        let starts: Vec<WirePose> = (0..slots).map(|index| self.start_of(index)).collect();
        self.sides().requests.send(self.header, slots, |index| DriveRequest {
            start: starts[index],
            seed: 7,
            ticks: 1_000_000,
            learner: index as u32,
            step: 0,
            flags,
            ..DriveRequest::default()
        })?;
        Ok(())
    }

    /// The first odometry of this batch; that of others is dropped.
    pub(super) fn first(&mut self, at_most: Duration) -> Result<Option<Seen>, Failure> {
        let of = self.header.attempt;
        self.wait(at_most, |stand| {
            stand.heard.iter().any(|seen| names_same(seen.header.attempt, of))
        })?;
        while let Some(seen) = self.heard.pop_front() {
            if names_same(seen.header.attempt, of) {
                return Ok(Some(seen));
            }
        }
        Ok(None)
    }

    /// The oldest odometry that was not taken yet.
    pub(super) fn next(&mut self, at_most: Duration) -> Result<Option<Seen>, Failure> {
        self.wait(at_most, |stand| !stand.heard.is_empty())?;
        Ok(self.heard.pop_front())
    }

    /// Requests a new batch, and returns its first odometry.
    pub(super) fn begin(&mut self, slots: usize, flags: u32) -> Result<Option<Seen>, Failure> {
        self.request(slots, flags)?;
        self.first(Duration::from_secs(2))
    }

    /// The header of a command that answers this odometry now.
    pub(super) fn answer_to(&self, header: TickHeader) -> TickHeader {
        let now = now_ns();
        TickHeader {
            controller_received_ns: now,
            controller_sent_ns: now,
            supervisor_received_ns: now,
            supervisor_sent_ns: now,
            ..header
        }
    }

    pub(super) fn send_commands(
        &self,
        header: TickHeader,
        commands: &[Command],
    ) -> Result<(), Failure> {
        self.sides().commands.send(header, commands.len(), |index| commands[index])?;
        Ok(())
    }

    /// Answers odometry with the same command for each slot.
    pub(super) fn answer(&self, seen: &Seen, command: Command) -> Result<TickHeader, Failure> {
        let header = self.answer_to(seen.header);
        self.send_commands(header, &vec![command; self.slots])?;
        Ok(header)
    }

    pub(super) fn send_credit(
        &self,
        header: BatchHeader,
        source: u32,
        ticks: u64,
    ) -> Result<(), Failure> {
        let header = BatchHeader { sent_ns: now_ns(), flags: 0, ..header };
        self.sides().credits.send(header, 1, |_| Credit { ticks, source, reserved: 0 })?;
        Ok(())
    }

    /// Drives on from `from` for the given number of ticks; `command` gives the command for each odometry.
    /// Returns all odometry, `from` included; less if the vehicle fell silent.
    pub(super) fn drive(
        &mut self,
        from: Seen,
        ticks: u64,
        mut command: impl FnMut(&Seen) -> Command,
    ) -> Result<Vec<Seen>, Failure> {
        let mut seen = vec![from];
        let end = seen[0].header.tick + ticks;
        while seen[seen.len() - 1].header.tick < end {
            let last = &seen[seen.len() - 1];
            let command = command(last);
            self.answer(last, command)?;
            let Some(next) = self.next(ANSWER)? else { break };
            seen.push(next);
        }
        Ok(seen)
    }

    /// Replaces the publishers by new ones.
    pub(super) fn replace_publishers(&mut self) -> Result<(), Failure> {
        // Each topic has room for one publisher: the old one must go before a new one can come.
        self.sides = None;
        self.sides = Some(Sides::new(&self.attachment)?);
        Ok(())
    }

    fn sides(&self) -> &Sides {
        self.sides.as_ref().expect("the ports are there except while they are replaced")
    }

    /// The last status of the vehicle.
    pub(super) fn told(&self) -> Status {
        self.beat.map(|(_, status, _)| status).unwrap_or_default()
    }

    /// Waits until a count of the status has risen; returns whether it has, and by how much.
    pub(super) fn wait_for_count(
        &mut self,
        before: u64,
        count: impl Fn(&Status) -> u64,
    ) -> Result<(bool, u64), Failure> {
        let rose = self.wait(Duration::from_millis(600), |stand| count(&stand.told()) > before)?;
        Ok((rose, count(&self.told()).saturating_sub(before)))
    }
}

/// Whether both name the same attempt at the same batch. The run that they name, and the padding, have checks of their
/// own.
fn names_same(a: Attempt, b: Attempt) -> bool {
    (a.batch, a.attempt) == (b.batch, b.attempt)
}
