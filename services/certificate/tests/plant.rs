//! The linear loop against our plant: the simulated vehicle, steered by the paper's law.

use certificate::{Car, Gains, LateralLoop};
use config::{Layers, Parameters, RunConfig};
use controller::{ControlLaw, Sight};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulator::SimulatedVehicle;
use tracking::{Pose, Reference};

/// A configuration of the paper's law with a car whose steering is this late and this slow.
fn config(speed_mps: f64, delay_s: f64, lag_s: f64) -> RunConfig {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    for set in [
        format!("reference.speed_mps={speed_mps:?}"),
        format!("vehicle.steering_delay_s={delay_s:?}"),
        format!("vehicle.steering_lag_s={lag_s:?}"),
        // Out of the way: the loop is linear without it.
        "vehicle.steering_rate_radps=100.0".into(),
        "vehicle.gear_engaged=true".into(),
    ] {
        layers.set(&set).unwrap();
    }
    layers.resolve().unwrap()
}

/// The straight line on which the reference runs: where it is, and its heading.
struct Line {
    at: [f64; 2],
    yaw_rad: f64,
}

impl Line {
    /// The line on which a car at `pose` has this offset and heading, this far behind the reference.
    fn beside(pose: Pose, behind_m: f64, offset_m: f64, heading_rad: f64) -> Self {
        let yaw_rad = pose.yaw_rad - heading_rad;
        let (sin, cos) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
        let x = pose.x_m + cos * behind_m + sin * offset_m;
        let y = pose.y_m + sin * behind_m - cos * offset_m;
        Self { at: [x, y], yaw_rad }
    }

    fn pose(&self) -> Pose {
        Pose { x_m: self.at[0], y_m: self.at[1], yaw_rad: self.yaw_rad }
    }

    fn run(&mut self, way_m: f64) {
        self.at[0] += way_m * libm::cos(self.yaw_rad);
        self.at[1] += way_m * libm::sin(self.yaw_rad);
    }

    /// Offset and heading of a pose.
    fn sees(&self, pose: Pose) -> [f64; 2] {
        let (dx, dy) = (pose.x_m - self.at[0], pose.y_m - self.at[1]);
        let offset = libm::cos(self.yaw_rad) * dy - libm::sin(self.yaw_rad) * dx;
        [offset, pose.yaw_rad - self.yaw_rad]
    }
}

/// The largest difference between model and plant over 4 s, relative to the largest offset.
fn difference(config: &RunConfig, set: &Parameters, offset_m: f64, heading_rad: f64) -> f64 {
    let speed_mps = config.reference.speed_mps;
    let gains = Gains::new(set);
    let model = LateralLoop::steady(&Car::new(config), &gains, speed_mps);
    let reference = Reference::new(config);
    let mut vehicle = SimulatedVehicle::new(config);
    let mut law = ControlLaw::new(config);
    vehicle.reset(Pose::default(), None);
    let lead_m = speed_mps / gains.kv;
    let mut line = Line { at: [lead_m, 0.0], yaw_rad: 0.0 };
    let mut tick = |vehicle: &mut SimulatedVehicle, line: &mut Line| {
        let seen = vehicle.observe();
        let sight =
            Sight::new(config, &reference, 0.0, line.pose(), seen.truth, seen.speed_mps, 0.0);
        let raw = law.command(set, &sight);
        vehicle.step(raw.speed_mps, raw.steering_rad);
        line.run(speed_mps * config.drive.tick_s);
        sight.error.along_track_m
    };
    let mut ahead_m = 0.0;
    for _ in 0..60_000 {
        ahead_m = tick(&mut vehicle, &mut line);
        let is_steady = (ahead_m / lead_m - 1.0).abs() < 1e-7;
        if is_steady && (vehicle.observe().speed_mps / speed_mps - 1.0).abs() < 1e-7 {
            break;
        }
    }
    assert!((ahead_m / lead_m - 1.0).abs() < 1e-6, "not steady: {ahead_m} {lead_m}");
    line = Line::beside(vehicle.observe().truth, ahead_m, offset_m, heading_rad);
    let mut state = vec![0.0; model.order()];
    (state[0], state[1]) = (offset_m, heading_rad);
    let (mut apart, mut largest) = (0.0f64, 0.0f64);
    for _ in 0..400 {
        tick(&mut vehicle, &mut line);
        model.step(&mut state);
        let [offset, heading] = line.sees(vehicle.observe().truth);
        // An unstable loop leaves the range in which a model can be linear.
        if heading.abs() > 1e-3 || state[2].abs() > 1e-3 {
            break;
        }
        apart = apart.max((offset - state[0]).abs());
        largest = largest.max(offset.abs());
    }
    apart / largest
}

/// The differences of `count` random sets at random speeds.
fn differences(count: usize, late: bool) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(28);
    let mut all: Vec<f64> = (0..count)
        .map(|index| {
            let maneuver = if index % 2 == 0 { "lane_change" } else { "roundabout" };
            let grid = Layers::maneuver(maneuver).unwrap().resolve().unwrap().grid();
            let set = grid.set(grid.position(rng.random_range(0..grid.len())));
            let speed_mps = rng.random_range(1.0..4.0);
            let up_to = if late { 0.3 } else { 0.0 };
            let delay_s = rng.random::<f64>() * up_to;
            // Whole ticks, parts of ticks, lag alone and dead time alone.
            let delay_s = if index % 3 == 0 { (delay_s * 100.0).round() / 100.0 } else { delay_s };
            let delay_s = if index % 7 == 0 { 0.0 } else { delay_s };
            let lag_s = if index % 5 == 0 { 0.0 } else { rng.random::<f64>() * up_to };
            let (offset_m, heading_rad) =
                (rng.random_range(-1e-5..1e-5), rng.random_range(-1e-5..1e-5));
            difference(&config(speed_mps, delay_s, lag_s), &set, offset_m, heading_rad)
        })
        .collect();
    all.sort_by(f64::total_cmp);
    println!("median {:e}, largest {:e} of {count}", all[count / 2], all[count - 1]);
    all
}

#[test]
fn the_linear_loop_is_the_plant_s() {
    assert!(differences(200, false).last().unwrap() < &1e-4);
}

#[test]
fn the_linear_loop_is_the_plant_s_with_dead_time_and_lag() {
    assert!(differences(200, true).last().unwrap() < &1e-4);
}
