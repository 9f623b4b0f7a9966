//! The ladder at work with the envelope's own alarm: vehicles with faults in the circuit, and how far from the path they
//! come from the fault on.
//!
//! `PATHTUNE_DRIVES` is the number of drives with each fault, `PATHTUNE_ENVELOPE_DRIVES` that of the drives that are
//! calibrated on: few of both by default. `PATHTUNE_SPEEDS`, `PATHTUNE_VEHICLE` and `PATHTUNE_SETS` change the car and
//! how it drives, each value behind a space; `PATHTUNE_GAINS=3,21,21,0.7` is one set for the whole circuit, and with
//! `PATHTUNE_SPREAD=nothing` the faulty vehicles are all of the file, while calibrated ones differ as ever. `PATHTUNE_SEED`
//! gives other drives, both calibrated and faulty ones, and with `PATHTUNE_ALL=1` all speeds are driven, however many come
//! too far from the path.

// A test reads what it is to drive.
#![allow(clippy::disallowed_methods)]

mod troubled;

use std::collections::BTreeMap;

use config::{Parameters, RunConfig};
use ipc_types::Safety;
use rollout::Rollout;
use trainer::calibration::Spread::{self, Varied};
use trainer::calibration::{calibrate, varied};
use troubled::{Fault, OTHERS, STEERING, Troubled, circuit};

const BEYOND_M: f64 = 1.0;
/// Seeds of calibrations and of the drives that are judged differ by this.
const FRESH: u64 = 1 << 40;

fn number(name: &str, default: u32) -> u32 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// In what the faulty vehicles differ from the file, beside their fault.
fn spread() -> Spread {
    match std::env::var("PATHTUNE_SPREAD").as_deref() {
        Ok("nothing") => Spread::Nothing,
        _ => Spread::Varied,
    }
}

/// The sets to drive with: those of each manoeuvre that is due.
fn sets_of(config: &RunConfig) -> Vec<Parameters> {
    if let Ok(text) = std::env::var("PATHTUNE_GAINS") {
        return config.law.parse_sets(&text).unwrap();
    }
    config.paper_rows().into_iter().find(|row| row.chosen).unwrap().sets
}

/// What became of a drive.
struct Driven {
    /// The largest distance from the path, from the fault on.
    farthest_m: f64,
    /// When the gate began to stop it, in seconds from the fault, and what for.
    stopped: Option<(f64, u32)>,
}

/// Drives with a fault that begins at places all over the first 170 m, of vehicles that differ a little.
fn drive(config: &RunConfig, sets: &[Parameters], fault: Fault, drives: u32) -> Vec<Driven> {
    let one = |index: u32| {
        let from_m = 2.0 + 168.0 * (f64::from(index) + 0.5) / f64::from(drives);
        let (plant, seed) =
            varied(config, FRESH + u64::from(number("PATHTUNE_SEED", 0)), index, spread());
        let car = Troubled::new(&plant, fault, from_m, (0, 0.0));
        let (mut driven_m, mut since_s) = (0.0, 0.0);
        let mut driven = Driven { farthest_m: 0.0, stopped: None };
        Rollout::around(car, config).drive_scheduled(sets, Some(seed), |_, tick| {
            driven_m += tick.observation.speed_mps * config.drive.tick_s;
            if driven_m >= from_m {
                driven.farthest_m = driven.farthest_m.max(tick.decision.path_distance_m);
                since_s += config.drive.tick_s;
            }
            if tick.gate.is_stopped && driven.stopped.is_none() {
                driven.stopped = Some((since_s, tick.gate.reasons));
            }
        });
        driven
    };
    (0..drives).map(one).collect()
}

fn beyond(drives: &[Driven]) -> usize {
    drives.iter().filter(|it| it.farthest_m > BEYOND_M).count()
}

/// The middle and the 95th of a hundred.
fn middle_and_most(mut numbers: Vec<f64>) -> (f64, f64) {
    numbers.sort_by(f64::total_cmp);
    let at = |percent: usize| numbers.get((numbers.len() * percent).div_ceil(100).max(1) - 1);
    (at(50).copied().unwrap_or(f64::NAN), at(95).copied().unwrap_or(f64::NAN))
}

#[test]
fn the_envelopes_alarm_keeps_faulty_vehicles_near_their_path() {
    let (count, calibrated) =
        (number("PATHTUNE_DRIVES", 2), number("PATHTUNE_ENVELOPE_DRIVES", 40));
    let speeds = std::env::var("PATHTUNE_SPEEDS").unwrap_or_else(|_| "1.45 3 4".to_owned());
    for speed_mps in speeds.split_whitespace().map(|it| it.parse().unwrap()) {
        let (mut config, _) = circuit(speed_mps);
        config.run.seed += u64::from(number("PATHTUNE_SEED", 0));
        let sets = sets_of(&config);
        let envelope = calibrate(&config, &sets, calibrated, Varied, |_| {}).unwrap();
        let sets = if sets.len() == 1 { sets } else { config.sets_by_zone(&sets) };
        println!(
            "{speed_mps} m/s: threshold {:.3} of {} drives, {} left out, alpha {:.4}",
            envelope.threshold,
            envelope.promise.threshold_on,
            envelope.promise.left_out,
            envelope.promise.alpha
        );
        let unwatched = config.clone();
        println!(
            "{speed_mps} m/s, without a fault: beyond 1 m {} of {count}",
            beyond(&drive(&unwatched, &sets, Fault::Healthy, count))
        );
        config.envelope = Some(Box::new(envelope));
        let (mut all, mut of_nothing, mut early) = (0, 0, 0);
        for (what, faults) in [("steering", &STEERING[..]), ("others", &OTHERS[..])] {
            let (mut by_rule, mut by_nothing) = (0, 0);
            for fault in faults {
                let nothing = drive(&unwatched, &sets, *fault, count);
                let rule = drive(&config, &sets, *fault, count);
                let mut why: BTreeMap<String, u32> = BTreeMap::new();
                for (_, reasons) in rule.iter().filter_map(|it| it.stopped) {
                    *why.entry(Safety::reason_names(reasons).join(" ")).or_default() += 1;
                }
                let seen_s: Vec<f64> = rule.iter().filter_map(|it| Some(it.stopped?.0)).collect();
                early += seen_s.iter().filter(|it| **it == 0.0).count();
                let (seen, (half_s, most_s)) = (seen_s.len(), middle_and_most(seen_s));
                let (half_m, most_m) =
                    middle_and_most(rule.iter().map(|it| it.farthest_m).collect());
                println!(
                    "{speed_mps} m/s, {fault:?}: beyond 1 m {} with nothing, {} with the envelope ({half_m:.2}/{most_m:.2} m); \
                     seen {seen} of {count} after {half_s:.1}/{most_s:.1} s by {why:?}",
                    beyond(&nothing),
                    beyond(&rule)
                );
                by_rule += beyond(&rule);
                by_nothing += beyond(&nothing);
            }
            println!(
                "{speed_mps} m/s, {what}, {} drives: beyond 1 m {by_nothing} with nothing, {by_rule} with the envelope",
                count as usize * faults.len()
            );
            all += by_rule;
            of_nothing += by_nothing;
        }
        println!(
            "{speed_mps} m/s: {all} beyond 1 m, {of_nothing} with nothing; {early} stopped before the fault"
        );
        let most = count as usize * 13 * 30 / 520;
        if std::env::var("PATHTUNE_ALL").is_err() {
            assert!(all <= most, "{all} beyond 1 m at {speed_mps} m/s, and at most {most} may be");
        }
        assert!(of_nothing > all, "the faults do no harm");
    }
}
