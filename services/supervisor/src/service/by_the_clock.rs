//! The supervisor in real time: it passes answers that are recent enough, and if there is none it sends commands of its
//! own. It keeps what a controller needs to join a drive.

use anyhow::Result;
use ipc_types::{
    BatchHeader, KeptLawState, LawState, Odometry, RawCommand, Safety, TickHeader, Zone, has,
};
use runtime::clock::{is_ahead, now_ns};

use super::{Slot, Supervisor, announce, tell_safety};
use crate::Action;

/// A batch in real time.
pub(super) struct Clocked {
    /// Header of the newest odometry.
    seen: Option<TickHeader>,
    /// Stamp of the odometry to which the newest answer belongs; before the first answer, that of the first odometry.
    answered_ns: u64,
    /// The newest answer, and the ticks' reference with it.
    has_reference: bool,
    /// When the last command was sent; 0 before the first.
    sent_ns: u64,
    /// Whether the drives had begun before this process did, and no answer has reported their state yet.
    joins: bool,
    /// The laws' newest states, one for each slot; empty before the first. Not in the slots, because no other mode has
    /// them, and a fleet should fit into the cache.
    law_states: Vec<KeptLawState>,
}

impl Clocked {
    /// A batch before its first odometry. `joins`: its drives had begun before this process did.
    pub(super) fn new(joins: bool) -> Self {
        Self {
            seen: None,
            answered_ns: 0,
            has_reference: false,
            sent_ns: 0,
            joins,
            law_states: Vec::new(),
        }
    }

    /// Whether an answer has been received.
    pub(super) fn has_reference(&self) -> bool {
        self.has_reference
    }

    /// [`Safety::ODOMETRY_STALE`] if there is no odometry that is recent enough.
    fn odometry_faults(&self, now_ns: u64, age_limit_ns: u64) -> u32 {
        let seen_ns = self.seen.map_or(0, |seen| seen.odometry_sent_ns);
        let is_stale = now_ns.saturating_sub(seen_ns) > age_limit_ns;
        if is_stale { Safety::ODOMETRY_STALE } else { 0 }
    }
}

impl Supervisor {
    /// Answers a raw command, if it is recent enough.
    pub(super) fn pass_by_the_clock(
        &mut self,
        header: TickHeader,
        raw: &[RawCommand],
        received_ns: u64,
    ) -> Result<()> {
        if !self.is_young(header, received_ns) {
            self.counters.late += 1;
            return Ok(());
        }
        self.hear_out(header, raw)?;
        self.send(header, received_ns, true)
    }

    /// Takes odometry, whether or not the controller answers it.
    pub(super) fn see(&mut self, header: TickHeader, odometry: &[Odometry]) {
        if !self.is_of_batch(header, odometry.len()) {
            return;
        }
        let joins = self.clocked.as_ref().is_some_and(|it| it.joins && it.seen.is_none());
        let now_ns = now_ns();
        // A stamp by another clock would count as recent for ever.
        if header.odometry_sent_ns > now_ns
            || is_ahead(header.tick, self.tick_s, self.batch.sent_ns, now_ns)
        {
            let odometry_sent_ns = header.odometry_sent_ns.min(now_ns);
            return self.refuse(TickHeader { odometry_sent_ns, ..header }, odometry, joins);
        }
        for (slot, odometry) in self.slots.iter_mut().zip(odometry) {
            let believed = slot.see(header.tick, odometry, joins);
            self.counters.rejected += u64::from(!believed);
        }
        if let Some(clocked) = &mut self.clocked {
            // The clock begins with the first tick: before it, the vehicle is still on its way to the start.
            if clocked.seen.is_none() {
                clocked.answered_ns = header.odometry_sent_ns;
            }
            clocked.seen = Some(header);
        }
    }

    /// Takes odometry whose tick is wrong: the vehicle is there, and its speed tells whether it stands. A drive that is
    /// `joined` still waits for odometry to begin with.
    fn refuse(&mut self, header: TickHeader, odometry: &[Odometry], joined: bool) {
        for (slot, odometry) in self.slots.iter_mut().zip(odometry) {
            slot.refuse(Safety::TIME_AHEAD, odometry.speed_mps);
        }
        self.counters.rejected += odometry.len() as u64;
        if let Some(clocked) = self.clocked.as_mut().filter(|_| !joined) {
            if clocked.seen.is_none() {
                clocked.answered_ns = header.odometry_sent_ns;
            }
            let tick = clocked.seen.map_or(0, |seen| seen.tick);
            clocked.seen = Some(TickHeader { tick, ..header });
        }
    }

    /// Whether an answer is recent enough to be passed, and newer than the one before.
    fn is_young(&self, header: TickHeader, now_ns: u64) -> bool {
        let Some(clocked) = &self.clocked else { return true };
        let stamp_ns = header.odometry_sent_ns;
        now_ns.saturating_sub(stamp_ns) <= self.answer_age_limit_ns
            && stamp_ns >= clocked.answered_ns
            // A stamp from the future would count as recent for ever.
            && stamp_ns <= now_ns
    }

    /// Takes over what the controller reports, and announces zones that begin with the next tick, before this tick's
    /// command.
    fn hear_out(&mut self, header: TickHeader, raw: &[RawCommand]) -> Result<()> {
        let mut joins = false;
        if let Some(clocked) = &mut self.clocked {
            clocked.answered_ns = header.odometry_sent_ns;
            clocked.has_reference = true;
            joins = std::mem::take(&mut clocked.joins);
        }
        self.keep_law_states()?;
        self.entered.clear();
        for (index, (slot, raw)) in self.slots.iter_mut().zip(raw).enumerate() {
            if joins {
                slot.zones.resume(raw.reference_along_m);
                if has(raw.flags, RawCommand::FROZEN) {
                    let is_straight = has(raw.flags, RawCommand::STRAIGHTENED);
                    let action = if is_straight { Action::BrakeStraight } else { Action::Brake };
                    slot.watch.resume_stop(action);
                }
            }
            if let Some(zone) = slot.hear(header.tick, raw) {
                let from_tick = header.tick + 1;
                self.entered.push(Zone { from_tick, slot: index as u32, zone });
            }
        }
        announce(&self.zones, self.batch, &self.entered)
    }

    /// Takes over the state that the laws must not lose. It was sent before the raw command.
    fn keep_law_states(&mut self) -> Result<()> {
        let Some(states) = self.law_states.receive_newest()? else { return Ok(()) };
        let len = states.items().len();
        let Some(clocked) = &mut self.clocked else { return Ok(()) };
        if states.header().attempt != self.batch.attempt || len != self.slots.len() {
            self.counters.dropped += 1;
            return Ok(());
        }
        let kept = states.items().iter().map(|state| {
            let LawState { tick, slot, count, numbers } = *state;
            KeptLawState { tick, slot, count, numbers }
        });
        clocked.law_states.clear();
        clocked.law_states.extend(kept);
        Ok(())
    }

    /// Sends a command in real time: what the raw command wants, within limits, if it is an answer; otherwise one of
    /// our own.
    fn send(&mut self, header: TickHeader, received_ns: u64, is_answer: bool) -> Result<()> {
        let now = now_ns();
        let (mut dt_s, mut faults) = (self.tick_s, 0);
        if let Some(clocked) = &mut self.clocked {
            if clocked.sent_ns > 0 {
                dt_s = ((now - clocked.sent_ns) as f64 / 1e9).min(self.tick_s);
            }
            clocked.sent_ns = now;
            faults |= clocked.odometry_faults(now, self.answer_age_limit_ns);
        }
        self.counters.batch = header.attempt.batch;
        self.counters.tick = header.tick + 1;
        let Self { slots, counters, .. } = self;
        let written = self.commands.write(slots.len(), |index| {
            let slot = &mut slots[index];
            // After a rearm the reference stands still until the controller has heard of it.
            let is_frozen =
                has(slot.raw.flags, RawCommand::FROZEN) && !slot.watch.state().is_latched();
            let (command, rejected) = slot.command(dt_s, faults, is_answer && !is_frozen);
            counters.rejected += u64::from(rejected);
            command
        })?;
        // Before the command, as in lockstep; and with every command, because a controller that joins needs the last one.
        self.tell_law_states(now)?;
        let has_reference = self.clocked.as_ref().is_none_or(Clocked::has_reference);
        tell_safety(&self.safety, self.batch, &self.slots, has_reference)?;
        // Stamped with the moment for which the gate made it.
        written.send(|_| TickHeader {
            supervisor_received_ns: received_ns,
            supervisor_sent_ns: now,
            ..header
        })?;
        Ok(())
    }

    /// Passes on the state that the laws must not lose, once it is known.
    fn tell_law_states(&self, now_ns: u64) -> Result<()> {
        let Some(Clocked { law_states: kept, .. }) = &self.clocked else { return Ok(()) };
        if !kept.is_empty() {
            let batch = BatchHeader { flags: 0, sent_ns: now_ns, ..self.batch };
            self.kept_law_states.send_quietly(batch, kept.len(), |index| kept[index])?;
        }
        Ok(())
    }

    /// Lets stopped vehicles that were rearmed drive again.
    pub(super) fn hear_rearms(&mut self) -> Result<bool> {
        let Some(rearm) = self.rearms.receive()? else { return Ok(false) };
        let Some(clocked) =
            self.clocked.as_ref().filter(|_| rearm.header().attempt.is_of(self.run))
        else {
            self.counters.dropped += 1;
            return Ok(true);
        };
        let faults = clocked.odometry_faults(now_ns(), self.answer_age_limit_ns);
        for rearm in rearm.items() {
            let Some(slot) = self.slots.get_mut(rearm.slot as usize) else {
                self.counters.dropped += 1;
                continue;
            };
            // The controller looks for the same place when it hears that the vehicle drives on.
            let leg = self.reference.leg_m(slot.measured, slot.raw.reference_along_m);
            let rearmed = slot.watch.rearm(faults | if leg.is_some() { 0 } else { Safety::NO_LEG });
            tracing::info!(slot = rearm.slot, rearmed, "rearm");
        }
        Ok(true)
    }

    /// When the next command of our own is due, if no answer comes; `None` in lockstep, before the first odometry, and
    /// when all drives have ended and all vehicles stand.
    pub(super) fn own_due_ns(&self) -> Option<u64> {
        let clocked = self.clocked.as_ref()?;
        clocked.seen?;
        if self.slots.iter().all(Slot::is_at_rest) {
            return None;
        }
        let too_old_ns = clocked.answered_ns + self.answer_age_limit_ns;
        Some(too_old_ns.max(clocked.sent_ns + (self.tick_s * 1e9) as u64))
    }

    /// Sends a command of our own, if it is time for it.
    pub(super) fn look_at_clock(&mut self) -> Result<bool> {
        let now = now_ns();
        let Some(seen) = self.clocked.as_ref().and_then(|clocked| clocked.seen) else {
            return Ok(false);
        };
        if self.own_due_ns().is_none_or(|due_ns| now < due_ns) {
            return Ok(false);
        }
        // There was no answer, so the controller's stamps stay empty.
        self.send(seen, now, false)?;
        Ok(true)
    }
}
