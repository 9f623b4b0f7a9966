//! The trainer's role in a replay: asks for the recorded batches, answers zones, and compares.

use std::path::PathBuf;

use anyhow::{Result, anyhow};
use config::Parameters;
use ipc_types::layout::{Bytes, Layout, Number, numbers};
use ipc_types::{
    Attempt, BatchHeader, Command, Credit, DriveOutcome, DriveRequest, GainSwitch, Message,
    Proposal, RawCommand, TickHeader, WakeRole, Zone,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Received, Service, join, serve};
use serde::{Deserialize, Serialize};

use crate::script::{Batch, COMPARED, Order, batches};

/// Ticks between two credits: a quarter of what the vehicle may run ahead.
const CREDIT_EVERY: u64 = Credit::AHEAD / 4;
/// The largest number of messages of a topic that one look takes.
const AT_ONCE: usize = 64;

/// The first answer that differs from the recorded one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "named after what they hold")]
pub struct Difference {
    pub batch: u64,
    pub tick: u64,
    pub slot: usize,
    pub topic: String,
    pub field: String,
    pub recorded: String,
    pub replayed: String,
}

/// The result of a replay.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outcome {
    /// Ticks that were compared.
    pub compared: u64,
    /// Batches that were replayed.
    pub batches: u64,
    /// The first difference, if there is one.
    pub difference: Option<Difference>,
}

/// Runs the process until it is asked to stop.
///
/// # Errors
/// If it cannot join the run, the recording cannot be read, or the transport fails.
pub fn run() -> Result<()> {
    let (attachment, bus, config) = join()?;
    let order = Order::read(&attachment.folder)?;
    let parameters_of = |named| {
        let parameters = config.law.parameters_of(named);
        parameters.map_err(|(name, problem)| anyhow!("{}: {name} {problem}", Order::FILE))
    };
    let by_zone = order.by_zone.iter().map(parameters_of).collect::<Result<_>>()?;
    let batches = batches(&order.file, &COMPARED, attachment.max_len)?;
    let mut reviewer = Reviewer {
        requests: bus.inlet()?,
        zones: bus.inlet()?,
        outcomes: bus.inlet()?,
        proposals: bus.outlet()?,
        gains: bus.outlet()?,
        credits: bus.outlet()?,
        raw: ComparedTopic::new(&bus)?,
        commands: ComparedTopic::new(&bus)?,
        run: attachment.names.run,
        folder: attachment.folder.clone(),
        order,
        by_zone,
        batches,
        batch: 0,
        header: BatchHeader {
            attempt: Attempt::between_batches(attachment.names.run),
            ..BatchHeader::default()
        },
        reported: None,
        credited: 0,
        outcome: Outcome::default(),
        stage: ReplayStage::Fresh,
        counters: Counters::default(),
    };
    serve(&attachment, &bus, WakeRole::Trainer, &mut reviewer)
}

#[derive(Clone, Copy, PartialEq)]
enum ReplayStage {
    Fresh,
    Driving,
    Over,
}

/// One of the topics that are compared.
struct ComparedTopic<M: Message> {
    inlet: Inlet<M>,
    early: Option<Received<M>>,
    next_tick: u64,
    difference: Option<Difference>,
}

impl<M: Message<Header = TickHeader>> ComparedTopic<M> {
    fn new(bus: &Bus) -> Result<Self> {
        Ok(Self { inlet: bus.observe()?, early: None, next_tick: 0, difference: None })
    }

    fn reset(&mut self) {
        (self.next_tick, self.difference) = (0, None);
    }

    /// Compares what has come with the recording; returns whether anything had come.
    fn compare(&mut self, now: BatchHeader, batch: &Batch, order: &Order) -> Result<bool> {
        for taken in 0..AT_ONCE {
            let message = match self.early.take() {
                Some(early) => early,
                None => match self.inlet.receive()? {
                    Some(message) => message,
                    None => return Ok(taken > 0),
                },
            };
            let header = message.header();
            if header.attempt.is_ahead_of(&now.attempt) {
                // Its request travels on another topic, and has not come yet.
                self.early = Some(message);
                return Ok(taken > 0);
            }
            if (header.attempt, header.tick) != (now.attempt, self.next_tick) {
                continue;
            }
            self.next_tick += 1;
            let is_wanted = (order.from_tick..order.to_tick).contains(&header.tick);
            if self.difference.is_none() && is_wanted {
                self.difference = first_difference(header.tick, message.items(), batch);
            }
        }
        Ok(true)
    }
}

/// The first field in which answers differ from the recorded ones.
fn first_difference<M: Message>(tick: u64, items: &[M], batch: &Batch) -> Option<Difference> {
    let recorded = batch.ticks.get(M::TOPIC.name)?.get(tick as usize);
    let differs = |slot: usize, field: &str, recorded: String, replayed: String| Difference {
        batch: batch.number(),
        tick,
        slot,
        topic: M::TOPIC.name.to_owned(),
        field: field.to_owned(),
        recorded,
        replayed,
    };
    let Some(recorded) = recorded else {
        let nothing = "nothing: the drive was over".to_owned();
        return Some(differs(0, "message", nothing, "a message".to_owned()));
    };
    let mut bytes = Vec::with_capacity(recorded.len());
    for item in items {
        item.put(&mut bytes);
    }
    let slots = recorded.chunks(size_of::<M>()).zip(bytes.chunks(size_of::<M>())).enumerate();
    for (slot, (was, is)) in slots {
        // Byte by byte first: making the names of all fields is rarely necessary.
        let fields = if was == is { Vec::new() } else { numbers(<M as Layout>::FIELDS) };
        for field in &fields {
            let (was, is) = (value(field, was), value(field, is));
            if was.0 != is.0 {
                return Some(differs(slot, &field.name, was.1, is.1));
            }
        }
    }
    None
}

/// A field's bits, and its value in words.
fn value(field: &Number, mut bytes: &[u8]) -> (u64, String) {
    bytes = bytes.get(field.offset..).unwrap_or_default();
    match field.kind {
        "u32" => u32::take(&mut bytes).map(|it| (u64::from(it), it.to_string())),
        "u64" => u64::take(&mut bytes).map(|it| (it, it.to_string())),
        _ => f64::take(&mut bytes).map(|it| (it.to_bits(), format!("{it:?}"))),
    }
    .unwrap_or_default()
}

struct Reviewer {
    requests: Inlet<DriveRequest>,
    zones: Inlet<Zone>,
    outcomes: Inlet<DriveOutcome>,
    proposals: Outlet<Proposal>,
    gains: Outlet<GainSwitch>,
    credits: Outlet<Credit>,
    raw: ComparedTopic<RawCommand>,
    commands: ComparedTopic<Command>,
    run: u64,
    folder: PathBuf,
    order: Order,
    /// The parameters of each zone that replace the recorded ones; empty to keep the recorded ones.
    by_zone: Vec<Parameters>,
    batches: Vec<Batch>,
    /// The batch that is replayed, as an index.
    batch: usize,
    /// Its header in this run.
    header: BatchHeader,
    /// Its ticks, once it was reported.
    reported: Option<u64>,
    credited: u64,
    outcome: Outcome,
    stage: ReplayStage,
    counters: Counters,
}

impl Reviewer {
    fn propose(&mut self) -> Result<()> {
        self.stage = ReplayStage::Driving;
        let attempt = Attempt::between_batches(self.run);
        let header = BatchHeader { attempt, sent_ns: now_ns(), ..BatchHeader::default() };
        let step = self.batch as u32;
        let by_zone = &self.by_zone;
        let Some(batch) =
            self.batches.get(self.batch).filter(|_| self.outcome.difference.is_none())
        else {
            self.stage = ReplayStage::Over;
            let text = serde_json::to_string_pretty(&self.outcome)?;
            std::fs::write(self.folder.join("outcome.json"), text)?;
            let header = BatchHeader { flags: Proposal::FINISHED, ..header };
            self.proposals.send(header, 1, |_| Proposal::default())?;
            return Ok(());
        };
        self.proposals.send(header, batch.requests.len(), |slot| {
            let request = batch.requests[slot];
            let recorded = request.flags & !DriveRequest::LOGGED;
            let mut flags = recorded | DriveRequest::RECORDED;
            let mut parameters = request.parameters;
            if let Some(first) = by_zone.first() {
                parameters = first.0;
                flags &= !DriveRequest::SCHEDULED;
                flags |= if by_zone.len() > 1 { DriveRequest::SCHEDULED } else { 0 };
            }
            let DriveRequest { seed, ticks, plant, .. } = request;
            Proposal { parameters, seed, ticks, learner: slot as u32, step, flags, plant }
        })?;
        Ok(())
    }

    /// Answers a zone with the recorded parameters, or with those under review.
    fn answer(&mut self, zones: &Received<Zone>) -> Result<()> {
        let header = zones.header();
        let Some(batch) = self.batches.get(self.batch) else { return Ok(()) };
        let answers: Vec<GainSwitch> = zones
            .items()
            .iter()
            .filter_map(|zone| {
                let Zone { from_tick, slot, zone } = *zone;
                let recorded = batch.switches.iter().find(|it| (it.slot, it.zone) == (slot, zone));
                let parameters = match self.by_zone.get(zone as usize) {
                    Some(parameters) => parameters.0,
                    None => match recorded {
                        Some(recorded) => recorded.parameters,
                        // A zone that was not entered in the recording: whatever parameters it gets, the command will
                        // differ.
                        None => batch.requests.get(slot as usize)?.parameters,
                    },
                };
                Some(GainSwitch { parameters, from_tick, slot, zone })
            })
            .collect();
        let header = BatchHeader { flags: 0, sent_ns: now_ns(), ..header };
        self.gains.send(header, answers.len(), |index| answers[index])?;
        Ok(())
    }

    fn credit(&mut self) -> Result<()> {
        let ticks = self.raw.next_tick.min(self.commands.next_tick);
        if ticks >= self.credited + CREDIT_EVERY {
            self.credited = ticks;
            let header = BatchHeader { flags: 0, sent_ns: now_ns(), ..self.header };
            let credit = Credit { ticks, source: DriveRequest::RECORDED, reserved: 0 };
            self.credits.send(header, 1, |_| credit)?;
        }
        Ok(())
    }

    /// Goes on once the batch was reported and all of it compared.
    fn go_on(&mut self) -> Result<()> {
        let ticks = self.raw.next_tick.min(self.commands.next_tick);
        if self.reported.is_none_or(|all| ticks < all) {
            return Ok(());
        }
        self.reported = None;
        let sides = [self.raw.difference.take(), self.commands.difference.take()];
        // The raw command comes first in a tick, and a stable choice between equal ticks keeps it first.
        self.outcome.difference =
            sides.into_iter().flatten().min_by_key(|it| (it.tick, it.topic == Command::TOPIC.name));
        let (from, to) = (self.order.from_tick, self.order.to_tick);
        self.outcome.compared += ticks.min(to).saturating_sub(from);
        self.outcome.batches += 1;
        self.batch += 1;
        self.propose()
    }
}

impl Service for Reviewer {
    fn poll(&mut self) -> Result<bool> {
        if self.stage == ReplayStage::Fresh {
            self.propose()?;
            return Ok(true);
        }
        let mut any = false;
        if let Some(request) = self.requests.receive_newest()? {
            any = true;
            let is_ours = request.items().first().is_some_and(|it| it.step as usize == self.batch);
            if request.header().attempt.is_of(self.run) && is_ours {
                self.header = request.header();
                self.credited = 0;
                self.raw.reset();
                self.commands.reset();
            }
        }
        while let Some(zones) = self.zones.receive()? {
            any = true;
            self.answer(&zones)?;
        }
        if let Some(batch) = self.batches.get(self.batch) {
            any |= self.raw.compare(self.header, batch, &self.order)?;
            any |= self.commands.compare(self.header, batch, &self.order)?;
        }
        self.credit()?;
        while let Some(outcomes) = self.outcomes.receive()? {
            any = true;
            let of_batch =
                outcomes.items().iter().filter(|it| it.report.step as usize == self.batch);
            if let Some(ticks) = of_batch.map(|it| it.report.ticks).max() {
                self.reported = Some(ticks);
            }
        }
        if self.stage == ReplayStage::Driving {
            self.go_on()?;
        }
        Ok(any)
    }

    fn status(&self) -> Counters {
        self.counters
    }
}
