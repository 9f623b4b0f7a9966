//! The figures in the form in which they are output: one report for every kind of output.
//!
//! Percentiles, the rate, period and jitter are those of the interval, normally a second; counts are those since
//! the monitor began. A percentile of nothing is 0: `n` distinguishes it from a real 0.

use hdrhistogram::Histogram;

use serde::Serialize;

use crate::latency::{Figures, Hop, Latency, TickCounts};

/// What is output once a second.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Report {
    /// Time since the monitor began.
    pub t_s: f64,
    /// Ticks seen.
    pub ticks: u64,
    /// Ticks that were driven but not seen.
    pub missed: u64,
    /// Ticks per second over the interval, missed ones included, because they were driven, too.
    pub rate_hz: f64,
    /// The attempt at the batch.
    pub attempt: u32,
    /// Commands that were applied later than the budget allows, or too late for their tick.
    pub deadline_misses: u64,
    /// The hops over the interval.
    pub hops: Hops,
    /// Spans between the odometry of consecutive ticks, over the interval.
    pub period: Period,
    /// How far the period's 99th percentile lies above its median.
    pub jitter_ns: u64,
    /// How old the last applied command was: from its sending until it was applied. `None` before the first one,
    /// and while the watched vehicle stands still because its drive has ended.
    pub age_ns: Option<u64>,
    /// The batch.
    pub batch: u64,
    /// The newest tick of the batch.
    pub tick: u64,
    /// The run's number.
    pub run: String,
    /// How long the interval was.
    pub interval_s: f64,
    /// The longest end-to-end span that is no deadline miss.
    pub budget_ns: u64,
    /// Deadline misses because the vehicle had gone on before the command was sent.
    pub late: u64,
    /// Batches of which nothing was seen.
    pub missed_batches: u64,
    /// Spans left out because a stamp was missing, went backwards or made no sense.
    pub implausible: u64,
    /// Messages that belong to no regular tick.
    pub strays: u64,
    /// Restarts of all processes since the run began.
    pub restarts: u32,
    /// The watched vehicle.
    pub vehicle: Vehicle,
}

/// The hops of a tick.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[allow(missing_docs, reason = "named as the hops are")]
pub struct Hops {
    pub vehicle_to_controller: Spans,
    pub controller: Spans,
    pub controller_to_supervisor: Spans,
    pub supervisor: Spans,
    pub supervisor_to_vehicle: Spans,
    pub end_to_end: Spans,
}

impl Hops {
    fn new(figures: &Figures) -> Self {
        let of = |hop| Spans::new(figures.hop(hop));
        Self {
            vehicle_to_controller: of(Hop::VehicleToController),
            controller: of(Hop::Controller),
            controller_to_supervisor: of(Hop::ControllerToSupervisor),
            supervisor: of(Hop::Supervisor),
            supervisor_to_vehicle: of(Hop::SupervisorToVehicle),
            end_to_end: of(Hop::EndToEnd),
        }
    }

    /// Every hop with its spans, in the order of a tick.
    pub fn each(&self) -> [(Hop, &Spans); 6] {
        [
            (Hop::VehicleToController, &self.vehicle_to_controller),
            (Hop::Controller, &self.controller),
            (Hop::ControllerToSupervisor, &self.controller_to_supervisor),
            (Hop::Supervisor, &self.supervisor),
            (Hop::SupervisorToVehicle, &self.supervisor_to_vehicle),
            (Hop::EndToEnd, &self.end_to_end),
        ]
    }
}

/// How long a hop took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[allow(missing_docs, reason = "percentiles")]
pub struct Spans {
    pub p50_ns: u64,
    pub p90_ns: u64,
    pub p99_ns: u64,
    pub p999_ns: u64,
    pub max_ns: u64,
    /// How many were read.
    pub n: u64,
}

impl Spans {
    fn new(histogram: &Histogram<u64>) -> Self {
        Self {
            p50_ns: quantile(histogram, 0.5),
            p90_ns: quantile(histogram, 0.9),
            p99_ns: quantile(histogram, 0.99),
            p999_ns: quantile(histogram, 0.999),
            max_ns: histogram.max(),
            n: histogram.len(),
        }
    }

    /// The percentiles with their names.
    pub fn each(&self) -> [(&'static str, u64); 5] {
        [
            ("p50", self.p50_ns),
            ("p90", self.p90_ns),
            ("p99", self.p99_ns),
            ("p999", self.p999_ns),
            ("max", self.max_ns),
        ]
    }
}

/// The span between consecutive ticks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[allow(missing_docs, reason = "percentiles")]
pub struct Period {
    pub p50_ns: u64,
    pub p99_ns: u64,
    pub max_ns: u64,
}

fn quantile(histogram: &Histogram<u64>, quantile: f64) -> u64 {
    // The upper end of a bucket may lie above every value that was seen.
    histogram.value_at_quantile(quantile).min(histogram.max())
}

/// One vehicle of the fleet, as its newest command says.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Vehicle {
    /// Its slot.
    pub slot: usize,
    /// Vehicles in the fleet; 0 before the first command.
    pub fleet: usize,
    /// The speed that it is commanded.
    pub speed_mps: f64,
    /// The speed that the controller wanted.
    pub wanted_speed_mps: f64,
    /// The steering angle that it is commanded.
    pub steering_rad: f64,
    /// The zone that it is in.
    pub zone: u32,
    /// What the supervisor has changed, and whether the drive has ended.
    pub flags: Vec<&'static str>,
    /// The gate's state as reported last; in lockstep it is reported when it changes.
    pub gate: &'static str,
    /// What is wrong, or was when the vehicle was stopped.
    pub reasons: Vec<&'static str>,
    /// Commands of this drive that the gate changed.
    pub changed_commands: u64,
    /// Commands of the gate's own in this drive: degraded, stopping or stopped.
    pub own_commands: u64,
    /// How often, while the monitor looked on, the gate began to do something about an alarm: see the flags `braked` and
    /// `steered`.
    pub actions: u64,
    /// The vehicle stops on its own, because its newest command is too old.
    pub own_stop: bool,
}

/// Everything in a report that is not in the figures.
#[derive(Debug, Clone, Default)]
pub struct Circumstances {
    /// The run's number.
    pub run: u64,
    /// Time since the monitor began.
    pub t_s: f64,
    /// How long the interval was.
    pub interval_s: f64,
    /// The longest end-to-end span that is no deadline miss.
    pub budget_ns: u64,
    /// Restarts of all processes.
    pub restarts: u32,
    /// The watched vehicle.
    pub vehicle: Vehicle,
}

impl Report {
    /// A report over an interval, with the counts of everything so far.
    pub fn new(
        latency: &Latency,
        interval: &Figures,
        total: TickCounts,
        at: Circumstances,
    ) -> Self {
        let newest = latency.newest().unwrap_or_default();
        let driven = interval.counts.ticks + interval.counts.missed;
        let period = Period {
            p50_ns: quantile(&interval.period, 0.5),
            p99_ns: quantile(&interval.period, 0.99),
            max_ns: interval.period.max(),
        };
        let stands = at.vehicle.flags.contains(&"ended");
        Self {
            t_s: rounded(at.t_s),
            ticks: total.ticks,
            missed: total.missed,
            rate_hz: rounded(if at.interval_s > 0.0 { driven as f64 / at.interval_s } else { 0.0 }),
            attempt: newest.attempt.attempt,
            deadline_misses: total.deadline_misses,
            hops: Hops::new(interval),
            period,
            jitter_ns: period.p99_ns - period.p50_ns,
            age_ns: latency.age_ns().filter(|_| !stands),
            batch: newest.attempt.batch,
            tick: newest.tick,
            run: format!("{:016x}", at.run),
            interval_s: rounded(at.interval_s),
            budget_ns: at.budget_ns,
            late: total.late,
            missed_batches: total.missed_batches,
            implausible: total.implausible,
            strays: total.strays,
            restarts: at.restarts,
            vehicle: at.vehicle,
        }
    }

    /// The report as a row, each column with its name. Nested keys are joined by `_`, a hop's without `hops`.
    pub fn columns(&self) -> Vec<(String, String)> {
        let mut columns: Vec<(String, String)> = Vec::new();
        let mut add = |name: &str, value: String| columns.push((name.to_owned(), value));
        add("t_s", self.t_s.to_string());
        add("ticks", self.ticks.to_string());
        add("missed", self.missed.to_string());
        add("rate_hz", self.rate_hz.to_string());
        add("attempt", self.attempt.to_string());
        add("deadline_misses", self.deadline_misses.to_string());
        for (hop, spans) in self.hops.each() {
            for (name, ns) in spans.each() {
                add(&format!("{}_{name}_ns", hop.name()), ns.to_string());
            }
            add(&format!("{}_n", hop.name()), spans.n.to_string());
        }
        add("period_p50_ns", self.period.p50_ns.to_string());
        add("period_p99_ns", self.period.p99_ns.to_string());
        add("period_max_ns", self.period.max_ns.to_string());
        add("jitter_ns", self.jitter_ns.to_string());
        add("age_ns", self.age_ns.map(|ns| ns.to_string()).unwrap_or_default());
        add("batch", self.batch.to_string());
        add("tick", self.tick.to_string());
        add("run", self.run.clone());
        add("interval_s", self.interval_s.to_string());
        add("budget_ns", self.budget_ns.to_string());
        add("late", self.late.to_string());
        add("missed_batches", self.missed_batches.to_string());
        add("implausible", self.implausible.to_string());
        add("strays", self.strays.to_string());
        add("restarts", self.restarts.to_string());
        add("vehicle_slot", self.vehicle.slot.to_string());
        add("vehicle_fleet", self.vehicle.fleet.to_string());
        add("vehicle_speed_mps", self.vehicle.speed_mps.to_string());
        add("vehicle_wanted_speed_mps", self.vehicle.wanted_speed_mps.to_string());
        add("vehicle_steering_rad", self.vehicle.steering_rad.to_string());
        add("vehicle_zone", self.vehicle.zone.to_string());
        add("vehicle_flags", self.vehicle.flags.join("|"));
        add("vehicle_gate", self.vehicle.gate.to_owned());
        add("vehicle_reasons", self.vehicle.reasons.join("|"));
        add("vehicle_changed_commands", self.vehicle.changed_commands.to_string());
        add("vehicle_own_commands", self.vehicle.own_commands.to_string());
        add("vehicle_actions", self.vehicle.actions.to_string());
        add("vehicle_own_stop", self.vehicle.own_stop.to_string());
        columns
    }

    /// The report as one line for people.
    pub fn line(&self) -> String {
        let end_to_end = self.hops.end_to_end;
        let mut line = format!(
            "{:7.1} s  {:>8.0} ticks/s  end to end p50 {:>8}  p99 {:>8}  max {:>8}  jitter {:>8}  \
             missed {}  deadline misses {}  batch {} attempt {}",
            self.t_s,
            self.rate_hz,
            human(end_to_end.p50_ns),
            human(end_to_end.p99_ns),
            human(end_to_end.max_ns),
            human(self.jitter_ns),
            self.missed,
            self.deadline_misses,
            self.batch,
            self.attempt,
        );
        if self.restarts > 0 {
            line += &format!("  restarts {}", self.restarts);
        }
        line
    }

    /// The report as a table for people.
    pub fn table(&self) -> String {
        let mut table = format!(
            "{:<26}{:>10}{:>10}{:>10}{:>10}{:>10}{:>12}\n",
            "hop", "p50", "p90", "p99", "p99.9", "max", "n"
        );
        for (hop, spans) in self.hops.each() {
            table += &format!("{:<26}", hop.name().replace('_', " "));
            for (_, ns) in spans.each() {
                table += &format!("{:>10}", human(ns));
            }
            table += &format!("{:>12}\n", spans.n);
        }
        table += &format!(
            "{:.0} ticks/s, period {} (jitter {}), {} ticks seen, {} missed, {} deadline misses over {}",
            self.rate_hz,
            human(self.period.p50_ns),
            human(self.jitter_ns),
            self.ticks,
            self.missed,
            self.deadline_misses,
            human(self.budget_ns),
        );
        table
    }
}

/// Rounds to a thousandth: a clock that is read between other work is not more exact.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

/// A span with the unit that keeps it short.
pub fn human(ns: u64) -> String {
    match ns {
        0..1_000 => format!("{ns} ns"),
        1_000..1_000_000 => format!("{:.1} µs", ns as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.2} ms", ns as f64 / 1e6),
        _ => format!("{:.2} s", ns as f64 / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::Command;

    #[test]
    fn a_row_holds_what_the_json_line_holds() {
        let mut report = Report { age_ns: Some(5), ..Report::default() };
        report.vehicle.flags = Command::flag_names(Command::ENDED | Command::REJECTED);
        let json = serde_json::to_value(&report).unwrap();
        let mut leaves = Vec::new();
        flatten("", &json, &mut leaves);
        let mut columns: Vec<String> = report.columns().into_iter().map(|(name, _)| name).collect();
        leaves.sort();
        columns.sort();
        assert_eq!(columns, leaves);
        let flags = ("vehicle_flags".to_owned(), "ended|rejected".to_owned());
        assert!(report.columns().contains(&flags));
    }

    fn flatten(prefix: &str, value: &serde_json::Value, leaves: &mut Vec<String>) {
        match value.as_object() {
            Some(object) => object.iter().for_each(|(key, value)| {
                let prefix = if prefix == "hops_" { "" } else { prefix };
                flatten(&format!("{prefix}{key}_"), value, leaves);
            }),
            None => leaves.push(prefix.trim_end_matches('_').to_owned()),
        }
    }

    #[test]
    fn spans_are_short_for_people() {
        let check = |ns, text: &str| assert_eq!(human(ns), text);
        check(0, "0 ns");
        check(999, "999 ns");
        check(1_000, "1.0 µs");
        check(2_340_000, "2.34 ms");
        check(60_000_000_000, "60.00 s");
    }
}
