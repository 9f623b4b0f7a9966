//! Records drives tick by tick; the figures are drawn from these recordings. In lockstep there is no gap; by the clock a
//! tick is missing if not every process sent a message of it. Rows are written as they come, and not kept.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use ipc_types::{
    BatchHeader, Command, Credit, DriveRequest, Message, Odometry, TickHeader, TrackingError, has,
};
use runtime::clock::{is_ahead, now_ns};
use runtime::{Bus, Inlet, Outlet, Received};
use serde::Serialize;
use tracking::{Pose, tracking_error};

use crate::along::{Growing, Sums};

/// One tick of a recorded drive: a line of its CSV file.
///
/// Poses are those of the tracked point in the map frame, errors those of the true pose in the vehicle frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[allow(missing_docs, reason = "units and meaning are those of ipc_types")]
pub struct Row {
    pub tick: u64,
    pub time_s: f64,
    pub x_m: f64,
    pub y_m: f64,
    pub yaw_rad: f64,
    pub measured_x_m: f64,
    pub measured_y_m: f64,
    pub measured_yaw_rad: f64,
    pub speed_mps: f64,
    pub yaw_rate_radps: f64,
    pub steering_rad: f64,
    pub reference_x_m: f64,
    pub reference_y_m: f64,
    pub reference_yaw_rad: f64,
    pub along_track_m: f64,
    pub cross_track_m: f64,
    pub heading_rad: f64,
    pub path_distance_m: f64,
    pub command_speed_mps: f64,
    pub command_yaw_rate_radps: f64,
    pub command_steering_rad: f64,
    pub flags: u32,
    pub zone: u32,
}

impl Row {
    /// Whether all that the vehicle said of itself is finite.
    pub(crate) fn is_finite(&self) -> bool {
        [
            self.x_m,
            self.y_m,
            self.yaw_rad,
            self.measured_x_m,
            self.measured_y_m,
            self.measured_yaw_rad,
            self.speed_mps,
            self.yaw_rate_radps,
        ]
        .iter()
        .all(|it| it.is_finite())
    }
}

/// The largest number of messages of a topic that one look takes: the vehicle should not wait until all of them are
/// taken.
const AT_ONCE: usize = 64;
/// Ticks between two credits: a quarter of what the vehicle may run ahead.
const CREDIT_EVERY: u64 = Credit::AHEAD / 4;

/// By the clock a recording that is not complete this long after its report will never be: a process that is held up leaves
/// ticks out.
const PATIENCE_BY_CLOCK: Duration = Duration::from_millis(500);
/// In lockstep no tick is left out. But a drive may be made again after its report, if a process has died, and its recording
/// with it: it is waited for as long as it grows, and until the dead process is back.
const PATIENCE_IN_LOCKSTEP: Duration = Duration::from_secs(10);

/// Records the drives of a batch that ask for it.
pub(crate) struct Recorder {
    run: u64,
    tick_s: f64,
    requests: Inlet<DriveRequest>,
    odometry: JoinedTopic<Odometry>,
    errors: JoinedTopic<TrackingError>,
    commands: JoinedTopic<Command>,
    credits: Outlet<Credit>,
    /// Where recordings are written, and the names of their files by the drives' learners.
    folder: PathBuf,
    names: BTreeMap<u32, String>,
    /// What is added up of each recording, before its first row.
    sums: Sums,
    batch: BatchHeader,
    next: Option<NextBatch>,
    /// The slots that are recorded, each with its learner, its step and what was recorded.
    slots: Vec<Recorded>,
    ticks: u64,
    credited: u64,
    by_clock: bool,
    grew_ns: u64,
}

/// A batch whose request came while a recording of the batch before was not whole yet.
struct NextBatch {
    header: BatchHeader,
    requests: Vec<DriveRequest>,
    since_ns: u64,
}

struct Recorded {
    slot: usize,
    learner: u32,
    step: u32,
    growing: Growing,
    /// Whether somebody has the recording already.
    is_taken: bool,
}

/// One of the topics that are joined: what was taken from it but not yet joined with the others.
struct JoinedTopic<M: Message> {
    inlet: Inlet<M>,
    /// A message of a batch whose request has not come yet: the two travel on different topics.
    early: Option<Received<M>>,
    /// The elements of the recorded slots, tick by tick, with the tick.
    taken: VecDeque<(u64, Vec<M>)>,
    next_tick: u64,
}

impl<M: Message<Header = TickHeader>> JoinedTopic<M> {
    fn new(bus: &Bus) -> Result<Self> {
        Ok(Self { inlet: bus.observe()?, early: None, taken: VecDeque::new(), next_tick: 0 })
    }

    fn reset(&mut self) {
        self.taken.clear();
        self.next_tick = 0;
    }

    /// Takes what has come; returns whether there was anything. By the clock, `tick_s` tells which ticks lie ahead of it:
    /// nobody answers those.
    fn take(
        &mut self,
        batch: BatchHeader,
        slots: &[Recorded],
        tick_s: Option<f64>,
    ) -> Result<bool> {
        for taken in 0..AT_ONCE {
            let message = match self.early.take() {
                Some(early) => early,
                None => match self.inlet.receive()? {
                    Some(message) => message,
                    None => return Ok(taken > 0),
                },
            };
            let header = message.header();
            if header.attempt.is_ahead_of(&batch.attempt) {
                self.early = Some(message);
                return Ok(taken > 0);
            }
            // By the clock the supervisor may send several commands in a tick; the first one answers it.
            let fits = header.attempt == batch.attempt
                && header.tick >= self.next_tick
                && !tick_s.is_some_and(|it| is_ahead(header.tick, it, batch.sent_ns, now_ns()));
            if !fits || slots.iter().any(|slot| slot.slot >= message.items().len()) {
                continue;
            }
            let elements = slots.iter().map(|slot| message.items()[slot.slot]).collect();
            self.taken.push_back((header.tick, elements));
            self.next_tick = header.tick + 1;
        }
        Ok(true)
    }
}

impl Recorder {
    /// Before the first request. The files are written below the run's folder, and named by the drives' learners.
    pub(crate) fn new(
        bus: &Bus,
        run: u64,
        tick_s: f64,
        (folder, names): (&Path, BTreeMap<u32, String>),
        sums: Sums,
    ) -> Result<Self> {
        Ok(Self {
            folder: folder.join(DRIVES_FOLDER),
            names,
            sums,
            run,
            tick_s,
            requests: bus.inlet()?,
            odometry: JoinedTopic::new(bus)?,
            errors: JoinedTopic::new(bus)?,
            commands: JoinedTopic::new(bus)?,
            credits: bus.outlet()?,
            batch: BatchHeader::default(),
            next: None,
            slots: Vec::new(),
            ticks: 0,
            credited: 0,
            by_clock: false,
            grew_ns: 0,
        })
    }

    /// Whether a recording that is not complete by now will never be: the report of its drive came at `since_ns`.
    pub(crate) fn has_waited_enough(&self, since_ns: u64) -> bool {
        let (since_ns, patience) = match self.by_clock {
            true => (since_ns, PATIENCE_BY_CLOCK),
            false => (since_ns.max(self.grew_ns), PATIENCE_IN_LOCKSTEP),
        };
        now_ns().saturating_sub(since_ns) >= patience.as_nanos() as u64
    }

    /// Takes over what has come; returns whether there was anything.
    pub(crate) fn poll(&mut self) -> Result<bool> {
        if let Some(request) = self.requests.receive_newest()? {
            let (header, requests) = (request.header(), request.items().to_vec());
            self.next = Some(NextBatch { header, requests, since_ns: now_ns() });
        }
        if self.next.as_ref().is_some_and(|next| !self.is_held_up(next))
            && let Some(next) = self.next.take()
        {
            self.start_batch(next.header, &next.requests);
        }
        if self.slots.is_empty() {
            return Ok(false);
        }
        let tick_s = self.by_clock.then_some(self.tick_s);
        let Self { batch, slots, .. } = self;
        let mut any = self.odometry.take(*batch, slots, tick_s)?;
        any |= self.errors.take(*batch, slots, tick_s)?;
        any |= self.commands.take(*batch, slots, tick_s)?;
        self.join_topics()?;
        if self.ticks >= self.credited + CREDIT_EVERY {
            self.credited = self.ticks;
            let header = BatchHeader { flags: 0, sent_ns: now_ns(), ..self.batch };
            let source = DriveRequest::RECORDED;
            let credit = Credit { ticks: self.ticks, source, reserved: 0 };
            self.credits.send(header, 1, |_| credit)?;
        }
        Ok(any)
    }

    fn start_batch(&mut self, header: BatchHeader, requests: &[DriveRequest]) {
        self.slots.clear();
        if !header.attempt.is_of(self.run) {
            return;
        }
        self.batch = header;
        (self.ticks, self.credited) = (0, 0);
        self.by_clock = requests.iter().any(|it| has(it.flags, DriveRequest::REAL_TIME));
        self.odometry.reset();
        self.errors.reset();
        self.commands.reset();
        self.slots.extend(
            requests
                .iter()
                .enumerate()
                .filter(|(_, request)| has(request.flags, DriveRequest::RECORDED))
                .filter_map(|(slot, &DriveRequest { learner, step, .. })| {
                    // A drive that a predecessor asked for has no name.
                    let part = self.folder.join(format!("{}.part", self.names.get(&learner)?));
                    let growing = Growing::new(part, self.sums.clone());
                    Some(Recorded { slot, learner, step, growing, is_taken: false })
                }),
        );
    }

    fn join_topics(&mut self) -> Result<()> {
        let (odometry, errors, commands) =
            (&mut self.odometry.taken, &mut self.errors.taken, &mut self.commands.taken);
        while let (Some((seen, _)), Some((erred, _)), Some((given, _))) =
            (odometry.front(), errors.front(), commands.front())
        {
            let tick = *seen.max(erred).max(given);
            if seen != erred || seen != given {
                // Each topic's ticks ascend: what is behind the newest of the three gets no partner any more.
                drop_before(tick, odometry);
                drop_before(tick, errors);
                drop_before(tick, commands);
                continue;
            }
            let next = (odometry.pop_front(), errors.pop_front(), commands.pop_front());
            let (Some((_, odometry)), Some((_, errors)), Some((_, commands))) = next else { break };
            let all = odometry.iter().zip(&errors).zip(&commands);
            for (slot, ((odometry, error), command)) in self.slots.iter_mut().zip(all) {
                slot.growing.add(&row(tick, self.tick_s, odometry, error, command))?;
            }
            self.ticks = tick + 1;
            self.grew_ns = now_ns();
        }
        Ok(())
    }

    /// Whether a batch must wait because the last messages of the one before are still on their way: a command travels one
    /// hop further than the report. A batch that is driven again waits for nothing, and no batch waits for long: nobody may
    /// want that recording any more.
    fn is_held_up(&self, next: &NextBatch) -> bool {
        next.header.attempt.batch != self.batch.attempt.batch
            && self.slots.iter().any(|slot| !slot.is_taken)
            && now_ns().saturating_sub(next.since_ns.max(self.grew_ns))
                < PATIENCE_BY_CLOCK.as_nanos() as u64
    }

    /// Whether anything of a drive was recorded and not taken.
    pub(crate) fn has_rows(&self, learner: u32, step: u32) -> bool {
        let is_it = |it: &Recorded| (it.learner, it.step) == (learner, step);
        self.slots.iter().any(|it| is_it(it) && !it.is_taken && it.growing.rows > 0)
    }

    /// The recording of a drive that lasted `ticks`, under its name: once it is complete, or as far as there is one.
    pub(crate) fn take(
        &mut self,
        learner: u32,
        step: u32,
        ticks: u64,
        must_be_whole: bool,
    ) -> Result<Option<Taken>> {
        let name = self.names.get(&learner).cloned().unwrap_or_default();
        let slot = self.slots.iter_mut().find(|it| (it.learner, it.step) == (learner, step));
        let mut none = Growing::new(self.folder.join(format!("{name}.part")), Sums::default());
        let growing = match slot {
            // The other vehicles of the batch may drive on; this one has stood still since.
            Some(slot) if !must_be_whole || slot.growing.is_whole(ticks) => {
                slot.is_taken = true;
                &mut slot.growing
            }
            None if !must_be_whole => &mut none,
            _ => return Ok(None),
        };
        growing.keep(&self.folder.join(format!("{name}.csv")))?;
        let (rows, next_tick) = (growing.rows, growing.next_tick);
        Ok(Some(Taken { name, rows, next_tick, sums: std::mem::take(&mut growing.sums) }))
    }
}

/// A recording that has its name.
pub(crate) struct Taken {
    pub(crate) name: String,
    pub(crate) rows: u64,
    /// The tick after the last one that was recorded.
    pub(crate) next_tick: u64,
    pub(crate) sums: Sums,
}

/// Drops the elements of earlier ticks.
fn drop_before<M>(tick: u64, taken: &mut VecDeque<(u64, Vec<M>)>) {
    while taken.front().is_some_and(|(of, _)| *of < tick) {
        taken.pop_front();
    }
}

fn row(
    tick: u64,
    tick_s: f64,
    odometry: &Odometry,
    error: &TrackingError,
    command: &Command,
) -> Row {
    let pose =
        |wire: ipc_types::WirePose| Pose { x_m: wire.x_m, y_m: wire.y_m, yaw_rad: wire.yaw_rad };
    let measured = pose(odometry.measured);
    let truth =
        if has(odometry.status, Odometry::HAS_TRUTH) { pose(odometry.truth) } else { measured };
    // The controller reports the error of the measured pose; the reference is the pose to which that error points.
    let apart =
        measured.rotation() * nalgebra::Vector2::new(error.along_track_m, error.cross_track_m);
    let reference = Pose {
        x_m: measured.x_m + apart.x,
        y_m: measured.y_m + apart.y,
        yaw_rad: measured.yaw_rad + error.heading_rad,
    };
    let true_error = tracking_error(reference, truth);
    Row {
        tick,
        time_s: tick as f64 * tick_s,
        x_m: truth.x_m,
        y_m: truth.y_m,
        yaw_rad: truth.yaw_rad,
        measured_x_m: measured.x_m,
        measured_y_m: measured.y_m,
        measured_yaw_rad: measured.yaw_rad,
        speed_mps: odometry.speed_mps,
        yaw_rate_radps: odometry.yaw_rate_radps,
        steering_rad: odometry.steering_rad,
        reference_x_m: reference.x_m,
        reference_y_m: reference.y_m,
        reference_yaw_rad: reference.yaw_rad,
        along_track_m: true_error.along_track_m,
        cross_track_m: true_error.cross_track_m,
        heading_rad: true_error.heading_rad,
        path_distance_m: error.path_distance_m,
        command_speed_mps: command.speed_mps,
        command_yaw_rate_radps: command.yaw_rate_radps,
        command_steering_rad: command.steering_rad,
        flags: command.flags,
        zone: command.zone,
    }
}

/// Folder of the recorded drives in the run's folder.
pub(crate) const DRIVES_FOLDER: &str = "drives";
