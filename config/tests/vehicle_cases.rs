//! What users' vehicle files and settings led to, each named after its case: what the start of a run says of them.

use config::{ConfigError, Layers, RunConfig};

/// A run on the user's own path, with a vehicle's file or preset.
fn start(path: &str, vehicle: &str, sets: &[&str]) -> Result<RunConfig, ConfigError> {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let file = folder.path().join(name);
        std::fs::write(&file, text).unwrap();
        file
    };
    let path = write("path.csv", path);
    let mut layers = Layers::own_path();
    match vehicle.contains('=') {
        true => {
            let file = write("car.toml", vehicle);
            layers.set_vehicle("--vehicle", file.to_str().unwrap())?;
        }
        false => layers.set_vehicle("--vehicle", vehicle)?,
    }
    layers.add_path(&path)?;
    for set in sets {
        layers.set(set)?;
    }
    layers.resolve()
}

fn refused(path: &str, vehicle: &str, sets: &[&str], parts: &[&str]) {
    let message = start(path, vehicle, sets).unwrap_err().to_string();
    for part in parts {
        assert!(message.contains(part), "{message:?} lacks {part:?}");
    }
}

const STRAIGHT: &str = "x_m,y_m\n0,0\n10,0\n20,0\n";

/// Straight on for 4 m, a half circle of this radius to the left, and 4 m back.
fn u_turn(radius_m: f64) -> String {
    let turn = (0..=24).map(|step| {
        let angle = std::f64::consts::PI * f64::from(step) / 24.0;
        (4.0 + radius_m * libm::sin(angle), radius_m * (1.0 - libm::cos(angle)))
    });
    let (before, after) = ((0..8).map(f64::from), (1..=8).map(f64::from));
    let points = before
        .map(|x| (0.5 * x, 0.0))
        .chain(turn)
        .chain(after.map(|x| (4.0 - 0.5 * x, 2.0 * radius_m)));
    let rows: Vec<String> = points.map(|(x, y)| format!("{x:.4},{y:.4}\n")).collect();
    format!("x_m,y_m\n{}", rows.concat())
}

#[test]
fn steering_limit_in_degrees() {
    let robot = "name = 'robot'\nwheelbase_m = 0.33\nsteering_limit_rad = 24\n";
    let parts = ["car.toml:3: vehicle.steering_limit_rad: is 24", "(0, 1.5]", "24° are 0.419"];
    refused(STRAIGHT, robot, &[], &parts);
    // A path that it could not drive is not what is wrong.
    refused(&u_turn(0.1), robot, &[], &parts);
}

#[test]
fn tick_longer_than_command_age() {
    let guarded = "tesla_model_3_guarded";
    let parts = ["drive.tick_s", "is 0.05", "vehicle.safety.command_age_limit_s", "0.15"];
    refused(STRAIGHT, guarded, &["run.realtime=true", "drive.tick_s=0.05"], &parts);
    let at_25_hz = ["run.realtime=true", "drive.tick_s=0.04"];
    refused(STRAIGHT, guarded, &at_25_hz, &["drive.tick_s"]);
    let longer = "vehicle.safety.command_age_limit_s=0.12";
    start(STRAIGHT, guarded, &[at_25_hz[0], at_25_hz[1], longer]).unwrap();
    // In lockstep no command is old.
    start(STRAIGHT, guarded, &["drive.tick_s=0.05"]).unwrap();
}

#[test]
fn vehicle_steering_limit() {
    let shuttle = "name = 'yard_shuttle'\nwheelbase_m = 2.0\ntracked_point_m = 0.0\nbody_front_m = 2.6\n\
                   body_rear_m = 0.6\nsteering_limit_rad = 0.9\nspeed_limit_mps = 3.0\n";
    let turn = u_turn(2.2);
    let config = start(&turn, shuttle, &[]).unwrap();
    assert_eq!(config.controller.steering_limit_rad, 0.9);
    assert_eq!(config.supervisor.speed_limit_mps, 3.0);
    // What the law may steer counts for the path, too.
    let less = ["controller.steering_limit_rad=0.5236"];
    refused(
        &turn,
        shuttle,
        &less,
        &["turn of radius 2.", "3.46 m", "controller.steering_limit_rad"],
    );
    let wide = start(STRAIGHT, shuttle, &["controller.steering_limit_rad=1.2"]).unwrap();
    assert_eq!(wide.controller.steering_limit_rad, 0.9);
}

#[test]
fn what_is_made_for_a_full_size_car_fits_a_small_one() {
    let learning = |vehicle: &str, sets: &[&str]| start(STRAIGHT, vehicle, sets).unwrap().learning;
    let full_size = learning("tesla_model_3", &[]);
    assert_eq!((full_size.error_high_cross_m, full_size.heading_weight), (3.0, 10.0));
    let small = learning("f1tenth", &[]);
    let ratio = 0.3302 / 2.875;
    assert_eq!(small.error_high_cross_m, 3.0 * ratio);
    assert_eq!(small.heading_weight, 10.0 * (ratio * ratio));
    let own = ["learning.error_high_cross_m=3.0", "learning.heading_weight=10.0"];
    assert_eq!(learning("f1tenth", &own), full_size);
}
