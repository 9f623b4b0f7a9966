//! Whether commanded speeds are told in another unit than the odometry's.

use crate::drive::{Command, Stretch};
use crate::levenberg::median;

/// What to know where the commanded speeds are those of the car in another unit.
pub(crate) fn wrong_unit(stretches: &[Stretch]) -> Option<String> {
    const NEAR: f64 = 0.06;
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
}
