//! The loop that every service runs.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};
use config::RunConfig;
use ipc_types::{Attempt, BatchHeader, Status, WakeRole};

use crate::chaos::{Saboteur, Spread};
use crate::clock::{coarse_ns, now_ns};
use crate::periods::Measured;
use crate::waiting::{Wait, Waiting, lock_memory};
use crate::{Attachment, Bus};

/// What every service does first: reads its environment, ties itself to the orchestrator, starts its log,
/// and reads the run's configuration.
///
/// # Errors
/// If the process was not started by an orchestrator, or the orchestrator is gone.
pub fn join() -> Result<(Attachment, Bus, RunConfig)> {
    let attachment = Attachment::from_env()?;
    attachment.tie_to_parent()?;
    crate::logging::init(&attachment.folder.join("logs"));
    let path = attachment.folder.join("config.toml");
    let text =
        std::fs::read_to_string(&path).with_context(|| format!("failed to read {path:?}"))?;
    let config = RunConfig::from_resolved(&text)?;
    let bus = Bus::attach(&attachment.names, attachment.max_len)?
        .in_ring(attachment.ring)
        .waiting(attachment.wait);
    Ok((attachment, bus, config))
}

/// The work of a process: takes what has arrived, and answers.
pub trait Service {
    /// Takes at most one step. Returns whether there was anything to do.
    ///
    /// # Errors
    /// Errors after which the process cannot go on.
    fn poll(&mut self) -> Result<bool>;

    /// What the process reports with each sign of life.
    fn status(&self) -> Counters;

    /// Whether the work is done and the process may end.
    fn is_finished(&self) -> bool {
        false
    }

    /// When to poll it again even if nobody wakes it, by [`now_ns`]; `u64::MAX` for never.
    fn due_ns(&self) -> u64 {
        u64::MAX
    }
}

/// What a process reports with each sign of life.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// The batch that is or was last under way; 0 before the first.
    pub batch: u64,
    /// Its next tick.
    pub tick: u64,
    /// Samples that did not match attempt and tick, and were dropped.
    pub dropped: u64,
    /// Samples that were not finite or out of range, and were rejected.
    pub rejected: u64,
    /// Samples that came too late in real time.
    pub late: u64,
    /// How many vehicles the process can drive in one tick; only for the vehicle.
    pub capacity: u32,
    /// How the vehicle paces; only for the vehicle.
    pub pacing: u32,
}

/// Time between signs of life: a fifth of the orchestrator's patience.
const BEAT_NS: u64 = 100_000_000;
/// Number of polls between looks at the clock and for new readers.
const LOOK_EVERY: u32 = 256;
/// After this many late messages in a row, the order of the ring is taken for wrong.
const LATE_IN_A_ROW: u32 = 32;

/// Runs a service until it has finished or the process is asked to stop.
///
/// # Errors
/// The service's own, or the transport's.
pub fn serve(
    attachment: &Attachment,
    bus: &Bus,
    role: WakeRole,
    service: &mut dyn Service,
) -> Result<()> {
    let stop = stop_flag()?;
    let alarm = bus.alarm(role)?;
    let mut beat = Heartbeat::new(attachment, bus, role)?;
    beat.send(now_ns(), service)?;
    tracing::info!(?role, "ready");

    if attachment.fifo.is_some()
        && let Err(why) = lock_memory()
    {
        tracing::warn!(%why, "memory is not locked");
    }
    // Only if the whole ring shares a core is there an order in which its processes run.
    let mut order = (role == WakeRole::Supervisor && attachment.wait == Wait::Yield)
        .then(|| RingOrder::new(attachment.names.run ^ attachment.incarnation));
    let mut waiting = Waiting::new(attachment.wait);
    let mut saboteur = Saboteur::from_env(role, &attachment.names.root);
    let mut measured = if role == WakeRole::Vehicle { Measured::from_env() } else { None };
    let mut polls = 0u32;
    loop {
        polls = polls.wrapping_add(1);
        let mut look = polls.is_multiple_of(LOOK_EVERY);
        if service.poll()? {
            if let Some(order) = &mut order {
                order.note(waiting.has_waited());
            }
            if let Some(measured) = &mut measured {
                let Counters { batch, tick, .. } = service.status();
                measured.note((batch, tick), now_ns());
            }
            // A step may take long, as that of a slow vehicle does: then check after every step.
            look |= beat.is_due(coarse_ns());
            if let Some(saboteur) = &mut saboteur {
                saboteur.strike(service.status());
            }
            waiting.progress();
        } else if waiting.may_sleep() {
            Waiting::sleep(bus, &alarm, service.due_ns());
            look = true;
        }
        if look {
            bus.look_for_readers();
            if stop.load(Ordering::Relaxed) || service.is_finished() {
                break;
            }
            beat.send_if_due(now_ns(), service)?;
        }
    }
    tracing::info!(?role, "stopped");
    Ok(())
}

/// A flag that SIGINT and SIGTERM raise.
fn stop_flag() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone())?;
    }
    Ok(stop)
}

/// Signs of life.
struct Heartbeat {
    outlet: crate::Outlet<Status>,
    run: u64,
    incarnation: u64,
    role: u32,
    last_ns: u64,
}

impl Heartbeat {
    fn new(attachment: &Attachment, bus: &Bus, role: WakeRole) -> Result<Self> {
        let role = match role {
            WakeRole::Vehicle => Status::VEHICLE,
            WakeRole::Supervisor => Status::SUPERVISOR,
            WakeRole::Controller => Status::CONTROLLER,
            WakeRole::Recorder => Status::RECORDER,
            WakeRole::Trainer | WakeRole::Orchestrator => Status::TRAINER,
        };
        Ok(Self {
            outlet: bus.outlet()?,
            run: attachment.names.run,
            incarnation: attachment.incarnation,
            role,
            last_ns: 0,
        })
    }

    fn send(&mut self, now_ns: u64, service: &dyn Service) -> Result<()> {
        let first = self.last_ns == 0;
        self.last_ns = now_ns;
        let Counters { batch, tick, dropped, rejected, late, capacity, pacing } = service.status();
        let status = Status {
            incarnation: self.incarnation,
            batch,
            tick,
            dropped,
            rejected,
            late,
            role: self.role,
            state: Status::READY,
            capacity,
            pacing,
        };
        let attempt = Attempt::between_batches(self.run);
        let header = BatchHeader { attempt, sent_ns: now_ns, ..BatchHeader::default() };
        // Only the first sign of life is waited for.
        if first {
            self.outlet.send(header, 1, |_| status)?;
        } else {
            self.outlet.send_quietly(header, 1, |_| status)?;
        }
        Ok(())
    }

    fn is_due(&self, now_ns: u64) -> bool {
        // The coarse clock may read earlier than the time of the last beat.
        now_ns.saturating_sub(self.last_ns) >= BEAT_NS
    }

    fn send_if_due(&mut self, now_ns: u64, service: &dyn Service) -> Result<()> {
        if self.is_due(now_ns) {
            self.send(now_ns, service)?;
        }
        Ok(())
    }
}

/// Heals the order in which the scheduler runs the ring.
///
/// The scheduler keeps the order in which processes became ready. Vehicle, controller, supervisor is the order of the
/// messages: in it, each process finds its message at its first look. In the other order, each tick takes two rounds.
/// The supervisor notices that, because its message is never there at its first look. It then sleeps for a short
/// random time, which shuffles the order.
pub(crate) struct RingOrder {
    late_in_a_row: u32,
    spread: Spread,
}

impl RingOrder {
    pub(crate) fn new(seed: u64) -> Self {
        Self { late_in_a_row: 0, spread: Spread::new(seed) }
    }

    pub(crate) fn note(&mut self, late: bool) {
        self.late_in_a_row = if late { self.late_in_a_row + 1 } else { 0 };
        if self.late_in_a_row == LATE_IN_A_ROW {
            self.late_in_a_row = 0;
            let nap_us = 1 + (100.0 * self.spread.uniform()) as u64;
            std::thread::sleep(Duration::from_micros(nap_us));
        }
    }
}
