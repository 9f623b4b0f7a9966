//! What a car meets on its way along a path: the joints, where curvature or heading change and the loop has to settle anew.

use crate::vertices::State;
use crate::{Car, Equilibrium, Gains};

/// A stretch of constant curvature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// How long it is.
    pub length_m: f64,
    /// Its curvature, 1/m, positive to the left.
    pub curvature: f64,
    /// By how much the path turns at its beginning.
    pub kink_rad: f64,
}

/// The moment at which the reference passes from one piece to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// Where it is, along the path.
    pub along_m: f64,
    /// Curvatures before and behind, 1/m.
    pub curvatures: [f64; 2],
    /// By how much the path turns.
    pub kink_rad: f64,
    /// The gains that the car drives with at this moment.
    pub gains: Gains,
    /// Offset, heading, filter and wheels in the frame of the reference behind the joint.
    pub state: State,
}

impl Joint {
    /// The deviation from where the loop is to settle.
    pub fn deviation(&self, at: &Equilibrium) -> State {
        let [offset, heading, filter, wheels] = self.state;
        let steering = at.steering_rad;
        [offset - at.offset_m, heading - at.heading_rad, filter - steering, wheels - steering]
    }
}

/// What a car met on its way.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Way {
    /// The joints.
    pub joints: Vec<Joint>,
    /// The largest turn of the wheels that was asked for in a tick, as a share of the limit, at most 1; `None` if it did
    /// not drive.
    pub steering_rate_share: Option<f64>,
}

/// Drives along a path without noise, with the speed that the law commands, and returns what it met. The
/// gains are those of the place of the car, along the path. The car begins settled on the first piece.
pub fn joints(
    car: &Car,
    pieces: &[Piece],
    reference_mps: f64,
    gains_at: impl Fn(f64) -> Gains,
) -> Way {
    let mut gains = gains_at(0.0);
    let Some(first) = pieces.first() else { return Way::default() };
    let Some(at) = Equilibrium::new(car, &gains, reference_mps, first.curvature) else {
        return Way::default();
    };
    let (h, wheelbase, point) = (car.tick_s, car.wheelbase_m, car.tracked_m(reference_mps));
    let limit = car.steering_limit_rad;
    let reach = car.steering_rate_radps * h;
    let (mut x, mut y, mut heading) = (-at.lead_m, at.offset_m, at.heading_rad);
    let (mut filter, mut wheels) = (at.steering_rad, at.steering_rad);
    let mut met = Vec::new();
    let mut share = 0.0f64;
    let (mut piece, mut begins_m, mut along_m) = (0, 0.0, 0.0);
    loop {
        if along_m >= begins_m + pieces[piece].length_m {
            let Some(next) = pieces.get(piece + 1) else {
                return Way { joints: met, steering_rate_share: Some(share.min(1.0)) };
            };
            begins_m += pieces[piece].length_m;
            (x, y) = turned(next.kink_rad, [x, y]);
            heading -= next.kink_rad;
            met.push(Joint {
                along_m: begins_m,
                curvatures: [pieces[piece].curvature, next.curvature],
                kink_rad: next.kink_rad,
                gains,
                state: [y, heading, filter, wheels],
            });
            piece += 1;
        }
        gains = gains_at((along_m + x).max(0.0));
        let (sin, cos) = (libm::sin(heading), libm::cos(heading));
        let ahead = -x * cos - y * sin;
        let aside = x * sin - y * cos;
        let omega = -gains.ks * heading + gains.kl * aside;
        filter = (gains.ki * (filter + h * omega)).clamp(-limit, limit);
        share = share.max((filter - wheels).abs() / reach);
        wheels += (filter - wheels).clamp(-reach, reach);
        let speed = (gains.kv * ahead).max(0.0);
        let turn = h * speed * libm::tan(wheels) / wheelbase;
        let middle = heading + 0.5 * turn;
        x += h * speed * libm::cos(middle) + point * (libm::cos(heading + turn) - cos);
        y += h * speed * libm::sin(middle) + point * (libm::sin(heading + turn) - sin);
        heading += turn;
        // The reference goes on, and the frame with it.
        let way = h * reference_mps;
        let angle = pieces[piece].curvature * way;
        let half = 0.5 * angle;
        let chord = if half == 0.0 { way } else { way * libm::sin(half) / half };
        (x, y) = turned(angle, [x - chord * libm::cos(half), y - chord * libm::sin(half)]);
        heading -= angle;
        along_m += way;
    }
}

/// The same point in a frame that has turned by an angle.
fn turned(angle: f64, [x, y]: [f64; 2]) -> (f64, f64) {
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    (cos * x + sin * y, cos * y - sin * x)
}
