//! The simulator in real time: a tick every `drive.tick_s` of the clock, with the last command held until it is too
//! old.

use anyhow::Result;
use config::RunConfig;
use ipc_types::{BatchHeader, Command, Odometry, TickHeader, has};
use runtime::clock::now_ns;
use runtime::{Counters, Inlet, Outlet};

use super::Slot;

/// The largest number of missed ticks that are made up for, if the process did not run for a while: a second at the
/// usual tick.
const MOST_MISSED: u64 = 100;

/// The additional state of a simulator in real time.
pub(super) struct Clocked {
    tick_ns: u64,
    command_age_limit_ns: u64,
    /// By how much the vehicle's own stop reduces its speed in a tick.
    stop_step_mps: f64,
    started_ns: u64,
    batch: Option<Batch>,
}

/// The batch under way; the vehicle goes on after its end, until the next one.
struct Batch {
    header: BatchHeader,
    /// The time of tick 0.
    since_ns: u64,
    /// The tick that comes next.
    tick: u64,
    /// The command that is held: its header, and a speed and steering angle for each slot.
    held: Option<(TickHeader, Vec<(f64, f64)>)>,
    applied_ns: u64,
}

impl Clocked {
    pub(super) fn new(config: &RunConfig, started_ns: u64) -> Self {
        let safety = config.vehicle.safety;
        Self {
            tick_ns: (config.drive.tick_s * 1e9) as u64,
            command_age_limit_ns: (safety.command_age_limit_s * 1e9) as u64,
            stop_step_mps: safety.stop_deceleration_mps2 * config.drive.tick_s,
            started_ns,
            batch: None,
        }
    }

    /// Begins a batch now, or joins one that had begun before this process did.
    pub(super) fn start(&mut self, header: BatchHeader, now_ns: u64) {
        let joins = header.sent_ns < self.started_ns;
        let since_ns = if joins { header.sent_ns } else { now_ns };
        let tick = now_ns.saturating_sub(since_ns).div_ceil(self.tick_ns);
        self.batch = Some(Batch { header, since_ns, tick, held: None, applied_ns: 0 });
    }

    /// When the next tick is due; never before the first batch.
    pub(super) fn due_ns(&self) -> u64 {
        self.batch.as_ref().map_or(u64::MAX, |batch| batch.since_ns + batch.tick * self.tick_ns)
    }

    /// Takes commands as they come, and computes a tick when it is due.
    pub(super) fn poll(
        &mut self,
        slots: &mut [Slot],
        commands: &Inlet<Command>,
        odometry: &Outlet<Odometry>,
        counters: &mut Counters,
    ) -> Result<bool> {
        let mut any = false;
        while let Some(command) = commands.receive()? {
            any = true;
            self.hold(command.header(), command.items(), slots, counters);
        }
        let now_ns = now_ns();
        let due_ns = self.due_ns();
        let Some(batch) = self.batch.as_ref().filter(|_| now_ns >= due_ns) else {
            return Ok(any);
        };
        let due_tick = now_ns.saturating_sub(batch.since_ns) / self.tick_ns;
        let missed = due_tick - batch.tick;
        let is_first = batch.tick == 0;
        let (command_age_limit_ns, stop_step_mps) = (self.command_age_limit_ns, self.stop_step_mps);
        let Some(batch) = &mut self.batch else { return Ok(any) };
        // The vehicle moves on while the process is held up; the odometry of that time is not sent late, it is missing.
        for _ in 0..(missed + u64::from(!is_first)).min(MOST_MISSED) {
            batch.step(slots, now_ns, command_age_limit_ns, stop_step_mps);
        }
        batch.tick = due_tick;
        let header = TickHeader {
            attempt: batch.header.attempt,
            tick: due_tick,
            applied_ns: batch.applied_ns,
            odometry_sent_ns: now_ns,
            ..TickHeader::default()
        };
        batch.tick += 1;
        counters.tick = batch.tick;
        odometry.send(header, slots.len(), |index| slots[index].observe_clocked())?;
        Ok(true)
    }

    /// Takes over a command, if it belongs to this batch and is recent enough.
    fn hold(
        &mut self,
        header: TickHeader,
        commands: &[Command],
        slots: &mut [Slot],
        counters: &mut Counters,
    ) {
        let Some(batch) = self.batch.as_mut().filter(|batch| {
            header.attempt == batch.header.attempt
                && batch.held.as_ref().is_none_or(|(held, _)| header.tick >= held.tick)
                && header.tick < batch.tick
                && commands.len() == slots.len()
        }) else {
            counters.dropped += 1;
            return;
        };
        let now_ns = now_ns();
        let sent_ns = header.supervisor_sent_ns;
        // A stamp from the future would count as recent for ever.
        if sent_ns > now_ns || now_ns - sent_ns > self.command_age_limit_ns {
            counters.late += 1;
            return;
        }
        let held = commands.iter().zip(slots).map(|(command, slot)| {
            slot.ended |= has(command.flags, Command::ENDED);
            let (speed_mps, steering_rad) = (command.speed_mps, command.steering_rad);
            if speed_mps.is_finite() && steering_rad.is_finite() {
                (speed_mps, steering_rad)
            } else {
                counters.rejected += 1;
                (0.0, 0.0)
            }
        });
        batch.held = Some((header, held.collect()));
        batch.applied_ns = now_ns;
    }
}

impl Batch {
    /// One tick of the world.
    fn step(&self, slots: &mut [Slot], now_ns: u64, command_age_limit_ns: u64, stop_step_mps: f64) {
        let fresh = self.held.as_ref().filter(|(header, _)| {
            now_ns.saturating_sub(header.supervisor_sent_ns) <= command_age_limit_ns
        });
        for (index, slot) in slots.iter_mut().enumerate() {
            // Also behind the end of the drive: then the supervisor brings the vehicle to a stop.
            let command = fresh.map(|(_, held)| held[index]);
            slot.own_stop = command.is_none() && !slot.ended;
            let (speed_mps, steering_rad) = command.unwrap_or_else(|| {
                // On from its own last command: one that follows the speed would follow a car that is late to obey.
                let from_mps = slot.stop_mps.unwrap_or(slot.last.speed_mps);
                ((from_mps - stop_step_mps).max(0.0), 0.0)
            });
            slot.stop_mps = command.is_none().then_some(speed_mps);
            slot.vehicle.step(speed_mps, steering_rad);
        }
    }
}

impl Slot {
    /// As [`Slot::observe`], for a vehicle that goes on after the end of its drive.
    fn observe_clocked(&mut self) -> Odometry {
        self.observe();
        self.last.status |= if self.ended { Odometry::ENDED } else { 0 }
            | if self.own_stop { Odometry::OWN_STOP } else { 0 };
        self.last
    }
}
