//! Folders of runs, made from fixtures and from drives that are driven here.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::Result;
use config::{Layers, Parameters, RunConfig};
use rollout::Rollout;
use tracking::{Pose, Reference, tracking_error};

/// A training of the lane change, with drives of the tuned set and the paper's.
pub(crate) fn train(run: &Path) -> Result<()> {
    let config = Layers::maneuver("lane_change")?.resolve()?;
    let tuned = Parameters::of(&[1.26, 11.0, 21.0, 0.84]);
    write_run(run, include_str!("../fixtures/train.json"), &config)?;
    fs::write(run.join("episodes.csv"), include_str!("../fixtures/episodes.csv"))?;
    record(run, &config, "tuned", tuned)?;
    record(run, &config, "paper", config.paper_set().unwrap())
}

/// A validation on a path like the paper's circuit, with four zones.
pub(crate) fn validate(run: &Path) -> Result<()> {
    let config = circuit()?;
    write_run(run, include_str!("../fixtures/validate.json"), &config)?;
    let chosen = Parameters::of(&[3.4, 21.0, 1.0, 0.84]);
    record(run, &config, "chosen", chosen)
}

/// An exhaustive grid; no drive of it is recorded.
pub(crate) fn grid(run: &Path) -> Result<()> {
    let config = Layers::maneuver("lane_change")?.resolve()?;
    write_run(run, include_str!("../fixtures/grid.json"), &config)?;
    fs::write(run.join("grid.csv"), grid_sets(&config)?)?;
    Ok(())
}

/// Every set of the grid with made-up measures, the last parameter running fastest.
fn grid_sets(config: &RunConfig) -> Result<String> {
    let keys: Vec<&str> = config.law.keys().collect();
    let measures = "value,distance,mse_m2,path_mean_m,path_p95_m,path_max_m,arrived";
    let mut text = format!("{},{measures}\n", keys.join(","));
    let grid = config.grid();
    for (index, position) in grid.positions().enumerate() {
        for value in config.law.values(&grid.set(position)) {
            write!(text, "{value},")?;
        }
        // Scattered over the sets: a prime's multiples visit every remainder.
        let place = (index * 7919 % grid.len()) as f64 / grid.len() as f64;
        let (distance, path) = (0.7955 + 0.9 * place * place, 0.077 + 0.1 * place);
        let (mse, p95, largest) = (1.4 + 4.0 * place, 2.4 * path, 3.1 * path);
        writeln!(text, "{distance},{distance},{mse},{path},{p95},{largest},false")?;
    }
    Ok(text)
}

fn circuit() -> Result<RunConfig> {
    let mut layers = Layers::maneuver("roundabout")?;
    layers.add_document(
        "circuit.toml",
        r#"
        paper = []
        [path]
        pieces = [
            { kind = "straight", length_m = 14.0 },
            { kind = "arc", radius_m = 6.0, angle_deg = -60.0 },
            { kind = "arc", radius_m = 16.0, angle_deg = 210.0 },
            { kind = "arc", radius_m = 6.0, angle_deg = -60.0 },
            { kind = "straight", length_m = 8.0 },
            { kind = "arc", radius_m = 8.0, angle_deg = 90.0 },
            { kind = "straight", length_m = 6.0 },
            { kind = "diagonal", length_m = 5.5, offset_m = 3.5 },
            { kind = "straight", length_m = 18.0 },
        ]
        zones = [
            { name = "straight", from_m = 0.0 },
            { name = "roundabout", from_m = 12.0 },
            { name = "straight", from_m = 86.0 },
            { name = "lane_change", from_m = 106.0 },
        ]
        [drive]
        loop_time_s = 90.0
        [reference]
        speed_mps = 1.6
        "#,
    )?;
    Ok(layers.resolve()?)
}

fn write_run(run: &Path, result: &str, config: &RunConfig) -> Result<()> {
    fs::create_dir_all(run)?;
    fs::write(run.join("result.json"), result)?;
    fs::write(run.join("config.toml"), toml::to_string(config)?)?;
    Ok(())
}

/// Records a drive without and one with noise.
fn record(run: &Path, config: &RunConfig, name: &str, parameters: Parameters) -> Result<()> {
    let drives = run.join("drives");
    fs::create_dir_all(&drives)?;
    for (suffix, seed) in [("noise_free", None), ("noisy", Some(3))] {
        fs::write(drives.join(format!("{name}_{suffix}.csv")), drive(config, parameters, seed)?)?;
    }
    Ok(())
}

/// One drive as the text of its file.
fn drive(config: &RunConfig, parameters: Parameters, seed: Option<u64>) -> Result<String> {
    let mut text = String::from(
        "tick,time_s,x_m,y_m,yaw_rad,measured_x_m,measured_y_m,measured_yaw_rad,speed_mps,yaw_rate_radps,steering_rad,\
         reference_x_m,reference_y_m,reference_yaw_rad,along_track_m,cross_track_m,heading_rad,command_speed_mps,\
         command_yaw_rate_radps,command_steering_rad,flags,zone\n",
    );
    let mut reference = Reference::new(config);
    let mut wrote = Ok(());
    Rollout::new(config).drive_with(parameters, seed, |tick, record| {
        let seen = record.observation;
        let at = reference.advance(tick as f64, seen.measured);
        let error = tracking_error(at, seen.truth);
        let zones = &config.path.zones;
        let zone = zones.iter().rposition(|zone| zone.from_m <= reference.along_m()).unwrap_or(0);
        let time_s = tick as f64 * config.drive.tick_s;
        let numbers = |[a, b, c]: [f64; 3]| format!("{a},{b},{c}");
        let pose = |pose: Pose| numbers([pose.x_m, pose.y_m, pose.yaw_rad]);
        let row = [
            pose(seen.truth),
            pose(seen.measured),
            numbers([seen.speed_mps, seen.yaw_rate_radps, seen.steering_rad]),
            pose(at),
            numbers([error.along_track_m, error.cross_track_m, error.heading_rad]),
            numbers([
                record.passed.speed_mps,
                record.passed.yaw_rate_radps,
                record.passed.steering_rad,
            ]),
        ];
        wrote = writeln!(text, "{tick},{time_s},{},0,{zone}", row.join(","));
    });
    wrote?;
    Ok(text)
}
