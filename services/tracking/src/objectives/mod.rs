//! The objective by which a drive is judged: one number, the smaller the better.
//!
//! An objective is a file of this folder with its row in the table below, and a file of `config/objectives` with its
//! settings. Learners, ranking, grid and report all use the same one.

mod distance;
mod mse;
mod path;
mod path_max;
mod weighted;

use config::RunConfig;

use crate::{DriveRecord, EndReason};

/// How one objective measures a drive.
trait Measure: Sized {
    /// The measure of a configuration.
    fn new(config: &RunConfig) -> Self;

    /// The value of a drive: finite, not negative, the smaller the better.
    fn of(&self, drive: &DriveRecord) -> f64;

    /// The value of a drive that is `apart_m` from where it should be at every tick: the bound for drives that arrive.
    fn of_bound(&self, apart_m: f64) -> f64;

    /// Whether it must first be given the least value of every other objective in the grid.
    fn needs_bests(&self) -> bool {
        false
    }

    /// Takes the drives of the whole grid, if [`Measure::needs_bests`].
    fn take_bests(&mut self, _drives: &[DriveRecord]) {}
}

/// The table of objectives: the name of the file in `config/objectives`, and the type that measures.
macro_rules! objectives {
    ($($name:literal => $kind:ident($measure:ty)),+ $(,)?) => {
        #[derive(Debug, Clone, Copy, PartialEq)]
        enum Kind {
            $($kind($measure)),+
        }

        impl Kind {
            fn new(config: &RunConfig) -> Self {
                match config.objective.name.as_str() {
                    $($name => Self::$kind(<$measure>::new(config)),)+
                    other => panic!("the objective {other} has a file in config/objectives but no row here"),
                }
            }

            fn of(&self, drive: &DriveRecord) -> f64 {
                match self { $(Self::$kind(measure) => measure.of(drive)),+ }
            }

            fn of_bound(&self, apart_m: f64) -> f64 {
                match self { $(Self::$kind(measure) => measure.of_bound(apart_m)),+ }
            }

            fn needs_bests(&self) -> bool {
                match self { $(Self::$kind(measure) => measure.needs_bests()),+ }
            }

            fn take_bests(&mut self, drives: &[DriveRecord]) {
                match self { $(Self::$kind(measure) => measure.take_bests(drives)),+ }
            }
        }

        #[cfg(test)]
        const NAMES: &[&str] = &[$($name),+];
    };
}

objectives! {
    "distance" => Distance(distance::Distance),
    "mse" => Mse(mse::Mse),
    "path" => Path(path::Path),
    "path_max" => PathMax(path_max::PathMax),
    "weighted" => Weighted(weighted::Weighted),
}

/// The objective of a configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Objective {
    kind: Kind,
    /// Distance that bounds the value of a drive which arrives; `None` if drives end by time.
    cap_m: Option<f64>,
}

impl Objective {
    /// The objective of a configuration.
    ///
    /// # Panics
    /// If no objective has that name; a resolved configuration names one.
    pub fn new(config: &RunConfig) -> Self {
        let cap_m = config.objective.cap_wheelbases * config.vehicle.wheelbase_m;
        Self { kind: Kind::new(config), cap_m: (cap_m > 0.0).then_some(cap_m) }
    }

    /// The value of a drive: finite, not negative, the smaller the better.
    ///
    /// If drives are meant to arrive, the value of one that does is bounded. The value of one that does not is the
    /// bound times (1 + the share of the path that it did not drive), so that it ranks after all drives that arrive.
    pub fn of(&self, drive: &DriveRecord) -> f64 {
        let Some(cap_m) = self.cap_m else { return self.kind.of(drive) };
        let cap = self.kind.of_bound(cap_m);
        if drive.reason == EndReason::Goal {
            self.kind.of(drive).min(cap)
        } else {
            // Never quite the bound itself, even at the very end of the path.
            cap * (1.0 + (1.0 - drive.progress).max(1e-6))
        }
    }

    /// Whether it must first be given the drives of the whole grid, by [`Objective::take_grid`].
    pub fn needs_grid(&self) -> bool {
        self.kind.needs_bests()
    }

    /// Takes the drives of the whole grid, whose least values become scales.
    pub fn take_grid(&mut self, drives: &[DriveRecord]) {
        self.kind.take_bests(drives);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    fn objective(name: &str, sets: &[&str]) -> Objective {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set(&format!("objective={name}")).unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        Objective::new(&layers.resolve().unwrap())
    }

    fn drive() -> DriveRecord {
        DriveRecord {
            mean_abs_cross_m: 0.3,
            mean_abs_heading_rad: 0.1,
            along_mse_m2: 0.5,
            cross_mse_m2: 0.25,
            path_mean_m: 0.2,
            path_max_m: 0.6,
            progress: 1.0,
            ..DriveRecord::default()
        }
    }

    #[test]
    fn table_and_files_name_the_same_objectives() {
        let mut known: Vec<&str> = config::names_in("objectives").collect();
        let mut rows = NAMES.to_vec();
        known.sort_unstable();
        rows.sort_unstable();
        assert_eq!(known, rows);
    }

    #[test]
    fn each_measures_its_own() {
        let check = |name: &str, wanted: f64| {
            let value = objective(name, &[]).of(&drive());
            assert!((value - wanted).abs() < 1e-12, "{name}: {value}");
        };
        check("distance", (0.09f64 + 10.0 * 0.01).sqrt());
        check("mse", 0.75);
        check("path", 0.2);
        check("path_max", 0.6);
    }

    #[test]
    fn a_sum_is_scaled_by_settings_or_by_the_best_of_the_grid() {
        let sets = ["objective.settings.mse_scale=0.5", "objective.settings.path_scale=0.1"];
        let scaled = objective("weighted", &sets);
        assert!(!scaled.needs_grid());
        assert_eq!(scaled.of(&drive()), 0.75 / 0.5 + 0.2 / 0.1);
        let mut by_best = objective("weighted", &[]);
        assert!(by_best.needs_grid());
        let better = DriveRecord { path_mean_m: 0.05, ..drive() };
        by_best.take_grid(&[drive(), better]);
        assert_eq!(by_best.of(&drive()), 1.0 + 0.2 / 0.05);
        assert!(!by_best.needs_grid());
    }

    #[test]
    fn what_does_not_arrive_ranks_behind_all_that_arrive() {
        for name in NAMES {
            let sets = ["mse_scale", "path_scale", "path_max_scale", "distance_scale"]
                .map(|key| format!("objective.settings.{key}=1.0"));
            let mut all: Vec<&str> = vec!["objective.cap_wheelbases=2.0"];
            if *name == "weighted" {
                all.extend(sets.iter().map(String::as_str));
            }
            let objective = objective(name, &all);
            let arrived = DriveRecord { reason: EndReason::Goal, ..drive() };
            let far = DriveRecord {
                mean_abs_cross_m: 1e9,
                along_mse_m2: 1e18,
                path_mean_m: 1e9,
                path_max_m: 1e9,
                ..arrived
            };
            let end = DriveRecord { reason: EndReason::Time, progress: 1.0, ..drive() };
            let half = DriveRecord { progress: 0.5, ..end };
            let none = DriveRecord { reason: EndReason::Collision, progress: 0.0, ..end };
            let values = [arrived, far, end, half, none].map(|drive| objective.of(&drive));
            assert!(values.is_sorted_by(|a, b| a < b), "{name}: {values:?}");
            assert!(values.iter().all(|value| value.is_finite()), "{name}: {values:?}");
        }
    }
}
