//! The simulator in lockstep: it publishes odometry k, waits for command k, integrates, and publishes k+1, as fast as the
//! rest of the ring answers.

use anyhow::Result;
use ipc_types::{Allowance, BatchHeader, Command, Credit, DriveRequest, Odometry, TickHeader, has};
use runtime::clock::now_ns;
use runtime::{Counters, Inlet, Outlet, Written};

use super::Slot;

/// What the next tick waits for.
pub(super) struct Lockstep {
    /// Header of the odometry that waits for its command; `None` between batches.
    waiting: Option<TickHeader>,
    /// What the batch's recorders allow.
    allowance: Allowance,
    /// Header of the odometry that waits for a recorder.
    held_back: Option<TickHeader>,
}

impl Lockstep {
    /// A batch of these requests, before its first odometry.
    pub(super) fn new(requests: &[DriveRequest]) -> Self {
        Self { waiting: None, allowance: Allowance::new(requests), held_back: None }
    }

    /// Publishes the odometry of tick 0.
    pub(super) fn start(
        &mut self,
        header: BatchHeader,
        slots: &mut [Slot],
        odometry: &Outlet<Odometry>,
    ) -> Result<()> {
        let first = odometry.write(slots.len(), |index| slots[index].observe())?;
        let header = TickHeader { attempt: header.attempt, ..TickHeader::default() };
        self.publish(first, header)
    }

    /// Whether it waits only for a command.
    pub(super) fn awaits_command(&self) -> bool {
        self.waiting.is_some() && self.held_back.is_none()
    }

    /// Header of the odometry that waits for a recorder.
    pub(super) fn held_back(&self) -> Option<TickHeader> {
        self.held_back
    }

    /// Applies for one tick the commands for which the odometry waits, and publishes the next odometry.
    pub(super) fn obey(
        &mut self,
        header: TickHeader,
        commands: &[Command],
        slots: &mut [Slot],
        odometry: &Outlet<Odometry>,
        counters: &mut Counters,
    ) -> Result<()> {
        let Some(waiting) = self.waiting else {
            counters.dropped += 1;
            return Ok(());
        };
        if !header_matches(header, waiting) || commands.len() != slots.len() {
            counters.dropped += 1;
            return Ok(());
        }
        let applied_ns = now_ns();
        let mut any_goes_on = false;
        let next = odometry.write(commands.len(), |index| {
            let (slot, command) = (&mut slots[index], &commands[index]);
            slot.ended |= has(command.flags, Command::ENDED);
            if slot.ended {
                slot.last.status |= Odometry::ENDED;
                return slot.last;
            }
            any_goes_on = true;
            let (mut speed_mps, mut steering_rad) = (command.speed_mps, command.steering_rad);
            if !(speed_mps.is_finite() && steering_rad.is_finite()) {
                counters.rejected += 1;
                (speed_mps, steering_rad) = (0.0, 0.0);
            }
            slot.vehicle.step(speed_mps, steering_rad);
            slot.observe()
        })?;
        if !any_goes_on {
            self.waiting = None;
            return Ok(());
        }
        counters.tick = waiting.tick + 1;
        let header = TickHeader {
            attempt: waiting.attempt,
            tick: waiting.tick + 1,
            applied_ns,
            ..TickHeader::default()
        };
        self.publish(next, header)
    }

    /// Publishes what was held back, once every recorder has got far enough.
    pub(super) fn catch_up(
        &mut self,
        held_back: TickHeader,
        credits: &Inlet<Credit>,
        slots: &[Slot],
        odometry: &Outlet<Odometry>,
        counters: &mut Counters,
    ) -> Result<bool> {
        let mut any = false;
        // Takes all of them: the newest one may be another recorder's.
        while let Some(credit) = credits.receive()? {
            any = true;
            let header = credit.header();
            let is_of_batch = header.attempt == held_back.attempt;
            let Some(credit) = credit.items().first().filter(|_| is_of_batch) else {
                counters.dropped += 1;
                continue;
            };
            self.allowance.grant(*credit);
        }
        if any {
            let again = odometry.write(slots.len(), |index| slots[index].last)?;
            self.publish(again, held_back)?;
        }
        Ok(any)
    }

    /// Sends odometry, unless a recorder has not got that far; then it must be written again later.
    fn publish(&mut self, written: Written<Odometry>, header: TickHeader) -> Result<()> {
        if !self.allowance.allows(header.tick) {
            self.held_back = Some(header);
            return Ok(());
        }
        self.held_back = None;
        self.waiting = Some(header);
        written.send(|now_ns| TickHeader { odometry_sent_ns: now_ns, ..header })?;
        Ok(())
    }
}

fn header_matches(a: TickHeader, b: TickHeader) -> bool {
    (a.attempt, a.tick) == (b.attempt, b.tick)
}
