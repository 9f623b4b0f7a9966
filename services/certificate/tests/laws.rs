//! The additional dead time of any law: linearised from the law itself, held to the exact loop of the paper's law and to
//! cars that are driven with that much more dead time.

use certificate::{Car, Gains, LateralLoop, LawLoop};
use config::{Layers, Parameters, RunConfig};
use rollout::{Plant, Rollout};
use simulator::{Observation, SimulatedVehicle};
use tracking::Pose;

fn config(maneuver: &str, sets: &[&str]) -> RunConfig {
    let mut layers = Layers::maneuver(maneuver).unwrap();
    for set in sets {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

#[test]
fn of_the_papers_law_it_is_the_exact_one() {
    let (mut seen, mut unstable) = (0, 0);
    for (delay_s, lag_s) in [(0.0, 0.0), (0.12, 0.08), (0.24, 0.27)] {
        let late = [
            format!("vehicle.steering_delay_s={delay_s}"),
            format!("vehicle.steering_lag_s={lag_s}"),
            "controller.compensate_dead_time=false".to_owned(),
        ];
        let late: Vec<&str> = late.iter().map(String::as_str).collect();
        let config = config("roundabout", &late);
        let (car, grid) = (Car::new(&config), config.grid());
        for position in grid.positions().step_by(47) {
            let set = grid.set(position);
            for speed_mps in [1.5, 3.5] {
                let exact = LateralLoop::steady(&car, &Gains::new(&set), speed_mps);
                let law = LawLoop::new(&config, &set, speed_mps).unwrap();
                let lead_m = speed_mps / set.0[0];
                assert!((law.lead_m() - lead_m).abs() < 1e-6, "{set:?}: {}", law.lead_m());
                // Closer to the edge than this, they may differ.
                if (exact.spectral_radius() - 1.0).abs() > 1e-5 {
                    assert_eq!(law.is_stable(), exact.is_stable(), "{set:?} {speed_mps}");
                }
                let [wanted_s, got_s] =
                    [exact.additional_dead_time_s(), law.additional_dead_time_s()];
                assert!((got_s - wanted_s).abs() < 1e-5, "{set:?}: {got_s}, exact {wanted_s}");
                seen += 1;
                unstable += usize::from(wanted_s == 0.0);
            }
        }
    }
    assert!(unstable > 5 && seen - unstable > 40, "{unstable} of {seen}");
}

/// A car that starts a little beside the path.
struct Beside(SimulatedVehicle);

impl Plant for Beside {
    fn reset(&mut self, start: Pose, noise_seed: Option<u64>) {
        self.0.reset(Pose { y_m: start.y_m + 0.01, ..start }, noise_seed);
    }

    fn observe(&mut self) -> Observation {
        self.0.observe()
    }

    fn step(&mut self, speed_mps: f64, steering_rad: f64) {
        self.0.step(speed_mps, steering_rad);
    }
}

/// How far a law's car is from a straight path at the end, with the steering that much later than its file says.
fn left_m(config: &RunConfig, set: Parameters, later_s: f64) -> f64 {
    let mut plant = config.clone();
    plant.vehicle.steering_delay_s += later_s;
    let mut rollout = Rollout::around(Beside(SimulatedVehicle::new(&plant)), config);
    let (mut left_m, last) = (0.0_f64, config.ticks() - 500);
    rollout.drive_with(set, None, |tick, record| {
        if tick >= last {
            left_m = left_m.max(record.observation.truth.y_m.abs());
        }
    });
    left_m
}

#[test]
fn of_every_law_a_car_that_is_later_by_less_comes_to_rest_and_by_more_does_not() {
    for law in ["paper", "pure_pursuit", "stanley", "lqr", "mpc"] {
        for (delay_s, lag_s) in [(0.0, 0.0), (0.12, 0.08)] {
            let settings = [
                format!("law_preset={law}"),
                format!("vehicle.steering_delay_s={delay_s}"),
                format!("vehicle.steering_lag_s={lag_s}"),
                "controller.compensate_dead_time=true".to_owned(),
                "path.pieces=[{kind='straight',length_m=2000.0}]".to_owned(),
                "reference.speed_mps=3.0".to_owned(),
                "drive.loop_time_s=80".to_owned(),
                "vehicle.gear_engaged=true".to_owned(),
            ];
            let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
            let config = config("lane_change", &settings);
            let set = config.law.defaults();
            let law_loop = LawLoop::new(&config, &set, 3.0).unwrap();
            let margin_s = law_loop.additional_dead_time_s();
            println!("{law} ({delay_s}, {lag_s}): {:.1} ms", 1000.0 * margin_s);
            assert!(margin_s > 0.03, "{law}: {margin_s}");
            if margin_s > 2.0 {
                continue;
            }
            let [less, more] = [0.9, 1.1].map(|share| left_m(&config, set, share * margin_s));
            println!("{law} ({delay_s}, {lag_s}): {less} m with less, {more} m with more");
            assert!(less < 2e-3 && more > 5.0 * less, "{law} ({delay_s}, {lag_s}): {less} {more}");
        }
    }
}
