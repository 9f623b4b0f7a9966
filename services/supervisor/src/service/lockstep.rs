//! The supervisor in lockstep: nothing happens between odometry, answer and command.

use anyhow::Result;
use ipc_types::{Odometry, RawCommand, TickHeader, Zone};
use runtime::Received;

use super::{Slot, Supervisor, announce, tell_safety};

impl Supervisor {
    /// Takes the odometry and the answer of a tick, and sends its command. It does all of this for one vehicle after
    /// the other, because a fleet does not fit into the nearest cache.
    pub(super) fn pass_in_lockstep(
        &mut self,
        header: TickHeader,
        raw: &[RawCommand],
        received_ns: u64,
    ) -> Result<()> {
        let odometry = self.odometry_of(header)?;
        let seen = odometry.as_ref().map_or(&[][..], Received::items);
        self.entered.clear();
        self.counters.batch = header.attempt.batch;
        self.counters.tick = header.tick + 1;
        let (batch, tick_s) = (self.batch, self.tick_s);
        let Self { slots, entered, zones, safety, counters, .. } = self;
        let mut tells_safety = false;
        let command = |index: usize| {
            let slot = &mut slots[index];
            if let Some(odometry) = seen.get(index) {
                let believed = slot.see(header.tick, odometry, false);
                counters.rejected += u64::from(!believed);
            }
            if let Some(zone) = slot.hear(header.tick, &raw[index]) {
                let from_tick = header.tick + 1;
                entered.push(Zone { from_tick, slot: index as u32, zone });
            }
            let told = |slot: &Slot| (slot.watch.state(), slot.watch.reasons(), slot.told_rate);
            let before = told(slot);
            let (command, rejected) = slot.command(tick_s, 0, true);
            slot.told_rate = slot.clock_rate();
            tells_safety |= told(slot) != before;
            counters.rejected += u64::from(rejected);
            command
        };
        let command = self.commands.write(raw.len(), command)?;
        // Before the command: when the vehicle answers the command, zones and rates must be known.
        announce(zones, batch, entered)?;
        if tells_safety {
            tell_safety(safety, batch, slots, true)?;
        }
        command.send(|now_ns| TickHeader {
            supervisor_received_ns: received_ns,
            supervisor_sent_ns: now_ns,
            ..header
        })?;
        Ok(())
    }

    /// The odometry that a raw command answers, in lockstep: it came before the command. The first odometry of the next
    /// batch may have come, too, and messages that belong to no batch of ours.
    fn odometry_of(&mut self, header: TickHeader) -> Result<Option<Received<Odometry>>> {
        let mut next = self.early_odometry.take();
        loop {
            let Some(odometry) = next.map_or_else(|| self.odometry.receive(), |it| Ok(Some(it)))?
            else {
                return Ok(None);
            };
            next = None;
            let it = odometry.header();
            // The stamp tells it from another message that claims the same tick.
            let is_answered = self.is_of_batch(it, odometry.items().len())
                && (it.tick, it.odometry_sent_ns) == (header.tick, header.odometry_sent_ns);
            if is_answered {
                return Ok(Some(odometry));
            }
            if it.tick == 0 && it.attempt.is_ahead_of(&header.attempt) {
                self.early_odometry = Some(odometry);
            }
        }
    }
}
