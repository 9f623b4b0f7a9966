//! Folders of runs, made from fixtures and from drives that are driven here.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::Result;
use config::{Gains, Layers, RunConfig};
use rollout::Rollout;
use tracking::{Pose, Reference, tracking_error};

/// A training of the lane change, with drives of the tuned set and the paper's.
pub(crate) fn train(run: &Path) -> Result<()> {
    let config = Layers::maneuver("lane_change")?.resolve()?;
    let tuned = Gains { kv: 1.26, kl: 11.0, ks: 21.0, ki: 0.84 };
    write_run(run, include_str!("../fixtures/train.json"), &config)?;
    record(run, &config, "tuned", tuned)?;
    record(run, &config, "paper", config.paper_gains().unwrap())
}

/// A validation on a path like the paper's circuit, with four zones.
pub(crate) fn validate(run: &Path) -> Result<()> {
    let config = circuit()?;
    write_run(run, include_str!("../fixtures/validate.json"), &config)?;
    let chosen = Gains { kv: 3.4, kl: 21.0, ks: 1.0, ki: 0.84 };
    record(run, &config, "chosen", chosen)
}

/// An exhaustive grid; no drive of it is recorded.
pub(crate) fn grid(run: &Path) -> Result<()> {
    let config = Layers::maneuver("lane_change")?.resolve()?;
    write_run(run, include_str!("../fixtures/grid.json"), &config)
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
fn record(run: &Path, config: &RunConfig, name: &str, gains: Gains) -> Result<()> {
    let drives = run.join("drives");
    fs::create_dir_all(&drives)?;
    for (suffix, seed) in [("noise_free", None), ("noisy", Some(3))] {
        fs::write(drives.join(format!("{name}_{suffix}.csv")), drive(config, gains, seed)?)?;
    }
    Ok(())
}

/// One drive as the text of its file.
fn drive(config: &RunConfig, gains: Gains, seed: Option<u64>) -> Result<String> {
    let mut text = String::from(
        "tick,time_s,x_m,y_m,yaw_rad,measured_x_m,measured_y_m,measured_yaw_rad,speed_mps,yaw_rate_radps,steering_rad,\
         reference_x_m,reference_y_m,reference_yaw_rad,along_track_m,cross_track_m,heading_rad,command_speed_mps,\
         command_yaw_rate_radps,command_steering_rad,flags,zone\n",
    );
    let mut reference = Reference::new(config);
    let mut wrote = Ok(());
    Rollout::new(config).drive_with(gains, seed, |tick, record| {
        let seen = record.observation;
        let at = reference.advance(tick, seen.measured);
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
