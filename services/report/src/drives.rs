//! The recorded drives of a run: one file of comma-separated values each, and how two of them make one set of figures.

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::ReportError;
use crate::files::{check_numbers, read_table};

/// One tick of a recorded drive, as far as the figures show it.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(crate) struct Row {
    pub(crate) time_s: f64,
    pub(crate) x_m: f64,
    pub(crate) y_m: f64,
    pub(crate) speed_mps: f64,
    pub(crate) reference_x_m: f64,
    pub(crate) reference_y_m: f64,
    pub(crate) along_track_m: f64,
    pub(crate) cross_track_m: f64,
    pub(crate) heading_rad: f64,
    pub(crate) command_speed_mps: f64,
    pub(crate) command_yaw_rate_radps: f64,
    pub(crate) zone: u32,
}

impl Row {
    /// The numbers of the row, each with the name of its column.
    fn numbers(&self) -> [(&'static str, f64); 11] {
        [
            ("time_s", self.time_s),
            ("x_m", self.x_m),
            ("y_m", self.y_m),
            ("speed_mps", self.speed_mps),
            ("reference_x_m", self.reference_x_m),
            ("reference_y_m", self.reference_y_m),
            ("along_track_m", self.along_track_m),
            ("cross_track_m", self.cross_track_m),
            ("heading_rad", self.heading_rad),
            ("command_speed_mps", self.command_speed_mps),
            ("command_yaw_rate_radps", self.command_yaw_rate_radps),
        ]
    }
}

/// The drives of one parameter set: with noise, without, or both.
#[derive(Debug, Default)]
pub(crate) struct DriveSet {
    pub(crate) name: String,
    pub(crate) noise_free: Option<Vec<Row>>,
    pub(crate) noisy: Option<Vec<Row>>,
}

/// Reads every recorded drive of a run, and joins those of the same set. A run without recorded drives has no set.
pub(crate) fn read(run: &Path) -> Result<Vec<DriveSet>, ReportError> {
    let folder = run.join("drives");
    let mut paths: Vec<PathBuf> = match fs::read_dir(&folder) {
        Ok(entries) => entries
            .map(|entry| Ok(entry?.path()))
            .collect::<Result<_, _>>()
            .map_err(|problem| ReportError::Read { path: folder.clone(), problem })?,
        Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
        Err(problem) => return Err(ReportError::Read { path: folder, problem }),
    };
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "csv"));
    paths.sort();

    let mut sets: BTreeMap<(u8, String), DriveSet> = BTreeMap::new();
    for path in paths {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let (name, noisy) = split_name(&stem);
        let rows = read_drive(&path)?;
        let set = sets
            .entry((order(&name), name.clone()))
            .or_insert_with(|| DriveSet { name, ..DriveSet::default() });
        *if noisy { &mut set.noisy } else { &mut set.noise_free } = Some(rows);
    }
    Ok(sets.into_values().collect())
}

/// The set's name for readers, and whether the drive is a noisy one.
fn split_name(stem: &str) -> (String, bool) {
    let words: String =
        stem.chars().map(|c| if c == '_' || c.is_control() { ' ' } else { c }).collect();
    let (name, noisy) = if let Some(name) = words.strip_suffix("noisy") {
        (name, true)
    } else if let Some(name) = words.strip_suffix("noise free") {
        (name, false)
    } else {
        (words.strip_suffix("noise-free").unwrap_or(&words), false)
    };
    let name = name.trim_end_matches([' ', '-']).trim_start();
    (if name.is_empty() { "drive" } else { name }.to_owned(), noisy)
}

/// The tuned set comes first, then the sets with which it is compared, then all others by name.
fn order(name: &str) -> u8 {
    match name {
        _ if name.starts_with("tuned") => 0,
        _ if name.starts_with("chosen") || name.starts_with("yours") => 1,
        _ if name.starts_with("paper") => 2,
        _ => 3,
    }
}

fn read_drive(path: &Path) -> Result<Vec<Row>, ReportError> {
    let mut rows = Vec::new();
    read_table(path, |row: Row| {
        // What a vehicle said that did not know it itself; without its heading there is no place of the reference either.
        let is_known = [row.x_m, row.y_m, row.speed_mps].iter().all(|it| it.is_finite());
        if !is_known || row.reference_x_m.is_nan() || row.reference_y_m.is_nan() {
            return Ok(());
        }
        check_numbers(row.numbers())?;
        rows.push(row);
        Ok(())
    })?;
    if rows.is_empty() {
        return Err(ReportError::malformed(path, None, "the file holds no tick"));
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::split_name;

    #[test]
    fn names_tell_set_and_noise() {
        for (stem, name, noisy) in [
            ("paper_noise_free", "paper", false),
            ("tuned_noisy", "tuned", true),
            ("tuned noise-free", "tuned", false),
            ("row_2_noisy", "row 2", true),
            ("something", "something", false),
            ("noisy", "drive", true),
        ] {
            assert_eq!(split_name(stem), (name.to_owned(), noisy), "{stem}");
        }
    }
}
