//! Paths in points, of the size of a vehicle.

use config::{Layers, RunConfig};

/// Lengths and curvatures, in wheelbases: a straight, a bend to the left, an S, and a straight.
#[allow(dead_code, reason = "one of the tests has no use for it")]
const BENDS: [(f64, f64); 6] =
    [(6.0, 0.0), (8.0, 0.2), (4.0, 0.0), (5.0, -0.25), (5.0, 0.25), (6.0, 0.0)];

/// A path in points: `bends` gives the curvature of stretches in wheelbases.
fn path_file(wheelbase_m: f64, speed_mps: f64, bends: &[(f64, f64)]) -> String {
    let mut file = "x_m,y_m,v_mps\n0,0,SPEED\n".replace("SPEED", &speed_mps.to_string());
    let (mut x, mut y, mut yaw) = (0.0f64, 0.0f64, 0.0f64);
    for (length, curvature) in bends {
        let step_m = 0.1 * wheelbase_m;
        for _ in 0..(length / 0.1) as usize {
            yaw += 0.5 * step_m * curvature / wheelbase_m;
            (x, y) = (x + step_m * libm::cos(yaw), y + step_m * libm::sin(yaw));
            yaw += 0.5 * step_m * curvature / wheelbase_m;
            file += &format!("{x},{y},{speed_mps}\n");
        }
    }
    file
}

/// A path of the size of the vehicle: a straight, a bend to the left, an S, and a straight.
#[allow(dead_code, reason = "one of the tests has no use for it")]
pub(crate) fn own_path(vehicle: &str, speed_mps: f64, sets: &[&str]) -> RunConfig {
    of_bends(vehicle, speed_mps, &BENDS, sets)
}

/// A path of these bends, as [`path_file`] takes them.
pub(crate) fn of_bends(
    vehicle: &str,
    speed_mps: f64,
    bends: &[(f64, f64)],
    sets: &[&str],
) -> RunConfig {
    let layers = || {
        let mut layers = Layers::own_path();
        layers.set_vehicle("test", vehicle).unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers
    };
    let wheelbase_m = layers().resolve().unwrap().vehicle.wheelbase_m;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("path.csv");
    std::fs::write(&file, path_file(wheelbase_m, speed_mps, bends)).unwrap();
    let mut layers = layers();
    layers.add_path(&file).unwrap();
    layers.resolve().unwrap()
}
