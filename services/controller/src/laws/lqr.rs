//! A linear-quadratic regulator on the lateral error of a kinematic car, with a price on moving the steering.
//!
//! The error model is that of Snider, "Automatic Steering Methods for Autonomous Automobile Path Tracking",
//! CMU-RI-TR-09-08 (2009), chapter 3, without slip. The Riccati equation is solved by doubling: Chu, Fan, Lin, Wang,
//! "Structure-preserving algorithms for periodic discrete-time algebraic Riccati equations", International Journal of
//! Control 77 (2004).

use config::{Parameters, RunConfig};
use nalgebra::{Matrix3, RowVector3, Vector3};
use tracking::tracking_error;

use super::{HeldSteering, Law, LawState, RawCommand};
use crate::Sight;
use crate::sight::Points;

/// The law with the steering angle of its last command, and its gains at the speeds that were driven.
#[derive(Debug, Clone)]
pub(super) struct Lqr {
    car: Car,
    /// Whether errors are measured at the nearest point of the path instead of against the moving reference.
    nearest: bool,
    steering: HeldSteering,
    gains: Box<GainTable>,
}

/// Gains over speed, for one set of weights. Computed where they are needed: most drives meet few speeds.
#[derive(Debug, Clone)]
struct GainTable {
    /// Apart of the speeds, m/s; the first is one step from standing.
    step_mps: f64,
    weights: Weights,
    rows: [Option<Gains>; GainTable::SPEEDS],
}

/// What the model knows of the car.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Car {
    points: Points,
    tick_s: f64,
}

/// The prices of the law's parameters.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Weights {
    /// Of the square of the distance from the path, rad²/m².
    offset: f64,
    /// Of the square of the heading error.
    heading: f64,
    /// Of the square of the steering rate, s².
    travel_s2: f64,
}

/// Steering change of a tick for each part of the error: distance to the left of the path, heading to its left, steering
/// to the left of the path's.
type Gains = RowVector3<f64>;

impl GainTable {
    /// Number of speeds, up to the speed limit of the vehicle.
    const SPEEDS: usize = 64;

    fn new(speed_limit_mps: f64) -> Self {
        Self {
            step_mps: speed_limit_mps / Self::SPEEDS as f64,
            weights: Weights::default(),
            rows: [None; Self::SPEEDS],
        }
    }

    /// The gains at a speed, linear between two speeds of the table and held at its ends.
    fn at(&mut self, weights: Weights, speed_mps: f64, car: Car) -> Gains {
        if self.weights != weights {
            (self.weights, self.rows) = (weights, [None; Self::SPEEDS]);
        }
        let last = Self::SPEEDS - 1;
        let place = (speed_mps.abs() / self.step_mps - 1.0).clamp(0.0, last as f64);
        let below = (place as usize).min(last - 1);
        let mut row = |index: usize| {
            let row_mps = self.step_mps * (index + 1) as f64;
            *self.rows[index].get_or_insert_with(|| regulator(weights, row_mps, car))
        };
        let (low, high) = (row(below), row(below + 1));
        low + (high - low) * (place - below as f64)
    }
}

/// The regulator of a car at a speed v with the wheelbase L, for the error x = (y, ψ, δ̃) of a point p ahead of the rear
/// axle and the change u of the steering in a tick of T:
///
/// x′ = A·x + B·u, with y′ = y + v·T·ψ + (p + v·T/2)·(ψ′ − ψ), ψ′ = ψ + v·T/L·(δ̃ + u), δ̃′ = δ̃ + u,
///
/// and the cost Σ q_y·y² + q_ψ·ψ² + δ̃² + r·(u/T)². Returns K of u = −K·x.
fn regulator(weights: Weights, speed_mps: f64, car: Car) -> Gains {
    let Car { points, tick_s } = car;
    let (wheelbase_m, tracked_m) = (points.wheelbase_m(speed_mps), points.tracked_m(speed_mps));
    /// Each step doubles the horizon: 2³⁰ ticks are for ever.
    const DOUBLINGS: usize = 30;
    const CLOSE: f64 = 1e-15;
    let turn = speed_mps * tick_s / wheelbase_m;
    let side_m = (tracked_m + 0.5 * speed_mps * tick_s) * turn;
    #[rustfmt::skip]
    let a = Matrix3::new(
        1.0, speed_mps * tick_s, side_m,
        0.0, 1.0, turn,
        0.0, 0.0, 1.0,
    );
    let b = Vector3::new(side_m, turn, 1.0);
    let price = weights.travel_s2 / (tick_s * tick_s);
    let mut step = a;
    let mut reach = b * b.transpose() / price;
    let mut cost = Matrix3::from_diagonal(&Vector3::new(weights.offset, weights.heading, 1.0));
    for _ in 0..DOUBLINGS {
        let Some(inverse) = (Matrix3::identity() + reach * cost).try_inverse() else { break };
        let added = step.transpose() * cost * inverse * step;
        reach += step * inverse * reach * step.transpose();
        cost += added;
        step = step * inverse * step;
        if added.amax() <= CLOSE * cost.amax() {
            break;
        }
    }
    let along_b = b.transpose() * cost;
    (along_b * a) / (price + (along_b * b)[0])
}

impl Lqr {
    /// The largest share p·κ of a circle's radius.
    const STEEPEST: f64 = 0.9;
}

impl Law for Lqr {
    fn new(config: &RunConfig) -> Self {
        Self {
            car: Car { points: Points::new(&config.vehicle), tick_s: config.drive.tick_s },
            nearest: config.law.settings.text("errors_at") != "reference",
            steering: HeldSteering::new(config),
            gains: Box::new(GainTable::new(config.supervisor.speed_limit_mps)),
        }
    }

    fn restart(&mut self, steering_rad: f64) {
        self.steering.hold(steering_rad);
    }

    fn state(&self) -> LawState {
        self.steering.state()
    }

    fn resume(&mut self, state: &LawState) {
        self.steering.resume(state);
    }

    /// With the parameters Kv (1/s), q_y (rad²/m²), q_ψ and the price r (s²) of the square of the steering rate, the
    /// gains K of this speed, the errors e_y, e_θ of the tracked point, p ahead of the rear axle, and the curvature κ of
    /// the path:
    ///
    /// φ = φ₋₁ + K₁·e_y + K₂·(e_θ − asin(p·κ)) − K₃·(φ₋₁ − atan(L·κ / √(1 − p²·κ²))),  v = v_ref + Kv·e_s,
    ///
    /// φ within its limit: on a circle the rear axle drives a smaller one, and the car points p·κ out of it.
    ///
    /// The price on the steering rate is the law's low-pass filter. Without it, weights could only ever make the law
    /// steer faster.
    fn command(&mut self, parameters: &Parameters, sight: &Sight) -> RawCommand {
        let [kv, offset, heading, travel_s2, ..] = parameters.0;
        let (error, curvature) = if self.nearest {
            let point = sight.projection();
            (tracking_error(point.pose, sight.pose), sight.path().curvature(point.along_m))
        } else {
            (sight.error, sight.reference_curvature())
        };
        let weights = Weights { offset, heading, travel_s2 };
        let k = self.gains.at(weights, sight.speed_mps, self.car);
        let (wheelbase_m, tracked_m) = (sight.wheelbase_m(), sight.tracked_m());
        // No car can drive a circle that is smaller than the way from its rear axle to its tracked point.
        let sin = (tracked_m * curvature).clamp(-Self::STEEPEST, Self::STEEPEST);
        let circle_rad = libm::atan(wheelbase_m * curvature / (1.0 - sin * sin).sqrt());
        let last_rad = self.steering.angle_rad();
        let phi = self.steering.hold(
            last_rad + k[0] * error.cross_track_m + k[1] * (error.heading_rad - libm::asin(sin))
                - k[2] * (last_rad - circle_rad),
        );
        RawCommand::following(sight, kv, phi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use tracking::{Pose, Reference};

    /// L = 2.875 m, p = 1.2 m, T = 0.01 s.
    fn car() -> Car {
        let vehicle = config(&["vehicle.tracked_point_m=1.2"]).vehicle;
        Car { points: Points::new(&vehicle), tick_s: 0.01 }
    }

    /// Derived outside this project: `scipy.linalg.solve_discrete_are` of SciPy 1.17 with the matrices of
    /// [`regulator`]'s documentation, for L = 2.875 m, p = 1.2 m and T = 0.01 s.
    #[test]
    fn gains_are_those_of_an_independent_solver() {
        let check = |offset, heading, travel_s2, speed_mps, wanted: [f64; 3]| {
            let weights = Weights { offset, heading, travel_s2 };
            let found = regulator(weights, speed_mps, car());
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-9, "{speed_mps}: {found} {wanted}");
            }
        };
        check(1.0, 1.0, 0.1, 1.5, [0.030909650256256856, 0.06418437985832263, 0.04459352103634139]);
        check(1.0, 1.0, 0.1, 8.0, [0.03017668813648135, 0.09693687355516108, 0.08936749311348174]);
        check(
            0.01,
            0.5,
            1.0,
            3.5,
            [0.0009898501980844378, 0.011671135909953495, 0.020196585350723165],
        );
        check(30.0, 30.0, 0.01, 0.5, [0.5166558184370248, 0.3693375579996349, 0.11022255091736483]);
    }

    fn config(sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set_law("test", "lqr").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    #[test]
    fn every_bound_of_the_weights_gives_gains_that_lead_to_the_path() {
        let law = config(&[]).law;
        let corners = |index: usize| [law.parameters[index].min, law.parameters[index].max];
        for offset in corners(1) {
            for heading in corners(2) {
                for travel_s2 in corners(3) {
                    for speed_mps in [0.05, 0.5, 2.0, 10.0, 40.0] {
                        let weights = Weights { offset, heading, travel_s2 };
                        let k = regulator(weights, speed_mps, car());
                        assert!(k.iter().all(|it| it.is_finite()), "{weights:?} {speed_mps}");
                        // The error decays on the car of the model: simulated until it had time to.
                        let mut x = Vector3::new(0.1, 0.0, 0.0);
                        let (turn, ahead_m) = (speed_mps * 0.01 / 2.875, speed_mps * 0.01);
                        let start = x.norm();
                        let mut largest = 0.0_f64;
                        for _ in 0..200_000 {
                            let steering = x[2] - (k * x)[0];
                            x = Vector3::new(
                                x[0] + ahead_m * x[1] + (1.2 + 0.5 * ahead_m) * turn * steering,
                                x[1] + turn * steering,
                                steering,
                            );
                            largest = largest.max(x[0].abs());
                        }
                        assert!(x.norm() < start, "{weights:?} {speed_mps}: {x}");
                        assert!(largest < 2.0 * start, "{weights:?} {speed_mps}: {largest}");
                    }
                }
            }
        }
    }

    fn command(law: &mut Lqr, config: &RunConfig, pose: Pose, speed_mps: f64) -> RawCommand {
        let mut reference = Reference::new(config);
        let reference_pose = reference.advance(700.0, pose);
        let sight = Sight::new(config, &reference, 700.0, reference_pose, pose, speed_mps, 0.0);
        law.command(&Parameters::of(&[0.0, 1.0, 1.0, 0.1]), &sight)
    }

    #[test]
    fn one_tick_by_hand() {
        let config = config(&["path.pieces=[{kind='straight',length_m=50.0}]"]);
        // The eighth of the table's speeds: 8 · limit / 64.
        let speed_mps = config.supervisor.speed_limit_mps / 8.0;
        let weights = Weights { offset: 1.0, heading: 1.0, travel_s2: 0.1 };
        let car = Car { points: Points::new(&config.vehicle), tick_s: 0.01 };
        let k = regulator(weights, speed_mps, car);
        let mut law = Lqr::new(&config);
        law.restart(0.2);
        let pose = Pose { x_m: 10.0, y_m: 0.5, yaw_rad: 0.1 };
        let found = command(&mut law, &config, pose, speed_mps);
        // The nearest point lies to the right, across the car by 0.5·cos 0.1.
        let wanted = 0.2 - k[0] * 0.5 * libm::cos(0.1) - k[1] * 0.1 - k[2] * 0.2;
        assert!((found.steering_rad - wanted).abs() < 1e-12, "{found:?} {wanted}");
        assert!((found.speed_mps - 1.5).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn on_a_circle_the_wheels_come_to_those_of_the_circle() {
        let config = config(&["path.pieces=[{kind='arc',radius_m=20.0,angle_deg=90.0}]"]);
        let tracked_m = config.vehicle.tracked_point_m;
        // The tracked point is on the circle, and the rear axle on a smaller one.
        let (at_rad, out_rad) = (0.3_f64, libm::asin(tracked_m / 20.0));
        let pose = Pose {
            x_m: 20.0 * libm::sin(at_rad),
            y_m: 20.0 * (1.0 - libm::cos(at_rad)),
            yaw_rad: at_rad - out_rad,
        };
        let mut law = Lqr::new(&config);
        let mut last = RawCommand::default();
        for _ in 0..2000 {
            last = command(&mut law, &config, pose, 2.0);
        }
        let rear_m = libm::sqrt(20.0 * 20.0 - tracked_m * tracked_m);
        let wanted_rad = libm::atan(2.875 / rear_m);
        assert!((last.steering_rad - wanted_rad).abs() < 1e-9, "{last:?}");
    }
}
