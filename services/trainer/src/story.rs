//! The story of a training, written as it happens: `episodes.csv` and `drives.csv` in the run's folder.
//!
//! A restarted trainer writes both again while it replays its journal. Rows of different learners are in the order in
//! which the drives came back.

use std::fs::File;
use std::path::Path;

use anyhow::{Context, Result};
use config::LawConfig;

use crate::training::Taken;

/// Name of the file with a row for each episode.
pub const EPISODES_FILE: &str = "episodes.csv";
/// Name of the file with a row for each step of a learner.
pub const DRIVES_FILE: &str = "drives.csv";

/// The two files, open for more.
pub(crate) struct Story {
    episodes: csv::Writer<File>,
    drives: csv::Writer<File>,
    /// Number of the law's parameters.
    parameters: usize,
    heading_weight: f64,
}

impl Story {
    pub(crate) fn new(folder: &Path, law: &LawConfig, heading_weight: f64) -> Result<Self> {
        let head = |names: &[&str]| -> Vec<String> {
            names
                .iter()
                .map(|name| (*name).to_owned())
                .chain(law.keys().map(str::to_owned))
                .collect()
        };
        let episodes = ["learner", "episode", "steps", "return", "last_value", "terminated"];
        let measures = ["value", "distance", "mse_m2", "path_mean_m", "path_p95_m", "path_max_m"];
        let drives = [&["learner", "step", "remembered", "reward"], &measures[..], &["arrived"]];
        Ok(Self {
            episodes: open(&folder.join(EPISODES_FILE), &head(&episodes))?,
            drives: open(&folder.join(DRIVES_FILE), &head(&drives.concat()))?,
            parameters: law.count(),
            heading_weight,
        })
    }

    /// Adds a step, and the episode that ended with it.
    pub(crate) fn add(&mut self, taken: &Taken) -> Result<()> {
        let Taken { ask, drive, value, remembered, told } = taken;
        let mut row = vec![
            ask.learner.to_string(),
            ask.step.to_string(),
            remembered.to_string(),
            told.reward.map(|reward| reward.to_string()).unwrap_or_default(),
        ];
        row.extend(
            [
                *value,
                drive.distance(self.heading_weight),
                drive.mse_m2(),
                drive.path_mean_m,
                drive.path_p95_m,
                drive.path_max_m,
            ]
            .map(|number| number.to_string()),
        );
        row.push(drive.arrived().to_string());
        row.extend(ask.parameters.0[..self.parameters].iter().map(f64::to_string));
        self.drives.write_record(&row)?;
        let Some(episode) = told.episode else { return Ok(()) };
        let mut row = vec![
            ask.learner.to_string(),
            episode.number.to_string(),
            episode.steps.to_string(),
            episode.reward_sum.to_string(),
            episode.last_value.to_string(),
            episode.terminal.is_some().to_string(),
        ];
        match episode.terminal {
            Some(set) => row.extend(set.0[..self.parameters].iter().map(f64::to_string)),
            None => row.extend(vec![String::new(); self.parameters]),
        }
        self.episodes.write_record(&row)?;
        Ok(())
    }

    /// Writes what was added to the files.
    pub(crate) fn flush(&mut self) -> Result<()> {
        self.episodes.flush()?;
        self.drives.flush()?;
        Ok(())
    }
}

fn open(path: &Path, head: &[String]) -> Result<csv::Writer<File>> {
    let mut writer =
        csv::Writer::from_path(path).with_context(|| format!("failed to write {path:?}"))?;
    writer.write_record(head)?;
    Ok(writer)
}
