//! What was measured beside what the file's values and the new ones predict, for pictures.

use crate::drive::{STANDING_MPS, Stretch};
use crate::prediction::{Car, From, way};
use crate::speed;
use crate::steering::{wheels, yaw_rates};

/// How long each predicted piece of the way is.
const WINDOW_S: f64 = 3.0;

/// One quantity over time: as measured, as the file's values predict it, and as the new ones do.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Series {
    /// As measured; `NaN` where it was not.
    pub measured: Vec<f64>,
    /// With the file's values.
    pub before: Vec<f64>,
    /// With the new ones.
    pub after: Vec<f64>,
}

/// A piece of the way, in the recording's frame: points (x, y) in metres, from one start on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Window {
    /// As the file's values predict it from the commands.
    pub before: Vec<[f64; 2]>,
    /// As the new ones do.
    pub after: Vec<[f64; 2]>,
}

/// The longest stretch of what was fitted.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Compared {
    /// Seconds since its beginning.
    pub time_s: Vec<f64>,
    /// Forward speed (m/s), from the commands alone.
    pub speed_mps: Series,
    /// Yaw rate (rad/s), from the commanded steering and the measured speed.
    pub yaw_rate_radps: Series,
    /// The measured way: points (x, y) in metres.
    pub way_m: Vec<[f64; 2]>,
    /// Pieces of 3 s, one after the other, each predicted from the commands alone.
    pub windows: Vec<Window>,
}

/// Compares two cars with the longest stretch.
pub(crate) fn compared(stretches: &[Stretch], before: Car<'_>, after: Car<'_>) -> Compared {
    let Some(it) = stretches.iter().max_by_key(|it| it.len()) else { return Compared::default() };
    let speeds = |car: Car<'_>| speed::run(it, car.vehicle).iter().map(|at| at.speed_mps).collect();
    let rates = |car: Car<'_>| yaw_rates(it, car.vehicle, 1.0);
    let (ways_before, ways_after) = (windows(it, before), windows(it, after));
    let pairs = ways_before.into_iter().zip(ways_after);
    Compared {
        time_s: it.time_s.iter().map(|time| time - it.time_s[0]).collect(),
        speed_mps: Series {
            measured: it.speed_mps.clone(),
            before: speeds(before),
            after: speeds(after),
        },
        yaw_rate_radps: Series {
            measured: it.yaw_rate_radps.clone(),
            before: rates(before),
            after: rates(after),
        },
        way_m: it.x_m.iter().zip(&it.y_m).map(|(x, y)| [*x, *y]).collect(),
        windows: pairs.map(|(before, after)| Window { before, after }).collect(),
    }
}

/// The predicted pieces of the way, where the car moves.
fn windows(stretch: &Stretch, car: Car<'_>) -> Vec<Vec<[f64; 2]>> {
    let angles = wheels(stretch, car.vehicle);
    let rates = yaw_rates(stretch, car.vehicle, 1.0);
    let loops = speed::run(stretch, car.vehicle);
    let mut windows = Vec::new();
    let mut next_s = stretch.time_s[0];
    for (index, state) in loops.iter().enumerate() {
        let now_s = stretch.time_s[index];
        let end = stretch.time_s.partition_point(|time| *time < now_s + WINDOW_S - 1e-6);
        if now_s < next_s || end >= stretch.len() || stretch.smooth_mps[index] <= STANDING_MPS {
            continue;
        }
        next_s = now_s + WINDOW_S;
        let mut points = Vec::new();
        let from = From { state: *state, yaw_rate_radps: rates[index] };
        way(stretch, car, &angles, from, index..end, |x, y| points.push([x, y]));
        windows.push(points);
    }
    windows
}
