//! Key by key: what a fit says of it, in the units of the file.

use config::Vehicle;
use serde::Serialize;

use crate::fit::{Fitted, Told};
use crate::identify::{Options, Point};
use crate::slip::Slip;
use crate::{speed, steering};

/// What tells the speed loop.
pub(crate) const SPEED_STEPS: &str = "steps of the commanded speed, up and down";

/// A key of a vehicle's file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Its name in the file.
    pub key: &'static str,
    /// The file's value.
    pub before: f64,
    /// The new value; the file's, if the drive does not tell it.
    pub after: f64,
    /// 95 % interval; `None` for what is not identified.
    pub interval: Option<[f64; 2]>,
    /// Whether the drive tells it.
    pub identified: bool,
    /// The drive tells it only roughly, but it speaks against the file's value.
    pub roughly: bool,
    /// The drive tells only the product or the ratio with this key, which keeps its value.
    pub only_with: Option<&'static str>,
    /// Why it is not identified.
    pub why: Option<String>,
    /// It keeps the file's value because the drive agrees with that, and would have told another one.
    pub agrees: bool,
}

/// Why a key of the speed loop is not told by a speed that is computed.
const AS_COMMANDED: &str = "the measured speed is the commanded one";

impl Row {
    /// Keeps the file's value of a key of the speed loop, because the speed was not measured.
    fn keep_as_commanded(&mut self) {
        (self.after, self.interval) = (self.before, None);
        (self.identified, self.roughly, self.agrees) = (false, false, false);
        (self.only_with, self.why) = (None, Some(AS_COMMANDED.to_owned()));
    }

    /// Whether [`Row::keep_as_commanded`] keeps it.
    pub(crate) fn is_as_commanded(&self) -> bool {
        self.why.as_deref() == Some(AS_COMMANDED)
    }

    /// What to drive so that the key shows.
    pub fn drive_next(&self) -> Option<&'static str> {
        Some(match self.key {
            "wheelbase_m" | "steering_gain" | "steering_offset_rad" => {
                "bends to both sides at a steady speed, for 20 s"
            }
            "steering_delay_s" | "steering_lag_s" => {
                "steering steps to both sides, or a steering sine that gets quicker"
            }
            "steering_rate_radps" => {
                "large steering steps, at which the wheels turn as fast as they can"
            }
            "steering_limit_rad" => "bends as tight as the car can drive, to both sides",
            "tracked_point_m" | "ros2.odometry_point_m" => "tight bends to both sides",
            "rear_slip_s2pm" | "yaw_lag_s2pm" | "understeer_s2pm" => {
                "bends to both sides, slowly and as fast as it is to drive"
            }
            "speed_delay_s" | "speed_kp" | "speed_ki" | "pedal_lag_s" | "drag_per_s"
            | "rolling_decel_mps2" => SPEED_STEPS,
            "throttle_accel_mps2" => "a step of the commanded speed that needs full throttle",
            "brake_decel_mps2" => "a step down of the commanded speed that needs full brake",
            _ => return None,
        })
    }
}

/// Half widths of the intervals of steering keys below which they are identified.
pub(crate) fn limits_of_steering(vehicle: &Vehicle) -> impl Fn(usize, &[f64]) -> f64 + use<> {
    let size = vehicle.wheelbase_m / 2.875;
    move |index, at| match index {
        steering::WHEELBASE | steering::GAIN => 0.05,
        steering::DELAY => 0.03,
        // A lag of some milliseconds need not be known to a quarter.
        steering::LAG => 0.25_f64.max(0.01 / libm::exp(at[index])),
        steering::RATE => 0.25,
        steering::STOP => 0.05,
        steering::OFFSET => 0.01,
        steering::POINT => 0.2 * size,
        // Tyres do something only where the drive says so for certain.
        steering::YAW_LAG | steering::UNDERSTEER => at[index].clamp(1e-6, MOST_TYRES_S2PM),
        _ => f64::INFINITY,
    }
}

/// Those of the speed loop's.
pub(crate) fn limits_of_speed(index: usize, at: &[f64]) -> f64 {
    match index {
        speed::DELAY => 0.03,
        speed::PEDAL_LAG => 0.25_f64.max(0.01 / libm::exp(at[index])),
        _ => 0.25,
    }
}

/// One key in the making: what it is made of in the coordinates of the fit.
struct Key<'a> {
    name: &'static str,
    before: f64,
    /// Parameters of which it is the sum, or the exponential of the sum.
    of: &'a [usize],
    is_log: bool,
}

/// Of a key of which a drive tells nothing.
const UNKNOWN: &str = "the drive tells nothing of it";

/// That half an interval is too wide.
fn known_to(half: f64, digits: usize) -> String {
    if half.is_finite() { format!("known to ± {half:.digits$} only") } else { UNKNOWN.to_owned() }
}

/// Widens the intervals of dead times where commands may have been given up to so much before their times. The car then
/// answered later than it seems.
pub(crate) fn allow_for_late_commands<'a>(rows: impl Iterator<Item = &'a mut Row>, late_s: f64) {
    let is_dead_time = |it: &&mut Row| {
        ["steering_delay_s", "speed_delay_s", "steering_delay_s + steering_lag_s"].contains(&it.key)
    };
    for [_, high] in rows.filter(is_dead_time).filter_map(|it| it.interval.as_mut()) {
        *high += late_s;
    }
}

fn row(fitted: &Fitted, key: &Key<'_>) -> Row {
    let told = fitted.told[key.of[0]];
    let at: f64 = key.of.iter().map(|&index| fitted.at[index]).sum();
    let factors: Vec<(usize, f64)> = key.of.iter().map(|&index| (index, 1.0)).collect();
    let half = fitted.half_of_whole(&factors);
    let value = |at: f64| if key.is_log { libm::exp(at) } else { at };
    let within = |half: f64| match key.is_log {
        true if half.is_finite() => format!("known to a factor of {:.2} only", libm::exp(half)),
        true => UNKNOWN.to_owned(),
        false => known_to(half, 3),
    };
    let unidentified = |why: String| Row {
        key: key.name,
        before: key.before,
        after: key.before,
        interval: None,
        identified: false,
        roughly: false,
        only_with: None,
        why: Some(why),
        agrees: false,
    };
    match told {
        Told::TooWide { half } => unidentified(within(half)),
        Told::AtLeast { least } => {
            let least = value(least);
            unidentified(format!(
                "at least {}; the wheels did not turn as fast as they can",
                rounded(least, least)
            ))
        }
        Told::Held => unidentified("not looked for".to_owned()),
        Told::Identified | Told::Roughly => {
            let interval = [value(at - half), value(at + half)];
            Row {
                key: key.name,
                before: key.before,
                after: rounded(value(at), 0.5 * (interval[1] - interval[0])),
                interval: Some(interval),
                identified: true,
                roughly: told == Told::Roughly,
                only_with: None,
                why: None,
                agrees: false,
            }
        }
    }
}

/// A value without the digits that its interval makes meaningless: rounded to a hundredth of half the interval or less.
fn rounded(value: f64, half: f64) -> f64 {
    if !(half > 0.0 && half.is_finite()) {
        return value;
    }
    let digits = (2.0 - libm::floor(libm::log10(half))).clamp(0.0, 12.0) as i32;
    let factor = 10.0_f64.powi(digits);
    (value * factor).round() / factor
}

/// The rows of steering, wheelbase and odometry's point.
pub(crate) fn steering_rows(
    fitted: &Fitted,
    vehicle: &Vehicle,
    point_m: f64,
    options: Options,
) -> Vec<Row> {
    let point = match options.point {
        Point::Tracked => "tracked_point_m",
        Point::Odometry => "ros2.odometry_point_m",
    };
    let key = |name, before, of, is_log| row(fitted, &Key { name, before, of, is_log });
    let wheelbase = match options.wheelbase_is_measured {
        false => key("wheelbase_m", vehicle.wheelbase_m, &[steering::WHEELBASE], true),
        true => key("steering_gain", vehicle.steering_gain, &[steering::GAIN], true),
    };
    let delay = Key {
        name: "steering_delay_s",
        before: vehicle.steering_delay_s,
        of: &[steering::DELAY],
        is_log: false,
    };
    let mut delay = row(fitted, &delay);
    not_negative(&mut delay);
    let mut rows = vec![
        wheelbase,
        delay,
        key("steering_lag_s", vehicle.steering_lag_s, &[steering::LAG], true),
        key("steering_rate_radps", vehicle.steering_rate_radps, &[steering::RATE], true),
        key("steering_offset_rad", vehicle.steering_offset_rad, &[steering::OFFSET], false),
        key(point, point_m, &[steering::POINT], false),
    ];
    // Most drives do not come to the stop.
    if fitted.told[steering::STOP] != Told::Held {
        rows.push(key("steering_limit_rad", vehicle.steering_limit_rad, &[steering::STOP], true));
    }
    rows.extend(tyre_rows(fitted, vehicle));
    rows
}

/// Half the width of the interval of what tyres do at speed from which on a drive tells nothing of it.
const MOST_TYRES_S2PM: f64 = 0.003;

/// The rows of how tyres let the car turn; none for a model that has no such keys.
fn tyre_rows(fitted: &Fitted, vehicle: &Vehicle) -> Vec<Row> {
    let keys = [
        ("yaw_lag_s2pm", vehicle.yaw_lag_s2pm, steering::YAW_LAG),
        ("understeer_s2pm", vehicle.understeer_s2pm, steering::UNDERSTEER),
    ];
    let keys = keys.into_iter().filter(|(_, _, index)| fitted.told[*index] != Told::Held);
    let row = |(name, before, index)| {
        let mut row = row(fitted, &Key { name, before, of: &[index], is_log: false });
        not_negative(&mut row);
        if let Told::TooWide { half } = fitted.told[index] {
            row.agrees = half <= MOST_TYRES_S2PM;
            row.why = Some(match row.agrees {
                true => format!("the drive agrees with the file's value, to ± {half:.4}"),
                false => known_to(half, 4),
            });
        }
        row
    };
    keys.map(row).collect()
}

/// The row of the rear axle's slip. The file's value stands unless the drive speaks against it: slip and the odometry's point
/// are hard to tell apart, and a little of one that is not there is paid for by the other.
pub(crate) fn slip_row(slip: Option<Slip>, vehicle: &Vehicle) -> Row {
    let before = vehicle.rear_slip_s2pm;
    let known = slip.filter(|it| it.half_s2pm <= MOST_TYRES_S2PM);
    let half = known.or(slip).map_or(f64::INFINITY, |it| it.half_s2pm);
    let told = known.filter(|it| it.at_s2pm > 0.0 && (it.at_s2pm - before).abs() > it.half_s2pm);
    Row {
        key: "rear_slip_s2pm",
        before,
        after: told.map_or(before, |it| rounded(it.at_s2pm, it.half_s2pm)),
        interval: told.map(|it| [(it.at_s2pm - half).max(0.0), it.at_s2pm + half]),
        identified: told.is_some(),
        roughly: false,
        only_with: None,
        why: match (told, known) {
            (Some(_), _) => None,
            (None, Some(_)) => {
                Some(format!("the drive agrees with the file's value, to ± {half:.4}"))
            }
            (None, None) => Some(known_to(half, 4)),
        },
        agrees: told.is_none() && known.is_some(),
    }
}

/// Widens the interval of the odometry's point by what the slip's leaves open. The point was fitted with one slip, and the
/// two are hard to tell apart.
pub(crate) fn point_with_slip(rows: &mut [Row], slip: Option<Slip>) {
    let tells = rows.iter().any(|it| it.key == "rear_slip_s2pm" && it.identified);
    let Some(slip) = slip.filter(|_| tells) else { return };
    let moves_m = slip.point_m_per_s2pm * slip.half_s2pm;
    let is_point = |it: &&mut Row| it.key.ends_with("_point_m") && it.identified;
    for row in rows.iter_mut().filter(is_point) {
        if let Some([low, high]) = &mut row.interval {
            let (middle, half) = (0.5 * (*low + *high), 0.5 * (*high - *low));
            let half = libm::hypot(half, moves_m);
            (*low, *high) = (middle - half, middle + half);
        }
    }
}

fn not_negative(row: &mut Row) {
    if let Some([low, _]) = &mut row.interval {
        *low = low.max(0.0);
    }
}

/// A sum of dead time and lag that is not known better than this is not identified.
const WIDEST_SUM_S: f64 = 0.03;

/// Dead time and lag of the steering together: also where the drive does not tell the two apart, so that one of them has to
/// stay what the file says.
pub(crate) fn delay_and_lag(fitted: &Fitted, vehicle: &Vehicle) -> Row {
    let are_told =
        [steering::DELAY, steering::LAG].iter().all(|it| fitted.told[*it] == Told::Identified);
    let at = if are_told { &fitted.at } else { &fitted.whole.at };
    let lag_s = libm::exp(at[steering::LAG]);
    let half = fitted.half_of_whole(&[(steering::DELAY, 1.0), (steering::LAG, lag_s)]);
    let sum_s = at[steering::DELAY] + lag_s;
    let before = vehicle.steering_delay_s + vehicle.steering_lag_s;
    let is_known = half <= WIDEST_SUM_S;
    Row {
        key: "steering_delay_s + steering_lag_s",
        before,
        after: if is_known { rounded(sum_s, half) } else { before },
        interval: is_known.then_some([(sum_s - half).max(0.0), sum_s + half]),
        identified: is_known,
        roughly: false,
        only_with: None,
        why: (!is_known).then(|| known_to(half, 3)),
        agrees: false,
    }
}

/// The rows of the speed loop.
pub(crate) fn speed_rows(fitted: &Fitted, vehicle: &Vehicle, is_commanded: bool) -> Vec<Row> {
    use speed::{BRAKE, DELAY, DRAG, KI, KP, PEDAL_LAG, ROLLING, THROTTLE};
    let throttle = row(
        fitted,
        &Key {
            name: "throttle_accel_mps2",
            before: vehicle.throttle_accel_mps2,
            of: &[THROTTLE],
            is_log: true,
        },
    );
    let key = |name, before, index| row(fitted, &Key { name, before, of: &[index], is_log: true });
    // A product with the throttle is divided by it again, with the uncertainty of both; or with the file's value.
    let with_throttle = |name, before, index: usize, sign: f64| {
        let mut one = key(name, before, index);
        if !one.identified {
            return one;
        }
        let scale =
            if throttle.identified { fitted.at[THROTTLE] } else { fitted.axes[THROTTLE].prior };
        let half = match throttle.identified {
            true => fitted.half_of_whole(&[(index, 1.0), (THROTTLE, sign)]),
            false => fitted.half_of_whole(&[(index, 1.0)]),
        };
        let at = fitted.at[index] + sign * scale;
        let interval = [libm::exp(at - half), libm::exp(at + half)];
        one.after = rounded(libm::exp(at), 0.5 * (interval[1] - interval[0]));
        one.interval = Some(interval);
        one.roughly |= throttle.roughly;
        one.only_with = (!throttle.identified).then_some("throttle_accel_mps2");
        one
    };
    let delay =
        Key { name: "speed_delay_s", before: vehicle.speed_delay_s, of: &[DELAY], is_log: false };
    let mut delay = row(fitted, &delay);
    not_negative(&mut delay);
    let mut rows = vec![
        delay,
        with_throttle("speed_kp", vehicle.speed_kp, KP, -1.0),
        with_throttle("speed_ki", vehicle.speed_ki, KI, -1.0),
        with_throttle("brake_decel_mps2", vehicle.brake_decel_mps2, BRAKE, 1.0),
        key("pedal_lag_s", vehicle.pedal_lag_s, PEDAL_LAG),
        key("drag_per_s", vehicle.drag_per_s, DRAG),
        key("rolling_decel_mps2", vehicle.rolling_decel_mps2, ROLLING),
        throttle,
    ];
    if is_commanded {
        rows.iter_mut().for_each(Row::keep_as_commanded);
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_drive_does_not_tell_is_said_without_an_infinite_number() {
        let vehicle = config::Layers::vehicle_of_file("f1tenth").unwrap();
        assert_eq!(slip_row(None, &vehicle).why.as_deref(), Some(UNKNOWN));
        assert_eq!(known_to(0.0123, 3), "known to ± 0.012 only");
    }

    #[test]
    fn a_point_is_as_uncertain_as_the_slip_beside_it_makes_it() {
        let row = |key, identified| Row {
            key,
            before: 0.5,
            after: 0.7,
            interval: Some([0.69, 0.71]),
            identified,
            roughly: false,
            only_with: None,
            why: None,
            agrees: false,
        };
        // 0.01 m by itself, and 0.024 m by the slip: 0.026 m.
        let slip = Slip { at_s2pm: 0.004, half_s2pm: 0.002, point_m_per_s2pm: 12.0 };
        let mut rows = [row("tracked_point_m", true), row("rear_slip_s2pm", true)];
        point_with_slip(&mut rows, Some(slip));
        let [low, high] = rows[0].interval.unwrap();
        assert!((low - 0.674).abs() < 1e-12 && (high - 0.726).abs() < 1e-12, "{low} {high}");
        assert_eq!(rows[1].interval, Some([0.69, 0.71]));
        // Where the file's slip stands, the point is that of this slip.
        let mut rows = [row("tracked_point_m", true), row("rear_slip_s2pm", false)];
        point_with_slip(&mut rows, Some(slip));
        assert_eq!(rows[0].interval, Some([0.69, 0.71]));
    }
}
