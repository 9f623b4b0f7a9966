//! How the vehicle turns: the lateral half of the single track, kinematic or dynamic.
//!
//! Both move the rear axle by one tick at a forward speed and an angle of the road wheels. The kinematic
//! one assumes that no tyre slips, which holds up to about 4 m/s; the dynamic one has linear tyres, a mass and an
//! inertia, and turns into the kinematic one as the speed goes to 0.

use config::{Vehicle, VehicleModel};
use tracking::{Pose, Turning};

/// A lateral model with its state.
#[derive(Debug, Clone)]
pub(crate) enum Lateral {
    /// No tyre slips, but for what the vehicle's file says of it.
    Kinematic {
        /// Slip angle of the rear axle per lateral acceleration, rad/(m/s²).
        rear_slip_s2pm: f64,
        /// How it turns.
        turning: Turning,
    },
    /// Linear tyres. Boxed, because it is four times as large.
    Dynamic(Box<DynamicSingleTrack>),
}

impl Lateral {
    /// The configured model, at rest.
    pub(crate) fn new(vehicle: &Vehicle) -> Self {
        match vehicle.model {
            VehicleModel::Kinematic => Self::Kinematic {
                rear_slip_s2pm: vehicle.rear_slip_s2pm,
                turning: Turning::new(vehicle),
            },
            VehicleModel::Dynamic => Self::Dynamic(Box::new(DynamicSingleTrack::new(vehicle))),
        }
    }

    /// Returns to rest.
    pub(crate) fn reset(&mut self) {
        match self {
            Self::Dynamic(track) => (track.lateral_mps, track.yaw_rate_radps) = (0.0, 0.0),
            Self::Kinematic { turning, .. } => turning.set(0.0, 0.0),
        }
    }

    /// Moves the rear axle by one tick; returns the yaw rate.
    pub(crate) fn step(
        &mut self,
        rear_axle: &mut Pose,
        speed_mps: f64,
        steering_rad: f64,
        tick_s: f64,
    ) -> f64 {
        match self {
            Self::Kinematic { rear_slip_s2pm, turning } => {
                let turned_rad = turning.turn(steering_rad, speed_mps, tick_s);
                // The heading in the middle of the tick: exact to second order.
                let middle_rad = rear_axle.yaw_rad + turned_rad / 2.0;
                rear_axle.x_m += speed_mps * tick_s * libm::cos(middle_rad);
                rear_axle.y_m += speed_mps * tick_s * libm::sin(middle_rad);
                if *rear_slip_s2pm != 0.0 {
                    // Outwards, as much as its tyres slip.
                    let out_m = *rear_slip_s2pm * speed_mps * speed_mps * turned_rad;
                    rear_axle.x_m += out_m * libm::sin(middle_rad);
                    rear_axle.y_m -= out_m * libm::cos(middle_rad);
                }
                rear_axle.yaw_rad += turned_rad;
                turning.yaw_rate_radps()
            }
            Self::Dynamic(track) => {
                track.step(speed_mps, steering_rad, tick_s);
                let turned_rad = track.yaw_rate_radps * tick_s;
                let middle_rad = rear_axle.yaw_rad + turned_rad / 2.0;
                let (sin, cos) = (libm::sin(middle_rad), libm::cos(middle_rad));
                let left_mps = track.rear_lateral_mps();
                rear_axle.x_m += tick_s * (speed_mps * cos - left_mps * sin);
                rear_axle.y_m += tick_s * (speed_mps * sin + left_mps * cos);
                rear_axle.yaw_rad += turned_rad;
                track.yaw_rate_radps
            }
        }
    }
}

/// The dynamic single track. In its equations, all in the vehicle frame (x forward, y left):
///
/// - `v` is the forward speed, `w` the lateral speed at the centre of gravity, `r` the yaw rate;
/// - `a` and `b` are the distances of front and rear axle from the centre of gravity, `L` = a + b;
/// - `m` is the mass, `J` the inertia about the vertical axis;
/// - `Cf` and `Cr` are the axles' cornering stiffnesses, `δ` is the angle of the road wheels.
///
/// The tyres' side forces are Ff = −Cf·((w + a·r)/v − tan δ) and Fr = −Cr·(w − b·r)/v. With tan δ for δ
/// the slip is 0 exactly where the kinematic single track rolls. The motion is
///
/// m·(ẇ + v·r) = Ff + Fr and J·ṙ = a·Ff − b·Fr.
#[derive(Debug, Clone)]
pub(crate) struct DynamicSingleTrack {
    mass_kg: f64,
    yaw_inertia_kgm2: f64,
    front_m: f64,
    rear_m: f64,
    front_npr: f64,
    rear_npr: f64,
    lateral_mps: f64,
    yaw_rate_radps: f64,
}

impl DynamicSingleTrack {
    fn new(vehicle: &Vehicle) -> Self {
        Self {
            mass_kg: vehicle.mass_kg,
            yaw_inertia_kgm2: vehicle.yaw_inertia_kgm2,
            front_m: vehicle.front_axle_to_cg_m,
            rear_m: vehicle.wheelbase_m - vehicle.front_axle_to_cg_m,
            front_npr: vehicle.cornering_stiffness_front_npr,
            rear_npr: vehicle.cornering_stiffness_rear_npr,
            lateral_mps: 0.0,
            yaw_rate_radps: 0.0,
        }
    }

    /// One tick of backward Euler in (w, r) at a fixed speed: the two equations of motion, linear in the new
    /// w and r, each multiplied by v. So nothing is divided by the speed, the stiff tyres of a slow car do
    /// no harm, and at v = 0 the solution is w = r = 0.
    fn step(&mut self, v: f64, steering_rad: f64, tick_s: f64) {
        let Self { mass_kg: m, yaw_inertia_kgm2: j, front_m: a, rear_m: b, .. } = *self;
        let (cf, cr) = (self.front_npr, self.rear_npr);
        let inertia = v / tick_s;
        let forward = cf * v * libm::tan(steering_rad);
        // (w, r)' solves [[ww, wr], [rw, rr]]·(w, r)' = (w_side, r_side).
        let ww = m * inertia + cf + cr;
        let wr = a * cf - b * cr + m * v * v;
        let rw = a * cf - b * cr;
        let rr = j * inertia + a * a * cf + b * b * cr;
        let w_side = m * inertia * self.lateral_mps + forward;
        let r_side = j * inertia * self.yaw_rate_radps + a * forward;
        // Above 0 at every speed below that at which an oversteering car becomes unstable; the
        // configuration rules out higher speeds.
        let determinant = ww * rr - wr * rw;
        self.lateral_mps = (w_side * rr - r_side * wr) / determinant;
        self.yaw_rate_radps = (ww * r_side - rw * w_side) / determinant;
    }

    /// Lateral speed of the rear axle.
    fn rear_lateral_mps(&self) -> f64 {
        self.lateral_mps - self.rear_m * self.yaw_rate_radps
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use proptest::prelude::*;

    fn dynamic(sets: &[&str]) -> Vehicle {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set("vehicle_preset=tesla_model_3_dynamic").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap().vehicle
    }

    fn kinematic() -> Vehicle {
        Layers::maneuver("lane_change").unwrap().resolve().unwrap().vehicle
    }

    /// The yaw rate and the radius of the rear axle's circle after a long time.
    fn steady(vehicle: &Vehicle, speed_mps: f64, steering_rad: f64) -> (f64, f64) {
        let mut lateral = Lateral::new(vehicle);
        let mut at = Pose::default();
        let mut rate = 0.0;
        for _ in 0..3000 {
            rate = lateral.step(&mut at, speed_mps, steering_rad, 0.01);
        }
        let before = at;
        lateral.step(&mut at, speed_mps, steering_rad, 0.01);
        let moved_m = libm::hypot(at.x_m - before.x_m, at.y_m - before.y_m);
        (rate, moved_m / 0.01 / rate)
    }

    #[test]
    fn the_preset_is_the_same_car_with_another_model() {
        let (kinematic, dynamic) = (kinematic(), dynamic(&[]));
        assert_eq!(dynamic.model, VehicleModel::Dynamic);
        assert_eq!(dynamic.name, "tesla_model_3_dynamic");
        let name = kinematic.name.clone();
        assert_eq!(Vehicle { model: VehicleModel::Kinematic, name, ..dynamic }, kinematic);
    }

    #[test]
    fn the_steady_yaw_rate_is_the_textbook_s() {
        let check = |vehicle: &Vehicle| {
            let length_m = vehicle.wheelbase_m;
            let (a, b) = (vehicle.front_axle_to_cg_m, length_m - vehicle.front_axle_to_cg_m);
            let (cf, cr) =
                (vehicle.cornering_stiffness_front_npr, vehicle.cornering_stiffness_rear_npr);
            let understeer = vehicle.mass_kg * (b * cr - a * cf) / (cf * cr * length_m);
            for speed_mps in [0.5f64, 4.0, 15.0, 30.0] {
                let per_angle = speed_mps / (length_m + understeer * speed_mps * speed_mps);
                // A small angle, as in the textbook, and a large one by its tangent.
                let (rate, _) = steady(vehicle, speed_mps, 1e-3);
                assert!((rate / (per_angle * 1e-3) - 1.0).abs() < 1e-6, "{speed_mps} m/s: {rate}");
                let (rate, _) = steady(vehicle, speed_mps, 0.1);
                assert!((rate / (per_angle * libm::tan(0.1)) - 1.0).abs() < 1e-9);
            }
        };
        check(&dynamic(&[]));
        check(&dynamic(&["vehicle.front_axle_to_cg_m=1.0"]));
        // Neutral, and slightly oversteering: valid below the critical speed.
        check(&dynamic(&["vehicle.cornering_stiffness_rear_npr=222900.0"]));
        check(&dynamic(&["vehicle.cornering_stiffness_rear_npr=222000.0"]));
    }

    #[test]
    fn slow_driving_is_kinematic() {
        // A loop with all the angles that the gains of a lane change command, at the paper's speeds.
        let drive = |vehicle: &Vehicle, speed_mps: f64| {
            let mut lateral = Lateral::new(vehicle);
            let mut at = Pose::default();
            let mut way = Vec::new();
            for tick in 0..1500 {
                let time_s = 0.01 * f64::from(tick);
                let speed_mps = speed_mps * time_s.min(1.0);
                lateral.step(&mut at, speed_mps, 0.5 * libm::sin(0.9 * time_s), 0.01);
                way.push(at);
            }
            way
        };
        for speed_mps in [0.3, 1.0, 1.5] {
            let (slips, rolls) = (drive(&dynamic(&[]), speed_mps), drive(&kinematic(), speed_mps));
            let mut squares = (0.0, 0.0);
            for (slip, roll) in slips.iter().zip(&rolls) {
                let apart_m = libm::hypot(slip.x_m - roll.x_m, slip.y_m - roll.y_m);
                squares.0 += apart_m * apart_m;
                squares.1 += roll.y_m * roll.y_m;
                assert!((slip.yaw_rad - roll.yaw_rad).abs() < 0.02);
            }
            // Compared with how far the loop goes sideways, which is what an mse measures.
            assert!(squares.0 / squares.1 < 1e-3, "{speed_mps} m/s: {squares:?}");
        }
        let (_, radius_m) = steady(&dynamic(&[]), 0.01, 0.3);
        assert!((radius_m * libm::tan(0.3) / 2.875 - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_rear_axle_that_slips_drives_a_circle_outside_of_where_it_points() {
        let vehicle = Vehicle { rear_slip_s2pm: 0.004, ..kinematic() };
        for (speed_mps, steering_rad) in [(2.0, 0.3), (6.0, 0.1), (6.0, -0.1)] {
            let (rate, radius_m) = steady(&vehicle, speed_mps, steering_rad);
            assert!((rate * 2.875 / libm::tan(steering_rad) - speed_mps).abs() < 1e-12);
            // It moves by the angle c·v·r beside its heading: forwards at v, outwards at c·v²·r.
            let out = 0.004 * speed_mps * rate;
            assert!((radius_m * rate / speed_mps - libm::sqrt(1.0 + out * out)).abs() < 1e-6);
            // As the dynamic car's does, whose slip per acceleration is m·a/(L·Cr).
            let slip_s2pm = 2035.0 * 1.4375 / (2.875 * 352_300.0);
            let linear = dynamic(&[]);
            let like = Vehicle { rear_slip_s2pm: slip_s2pm, ..kinematic() };
            let beside = |vehicle: &Vehicle| {
                let mut lateral = Lateral::new(vehicle);
                let mut at = Pose::default();
                let mut last = at;
                for _ in 0..3000 {
                    last = at;
                    lateral.step(&mut at, speed_mps, steering_rad, 0.01);
                }
                let way_rad = libm::atan2(at.y_m - last.y_m, at.x_m - last.x_m);
                tracking::wrap_angle(way_rad - 0.5 * (at.yaw_rad + last.yaw_rad))
            };
            // It understeers a little, which the kinematic one does not.
            assert!((beside(&like) / beside(&linear) - 1.0).abs() < 0.05);
        }
    }

    #[test]
    fn faster_driving_is_not() {
        let (slips, rolls) = (steady(&dynamic(&[]), 15.0, 0.05), steady(&kinematic(), 15.0, 0.05));
        assert!(slips.0 < 0.95 * rolls.0 && slips.1 > 1.05 * rolls.1);
    }

    #[test]
    fn a_standing_car_does_not_move() {
        let mut lateral = Lateral::new(&dynamic(&[]));
        let start = Pose { x_m: 1.0, y_m: 2.0, yaw_rad: 0.5 };
        let mut at = start;
        for tick in 0..500 {
            let rate = lateral.step(&mut at, 0.0, 0.5 * libm::sin(f64::from(tick)), 0.01);
            assert_eq!((rate, at), (0.0, start));
        }
        // It does not remember how it was driven before it stopped, or before a reset, either.
        lateral.step(&mut at, 9.0, 0.3, 0.01);
        lateral.reset();
        let mut again = start;
        let first = Lateral::new(&dynamic(&[])).step(&mut again, 3.0, 0.1, 0.01);
        let mut at = start;
        assert_eq!((lateral.step(&mut at, 3.0, 0.1, 0.01), at), (first, again));
    }

    proptest! {
        #[test]
        fn random_driving_stays_bounded(
            commands in prop::collection::vec((0.0..50.0f64, -0.52..0.52f64, 1usize..60), 1..60),
            tick_s in 0.001..0.1f64,
            // Down to slightly oversteering, with a critical speed just above the limit.
            rear_npr in prop_oneof![Just(352_300.0), 217_000.0..225_000.0f64, 225_000.0..1e7f64],
        ) {
            let stiffness = format!("vehicle.cornering_stiffness_rear_npr={rear_npr:?}");
            let vehicle = dynamic(&["vehicle.speed_limit_mps=50.0", &stiffness]);
            let mut lateral = Lateral::new(&vehicle);
            let mut at = Pose::default();
            for (speed_mps, steering_rad, ticks) in commands {
                for _ in 0..ticks {
                    let before = at;
                    let rate = lateral.step(&mut at, speed_mps, steering_rad, tick_s);
                    prop_assert!(at.is_finite() && rate.abs() < 60.0, "{rate}");
                    let moved_m = libm::hypot(at.x_m - before.x_m, at.y_m - before.y_m);
                    prop_assert!(moved_m < 4.0 * 50.0 * tick_s, "{moved_m}");
                }
            }
        }
    }
}
