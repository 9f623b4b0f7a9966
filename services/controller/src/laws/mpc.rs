//! Model-predictive control: the steering plan over a horizon that costs least, within the limits of the steering, of
//! which the first part is driven.
//!
//! Linear time-varying, on the lateral error of a kinematic car, as in Kong, Pfeiffer, Schildbach, Borrelli, "Kinematic
//! and Dynamic Vehicle Models for Autonomous Driving Control Design", IEEE Intelligent Vehicles Symposium (2015), with the
//! error in place of the pose: speed is the reference's business.

use config::{Parameters, RunConfig};
use tracking::{tracking_error, wrap_angle};

use super::{HeldSteering, Law, LawState, RawCommand};
use crate::Sight;
use crate::quadratic::{Limits, N, Plan, Square, least};

/// The law with the steering angle of its last command.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mpc {
    tick_s: f64,
    steering_limit_rad: f64,
    steering_rate_radps: f64,
    /// Whether errors are measured at the nearest point of the path instead of against the moving reference.
    nearest: bool,
    steering: HeldSteering,
}

/// What a plan is weighed by, and over which time each of its angles is driven.
#[derive(Debug, Clone, Copy)]
struct Weights {
    offset: f64,
    heading: f64,
    travel_s2: f64,
    step_s: f64,
}

/// The car at the start of a plan.
#[derive(Debug, Clone, Copy)]
struct Start {
    speed_mps: f64,
    /// See [`Sight::wheelbase_m`].
    wheelbase_m: f64,
    /// The tracked point, ahead of the one that moves where the car points.
    tracked_m: f64,
    /// Of the tracked point, to the left of the path.
    offset_m: f64,
    /// To the left of the path's.
    heading_rad: f64,
    steering_rad: f64,
}

impl Mpc {
    /// The plan for a car, on a path that turns by these angles in the steps of the plan.
    ///
    /// In a step of T the wheels turn evenly from δ₋₁ to δ, so that the car turns by v·T/L·tan((δ₋₁ + δ)/2): linear
    /// around the angles of the path's own curvature. The cost is
    ///
    /// Σ q_y·y² + q_ψ·(ψ + asin(p·κ))² + (δ − atan(L·κ))² + r·((δ − δ₋₁)/T)²,
    ///
    /// with the tracked point p ahead of the rear axle.
    #[allow(clippy::needless_range_loop, reason = "indices as in the equations")]
    fn plan(&self, weights: Weights, start: Start, turns_rad: &Plan) -> Option<Plan> {
        let Weights { offset, heading, travel_s2, step_s } = weights;
        let step_m = start.speed_mps * step_s;
        let change_price = travel_s2 / (step_s * step_s);
        let limit_rad = self.steering_limit_rad;
        let mut h: Square = [[0.0; N]; N];
        let mut g: Plan = [0.0; N];
        // Offset and heading as they are without steering, and how they depend on each angle of the plan.
        let (mut y, mut psi) = (start.offset_m, start.heading_rad);
        let (mut y_by, mut psi_by) = ([0.0; N], [0.0; N]);
        for k in 0..N {
            let turn_rad = turns_rad[k];
            let curvature = if step_m == 0.0 { 0.0 } else { turn_rad / step_m };
            let wanted_rad = libm::atan(start.wheelbase_m * curvature).clamp(-limit_rad, limit_rad);
            // On a circle the car points out of it, so that its tracked point stays on it.
            let out_rad = libm::asin((start.tracked_m * curvature).clamp(-1.0, 1.0));
            // The car's turn is `turned + slope · (mean angle of the step)`.
            let tan = libm::tan(wanted_rad);
            let slope = step_m / start.wheelbase_m * (1.0 + tan * tan);
            let turned = step_m / start.wheelbase_m * tan - slope * wanted_rad;
            let mut by = [0.0; N];
            by[k] = 0.5 * slope;
            let mut turned = turned;
            if k > 0 {
                by[k - 1] = 0.5 * slope;
            } else {
                turned += 0.5 * slope * start.steering_rad;
            }
            // Half of the turn counts for the way of this step; the tracked point swings out by all of it.
            let swing_m = start.tracked_m + 0.5 * step_m;
            y += step_m * psi + swing_m * turned - 0.5 * step_m * turn_rad;
            psi += turned - turn_rad;
            for j in 0..=k {
                y_by[j] += step_m * psi_by[j] + swing_m * by[j];
                psi_by[j] += by[j];
            }
            for i in 0..=k {
                g[i] += offset * y * y_by[i] + heading * (psi + out_rad) * psi_by[i];
                for j in 0..=i {
                    h[i][j] += offset * y_by[i] * y_by[j] + heading * psi_by[i] * psi_by[j];
                }
            }
            h[k][k] += 1.0 + change_price;
            g[k] -= wanted_rad;
            if k > 0 {
                h[k - 1][k - 1] += change_price;
                h[k][k - 1] -= change_price;
            } else {
                g[0] -= change_price * start.steering_rad;
            }
        }
        for i in 0..N {
            for j in 0..i {
                h[j][i] = h[i][j];
            }
        }
        let limits = Limits {
            angle_rad: limit_rad,
            change_rad: self.steering_rate_radps * step_s,
            last_rad: start.steering_rad,
        };
        least(&h, &g, &limits)
    }
}

impl Law for Mpc {
    fn new(config: &RunConfig) -> Self {
        let vehicle = &config.vehicle;
        Self {
            tick_s: config.drive.tick_s,
            steering_limit_rad: config.controller.steering_limit_rad,
            steering_rate_radps: vehicle
                .steering_rate_radps
                .min(vehicle.safety.steering_rate_limit_radps),
            nearest: config.law.settings.text("errors_at") != "reference",
            steering: HeldSteering::new(config),
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

    /// With the parameters Kv (1/s), q_y (rad²/m²), q_ψ, the price r (s²) of the square of the steering rate, and the
    /// horizon (s), of which each of the N steps is a part T: drives a tick h of the plan's first step,
    ///
    /// φ = φ₋₁ + (δ₁ − φ₋₁)·h/T,  v = v_ref + Kv·e_s,  φ within its limit.
    fn command(&mut self, parameters: &Parameters, sight: &Sight) -> RawCommand {
        let [kv, offset, heading, travel_s2, horizon_s, ..] = parameters.0;
        let (error, from_m) = if self.nearest {
            let point = sight.projection();
            (tracking_error(point.pose, sight.pose), point.along_m)
        } else {
            (sight.error, sight.reference_along_m())
        };
        let step_s = horizon_s / N as f64;
        let mut at_rad = sight.path_ahead(from_m, 0.0).yaw_rad;
        let step_m = sight.speed_mps * step_s;
        let turns_rad = std::array::from_fn(|k| {
            let next_rad = sight.path_ahead(from_m, step_m * (k + 1) as f64).yaw_rad;
            wrap_angle(next_rad - std::mem::replace(&mut at_rad, next_rad))
        });
        let last_rad = self.steering.angle_rad();
        let start = Start {
            speed_mps: sight.speed_mps,
            wheelbase_m: sight.wheelbase_m(),
            tracked_m: sight.tracked_m(),
            // The path lies where the error says, seen from the car.
            offset_m: -error.cross_track_m * libm::cos(error.heading_rad)
                + error.along_track_m * libm::sin(error.heading_rad),
            heading_rad: -error.heading_rad,
            steering_rad: last_rad,
        };
        let weights = Weights { offset, heading, travel_s2, step_s };
        // A plan that cannot be found, for numbers beyond any car's, is to hold the wheels.
        let first_rad = self.plan(weights, start, &turns_rad).map_or(last_rad, |plan| plan[0]);
        let phi = self.steering.hold(last_rad + (first_rad - last_rad) * self.tick_s / step_s);
        RawCommand::following(sight, kv, phi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use tracking::{Pose, Reference};

    fn config(sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set_law("test", "mpc").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    const WEIGHTS: Weights = Weights { offset: 1.0, heading: 1.0, travel_s2: 0.1, step_s: 0.1 };

    /// Derived outside this project: the error model simulated in Python for each angle of the plan, and the programme
    /// solved by quadprog 0.1.13. Both plans meet the limit of the rate, the second also that of the angle.
    #[test]
    fn a_plan_is_that_of_an_independent_solver() {
        let mpc = Mpc::new(&config(&[]));
        let check = |start: Start, turns_rad: Plan, wanted: [f64; 5]| {
            let plan = mpc.plan(WEIGHTS, start, &turns_rad).unwrap();
            for (place, wanted_rad) in [0, 1, 5, 12, 19].into_iter().zip(wanted) {
                let found_rad = plan[place];
                assert!((found_rad - wanted_rad).abs() < 1e-8, "{place}: {found_rad} {wanted_rad}");
            }
        };
        let turns_rad = std::array::from_fn(|k| match k {
            0..8 => 0.0,
            8..14 => 0.02,
            _ => -0.05,
        });
        check(
            Start {
                speed_mps: 2.0,
                wheelbase_m: 2.875,
                tracked_m: 0.7,
                offset_m: 0.3,
                heading_rad: -0.1,
                steering_rad: 0.05,
            },
            turns_rad,
            [
                0.025627571585643875,
                0.01605871834743292,
                0.054266932614828664,
                0.02363012908977126,
                -0.33165115922440197,
            ],
        );
        check(
            Start {
                speed_mps: 3.0,
                wheelbase_m: 2.875,
                tracked_m: 0.7,
                offset_m: 5.0,
                heading_rad: 0.5,
                steering_rad: 0.1,
            },
            [0.0; N],
            [0.04, -0.02, -0.26, -0.5235987755982988, -0.498479781974141],
        );
    }

    #[test]
    fn on_the_path_the_plan_is_the_path_s_own_curvature() {
        let mpc = Mpc::new(&config(&[]));
        let curvature = 1.0 / 18.0;
        let steering_rad = libm::atan(2.875 * curvature);
        let start = Start {
            speed_mps: 2.0,
            wheelbase_m: 2.875,
            tracked_m: 0.7,
            offset_m: 0.0,
            heading_rad: -libm::asin(0.7 * curvature),
            steering_rad,
        };
        let plan = mpc.plan(WEIGHTS, start, &[0.2 * curvature; N]).unwrap();
        for angle_rad in plan {
            assert!((angle_rad - steering_rad).abs() < 2e-3, "{angle_rad} {steering_rad}");
        }
    }

    #[test]
    fn a_plan_keeps_to_the_limits_and_a_car_at_rest_does_not_steer() {
        let mpc = Mpc::new(&config(&[]));
        let start = Start {
            speed_mps: 3.0,
            wheelbase_m: 2.875,
            tracked_m: 0.7,
            offset_m: 5.0,
            heading_rad: 0.5,
            steering_rad: 0.1,
        };
        let plan = mpc.plan(WEIGHTS, start, &[0.0; N]).unwrap();
        let mut last_rad = start.steering_rad;
        for angle_rad in plan {
            assert!(angle_rad.abs() <= mpc.steering_limit_rad + 1e-8);
            let change_rad = mpc.steering_rate_radps * WEIGHTS.step_s;
            assert!((angle_rad - last_rad).abs() <= change_rad + 1e-8);
            last_rad = angle_rad;
        }
        let rest = Start { speed_mps: 0.0, steering_rad: 0.0, ..start };
        assert_eq!(mpc.plan(WEIGHTS, rest, &[0.0; N]).unwrap(), [0.0; N]);
    }

    #[test]
    fn a_tick_is_a_part_of_the_plan_s_first_step() {
        let config = config(&["path.pieces=[{kind='straight',length_m=50.0}]"]);
        let mut reference = Reference::new(&config);
        let pose = Pose { x_m: 10.0, y_m: 0.5, yaw_rad: 0.1 };
        let reference_pose = reference.advance(700.0, pose);
        let sight = Sight::new(&config, &reference, 700.0, reference_pose, pose, 2.0, 0.0);
        let mut law = Mpc::new(&config);
        law.restart(0.2);
        let start = Start {
            speed_mps: 2.0,
            wheelbase_m: 2.875,
            tracked_m: 0.7,
            offset_m: 0.5,
            heading_rad: 0.1,
            steering_rad: 0.2,
        };
        let plan = law.plan(WEIGHTS, start, &[0.0; N]).unwrap();
        let command = law.command(&Parameters::of(&[0.0, 1.0, 1.0, 0.1, 2.0]), &sight);
        let wanted_rad = 0.2 + 0.1 * (plan[0] - 0.2);
        assert!((command.steering_rad - wanted_rad).abs() < 1e-9, "{command:?} {wanted_rad}");
        assert!((command.speed_mps - 1.5).abs() < 1e-12);
    }
}
