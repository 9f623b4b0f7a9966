//! Reads a path's file: rows of points that a user measured, drew or computed, in the forms in which tools write them.
//!
//! - A table of numbers, separated by `,`, `;`, `|` or spaces. Its header may be a line or a comment, and columns are found by
//!   what their names mean, in any order; without a header by what the numbers are, or as the user says.
//! - A track or route of GPX.
//!
//! Lines that begin with `#`, `//` or `%` are comments. Heading and curvature are not read: their conventions differ from
//! tool to tool, and they follow from the points. Each decision that the file leaves open is told, and each mistake is
//! reported in one line that names the file and its line.

mod foreign;
mod geo;
mod gpx;
mod header;
mod headless;
mod lines;
mod options;
mod rows;
mod steps;
#[cfg(test)]
mod tests;

pub use options::{Columns, Crs, PathOptions};

use crate::ConfigError;

/// The content of a path's file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PathFile {
    /// The points: at least 2, and no two neighbours the same. The last point of a closed path is its first.
    pub(crate) points: Vec<[f64; 2]>,
    /// The speed at each point; empty if the file has no such column.
    pub(crate) speeds_mps: Vec<f64>,
    /// From each point to the road's edges on the left and on the right; empty if the file has no such columns.
    pub(crate) widths_m: Vec<[f64; 2]>,
    /// The line of each point.
    pub(crate) lines: Vec<usize>,
    /// What the file's coordinates are.
    crs: Crs,
    /// What the points are seen from, in the file's own coordinates, latitude before longitude; 0 if they are the file's.
    origin: [f64; 2],
    /// How the file was read: what the user may not expect.
    pub(crate) notes: Vec<String>,
}

impl PathFile {
    /// A place that a user gives in the file's coordinates, in those of the points; and what it is taken for, if that is not plain.
    /// Beside latitudes and longitudes it may be in metres, too, as the points are told: a degree is farther than any path is long.
    pub(crate) fn place(&self, [a, b]: [f64; 2]) -> ([f64; 2], Option<String>) {
        const NEAR_DEG: f64 = 1.0;
        let [x, y] = self.origin;
        match self.crs {
            Crs::Metres if self.origin == [0.0, 0.0] => ([a, b], None),
            Crs::Metres => {
                ([a - x, b - y], Some("the file's own coordinates, in metres".to_owned()))
            }
            Crs::WebMercator => {
                let point = geo::from_mercator(&[self.origin, [a, b]])[1];
                (point, Some("web-Mercator, and scaled as the points are".to_owned()))
            }
            Crs::Wgs84 => {
                let off_deg = |[lat, lon]: &[f64; 2]| (lat - x).abs().max((lon - y).abs());
                let [latitude_first, longitude_first] = [[a, b], [b, a]];
                let nearer = if off_deg(&longitude_first) < off_deg(&latitude_first) {
                    longitude_first
                } else {
                    latitude_first
                };
                if off_deg(&nearer) > NEAR_DEG {
                    let words = "metres east and north of the first point".to_owned();
                    return ([a, b], Some(words));
                }
                let words = format!("latitude {}, longitude {}", nearer[0], nearer[1]);
                (geo::from_degrees(&[self.origin, nearer])[1], Some(words))
            }
        }
    }
}

/// A path that something else has read from a file, such as a bag.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedPath {
    /// Its points: x and y in metres.
    pub points: Vec<[f64; 2]>,
    /// What the user has to know of it.
    pub notes: Vec<String>,
}

/// What the rows of a file hold, before the coordinates become metres.
#[derive(Debug, Default)]
struct Raw {
    points: Vec<[f64; 2]>,
    /// Whether they are latitude and longitude in degrees.
    is_degrees: bool,
    /// Whether a name or a comment says that they are web-Mercator.
    is_mercator: bool,
    speeds_mps: Vec<f64>,
    widths_m: Vec<[f64; 2]>,
    lines: Vec<usize>,
    notes: Vec<String>,
}

/// Parses the bytes of the file that `origin` names.
///
/// # Errors
/// At the first mistake, with its line and what to do about it.
pub(crate) fn parse(
    origin: &str,
    bytes: &[u8],
    options: &PathOptions,
) -> Result<PathFile, ConfigError> {
    let bytes = bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(bytes);
    // Its tags are ASCII, whatever encoding its names have.
    let is_gpx = gpx::is_gpx(&String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]));
    if !is_gpx && let Some(kind) = foreign::looks_like(bytes) {
        let problem = format!(
            "looks like {kind}, and is no path; give a table with the columns x_m,y_m[,v_mps], a raceline, a GPX file, or a \
             recording of ROS 2"
        );
        return Err(mistake(origin, 1, problem));
    }
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = bytes[..error.valid_up_to()].iter().filter(|byte| **byte == b'\n').count() + 1;
        mistake(origin, line, "is not UTF-8 text; save the file as UTF-8")
    })?;
    if text.trim().is_empty() {
        let problem = "is empty; write a header x_m,y_m[,v_mps], and one point per line";
        return Err(mistake(origin, 1, problem));
    }
    let raw = if is_gpx {
        let points = gpx::points(text).map_err(|(line, problem)| mistake(origin, line, problem))?;
        let (lines, points) = points.into_iter().unzip();
        let notes = vec!["read as GPX".to_owned()];
        Raw { points, lines, notes, is_degrees: true, ..Raw::default() }
    } else {
        rows::read(origin, text, options)?
    };
    of_raw(origin, raw, options)
}

/// The path of points from a recording; in errors they are counted instead of lines.
///
/// # Errors
/// As [`parse`].
pub(crate) fn of_recording(
    origin: &str,
    path: RecordedPath,
    options: &PathOptions,
) -> Result<PathFile, ConfigError> {
    let RecordedPath { points, notes } = path;
    let lines = (1..=points.len()).collect();
    of_raw(origin, Raw { points, lines, notes, ..Raw::default() }, options)
}

/// A path from points that were read: in metres, each step checked.
fn of_raw(origin: &str, raw: Raw, options: &PathOptions) -> Result<PathFile, ConfigError> {
    match raw.points.len() {
        0 => return Err(mistake(origin, 1, "no points follow; write one per line")),
        1 => {
            return Err(mistake(
                origin,
                raw.lines[0],
                "is the only point; a path needs at least 2",
            ));
        }
        _ => {}
    }
    steps::checked(origin, flattened(origin, raw, options)?)
}

/// The points as metres of a flat frame.
fn flattened(origin: &str, raw: Raw, options: &PathOptions) -> Result<PathFile, ConfigError> {
    let Raw { points, is_degrees, is_mercator, speeds_mps, widths_m, lines, mut notes } = raw;
    let first = points[0];
    let crs = match options.crs {
        Some(crs) => crs,
        None if is_degrees => Crs::Wgs84,
        None if is_mercator => Crs::WebMercator,
        None if geo::looks_like_mercator(first) => {
            let problem = format!(
                "({}, {}) looks like web-Mercator, whose unit is {:.3} m there; read it with --crs web-mercator, or with --crs \
                 metres if the numbers are metres of another grid",
                first[0],
                first[1],
                geo::mercator_scale(first[1])
            );
            return Err(mistake(origin, lines[0], problem));
        }
        None => Crs::Metres,
    };
    let mut seen_from = [0.0, 0.0];
    let points = match crs {
        Crs::Wgs84 => {
            // Of x and y, x is the one to the east.
            let degrees: Vec<[f64; 2]> =
                if is_degrees { points } else { points.iter().map(|[x, y]| [*y, *x]).collect() };
            let wrong = degrees.iter().position(|[lat, lon]| lat.abs() > 90.0 || lon.abs() > 180.0);
            if let Some(index) = wrong {
                let [lat, lon] = degrees[index];
                let problem = format!(
                    "holds the latitude {lat} and the longitude {lon}, which are no degrees"
                );
                return Err(mistake(origin, lines[index], problem));
            }
            seen_from = degrees[0];
            notes.push(format!(
                "latitude and longitude (WGS 84) taken as metres east and north of the first point, latitude {}, longitude {}",
                seen_from[0], seen_from[1]
            ));
            geo::from_degrees(&degrees)
        }
        Crs::WebMercator => {
            seen_from = first;
            notes.push(format!(
                "web-Mercator scaled by {:.4}, the cosine of the latitude, and seen from the first point, {}, {}",
                geo::mercator_scale(first[1]),
                first[0],
                first[1]
            ));
            geo::from_mercator(&points)
        }
        Crs::Metres if geo::is_far(&points) => {
            seen_from = first;
            let else_mercator = if options.crs.is_none() {
                "; taken as metres, as UTM is (web-Mercator: --crs web-mercator)"
            } else {
                ""
            };
            notes.push(format!(
                "coordinates are kept from the first point on, {}, {}{else_mercator}",
                first[0], first[1]
            ));
            geo::relative(&points)
        }
        Crs::Metres => points,
    };
    Ok(PathFile { points, speeds_mps, widths_m, lines, crs, origin: seen_from, notes })
}

fn mistake(origin: &str, line: usize, problem: impl Into<String>) -> ConfigError {
    ConfigError::new(format!("{origin}:{line}"), "", problem)
}

/// The user's own words in an error: in quotes, on one line, no longer than a line.
fn quoted(text: &str) -> String {
    const LONGEST: usize = 60;
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{:?}…", &text[..end]),
        None => format!("{text:?}"),
    }
}
