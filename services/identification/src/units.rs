//! Whether a drive tells something in another unit than it should.

use crate::drive::{Command, Stretch};
use crate::levenberg::median;
use crate::refusal::Refusal;

/// How near a ratio has to be to that of two units.
const NEAR: f64 = 0.06;

/// What to know where the commanded speeds are those of the car in another unit.
pub(crate) fn wrong_unit(stretches: &[Stretch]) -> Option<String> {
    let mut ratios: Vec<f64> = stretches.iter().flat_map(commanded_to_driven).collect();
    if ratios.is_empty() {
        return None;
    }
    let ratio = median(&mut ratios);
    let units = [(3.6, "km/h"), (2.237, "mph")];
    let (_, unit) = units.into_iter().find(|(of, _)| (ratio / of - 1.0).abs() < NEAR)?;
    Some(format!(
        "the commanded speeds are {ratio:.2} times those that the car drives: are they in {unit}? They are taken as m/s, and what \
         is said of the speed loop holds for that alone"
    ))
}

/// What contradicts itself in the odometry by the ratio of two units: speeds and poses, headings and poses, or yaw rates and
/// headings.
pub(crate) fn wrong_unit_of_odometry(stretches: &[Stretch]) -> Option<Refusal> {
    /// Way, and turn, from which a ratio is told.
    const WAY_M: f64 = 10.0;
    const TURN_RAD: f64 = 2.0;
    let ways = stretches.iter().map(Ways::of);
    let sum = ways.reduce(|a, b| Ways {
        told_m: a.told_m + b.told_m,
        way_m: a.way_m + b.way_m,
        direction_rad: a.direction_rad + b.direction_rad,
        yaw_rad: a.yaw_rad + b.yaw_rad,
        rate_rad: a.rate_rad + b.rate_rad,
    })?;
    let near = |ratio: f64, of: f64| (ratio / of - 1.0).abs() < NEAR;
    let (speeds, yaw) = (sum.told_m / sum.way_m, sum.yaw_rad / sum.direction_rad);
    let rates = sum.rate_rad / sum.yaw_rad;
    const DEGREES: f64 = 180.0 / std::f64::consts::PI;
    let (metres, radians) = ("metres", "radians");
    let speeds_are = |looks_like| Refusal::WrongUnit {
        what: "the measured speeds are",
        times: speeds,
        than: "the poses",
        looks_like,
        needed: "m/s",
    };
    let poses_are = |looks_like| Refusal::WrongUnit {
        what: "the positions change by",
        times: 1.0 / speeds,
        than: "the measured speeds",
        looks_like,
        needed: metres,
    };
    let wrong_way = match () {
        () if sum.way_m < WAY_M => None,
        () if near(speeds, 3.6) => Some(speeds_are("km/h")),
        () if near(speeds, 2.237) => Some(speeds_are("mph")),
        () if near(speeds, 0.01) => Some(poses_are("centimetres")),
        () if near(speeds, 0.001) => Some(poses_are("millimetres")),
        () => None,
    };
    let in_degrees = |what, times, than, needed| Refusal::WrongUnit {
        what,
        times,
        than,
        looks_like: "degrees",
        needed,
    };
    let turns = sum.direction_rad > TURN_RAD;
    wrong_way.or_else(|| match () {
        // A pose's noise turns its direction to and fro.
        () if turns && yaw > 0.5 * DEGREES && yaw < 1.2 * DEGREES => {
            Some(in_degrees("the headings turn by", yaw, "the positions", radians))
        }
        () if turns && near(rates, DEGREES) => {
            Some(in_degrees("the yaw rates are", rates, "the headings", "radians a second"))
        }
        () => None,
    })
}

/// How far a car came in a stretch, and how far it turned, as each part of its odometry has it: summed up over steps of a
/// second in which it drove.
struct Ways {
    /// By the measured speeds, and by the positions.
    told_m: f64,
    way_m: f64,
    /// By the direction in which the positions move, by the headings, and by the yaw rates.
    direction_rad: f64,
    yaw_rad: f64,
    rate_rad: f64,
}

impl Ways {
    fn of(it: &Stretch) -> Self {
        /// Shorter steps tell no direction, as a share of the usual one.
        const SHORT: f64 = 0.3;
        let mut sum =
            Self { told_m: 0.0, way_m: 0.0, direction_rad: 0.0, yaw_rad: 0.0, rate_rad: 0.0 };
        let step = (1.0 / it.tick_s).round().max(1.0) as usize;
        let places: Vec<usize> = (0..it.len()).step_by(step).collect();
        let chord = |from: usize, to: usize| (it.x_m[to] - it.x_m[from], it.y_m[to] - it.y_m[from]);
        let chord_m = |from: usize, to: usize| {
            let (dx, dy) = chord(from, to);
            libm::hypot(dx, dy)
        };
        let mut all: Vec<f64> = places.windows(2).map(|two| chord_m(two[0], two[1])).collect();
        let usual_m = median(&mut all);
        for three in places.windows(3) {
            let (from, middle, to) = (three[0], three[1], three[2]);
            if chord_m(from, middle).min(chord_m(middle, to)) < SHORT * usual_m {
                continue;
            }
            sum.way_m += chord_m(from, middle);
            sum.told_m += it.smooth_mps[from..middle].iter().sum::<f64>() * it.tick_s;
            let ((ax, ay), (bx, by)) = (chord(from, middle), chord(middle, to));
            let turned_rad = libm::atan2(ax * by - ay * bx, ax * bx + ay * by);
            sum.direction_rad += turned_rad.abs();
            // From the middle of one step to that of the next.
            let half = step / 2;
            let (a, b) = (from + half, (middle + half).min(it.len() - 1));
            sum.yaw_rad += (it.yaw_rad[b] - it.yaw_rad[a]).abs();
            sum.rate_rad += (it.yaw_rate_radps[a..b].iter().sum::<f64>() * it.tick_s).abs();
        }
        sum
    }
}

/// The commanded speed beside the driven one, wherever it was held for a while and the car drives.
fn commanded_to_driven(stretch: &Stretch) -> Vec<f64> {
    const HELD_S: f64 = 2.0;
    let mut ratios = Vec::new();
    for (two, first) in stretch.commands.windows(2).zip(held_since(&stretch.commands)) {
        let held_s = two[1].time_s - first;
        let at = stretch.time_s.partition_point(|time_s| *time_s < two[1].time_s);
        let Some(driven_mps) = stretch.smooth_mps.get(at) else { continue };
        if held_s > HELD_S && *driven_mps > 0.2 && two[0].speed_mps > 0.0 {
            ratios.push(two[0].speed_mps / driven_mps);
        }
    }
    ratios
}

/// Since when each command's speed had been commanded, but for small changes.
fn held_since(commands: &[Command]) -> impl Iterator<Item = f64> + '_ {
    let mut since = commands.first().map_or((0.0, 0.0), |it| (it.time_s, it.speed_mps));
    commands.iter().map(move |it| {
        if (it.speed_mps - since.1).abs() > 0.05 * since.1.abs() {
            since = (it.time_s, it.speed_mps);
        }
        since.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::{Drive, Odometry, stretches};

    /// A car that follows steps of its speed within half a second, whose commands are told in a unit.
    fn driven(unit: f64, follows: f64) -> Vec<Stretch> {
        let asked = |time_s: f64| if time_s % 10.0 < 5.0 { 2.0 } else { 3.0 };
        let (mut drive, mut speed_mps) = (Drive::default(), 2.0 * follows);
        for tick in 0..4000 {
            let time_s = 0.01 * f64::from(tick);
            speed_mps += 0.02 * (follows * asked(time_s) - speed_mps);
            drive.odometry.push(Odometry { time_s, speed_mps, ..Odometry::default() });
            let speed_mps = unit * asked(time_s);
            drive.commands.push(Command { time_s, speed_mps, steering_rad: 0.0 });
        }
        stretches(&drive)
    }

    #[test]
    fn kilometres_an_hour_are_told_and_a_car_that_does_not_come_up_to_speed_is_none() {
        assert!(wrong_unit(&driven(3.6, 0.98)).unwrap().contains("km/h"));
        assert!(wrong_unit(&driven(2.237, 1.0)).unwrap().contains("mph"));
        for follows in [1.0, 0.8, 0.6, 0.35] {
            assert_eq!(wrong_unit(&driven(1.0, follows)), None, "{follows}");
        }
        assert_eq!(wrong_unit(&[]), None);
    }

    #[test]
    fn odometry_that_contradicts_itself_by_the_ratio_of_two_units_is_told() {
        // A figure of eight, by factors for positions, heading, speed and yaw rate; with some noise.
        let driven = |[position, heading, speed, rate]: [f64; 4]| {
            let mut drive = Drive::default();
            let (mut x_m, mut y_m, mut yaw_rad) = (3.0, 1.0, 0.3);
            for tick in 0..4000_u32 {
                let time_s = 0.01 * f64::from(tick);
                let (speed_mps, yaw_rate_radps) = (2.0, 0.5 * libm::sin(0.4 * time_s));
                let noise = f64::from(tick * 7919 % 1013) / 506.0 - 1.0;
                drive.odometry.push(Odometry {
                    time_s,
                    x_m: position * (x_m + 0.03 * noise),
                    y_m: position * (y_m - 0.03 * noise),
                    yaw_rad: heading * yaw_rad,
                    speed_mps: speed * speed_mps,
                    yaw_rate_radps: rate * yaw_rate_radps,
                });
                x_m += 0.01 * speed_mps * libm::cos(yaw_rad);
                y_m += 0.01 * speed_mps * libm::sin(yaw_rad);
                yaw_rad += 0.01 * yaw_rate_radps;
            }
            wrong_unit_of_odometry(&stretches(&drive)).map(|why| why.to_string())
        };
        let degrees = 180.0 / std::f64::consts::PI;
        for (by, what) in [
            ([1.0, 1.0, 3.6, 1.0], "the measured speeds are 3.6"),
            ([1.0, 1.0, 2.237, 1.0], "mph"),
            ([100.0, 1.0, 1.0, 1.0], "centimetres"),
            ([1000.0, 1.0, 1.0, 1.0], "millimetres"),
            ([1.0, degrees, 1.0, 1.0], "the headings turn by"),
            ([1.0, degrees, 1.0, degrees], "the headings turn by"),
            ([1.0, 1.0, 1.0, degrees], "the yaw rates are 57."),
        ] {
            let told = driven(by).unwrap_or_default();
            assert!(told.contains(what), "{by:?}: {told}");
        }
        for speed in [1.0, 1.4, 0.5, 3.0] {
            assert_eq!(driven([1.0, 1.0, speed, 1.0]), None, "{speed}");
        }
        assert_eq!(driven([1.0, 1.0, 1.0, f64::NAN]), None);
        assert_eq!(wrong_unit_of_odometry(&[]), None);
    }
}
