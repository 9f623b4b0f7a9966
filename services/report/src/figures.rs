//! The figures of the recorded drives, as in the paper: the trajectory in the plane, and velocities and errors over
//! time.

use config::RunConfig;
use maud::{Markup, html};
use tracking::{Path, Pose};

use crate::ReportError;
use crate::axis::{Axis, short};
use crate::canvas::{DASHES, GREY, HALF, INK, Marker, NAVY, ORANGE, Stroke};
use crate::chart::{Chart, Line, Map};
use crate::drives::{DriveSet, Row};
use crate::page::Page;

/// Adds one section for each set with recorded drives.
pub(crate) fn sections(
    page: &mut Page,
    sets: &[DriveSet],
    config: &RunConfig,
) -> Result<(), ReportError> {
    for set in sets {
        let body = figures(page, set, config)?;
        page.section(&format!("Drives: {}", set.name), body);
    }
    Ok(())
}

type Series<'a> = (&'a str, Stroke, fn(&Row) -> f64);

/// Lines over time, in the order of the legend: noise-free lines are drawn on top of noisy ones.
fn over_time(set: &DriveSet, noise_free: &[Series], noisy: &[Series]) -> Vec<Line> {
    let mut lines = Vec::new();
    for (rows, series) in [(&set.noise_free, noise_free), (&set.noisy, noisy)] {
        let Some(rows) = rows else { continue };
        for (label, look, value) in series {
            lines.push(Line::new(*label, rows.iter().map(|row| (row.time_s, value(row))), *look));
        }
    }
    lines
}

fn figures(page: &mut Page, set: &DriveSet, config: &RunConfig) -> Result<Markup, ReportError> {
    let map = map(page, set, config)?;
    let rows = || set.noise_free.iter().chain(&set.noisy).flatten();
    let time = Axis::tight(rows().map(|row| row.time_s), 6);
    let borders = borders_in_time(set);
    let mut chart = |kind: &str, y_name: &str, caption: &str, lines: &[Line]| {
        let picture = Chart {
            name: &format!("{}-{kind}", set.name),
            words: &format!("Drives of the set {}: {caption}", set.name),
            width: HALF,
            height: 210.0,
            x: time.clone(),
            x_name: "time [s]",
            y_name,
            lines,
            legend_rows: 2,
            borders: &borders,
        }
        .draw()?;
        Ok::<_, ReportError>(page.figure(picture, caption))
    };

    let bold = Stroke::solid(NAVY, 1.8);
    let light = Stroke::solid(ORANGE, 1.5);
    let faint = Stroke::solid(ORANGE, 0.5);
    let speed = chart(
        "velocity",
        "v [m/s]",
        "Linear velocity v; thin lines show the commanded one.",
        &over_time(
            set,
            &[
                ("v, noise-free", bold, |row| row.speed_mps),
                ("commanded, noise-free", Stroke::dashed(INK, 0.8, DASHES[2]), |row| {
                    row.command_speed_mps
                }),
            ],
            &[
                ("v, noisy", light, |row| row.speed_mps),
                ("commanded, noisy", faint, |row| row.command_speed_mps),
            ],
        ),
    )?;
    let turning = chart(
        "angular-velocity",
        "ωₛ [rad/s]",
        "Angular velocity ωₛ of the control law. Noise on the pose goes straight into it.",
        &over_time(
            set,
            &[("ωₛ, noise-free", bold, |row| row.command_yaw_rate_radps)],
            &[("ωₛ, noisy", Stroke::solid(ORANGE, 0.6), |row| row.command_yaw_rate_radps)],
        ),
    )?;
    let position = chart(
        "position-errors",
        "error [m]",
        "True errors along and across the track, in the vehicle’s frame.",
        &over_time(
            set,
            &[
                ("along, noise-free", bold, |row| row.along_track_m),
                ("across, noise-free", Stroke::dashed(NAVY, 1.6, DASHES[1]), |row| {
                    row.cross_track_m
                }),
            ],
            &[
                ("along, noisy", light, |row| row.along_track_m),
                ("across, noisy", Stroke::dashed(ORANGE, 1.5, DASHES[2]), |row| row.cross_track_m),
            ],
        ),
    )?;
    let heading = chart(
        "heading-error",
        "heading error [rad]",
        "True error of the heading.",
        &over_time(
            set,
            &[("heading, noise-free", bold, |row| row.heading_rad)],
            &[("heading, noisy", light, |row| row.heading_rad)],
        ),
    )?;
    Ok(html! { div.figures { (map) (speed) (turning) (position) (heading) } })
}

fn map(page: &mut Page, set: &DriveSet, config: &RunConfig) -> Result<Markup, ReportError> {
    let way = |rows: &[Row]| rows.iter().map(|row| (row.x_m, row.y_m)).collect::<Vec<_>>();
    let mut lines = Vec::new();
    let mut ends = Vec::new();
    // Thin dashes on top of the solid line, so that both are visible where the drives coincide.
    for (label, rows, look, marker) in [
        ("noisy", &set.noisy, Stroke::dashed(ORANGE, 1.5, &[5.0, 5.0]), Marker::Triangle),
        ("noise-free", &set.noise_free, Stroke::solid(NAVY, 2.0), Marker::Disc),
    ] {
        let Some(rows) = rows else { continue };
        let line = Line::new(label, way(rows), look);
        let end = Stroke { marker: Some(marker), ..look };
        ends.extend(line.points.last().map(|point| (*point, end)));
        lines.push(line);
    }
    if let Some(rows) = set.noise_free.as_ref().or(set.noisy.as_ref()) {
        let reference = rows.iter().map(|row| (row.reference_x_m, row.reference_y_m));
        lines.push(Line::new("reference", reference, Stroke::dashed(GREY, 3.2, &[9.0, 6.0])));
    }
    lines.extend(edges(config));
    let borders = borders_on_map(config);
    let picture = Map {
        name: &format!("{}-trajectory", set.name),
        words: &format!("Trajectory of the set {}, with the reference.", set.name),
        lines: &lines,
        ends: &ends,
        borders: &borders,
    }
    .draw()?;
    let mut caption = "Trajectory of the tracked point (true pose) and its reference; the markers show where the drives ended (disc: noise-free, triangle: noisy).".to_owned();
    if !borders.is_empty() {
        let zones = config.path.zones.iter().enumerate().map(|(index, zone)| {
            format!("{} {} from {} m", index + 1, zone.name, short(zone.from_m))
        });
        caption += &format!(
            " Zones along the path: {}; over time, a dotted line shows when the vehicle entered one.",
            zones.collect::<Vec<_>>().join(", ")
        );
    }
    Ok(page.figure(picture, &caption))
}

/// The edges of the road, where they are known.
fn edges(config: &RunConfig) -> Vec<Line> {
    let points = &config.path.points;
    let edge = |side: usize, sign: f64| {
        let at = config.path.widths_m.iter().enumerate().map(|(index, widths_m)| {
            let (from, to) = (index.saturating_sub(1), (index + 1).min(points.len() - 1));
            let (dx, dy) = (points[to][0] - points[from][0], points[to][1] - points[from][1]);
            let aside = sign * widths_m[side] / dx.hypot(dy).max(1e-9);
            (points[index][0] - aside * dy, points[index][1] + aside * dx)
        });
        Line::new("edge of the road", at, Stroke::solid(GREY, 1.0))
    };
    if config.path.widths_m.is_empty() { Vec::new() } else { vec![edge(0, 1.0), edge(1, -1.0)] }
}

/// Where the zones begin on the path; empty if there is only one.
fn borders_on_map(config: &RunConfig) -> Vec<(Pose, String)> {
    if config.path.zones.len() < 2 {
        return Vec::new();
    }
    let path = Path::new(&config.path);
    let zones = config.path.zones.iter().enumerate();
    zones.map(|(index, zone)| (path.at(zone.from_m), (index + 1).to_string())).collect()
}

/// When the vehicle changed its zone, in the noise-free drive if there is one.
fn borders_in_time(set: &DriveSet) -> Vec<(f64, String)> {
    let Some(rows) = set.noise_free.as_ref().or(set.noisy.as_ref()) else { return Vec::new() };
    rows.windows(2)
        .filter(|pair| pair[0].zone != pair[1].zone)
        .map(|pair| (pair[1].time_s, (u64::from(pair[1].zone) + 1).to_string()))
        .collect()
}
