//! The objective by which a drive is judged: one number, the smaller the better.
//!
//! An objective is a file of this folder with its row in the table below, and a file of `config/objectives` with its
//! settings. Learners, ranking, grid and report all use the same one.

mod arrival;
mod distance;
mod limits;
mod mse;
mod path;
mod path_max;
mod weighted;

use config::RunConfig;

use self::limits::Limits;
use crate::DriveRecord;

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

/// Bounds the value of a drive within the limits, if drives end by their time: no drive worth its name is so far off.
const WITHIN_LIMITS_WHEELBASES: f64 = 10.0;

/// A value of which half the bound is left as it is, and what is beyond comes nearer and nearer to the bound: of two
/// values the larger one stays the larger one.
fn bounded(value: f64, bound: f64) -> f64 {
    let half = 0.5 * bound;
    if value <= half { value } else { bound - half * (half / value) }
}

/// The objective of a configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Objective {
    kind: Kind,
    /// Distance that bounds the value of a drive which arrives; `None` if drives end by time.
    cap_m: Option<f64>,
    limits: Limits,
    /// Distance that bounds the value of a drive within the limits.
    bound_m: f64,
}

impl Objective {
    /// The objective of a configuration.
    ///
    /// # Panics
    /// If no objective has that name; a resolved configuration names one.
    pub fn new(config: &RunConfig) -> Self {
        let wheelbase_m = config.vehicle.wheelbase_m;
        let cap_m = config.objective.cap_wheelbases * wheelbase_m;
        let cap_m = (cap_m > 0.0).then_some(cap_m);
        let bound_m = cap_m.unwrap_or(WITHIN_LIMITS_WHEELBASES * wheelbase_m);
        let limits = Limits(config.objective.limits);
        Self { kind: Kind::new(config), cap_m, limits, bound_m }
    }

    /// The value of a drive: finite, not negative, the smaller the better.
    ///
    /// If drives are meant to arrive, or have limits, the value of one that does and keeps them is bounded. The value of
    /// any other is the bound times (1 + how much it misses), so that it ranks behind all that arrive within the limits.
    /// What one misses that does not arrive is as much as one can miss that breaks all limits, so that it ranks behind all
    /// that arrive, and the more the less far it came and the farther from the path it was, as `arrival.rs` says.
    pub fn of(&self, drive: &DriveRecord) -> f64 {
        if self.cap_m.is_none() && !self.limits.are_hard() {
            return self.kind.of(drive) * self.limits.price(drive);
        }
        let bound = self.kind.of_bound(self.bound_m);
        let missed = match self.cap_m {
            // Those of several drives together have been counted.
            Some(_) if drive.missed > 0.0 => self.limits.most_missed() + drive.missed,
            Some(cap_m) if !drive.arrived() => {
                self.limits.most_missed() + arrival::missed(drive, cap_m)
            }
            _ => self.limits.missed(drive),
        };
        match missed > 0.0 {
            true => bound * (1.0 + missed),
            false => bounded(self.kind.of(drive) * self.limits.price(drive), bound),
        }
    }

    /// One record of several drives with the same parameters: their means, and where drives are meant to arrive what they
    /// missed together, so that the number that arrive counts first.
    ///
    /// # Panics
    /// If there is no drive.
    pub fn mean_of(&self, drives: &[DriveRecord]) -> DriveRecord {
        let missed = self.cap_m.map_or(0.0, |cap_m| arrival::missed_together(drives, cap_m));
        DriveRecord { missed, ..DriveRecord::mean_of(drives) }
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
    use crate::EndReason;
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
    fn turning_the_wheels_has_a_smooth_price_above_its_threshold_alone() {
        let priced = objective("path", &["objective.limits.steering_travel_price_radps=0.6"]);
        let at =
            |steering_travel_radps| priced.of(&DriveRecord { steering_travel_radps, ..drive() });
        assert_eq!([0.0, 0.6].map(at), [0.2, 0.2]);
        assert!((at(0.6001) - 0.2).abs() < 1e-6);
        assert!((at(0.72) - 0.4).abs() < 1e-12 && (at(0.9) - 0.2 * 5.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_over_a_limit_ranks_behind_all_within_whether_drives_arrive_or_not() {
        for cap in ["objective.cap_wheelbases=2.0", "objective.cap_wheelbases=0.0"] {
            let limits =
                ["objective.limits.steering_travel_radps=0.5", "objective.limits.progress=0.97"];
            let objective = objective("path", &[&[cap][..], &limits].concat());
            let goal = DriveRecord { reason: EndReason::Goal, ..drive() };
            let late = DriveRecord { reason: EndReason::Time, progress: 0.99, ..goal };
            let with = |path_mean_m, steering_travel_radps, progress_in_time| DriveRecord {
                path_mean_m,
                steering_travel_radps,
                progress_in_time,
                ..goal
            };
            let values = [
                with(0.2, 0.5, 1.0),
                with(1e9, 0.5, 0.97),
                with(0.0, 0.51, 1.0),
                with(0.0, 0.7, 1.0),
                with(0.0, 1e9, 1.0),
                with(0.0, 1e9, 0.5),
            ]
            .map(|drive| objective.of(&drive));
            assert!(values.is_sorted_by(|a, b| a < b), "{cap}: {values:?}");
            assert!(values[5].is_finite());
            if cap.ends_with("2.0") {
                assert!(
                    objective.of(&late) > values[5],
                    "what does not arrive is behind all that do"
                );
            }
        }
    }

    #[test]
    fn what_arrives_is_told_apart_however_far_it_is_from_the_path() {
        let sets =
            ["objective.cap_wheelbases=2.0", "objective.limits.steering_travel_price_radps=0.6"];
        let objective = objective("path", &sets);
        let of = |path_mean_m, steering_travel_radps| {
            let reason = EndReason::Goal;
            objective.of(&DriveRecord { path_mean_m, steering_travel_radps, reason, ..drive() })
        };
        let values = [of(2.8, 0.0), of(2.9, 0.0), of(4.0, 0.0), of(4.0, 1.0), of(40.0, 9.0)];
        assert!(values.is_sorted_by(|a, b| a < b) && values[4] < 5.75, "{values:?}");
        assert_eq!(values[0], 2.8);
    }

    #[test]
    fn each_limit_holds_what_it_names() {
        type Of = fn(&mut DriveRecord) -> &mut f64;
        let limits: [(&str, Of); 6] = [
            ("steering_travel_radps", |it| &mut it.steering_travel_radps),
            ("steering_rate_p95_radps", |it| &mut it.steering_rate_p95_radps),
            ("lateral_acceleration_p95_mps2", |it| &mut it.lateral_acceleration_p95_mps2),
            ("lateral_acceleration_max_mps2", |it| &mut it.lateral_acceleration_max_mps2),
            ("lateral_jerk_p95_mps3", |it| &mut it.lateral_jerk_p95_mps3),
            ("lateral_jerk_max_mps3", |it| &mut it.lateral_jerk_max_mps3),
        ];
        for (key, field) in limits {
            let objective = objective("path", &[&format!("objective.limits.{key}=2.0")]);
            let with = |value| {
                let mut drive = drive();
                *field(&mut drive) = value;
                objective.of(&drive)
            };
            assert_eq!(with(2.0), 0.2, "{key}");
            assert!(with(2.1) > with(2.0) && with(3.0) > with(2.1), "{key}");
        }
    }

    #[test]
    fn without_limits_the_paper_s_objective_is_as_it_was() {
        let shaking = DriveRecord { steering_travel_radps: 1e3, progress: 0.1, ..drive() };
        assert_eq!(objective("path", &[]).of(&shaking), 0.2);
    }

    #[test]
    fn what_does_not_arrive_ranks_behind_all_that_arrive() {
        for name in NAMES {
            let sets = [
                "mse_scale",
                "path_scale",
                "path_max_scale",
                "distance_scale",
                "steering_travel_scale",
            ]
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
