//! The path in a bag of ROS 2: a `nav_msgs/Path`, or the way that a car drove, from its `nav_msgs/Odometry`.
//!
//! Our reader of MCAP knows topics but no types, so that a message is what it can be read as, to its last byte.

use std::collections::BTreeMap;
use std::path::Path as File;

use anyhow::{Result, anyhow, bail, ensure};
use byteorder::{BigEndian, LittleEndian};
use config::RecordedPath;
use recorder::reading::AnyMessage;
use ros2_vehicle::messages::{Header, Odometry, Pose};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::cut_off::blame;

/// Of a driven way, a point is kept once the car is this far from the last one.
const APART_M: f64 = 0.02;
/// The most points that are kept of a topic.
const MOST_POINTS: usize = 1_000_000;

/// `nav_msgs/Path`.
#[derive(Debug, Deserialize)]
struct Planned {
    #[serde(rename = "header")]
    _header: Header,
    poses: Vec<Stamped>,
}

/// `geometry_msgs/PoseStamped`.
#[derive(Debug, Deserialize)]
struct Stamped {
    #[serde(rename = "header")]
    _header: Header,
    pose: Pose,
}

/// What a topic holds.
#[derive(Debug)]
enum Found {
    /// The points of the longest message, and which one that was, of how many with more than one point; whether they differ.
    Planned {
        points: Vec<[f64; 2]>,
        at: usize,
        count: usize,
        differ: bool,
    },
    /// The points where it came by, and how many poses were no numbers.
    Driven(Vec<[f64; 2]>, usize),
    Other,
}

/// Reads the path of a bag; without a topic the only `nav_msgs/Path`, or else the only odometry.
pub(crate) fn read(file: &File, topic: Option<&str>) -> Result<RecordedPath, String> {
    read_bag(file, topic).map_err(|why| format!("{} {why:#}", file.display()))
}

fn read_bag(file: &File, wanted: Option<&str>) -> Result<RecordedPath> {
    let mut topics: BTreeMap<String, Found> = BTreeMap::new();
    let cut_off = recorder::reading::read_any(file, |AnyMessage { topic, data, .. }| {
        if wanted.is_some_and(|wanted| wanted != topic) {
            topics.entry(topic.to_owned()).or_insert(Found::Other);
            return Ok(());
        }
        let found = topics.entry(topic.to_owned()).or_insert_with(|| kind_of(data));
        add(found, data)
    })?;
    let names = |pick: &dyn Fn(&Found) -> bool| -> Vec<&str> {
        topics.iter().filter(|(_, found)| pick(found)).map(|(topic, _)| topic.as_str()).collect()
    };
    let planned = names(&|found| matches!(found, Found::Planned { .. }));
    let driven = names(&|found| matches!(found, Found::Driven(..)));
    let (topic, kind) = match (&planned[..], &driven[..]) {
        ([one], _) => (*one, "nav_msgs/Path"),
        ([], [one]) => (*one, "nav_msgs/Odometry, the way that the car drove"),
        ([], []) => {
            let all = names(&|_| true).into_iter().take(30).collect::<Vec<_>>().join(", ");
            let of = wanted.map(|topic| format!(" on {topic}")).unwrap_or_default();
            let why =
                anyhow!("has no nav_msgs/Path and no nav_msgs/Odometry{of}; its topics are {all}");
            return blame(Err(why), cut_off.as_deref());
        }
        (several @ [_, _, ..], _) | ([], several) => bail!(
            "has several paths, on {}; name one with --path-topic",
            several.iter().take(30).copied().collect::<Vec<_>>().join(", ")
        ),
    };
    let mut notes = vec![format!("read {topic}, {kind}; speeds are not read")];
    let points = match topics.get(topic) {
        Some(Found::Planned { points, at, count, differ }) => {
            if *differ {
                notes.push(format!(
                    "its {count} messages hold different paths; the longest is taken, the {}, of {:.1} m",
                    ordinal(*at + 1),
                    length_m(points)
                ));
            }
            points
        }
        Some(Found::Driven(points, lost)) => {
            if *lost > 0 {
                notes.push(format!("{lost} of its poses are no numbers, and are left out"));
            }
            points
        }
        _ => bail!("has no path on {topic}"),
    };
    notes.extend(cut_off.map(|why| format!("it {why}; what comes before is used")));
    Ok(RecordedPath { points: points.clone(), notes })
}

fn kind_of(data: &[u8]) -> Found {
    if decode::<Odometry>(data).is_some() {
        Found::Driven(Vec::new(), 0)
    } else if decode::<Planned>(data).is_some() {
        Found::Planned { points: Vec::new(), at: 0, count: 0, differ: false }
    } else {
        Found::Other
    }
}

fn add(found: &mut Found, data: &[u8]) -> Result<()> {
    let points = match found {
        Found::Other => return Ok(()),
        Found::Planned { points, at, count, differ } => {
            if let Some(path) = decode::<Planned>(data).filter(|path| path.poses.len() > 1) {
                let new: Vec<[f64; 2]> = path.poses.iter().map(|it| place(&it.pose)).collect();
                if let Some(point) = new.iter().position(|it| it.iter().any(|it| !it.is_finite())) {
                    bail!("holds a path whose point {} is no number", point + 1);
                }
                *differ |= *count > 0 && new != *points;
                // Who follows a plan shortens it on the way.
                if *count == 0 || length_m(&new) > length_m(points) {
                    (*points, *at) = (new, *count);
                }
                *count += 1;
            }
            points
        }
        Found::Driven(points, lost) => {
            if let Some(odometry) = decode::<Odometry>(data) {
                let at = place(&odometry.pose.pose);
                *lost += usize::from(at.iter().any(|it| !it.is_finite()));
                let is_apart = points.last().is_none_or(|last: &[f64; 2]| {
                    libm::hypot(at[0] - last[0], at[1] - last[1]) >= APART_M
                });
                if is_apart && at.iter().all(|it| it.is_finite()) {
                    points.push(at);
                }
            }
            points
        }
    };
    ensure!(points.len() <= MOST_POINTS, "holds more than {MOST_POINTS} points; cut it");
    Ok(())
}

fn length_m(points: &[[f64; 2]]) -> f64 {
    points.windows(2).map(|it| libm::hypot(it[1][0] - it[0][0], it[1][1] - it[0][1])).sum()
}

/// 1st, 2nd, 3rd, 4th, …
fn ordinal(number: usize) -> String {
    let ending = match (number % 10, number % 100) {
        (1, rest) if rest != 11 => "st",
        (2, rest) if rest != 12 => "nd",
        (3, rest) if rest != 13 => "rd",
        _ => "th",
    };
    format!("{number}{ending}")
}

fn place(pose: &Pose) -> [f64; 2] {
    [pose.position.x, pose.position.y]
}

/// A message from its bytes, all of them: CDR behind a header of four bytes, whose second says the order of bytes.
fn decode<T: DeserializeOwned>(data: &[u8]) -> Option<T> {
    let (order, rest) = (data.get(..2)?, data.get(4..)?);
    let (message, used) = match order {
        [0, 1] => cdr_encoding::from_bytes::<T, LittleEndian>(rest).ok()?,
        [0, 0] => cdr_encoding::from_bytes::<T, BigEndian>(rest).ok()?,
        _ => return None,
    };
    // Some writers fill up to four bytes.
    (used <= rest.len() && rest.len() - used < 4).then_some(message)
}
