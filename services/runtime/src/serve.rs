//! The loop that every service runs, and how it waits.
//!
//! All processes of a ring share one core: each yields to the next, which then finds what it waits for.
//! Nobody spins, and nobody sleeps while ticks flow.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::yield_now;
use std::time::Duration;

use anyhow::{Context, Result};
use config::RunConfig;
use ipc_types::{BatchHeader, Status, WakeRole};

use crate::bus::SLEEPS_AFTER_NS;
use crate::chaos::{Saboteur, Spread};
use crate::clock::now_ns;
use crate::{Attachment, Bus};

/// What every service does first: reads its environment, ties itself to the orchestrator, starts its log,
/// and reads the run's configuration.
///
/// # Errors
/// If the process was not started by an orchestrator, or that one is gone.
pub fn join() -> Result<(Attachment, Bus, RunConfig)> {
    let attachment = Attachment::from_env()?;
    attachment.tie_to_parent()?;
    crate::logging::init();
    let path = attachment.folder.join("config.toml");
    let text =
        std::fs::read_to_string(&path).with_context(|| format!("failed to read {path:?}"))?;
    let config = RunConfig::from_resolved(&text)?;
    let bus = Bus::attach(&attachment.names, attachment.max_len)?;
    Ok((attachment, bus, config))
}

/// A process's work: takes what has arrived, and answers.
pub trait Service {
    /// Takes at most one step. Returns whether there was anything to do.
    ///
    /// # Errors
    /// What the process cannot go on without.
    fn poll(&mut self) -> Result<bool>;

    /// What the process tells of itself with each sign of life.
    fn status(&self) -> Counters;

    /// How long the process may sleep at most, if nobody wakes it: until its next deadline.
    fn nap(&self) -> Duration {
        NAP
    }

    /// Whether the work is done and the process may end.
    fn is_finished(&self) -> bool {
        false
    }
}

/// What a process tells of itself with each sign of life.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// The batch that is or was last under way; 0 before the first.
    pub batch: u64,
    /// Its next tick.
    pub tick: u64,
    /// Samples that did not match run, batch, attempt and tick, and were dropped.
    pub dropped: u64,
    /// Samples that were not finite or out of range, and were rejected.
    pub rejected: u64,
    /// Samples that came too late in real time.
    pub late: u64,
    /// Vehicles that the process can drive in one tick; only of the vehicle.
    pub capacity: u32,
    /// How the vehicle paces; only of the vehicle.
    pub pacing: u32,
}

/// Yields before a process may sleep: on a busy core each one can take a time slice, on an idle one they
/// are over within `SLEEPS_AFTER_NS`.
const YIELDS: u32 = 64;
/// Longest sleep: bounds what a lost wake-up could cost.
pub const NAP: Duration = Duration::from_millis(20);
/// Between signs of life; a fifth of the orchestrator's patience.
const BEAT_NS: u64 = 100_000_000;
/// Polls between looks at the clock and for new readers.
const LOOK_EVERY: u32 = 256;
/// Messages in a row that came late before the order of the ring is taken for wrong.
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

    let mut order = RingOrder::new(attachment.names.run ^ attachment.incarnation);
    let mut waiting = Waiting::default();
    let mut saboteur = Saboteur::from_env(role, &attachment.names.root);
    let mut polls = 0u32;
    loop {
        polls = polls.wrapping_add(1);
        let mut look = polls.is_multiple_of(LOOK_EVERY);
        if service.poll()? {
            if role == WakeRole::Supervisor {
                order.note(waiting.has_waited());
            }
            waiting.progress();
            // A step may take long, as a slow vehicle's does: then every one of them is looked behind.
            look |= beat.is_due(now_ns());
            if let Some(saboteur) = &mut saboteur {
                saboteur.strike(service.status());
            }
            yield_now();
        } else if waiting.may_sleep() {
            bus.look_for_readers();
            alarm.wait(service.nap());
            look = true;
        } else {
            yield_now();
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

/// When a reader may sleep: after `YIELDS` looks in vain, and `SLEEPS_AFTER_NS` behind the first one.
///
/// Who sleeps earlier misses messages, because writers count on it: see [`crate::Outlet::send`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Waiting {
    looks_in_vain: u32,
    since_ns: u64,
}

impl Waiting {
    /// There was a message.
    pub fn progress(&mut self) {
        self.looks_in_vain = 0;
    }

    /// Whether the last look was in vain.
    pub fn has_waited(&self) -> bool {
        self.looks_in_vain > 0
    }

    /// Notes a look in vain; whether the reader may sleep after it, else it yields and looks again.
    pub fn may_sleep(&mut self) -> bool {
        self.looks_in_vain += 1;
        if self.looks_in_vain == 1 {
            self.since_ns = now_ns();
        }
        // A sleeper's looks go on counting: once it may sleep, it may until the next message.
        self.looks_in_vain >= YIELDS && now_ns() - self.since_ns >= SLEEPS_AFTER_NS
    }
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
        let header = BatchHeader { run: self.run, sent_ns: now_ns, ..BatchHeader::default() };
        // Only the first one is waited for.
        if first {
            self.outlet.send(header, 1, |_| status)?;
        } else {
            self.outlet.send_quietly(header, 1, |_| status)?;
        }
        Ok(())
    }

    fn is_due(&self, now_ns: u64) -> bool {
        now_ns - self.last_ns >= BEAT_NS
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
/// It keeps the order in which processes became ready. Vehicle, controller, supervisor is the order of the
/// messages: each finds its message at its first look. In the other order each tick takes two rounds. The
/// supervisor sees that, because its message is never there at its first look, and then steps aside for a
/// random moment, which shuffles the order.
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
