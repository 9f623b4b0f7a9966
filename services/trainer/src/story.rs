//! The story of a training, written as it happens: `episodes.csv` and `drives.csv` in the run's folder.
//!
//! A restarted trainer cuts both off where they stood at its checkpoint, and writes the rest again while it replays its
//! journal. Rows of different learners are in the order in which the drives came back.

use std::fs::{self, File};
use std::io::{self, Seek, SeekFrom};
use std::path::Path;

use anyhow::{Context, Result};
use config::LawConfig;
use serde::{Deserialize, Serialize};

use crate::own_file;
use crate::training::Taken;

/// Name of the file with a row for each episode.
pub const EPISODES_FILE: &str = "episodes.csv";
/// Name of the file with a row for each step of a learner.
pub const DRIVES_FILE: &str = "drives.csv";

/// Lengths of the two files, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Lengths {
    episodes: u64,
    drives: u64,
}

impl Lengths {
    /// Whether the files in a folder are that long, or longer.
    pub(crate) fn are_within(&self, folder: &Path) -> bool {
        [(EPISODES_FILE, self.episodes), (DRIVES_FILE, self.drives)].into_iter().all(
            |(name, length)| {
                fs::symlink_metadata(folder.join(name)).is_ok_and(|meta| meta.len() >= length)
            },
        )
    }
}

/// The two files, open for more.
pub(crate) struct Story {
    episodes: csv::Writer<File>,
    drives: csv::Writer<File>,
    /// Number of the law's parameters.
    parameters: usize,
    heading_weight: f64,
}

impl Story {
    /// The files in a folder, cut off at these lengths, or begun anew.
    pub(crate) fn open(
        folder: &Path,
        law: &LawConfig,
        heading_weight: f64,
        lengths: Option<Lengths>,
    ) -> Result<Self> {
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
        let open = |name: &str, head: &[String], length: Option<u64>| {
            let path = folder.join(name);
            open(&path, head, length).with_context(|| format!("failed to write {path:?}"))
        };
        Ok(Self {
            episodes: open(EPISODES_FILE, &head(&episodes), lengths.map(|it| it.episodes))?,
            drives: open(DRIVES_FILE, &head(&drives.concat()), lengths.map(|it| it.drives))?,
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

    /// Writes what was added; returns how long the files are now.
    pub(crate) fn written(&mut self) -> Result<Lengths> {
        self.flush()?;
        let (episodes, drives) = (self.episodes.get_ref(), self.drives.get_ref());
        Ok(Lengths { episodes: episodes.metadata()?.len(), drives: drives.metadata()?.len() })
    }
}

fn open(path: &Path, head: &[String], length: Option<u64>) -> io::Result<csv::Writer<File>> {
    let mut file = own_file::open(path)?;
    file.set_len(length.unwrap_or_default())?;
    file.seek(SeekFrom::End(0))?;
    let mut writer = csv::Writer::from_writer(file);
    if length.is_none() {
        writer.write_record(head)?;
    }
    Ok(writer)
}
