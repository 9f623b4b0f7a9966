//! The ladder over whole drives: vehicles with faults in the circuit, and what each action makes of them.
//!
//! The alarm here is one that knows: it comes half a second (`PATHTUNE_ALARM_S`) after the fault, so that the actions alone
//! are compared. `PATHTUNE_DRIVES` is the number of drives with each fault, `PATHTUNE_VEHICLE` a preset of the vehicle, and
//! `PATHTUNE_SETS` settings, each behind a space.

// A test reads what it is to drive.
#![allow(clippy::disallowed_methods)]

mod troubled;

use config::{Parameters, RunConfig};
use ipc_types::Safety;
use rollout::Rollout;
use troubled::Fault::{self, *};
use troubled::{OTHERS, STEERING, Troubled, circuit};

/// After the fault.
fn alarm_s() -> f64 {
    std::env::var("PATHTUNE_ALARM_S").map_or(0.5, |text| text.parse().unwrap())
}

const BEYOND_M: f64 = 1.0;

/// What an alarm that knows gives as its reason.
fn reason(fault: Fault) -> u32 {
    match fault {
        Healthy => 0,
        Understeer | SteeringGain | SteeringRate | StuckStraight | StuckAsItIs | SteeringOffset => {
            Safety::OUT_BY_YAW
        }
        WrongSign => Safety::STEERING_REVERSED,
        ThrottleAsItIs | ThrottleFull => Safety::OUT_BY_QUALITY,
        SpeedSensor => Safety::OUT_BY_ALONG,
        Drift | PoseOff => Safety::OUT_BY_LATERAL,
        Noise => Safety::OUT_BY_NOISE,
    }
}

/// Largest distances from the path, from the fault on, of some drives.
fn distances(
    (config, sets): &(RunConfig, Vec<Parameters>),
    fault: Fault,
    alarm: u32,
    drives: u32,
) -> Vec<f64> {
    let drive = |index: u32| {
        let from_m = 2.0 + 168.0 * (f64::from(index) + 0.5) / f64::from(drives);
        let car = Troubled::new(config, fault, from_m, (alarm, alarm_s()));
        let (mut driven_m, mut farthest_m) = (0.0, 0.0f64);
        Rollout::around(car, config).drive_scheduled(sets, Some(u64::from(index)), |_, tick| {
            driven_m += tick.observation.speed_mps * config.drive.tick_s;
            if driven_m >= from_m {
                farthest_m = farthest_m.max(tick.decision.path_distance_m);
            }
        });
        farthest_m
    };
    (0..drives).map(drive).collect()
}

fn beyond(distances: &[f64]) -> usize {
    distances.iter().filter(|it| **it > BEYOND_M).count()
}

fn drives(default: u32) -> u32 {
    std::env::var("PATHTUNE_DRIVES").map_or(default, |text| text.parse().unwrap())
}

#[test]
fn the_rule_keeps_faulty_vehicles_near_their_path() {
    let count = drives(2);
    for speed_mps in [1.45, 3.0, 4.0] {
        let circuit = circuit(speed_mps);
        let mut all = 0;
        let mut of_straight = 0;
        for (what, faults) in [("steering", &STEERING[..]), ("others", &OTHERS[..])] {
            let mut by_action = [0; 5];
            for fault in faults {
                let mut line = format!("{speed_mps} m/s, {fault:?}:");
                let actions = [
                    ("nothing", 0),
                    ("rest", Safety::OUT_BY_ALONG),
                    ("brake", Safety::OUT_BY_YAW),
                    ("straight", Safety::STEERING_REVERSED),
                    ("rule", reason(*fault)),
                ];
                for ((name, alarm), sum) in actions.into_iter().zip(&mut by_action) {
                    let mut all = distances(&circuit, *fault, alarm, count);
                    all.sort_by(f64::total_cmp);
                    *sum += beyond(&all);
                    let (middle, most) = (all[all.len() / 2], all[all.len() * 95 / 100]);
                    line += &format!(" {name} {} ({middle:.2}/{most:.2})", beyond(&all));
                }
                println!("{line}");
            }
            println!(
                "{speed_mps} m/s, {what}, {} drives each: beyond 1 m {by_action:?} with nothing, rest, brake, straight, \
                 the rule",
                count as usize * faults.len()
            );
            all += by_action[4];
            of_straight += by_action[3];
        }
        let most = count as usize * 13 * 30 / 520;
        assert!(all <= most, "{all} beyond 1 m at {speed_mps} m/s, and at most {most} may be");
        println!(
            "{speed_mps} m/s: {all} by the rule, {of_straight} by stops with the wheels straight"
        );
    }
}
