//! The drives of a vehicle that is not our simulator: where its figures come from.
//!
//! What drives need not be our ring in lockstep, whose drives plain calls compute. Then each figure of the table is that
//! of a drive which was made, or the mean of several if the same request does not give the same drive.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, Result};
use config::launch::Launch;
use config::{MAX_PARAMETERS, Parameters, RunConfig};
use outcome::{Interval, Measures, Spread};
use tracking::DriveRecord;

use crate::Training;
use crate::statistics::Estimate;
use crate::sweep::PlannedDrive;
use crate::training::by_values;
use crate::wire::Driven;

/// Name of the launch file in a run's folder.
const LAUNCH_FILE: &str = "launch.toml";

/// What makes the drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Driver {
    /// Our ring in lockstep: plain calls compute the same drives.
    Simulator,
    /// Anything else: a drive is known only if it was made. `repeats` says whether the same request gives the same drive.
    Vehicle { repeats: bool },
}

impl Driver {
    /// What makes the drives of a run, by the launch file in its folder.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub(crate) fn of_run(folder: &Path, config: &RunConfig) -> Result<Self> {
        let path = folder.join(LAUNCH_FILE);
        let text =
            std::fs::read_to_string(&path).with_context(|| format!("failed to read {path:?}"))?;
        let launch = Launch::parse(LAUNCH_FILE, &text)?;
        if launch.ring_is_ours() && !config.run.realtime {
            return Ok(Self::Simulator);
        }
        Ok(Self::Vehicle { repeats: launch.repeats() && !config.run.realtime })
    }
}

/// Drives without noise, by their sets.
#[derive(Debug, Clone, Default)]
pub struct OwnDrives(HashMap<[u64; MAX_PARAMETERS], Vec<DriveRecord>>);

impl OwnDrives {
    /// Adds a drive.
    pub fn add(&mut self, set: &Parameters, drive: DriveRecord) {
        self.0.entry(set.to_bits()).or_default().push(drive);
    }

    /// Adds the drives of a list that were made.
    pub fn take(&mut self, driven: &[Driven]) {
        for Driven { report, record } in driven {
            self.add(&Parameters(report.parameters), *record);
        }
    }

    /// The drives of a set.
    pub fn of(&self, set: &Parameters) -> &[DriveRecord] {
        self.0.get(&set.to_bits()).map_or(&[], Vec::as_slice)
    }

    /// The drives that these sets lack, if each is to have `repeats` of them. A set counts once, however often it is named.
    pub fn missing(
        &self,
        sets: impl IntoIterator<Item = Parameters>,
        repeats: u32,
    ) -> Vec<PlannedDrive> {
        let mut sets: Vec<Parameters> = sets.into_iter().collect();
        sets.sort_by(by_values);
        sets.dedup();
        let missing = |set: Parameters| {
            let count = (repeats as usize).saturating_sub(self.of(&set).len());
            let drive = PlannedDrive { by_zone: vec![set], seed: None, plant: 0, record: None };
            std::iter::repeat_n(drive, count)
        };
        sets.into_iter().flat_map(missing).collect()
    }
}

/// The set that a training recommends by its own drives alone.
pub(crate) fn recommended(training: &Training) -> Parameters {
    let means: HashMap<_, f64> =
        training.visited().iter().map(|set| (set.parameters.to_bits(), set.mean_value)).collect();
    let mean = |set: &Parameters| means.get(&set.to_bits()).copied().unwrap_or(f64::INFINITY);
    training.tuner().recommend(&|a, b| mean(a).total_cmp(&mean(b)).then_with(|| by_values(a, b)))
}

/// The means of the measures of a set's drives: of the largest values the largest, and arrived only if all
/// drives did.
///
/// # Panics
/// If there is no drive.
pub(crate) fn mean_of(all: &[Measures]) -> Measures {
    let first = all[0];
    // By differences from the first one: equal drives have exactly their own value as mean.
    let mean = |of: fn(&Measures) -> f64| {
        let sum: f64 = all.iter().map(|it| of(it) - of(&first)).sum();
        of(&first) + sum / all.len() as f64
    };
    let most = |of: fn(&Measures) -> f64| all.iter().map(of).fold(0.0, f64::max);
    Measures {
        value: mean(|it| it.value),
        distance: mean(|it| it.distance),
        mse_m2: mean(|it| it.mse_m2),
        path_mean_m: mean(|it| it.path_mean_m),
        path_p95_m: mean(|it| it.path_p95_m),
        path_max_m: most(|it| it.path_max_m),
        steering_travel_radps: mean(|it| it.steering_travel_radps),
        steering_rate_p95_radps: mean(|it| it.steering_rate_p95_radps),
        lateral_acceleration_p95_mps2: mean(|it| it.lateral_acceleration_p95_mps2),
        lateral_acceleration_max_mps2: most(|it| it.lateral_acceleration_max_mps2),
        lateral_jerk_p95_mps3: mean(|it| it.lateral_jerk_p95_mps3),
        lateral_jerk_max_mps3: most(|it| it.lateral_jerk_max_mps3),
        progress_in_time: mean(|it| it.progress_in_time),
        arrived: all.iter().all(|it| it.arrived),
    }
}

/// How certain these means are; `None` of a single drive.
pub(crate) fn spread_of(all: &[Measures]) -> Option<Spread> {
    let interval = |of: fn(&Measures) -> f64| {
        let Estimate { low, high, .. } = Estimate::of(&all.iter().map(of).collect::<Vec<_>>());
        Interval { low, high }
    };
    (all.len() > 1).then(|| Spread {
        drives: all.len() as u32,
        value: interval(|it| it.value),
        distance: interval(|it| it.distance),
        mse_m2: interval(|it| it.mse_m2),
        path_mean_m: interval(|it| it.path_mean_m),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(first: f64) -> Parameters {
        Parameters::of(&[first, 1.0])
    }

    #[test]
    fn a_set_is_driven_as_often_as_it_lacks() {
        let mut own = OwnDrives::default();
        own.add(&set(1.0), DriveRecord::default());
        let missing = own.missing([set(2.0), set(1.0), set(2.0)], 3);
        let sets: Vec<f64> = missing.iter().map(|it| it.by_zone[0].0[0]).collect();
        assert_eq!(sets, [1.0, 1.0, 2.0, 2.0, 2.0]);
        assert!(missing.iter().all(|it| it.seed.is_none() && it.record.is_none()));
        assert!(own.missing([set(1.0)], 1).is_empty());
        assert_eq!((own.of(&set(1.0)).len(), own.of(&set(2.0)).len()), (1, 0));
    }

    #[test]
    fn equal_drives_have_their_own_value_as_mean_and_no_width() {
        // Whose threefold sum over three is not always the number itself.
        for value in [0.1, 0.7, 1.0 / 3.0, 0.123_456_789_012_345_67] {
            let one = Measures {
                value,
                mse_m2: value,
                path_max_m: value,
                arrived: true,
                ..Measures::default()
            };
            assert_eq!(mean_of(&[one; 7]), one);
            let spread = spread_of(&[one; 7]).unwrap();
            assert!((spread.value.high - spread.value.low).abs() < 1e-12);
            assert_eq!((spread.drives, spread_of(&[one])), (7, None));
        }
    }

    #[test]
    fn a_mean_is_of_all_drives_and_a_maximum_the_largest() {
        let with = |value: f64, arrived| Measures {
            value,
            path_mean_m: 2.0 * value,
            path_max_m: 3.0 * value,
            arrived,
            ..Measures::default()
        };
        let mean = mean_of(&[with(1.0, true), with(4.0, false), with(1.0, true)]);
        assert_eq!((mean.value, mean.path_mean_m, mean.path_max_m), (2.0, 4.0, 12.0));
        assert!(!mean.arrived);
        let spread = spread_of(&[with(1.0, true), with(4.0, true)]).unwrap();
        // Two drives say little: Student's t with one degree of freedom.
        assert!((spread.value.high - 2.5 - 12.706_205 * 1.5).abs() < 1e-5);
        assert!((spread.value.low + spread.value.high - 5.0).abs() < 1e-9);
    }
}
