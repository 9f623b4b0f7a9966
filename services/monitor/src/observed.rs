//! A run as an observer sees it: its topics drained into the figures, and what its orchestrator reports about its
//! processes.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::time::Duration;

use ipc_types::topics::OBSERVER_BUFFER;
use ipc_types::{Attempt, Command, Odometry, RawCommand, Safety, has};
use runtime::clock::now_ns;
use runtime::observer::{Observer, ObserverError};
use runtime::run::{LOCK_FILE, RunNames};
use runtime::{BusError, Inlet};
use serde::Deserialize;

use crate::MonitorError;
use crate::latency::{Figures, Latency};
use crate::report::{Circumstances, Report, Vehicle};

/// How long a run that is only just being created may refuse an observer.
const BEING_MADE: Duration = Duration::from_secs(2);

/// A run that is observed.
pub(crate) struct ObservedRun {
    // The ports must be dropped before the observer's place on the bus: fields are dropped in this order.
    odometry: Inlet<Odometry>,
    raw_commands: Inlet<RawCommand>,
    commands: Inlet<Command>,
    safety: Inlet<Safety>,
    _observer: Observer,
    names: RunNames,
    latency: Latency,
    total: Figures,
    vehicle: Vehicle,
    /// Whether the fleet was seen to have the wanted slot.
    is_in_range: bool,
    /// What the gate did about an alarm, as bits of the last command's flags.
    acts: u32,
    budget_ns: u64,
    restarts: BTreeMap<String, u32>,
    began_ns: u64,
    interval_ns: u64,
}

#[derive(Debug, Deserialize)]
struct RunState {
    #[serde(default)]
    rings: usize,
    processes: Vec<ProcessState>,
}

#[derive(Debug, Deserialize)]
struct ProcessState {
    name: String,
    restarts: u32,
}

impl ObservedRun {
    /// Joins a run as one more observer.
    pub(crate) fn attach(
        names: &RunNames,
        slot: usize,
        budget_ns: u64,
    ) -> Result<Self, MonitorError> {
        let until_ns = now_ns() + BEING_MADE.as_nanos() as u64;
        loop {
            let error = match Self::try_attach(names, slot, budget_ns) {
                Ok(run) => return Ok(run),
                Err(error) => error,
            };
            match error {
                ObserverError::Full => return Err(MonitorError::User(error.to_string())),
                _ if !is_alive(names) => {
                    return Err(MonitorError::User(format!(
                        "run {:016x} has just ended",
                        names.run
                    )));
                }
                ObserverError::Bus(_) if now_ns() < until_ns => {
                    std::thread::sleep(Duration::from_millis(20));
                }
                error => return Err(MonitorError::Other(error.into())),
            }
        }
    }

    fn try_attach(names: &RunNames, slot: usize, budget_ns: u64) -> Result<Self, ObserverError> {
        let observer = Observer::attach(names)?;
        let ports = || -> Result<_, BusError> {
            let bus = observer.bus();
            Ok((bus.observe()?, bus.observe()?, bus.observe()?, bus.observe()?))
        };
        let (odometry, raw_commands, commands, safety) = ports()?;
        let now_ns = now_ns();
        let mut run = Self {
            odometry,
            raw_commands,
            commands,
            safety,
            _observer: observer,
            names: names.clone(),
            latency: Latency::new(names.run, budget_ns),
            total: Figures::new(),
            vehicle: Vehicle {
                slot,
                gate: Safety::state_name(Safety::NORMAL),
                ..Vehicle::default()
            },
            is_in_range: false,
            acts: 0,
            budget_ns,
            restarts: BTreeMap::new(),
            began_ns: now_ns,
            interval_ns: now_ns,
        };
        run.restarts = run.read_restarts().unwrap_or_default();
        Ok(run)
    }

    /// Takes what has come.
    pub(crate) fn drain(&mut self) -> Result<(), MonitorError> {
        // What exceeds a buffer came while it was drained: that can wait for the next time.
        for _ in 0..OBSERVER_BUFFER {
            let Some(message) = self.odometry.receive()? else { break };
            self.latency.odometry(message.header());
            if let Some(odometry) = message.items().get(self.vehicle.slot) {
                self.vehicle.own_stop = has(odometry.status, Odometry::OWN_STOP);
            }
        }
        if let Some(message) = self.safety.receive_newest()?
            && let Some(safety) = message.items().get(self.vehicle.slot)
        {
            self.vehicle.gate = Safety::state_name(safety.state);
            self.vehicle.reasons = Safety::reason_names(safety.reasons);
            self.vehicle.changed_commands = safety.changed;
            self.vehicle.own_commands = safety.own;
        }
        let mut newest = None;
        for _ in 0..OBSERVER_BUFFER {
            let Some(message) = self.raw_commands.receive()? else { break };
            self.latency.raw_command(message.header());
            newest = Some(message);
        }
        let slot = self.vehicle.slot;
        if let Some(raw) = newest.as_ref().and_then(|message| message.items().get(slot)) {
            self.vehicle.wanted_speed_mps = raw.speed_mps;
        }
        drop(newest);
        let mut newest = None;
        for _ in 0..OBSERVER_BUFFER {
            let Some(message) = self.commands.receive()? else { break };
            self.latency.command(message.header());
            if let Some(command) = message.items().get(slot) {
                let acts = command.flags & (Command::BRAKED | Command::STEERED);
                self.vehicle.actions += u64::from(acts != 0 && acts != self.acts);
                self.acts = acts;
            }
            newest = Some(message);
        }
        let Some(newest) = newest else { return Ok(()) };
        let vehicle = &mut self.vehicle;
        vehicle.fleet = newest.items().len();
        if let Some(command) = newest.items().get(slot) {
            self.is_in_range = true;
            vehicle.speed_mps = command.speed_mps;
            vehicle.steering_rad = command.steering_rad;
            vehicle.zone = command.zone;
            vehicle.flags = Command::flag_names(command.flags);
        } else if !self.is_in_range {
            // Later batches may be smaller; the first one that is seen shows whether the slot exists.
            let last = vehicle.fleet.saturating_sub(1);
            return Err(MonitorError::User(format!(
                "there is no vehicle {slot}: the fleet has {}, and the last one is --vehicle {last}",
                vehicle.fleet
            )));
        } else {
            vehicle.flags = vec!["not_in_batch"];
        }
        Ok(())
    }

    /// The attempt that is driven; `None` before the first odometry.
    pub(crate) fn drive(&self) -> Option<Attempt> {
        self.latency.newest().map(|header| header.attempt)
    }

    /// Time since the monitor began, or was reset.
    pub(crate) fn age_s(&self) -> f64 {
        (now_ns() - self.began_ns) as f64 * 1e-9
    }

    /// Whether ticks were seen since the last report.
    pub(crate) fn has_seen_ticks(&self) -> bool {
        self.latency.has_seen_ticks()
    }

    /// Lets the interval of the next report begin now.
    pub(crate) fn begin_interval(&mut self) {
        self.interval_ns = now_ns();
    }

    /// The report of the time since the last one.
    pub(crate) fn report(&mut self) -> Report {
        let now_ns = now_ns();
        let since_ns = std::mem::replace(&mut self.interval_ns, now_ns);
        let at = self.circumstances(now_ns, since_ns);
        let interval = self.latency.take(&mut self.total);
        Report::new(&self.latency, &interval, self.total.counts, at)
    }

    /// The report of everything since the monitor began, or was reset.
    pub(crate) fn total(&self) -> Report {
        let at = self.circumstances(now_ns(), self.began_ns);
        Report::new(&self.latency, &self.total, self.total.counts, at)
    }

    /// Forgets all figures.
    pub(crate) fn reset(&mut self) {
        let _ = self.report();
        self.total.reset();
        self.began_ns = self.interval_ns;
    }

    fn circumstances(&self, now_ns: u64, since_ns: u64) -> Circumstances {
        Circumstances {
            run: self.names.run,
            t_s: (now_ns - self.began_ns) as f64 * 1e-9,
            interval_s: (now_ns - since_ns) as f64 * 1e-9,
            budget_ns: self.budget_ns,
            restarts: self.restarts.values().sum(),
            vehicle: self.vehicle.clone(),
        }
    }

    fn read_state(&self) -> Option<RunState> {
        let state = fs::read(self.names.root.join("run.json")).ok()?;
        serde_json::from_slice(&state).ok()
    }

    /// How many rings share the run's drives; what is observed is the first.
    pub(crate) fn rings(&self) -> usize {
        self.read_state().map_or(1, |state| state.rings.max(1))
    }

    fn read_restarts(&self) -> Option<BTreeMap<String, u32>> {
        let state = self.read_state()?;
        Some(state.processes.into_iter().map(|process| (process.name, process.restarts)).collect())
    }

    /// Restarts that the orchestrator has reported since the last call.
    pub(crate) fn new_restarts(&mut self) -> Vec<String> {
        let Some(restarts) = self.read_restarts() else { return Vec::new() };
        let is_new = |(name, count): &(&String, &u32)| {
            **count > self.restarts.get(*name).copied().unwrap_or_default()
        };
        let events = restarts
            .iter()
            .filter(is_new)
            .map(|(name, count)| format!("{name} was restarted ({count})"))
            .collect();
        self.restarts = restarts;
        events
    }

    /// Whether the run's orchestrator still lives.
    pub(crate) fn is_alive(&self) -> bool {
        is_alive(&self.names)
    }
}

/// Whether a run that was alive still is. Unlike a run that is only just being created, it has its lock.
fn is_alive(names: &RunNames) -> bool {
    File::open(names.root.join(LOCK_FILE)).is_ok_and(|lock| lock.try_lock().is_err())
}
