//! The vehicle's role, filled with recorded odometry: commands move nothing, they only trigger the next tick.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use config::MAX_FLEET;
use ipc_types::{
    Allowance, BatchHeader, Command, Credit, DriveRequest, Odometry, TickHeader, WakeRole, has,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};

use crate::script::{Batch, Order, batches, parse};

/// Runs the process until it is asked to stop. With a file, the first batch of that recording answers every request;
/// otherwise the batches of the run's order are used, each for the request that names it.
///
/// # Errors
/// If it cannot join the run, the recording cannot be read, or the transport fails.
pub fn run(file: Option<&Path>) -> Result<()> {
    let (attachment, bus, config) = join()?;
    attachment.take_place();
    let (batches, speed) = match file {
        Some(file) => (batches(file, &["odometry"], MAX_FLEET)?, None),
        None => {
            let order = Order::read(&attachment.folder)?;
            (batches(&order.file, &["odometry"], attachment.max_len)?, order.speed)
        }
    };
    let tick_ns = speed.map(|speed| (config.drive.tick_s * 1e9 / speed) as u64);
    let mut replayer = Replayer::new(&bus, attachment.names.run, batches, tick_ns)?;
    if file.is_some() {
        replayer.for_any = true;
        let slots = replayer.batches.first().map_or(0, |batch| batch.requests.len());
        replayer.counters.capacity = slots as u32;
    }
    serve(&attachment, &bus, WakeRole::Vehicle, &mut replayer)
}

struct Replayer {
    requests: Inlet<DriveRequest>,
    commands: Inlet<Command>,
    credits: Inlet<Credit>,
    odometry: Outlet<Odometry>,
    run: u64,
    batches: Vec<Batch>,
    /// The first batch answers every request.
    for_any: bool,
    /// Time between two ticks, if the clock paces.
    tick_ns: Option<u64>,
    started_ns: u64,
    /// The batch that is replayed, as an index.
    batch: usize,
    ended: Vec<bool>,
    /// Header of the odometry that waits for its command.
    waiting: Option<TickHeader>,
    /// Header of the odometry that waits for the reviewer, or for its time.
    held_back: Option<TickHeader>,
    /// What the batch's recorders allow.
    allowance: Allowance,
    counters: Counters,
}

impl Replayer {
    fn new(bus: &Bus, run: u64, batches: Vec<Batch>, tick_ns: Option<u64>) -> Result<Self> {
        Ok(Self {
            requests: bus.inlet()?,
            commands: bus.inlet()?,
            credits: bus.inlet()?,
            odometry: bus.outlet()?,
            run,
            batches,
            for_any: false,
            tick_ns,
            started_ns: 0,
            batch: 0,
            ended: Vec::new(),
            waiting: None,
            held_back: None,
            allowance: Allowance::new(&[]),
            counters: Counters { capacity: MAX_FLEET as u32, ..Counters::default() },
        })
    }

    fn start_batch(&mut self, header: BatchHeader, requests: &[DriveRequest]) {
        (self.waiting, self.held_back) = (None, None);
        // The reviewer numbers its steps by the batches of the recording.
        let batch = match requests.first() {
            Some(_) if self.for_any => 0,
            Some(request) => request.step as usize,
            None => usize::MAX,
        };
        let fits = self.batches.get(batch).is_some_and(|it| it.requests.len() == requests.len());
        if !header.attempt.is_of(self.run) || !fits {
            self.counters.dropped += 1;
            return;
        }
        self.batch = batch;
        self.ended = vec![false; requests.len()];
        self.allowance = Allowance::new(requests);
        self.started_ns = now_ns();
        self.held_back = Some(TickHeader { attempt: header.attempt, ..TickHeader::default() });
    }

    /// Publishes what was held back, once it may be.
    fn publish(&mut self, mut header: TickHeader) -> Result<bool> {
        while let Some(credit) = self.credits.receive()? {
            if credit.header().attempt == header.attempt {
                credit.items().iter().for_each(|credit| self.allowance.grant(*credit));
            } else {
                self.counters.dropped += 1;
            }
        }
        if !self.allowance.allows(header.tick) {
            return Ok(false);
        }
        let due_ns = self.started_ns + header.tick * self.tick_ns.unwrap_or_default();
        let early_ns = due_ns.saturating_sub(now_ns());
        if early_ns > 0 {
            // Only one nap at a time, so that requests and signs of life go on.
            std::thread::sleep(Duration::from_nanos(early_ns.min(1_000_000)));
            return Ok(true);
        }
        self.held_back = None;
        let recorded = &self.batches[self.batch].ticks["odometry"];
        let is_beyond = header.tick as usize >= recorded.len();
        let bytes =
            recorded.get(header.tick as usize).or(recorded.last()).context("no odometry")?;
        let odometry: Vec<Odometry> = parse(bytes);
        // A drive that goes on beyond the end of the recording is told to end.
        let more = if is_beyond { Odometry::COLLISION } else { 0 };
        header.odometry_sent_ns = now_ns();
        (self.counters.batch, self.counters.tick) = (header.attempt.batch, header.tick);
        self.odometry.send(header, self.ended.len(), |slot| {
            let mut seen = odometry.get(slot).copied().unwrap_or_default();
            seen.status |= more | if self.ended[slot] { Odometry::ENDED } else { 0 };
            seen
        })?;
        self.waiting = Some(header);
        Ok(true)
    }

    fn obey(&mut self, header: TickHeader, commands: &[Command]) {
        let fits = self.waiting.is_some_and(|waiting| {
            (header.attempt, header.tick) == (waiting.attempt, waiting.tick)
        });
        if !fits || commands.len() != self.ended.len() {
            self.counters.dropped += 1;
            return;
        }
        self.waiting = None;
        for (ended, command) in self.ended.iter_mut().zip(commands) {
            *ended |= has(command.flags, Command::ENDED);
            let is_finite = command.speed_mps.is_finite() && command.steering_rad.is_finite();
            self.counters.rejected += u64::from(!is_finite && !*ended);
        }
        if !self.ended.iter().all(|ended| *ended) {
            self.held_back = Some(TickHeader {
                attempt: header.attempt,
                tick: header.tick + 1,
                applied_ns: now_ns(),
                ..TickHeader::default()
            });
        }
    }
}

impl Service for Replayer {
    fn poll(&mut self) -> Result<bool> {
        if let Some(request) = self.requests.receive_newest()? {
            self.start_batch(request.header(), request.items());
            return Ok(true);
        }
        if let Some(held_back) = self.held_back {
            return self.publish(held_back);
        }
        let Some(command) = self.commands.receive()? else { return Ok(false) };
        self.obey(command.header(), command.items());
        if let Some(held_back) = self.held_back {
            self.publish(held_back)?;
        }
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }
}
