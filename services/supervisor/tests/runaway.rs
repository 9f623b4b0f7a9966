//! A vehicle that drives on although it is braked: its reference goes along with it, until the path ends.

use config::Layers;
use ipc_types::Safety;
use supervisor::{Action, Movement, RawCommand, State, Watch};
use tracking::{FASTEST_CLOCK, Pose};

const TICK_S: f64 = 0.01;
const LENGTH_M: f64 = 60.0;
const PATH_MPS: f64 = 1.5;

/// A car with its reference, on a straight along x.
struct Drive {
    watch: Watch,
    tick: u64,
    x_m: f64,
    speed_mps: f64,
    along_m: f64,
}

impl Drive {
    fn new() -> Self {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set_vehicle("test", "tesla_model_3_guarded").unwrap();
        for set in [
            &format!("path.pieces=[{{kind='straight',length_m={LENGTH_M:?}}}]"),
            "vehicle.gear_engaged=true",
            &format!("reference.speed_mps={PATH_MPS:?}"),
        ] {
            layers.set(set).unwrap();
        }
        let watch = Watch::new(&layers.resolve().unwrap());
        Self { watch, tick: 0, x_m: 0.0, speed_mps: 0.0, along_m: 0.0 }
    }

    /// Some ticks in which the car's speed changes by so much in a second; the last rate of the clock.
    fn drive(&mut self, seconds: f64, mps2: f64) -> f64 {
        let mut rate = 0.0;
        for _ in 0..(seconds / TICK_S).round() as u64 {
            self.speed_mps = (self.speed_mps + mps2 * TICK_S).max(0.0);
            self.x_m += self.speed_mps * TICK_S;
            let pose = Pose { x_m: self.x_m, ..Pose::default() };
            let movement = Movement { pose, speed_mps: self.speed_mps, yaw_rate_radps: 0.0 };
            self.watch.see(self.tick, movement, true);
            self.watch.follow(self.along_m);
            let raw = RawCommand { speed_mps: PATH_MPS, yaw_rate_radps: 0.0, steering_rad: 0.0 };
            self.watch.command(TICK_S, 0, Some(raw));
            rate = self.watch.clock_rate(1.0);
            self.along_m = (self.along_m + rate * PATH_MPS * TICK_S).min(LENGTH_M);
            self.tick += 1;
        }
        rate
    }

    /// How far the reference is ahead of the car.
    fn ahead_m(&self) -> f64 {
        self.along_m - self.x_m
    }
}

#[test]
fn the_reference_goes_along_with_a_vehicle_that_runs_away_until_the_path_ends() {
    let mut drive = Drive::new();
    // Up to 4 m/s, where 1.5 m/s is asked for.
    drive.drive(2.0, 2.0);
    assert_eq!(drive.watch.action(), Some(Action::Brake));
    let rate = drive.drive(2.0, 0.0);
    assert!((rate - 4.0 / PATH_MPS).abs() < 0.05, "{rate}");
    // By 0.6 s of its drive.
    assert!((drive.ahead_m() - 2.4).abs() < 0.1, "{}", drive.ahead_m());
    // It slows down after all: the reference comes to rest with it.
    drive.drive(1.0, -2.0);
    assert!((drive.ahead_m() - 1.2).abs() < 0.4, "{}", drive.ahead_m());
    // It does not.
    drive.drive(1.0, 2.0);
    assert!((0.0..=FASTEST_CLOCK).contains(&drive.drive(8.0, 0.0)));
    assert!(drive.along_m < LENGTH_M && drive.ahead_m() > 2.0, "{}", drive.ahead_m());
    // Behind the end there is nothing to follow.
    assert_eq!(drive.drive(8.0, 0.0), 0.0);
    assert_eq!(drive.along_m, LENGTH_M);
    assert_eq!(drive.watch.state(), State::Stopping);
    // It stands, and the reference with it.
    assert_eq!(drive.drive(3.0, -4.0), 0.0);
    assert_eq!(drive.watch.state(), State::Stopped);
}

#[test]
fn beside_a_vehicle_that_steers_the_wrong_way_round_it_stands() {
    let mut drive = Drive::new();
    drive.drive(2.0, 2.0);
    assert!(drive.drive(1.0, 0.0) > 1.0);
    drive.watch.stop(Safety::STEERING_REVERSED);
    assert_eq!(drive.drive(0.02, 0.0), 0.0);
    assert_eq!(drive.watch.action(), Some(Action::BrakeStraight));
}
