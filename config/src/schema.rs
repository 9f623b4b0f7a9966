//! The resolved configuration of a run. Every key is documented next to its value in the presets; the
//! comments here say what the presets cannot.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::law::{LawConfig, NamedParameters, Parameters, Settings, paper_law};
use crate::{Axes, ConfigError, Grid, validate};

/// Everything that determines what a run computes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// Name of the manoeuvre.
    pub maneuver: String,
    /// Name or file of the vehicle preset.
    pub vehicle_preset: String,
    /// The rows of the paper's table for this manoeuvre; empty for a path that the paper does not have.
    pub paper: Vec<PaperSet>,
    /// The path to drive.
    pub path: PathConfig,
    /// How the reference pose advances.
    pub reference: Reference,
    /// Length and pace of a drive.
    pub drive: Drive,
    /// Settings that every control law shares.
    pub controller: Controller,
    /// Name or file of the control law's preset.
    pub law_preset: String,
    /// The control law.
    pub law: LawConfig,
    /// Settings of the safety gate and of the zones.
    pub supervisor: Supervisor,
    /// Noise of the odometry.
    pub noise: Noise,
    /// The road's edges, and what leaving it costs.
    pub collision: Collision,
    /// The objective by which a drive is judged.
    pub objective: ObjectiveConfig,
    /// The values of the grid along each of the law's parameters; see [`RunConfig::grid`].
    pub grid: Axes,
    /// When a set is ranked among all sets of the grid.
    pub ranking: Ranking,
    /// The tuner.
    pub tuner: TunerConfig,
    /// The learners of the Q-learning tuners.
    pub learning: Learning,
    /// How a set is chosen under noise.
    pub robust: Robust,
    /// On which plants a set is driven in a training.
    #[serde(default)]
    pub over: crate::Over,
    /// The envelope to which a drive is held, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub envelope: Option<Box<crate::Envelope>>,
    /// Whether a drive that leaves its envelope is only told of, and not stopped.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub envelope_only_judges: bool,
    /// The regions of the zones' gains to which their changes are held; empty if they are not.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub switch_regions: Vec<crate::ZoneRegion>,
    /// The keys that differ from run to run.
    pub run: Run,
    /// The vehicle.
    pub vehicle: Vehicle,
}

impl RunConfig {
    /// Parses the configuration that the orchestrator resolved and wrote for the processes of a run.
    ///
    /// # Errors
    /// If the text is not a complete and valid configuration.
    pub fn from_resolved(text: &str) -> Result<Self, ConfigError> {
        let config: Self = toml::from_str(text)
            .map_err(|error| ConfigError::new("config.toml", "", error.message().to_owned()))?;
        validate::validate(&config)
            .map_err(|(key, problem)| ConfigError::new("config.toml", key, problem))?;
        Ok(config)
    }

    /// Ticks of a full drive.
    pub fn ticks(&self) -> u64 {
        (self.drive.loop_time_s / self.drive.tick_s).round() as u64
    }

    /// The parameter sets that can be chosen.
    pub fn grid(&self) -> Grid {
        Grid::new(&self.law, &self.grid)
    }

    /// The paper's rows with which this path can be driven: those with a set for each manoeuvre of its zones, or one
    /// for all. Empty with a law other than the paper's.
    pub fn paper_rows(&self) -> Vec<PaperRow> {
        let paper = paper_law();
        if !self.law.keys().eq(paper.keys()) || self.law.name != paper.name {
            return Vec::new();
        }
        let due = self.maneuvers_due().len();
        let rows = self.paper.iter().filter(|row| row.gains.len() == 1 || row.gains.len() == due);
        rows.map(|row| PaperRow {
            sets: row
                .gains
                .iter()
                .map(|set| paper.parameters_of(set).expect("a resolved configuration was checked"))
                .collect(),
            mse_m2: row.mse_m2,
            noisy_mse_m2: row.noisy_mse_m2,
            chosen: row.chosen,
        })
        .collect()
    }

    /// The set that the paper chose for this manoeuvre, if it chose a single one.
    pub fn paper_set(&self) -> Option<Parameters> {
        match self.paper_rows().into_iter().find(|row| row.chosen)?.sets[..] {
            [set] => Some(set),
            _ => None,
        }
    }

    /// How far from the path the vehicle may be; infinite if that is not watched.
    pub fn path_distance_limit_m(&self) -> f64 {
        let noise_m = if self.noise.enabled { self.noise.position_sd_m } else { 0.0 };
        let derived_m = 3.0 * self.vehicle.wheelbase_m / FULL_SIZE_WHEELBASE_M + noise_m;
        let limit = self.vehicle.safety.path_distance_limit_m;
        limit.or(if self.is_as_in_the_paper() { f64::INFINITY } else { derived_m })
    }

    /// How far the vehicle's heading may differ from the path's; infinite if that is not watched.
    pub fn path_heading_limit_rad(&self) -> f64 {
        let noise_rad = if self.noise.enabled { self.noise.heading_half_width_rad } else { 0.0 };
        let limit = self.vehicle.safety.path_heading_limit_rad;
        limit.or(if self.is_as_in_the_paper() { f64::INFINITY } else { 0.8 + noise_rad })
    }

    /// Whether the gate watches that the vehicle does what it is told.
    pub fn watches_response(&self) -> bool {
        match self.vehicle.safety.watch_response {
            Watched::On => true,
            Watched::Off => false,
            // An envelope that stops the vehicle changes the paper's drives anyway.
            Watched::Auto => {
                let is_stopped_by_envelope = self.envelope.is_some() && !self.envelope_only_judges;
                is_stopped_by_envelope || !self.is_as_in_the_paper()
            }
        }
    }

    /// Whether it is one of the paper's manoeuvres with the paper's vehicle, kinematic or dynamic: its drives are to be
    /// the paper's, without a gate that ends them.
    fn is_as_in_the_paper(&self) -> bool {
        let is_paper_s_vehicle =
            ["tesla_model_3", "tesla_model_3_dynamic"].contains(&&*self.vehicle_preset);
        !self.paper.is_empty() && is_paper_s_vehicle
    }

    /// Whether drives are meant to arrive at the end of the path; those that are not end by their time.
    pub fn is_to_arrive(&self) -> bool {
        self.objective.cap_wheelbases > 0.0
    }

    /// Whether the reference waits for a vehicle that does not follow: on every path but the paper's, whose drives are to
    /// be the paper's.
    pub fn reference_waits(&self) -> bool {
        let Reference { advance, wait_to_speed, wait_to_s, .. } = self.reference;
        let is_on = wait_to_speed.is_finite() || wait_to_s.is_finite();
        advance == Advance::Time && is_on && self.paper.is_empty()
    }

    /// Whether the path is one of the user's own.
    pub fn is_own_path(&self) -> bool {
        self.maneuver == crate::presets::OWN_PATH
    }

    /// The key of a scale of the objective that is 0, which stands for the least value in the grid; `None` if the
    /// objective needs no grid.
    pub fn scale_from_grid(&self) -> Option<String> {
        let settings = &self.objective.settings;
        let is_from_grid = |key: &&String| {
            let Some(name) = key.strip_suffix("_scale") else { return false };
            let weight = format!("{name}_weight");
            let counts = !settings.0.contains_key(&weight) || settings.number(&weight) > 0.0;
            counts && settings.number(key) == 0.0
        };
        settings.0.keys().find(is_from_grid).map(|key| format!("objective.settings.{key}"))
    }

    /// Names of the manoeuvres that the path needs, each once, in the order of their first zones.
    pub fn maneuvers_due(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for zone in &self.path.zones {
            if !names.contains(&zone.name.as_str()) {
                names.push(&zone.name);
            }
        }
        names
    }

    /// The parameters of each zone, from one set for each of [`RunConfig::maneuvers_due`], or one for all.
    ///
    /// # Panics
    /// If there is neither one set nor one for each manoeuvre.
    pub fn sets_by_zone(&self, sets: &[Parameters]) -> Vec<Parameters> {
        let due = self.maneuvers_due();
        assert!(sets.len() == 1 || sets.len() == due.len(), "a set for each manoeuvre");
        let set_of = |zone: &ZoneConfig| {
            let place = due.iter().position(|name| *name == zone.name).expect("made of the zones");
            sets[place % sets.len()]
        };
        self.path.zones.iter().map(set_of).collect()
    }

    /// Number of learners of the tuner: its setting `learners`, or else one for each learning rate.
    pub fn learners(&self) -> usize {
        match self.tuner.settings.0.get("learners") {
            Some(_) => self.tuner.settings.number("learners").max(1.0) as usize,
            None => self.run.alphas.len(),
        }
    }

    /// Number of drives for which a training can wait at the same time: one for each learner, plant, and
    /// drive on that.
    pub fn drivers(&self) -> usize {
        self.learners() * self.drives_of_step()
    }

    /// Number of vehicles in the fleet: `run.fleet`, or one for each learner and plant.
    pub fn fleet(&self) -> usize {
        match self.run.fleet {
            0 => self.drivers().min(crate::MAX_FLEET),
            fleet => fleet as usize,
        }
    }
}

/// One row of the paper's tables: gains, and the paper's results with them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperSet {
    /// One set of the paper's law for each manoeuvre of the path, in the order in which they come.
    pub gains: Vec<NamedParameters>,
    /// Its mse without noise.
    pub mse_m2: f64,
    /// Its worst mse of ten drives with noise.
    pub noisy_mse_m2: f64,
    /// Whether it is the set that the paper chose.
    #[serde(default)]
    pub chosen: bool,
}

/// A row of the paper's tables whose sets can be driven.
#[derive(Debug, Clone, PartialEq)]
pub struct PaperRow {
    /// One set for each manoeuvre of the path, or one for all.
    pub sets: Vec<Parameters>,
    /// Its mse without noise.
    pub mse_m2: f64,
    /// Its worst mse of ten drives with noise.
    pub noisy_mse_m2: f64,
    /// Whether it is the set that the paper chose.
    pub chosen: bool,
}

/// The objective by which a drive is judged: the one number that is minimised.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct ObjectiveConfig {
    pub name: String,
    pub summary: String,
    /// Its unit; empty if it has none.
    pub unit: String,
    pub cap_wheelbases: f64,
    #[serde(default)]
    pub limits: ObjectiveLimits,
    /// The settings of its file in `config/objectives`.
    #[serde(default)]
    pub settings: Settings,
}

impl ObjectiveConfig {
    /// Whether a drive's value may differ from what the objective's name measures: by a bound, a price or a limit.
    pub fn is_adjusted(&self) -> bool {
        self.cap_wheelbases > 0.0 || self.limits != ObjectiveLimits::default()
    }
}

/// Limits of a drive beside its objective; 0 is no limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct ObjectiveLimits {
    pub steering_travel_price_radps: f64,
    pub steering_travel_radps: f64,
    pub steering_rate_p95_radps: f64,
    pub lateral_acceleration_p95_mps2: f64,
    pub lateral_acceleration_max_mps2: f64,
    pub lateral_jerk_p95_mps3: f64,
    pub lateral_jerk_max_mps3: f64,
    pub progress: f64,
}

/// The tuner that `learning.tuner` names, as described by its file in `config/tuners`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TunerConfig {
    /// What it is, in one line.
    pub summary: String,
    /// Its own settings.
    #[serde(default)]
    pub settings: Settings,
    /// The least and the largest value of each setting that is a number.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub ranges: BTreeMap<String, [f64; 2]>,
    /// The words that a setting may be, by its key; for settings that are words.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub choices: BTreeMap<String, Vec<String>>,
}

impl TunerConfig {
    /// Whether it has a budget of drives.
    pub fn has_budget(&self) -> bool {
        self.settings.0.contains_key("drives")
    }
}

/// When a set is ranked among all sets of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Ranking {
    pub max_ticks: u64,
    pub repeats: u32,
}

/// A pose in the map frame (REP-103: x forward, y left, yaw counter-clockwise).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseConfig {
    /// x in the map frame.
    pub x_m: f64,
    /// y in the map frame.
    pub y_m: f64,
    /// Yaw in the map frame.
    pub yaw_rad: f64,
}

/// A path, as a chain of pieces or as a row of points: one of the two is empty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PathConfig {
    /// Pose of the path's start.
    pub start: PoseConfig,
    /// The pieces, one after the other.
    pub pieces: Vec<Piece>,
    /// Points through which the path runs, (x_m, y_m) in the map frame; the first one is at the start. A
    /// path is closed if its last point is its first.
    pub points: Vec<[f64; 2]>,
    /// Name of a path from a file: that file's, without its ending; otherwise empty.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// The reference's speed at each point; empty if it is the same everywhere.
    pub speeds_mps: Vec<f64>,
    /// From each point to the road's edges, on the left and on the right; empty if they are not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub widths_m: Vec<[f64; 2]>,
    /// How many times a closed path is driven. Points, speeds and zones are those of one lap.
    #[serde(default = "one_lap")]
    pub laps: u32,
    /// The zones, in the order of the path.
    pub zones: Vec<ZoneConfig>,
}

fn one_lap() -> u32 {
    1
}

impl PathConfig {
    /// Whether the path is a closed one through points: its last point is its first.
    pub fn is_closed(&self) -> bool {
        self.points.len() > 2 && self.points.first() == self.points.last()
    }
}

/// One piece of a path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Piece {
    /// Straight on.
    Straight {
        /// Length.
        length_m: f64,
    },
    /// A straight diagonal to another lane: its heading is that of the diagonal; after it, the heading is the old one
    /// again.
    Diagonal {
        /// Distance ahead, in the heading before the piece.
        length_m: f64,
        /// Distance to the left; negative to the right.
        offset_m: f64,
    },
    /// Half a wave of a cosine to another lane: it begins and ends in the heading before the piece.
    Cosine {
        /// Distance ahead, in that heading.
        length_m: f64,
        /// Distance to the left; negative to the right.
        offset_m: f64,
    },
    /// Part of a circle.
    Arc {
        /// Radius.
        radius_m: f64,
        /// Angle turned; positive to the left.
        angle_deg: f64,
    },
}

/// A stretch of the path on which one manoeuvre is due.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ZoneConfig {
    /// Name of the manoeuvre that is due.
    pub name: String,
    /// Where the zone begins, along the path.
    pub from_m: f64,
}

macro_rules! choice {
    ($(#[$doc:meta])* $name:ident { $($(#[$variant_doc:meta])* $variant:ident),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum $name { $($(#[$variant_doc])* $variant),+ }
    };
}

pub(crate) use choice;

choice!(
    /// How the reference pose advances.
    Advance {
        /// With time, at a set speed after a ramp from rest.
        Time,
        /// With the projection of the measured pose on the path.
        Projection,
    }
);

/// How the reference pose advances.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Reference {
    pub advance: Advance,
    pub lookahead_m: f64,
    pub speed_mps: f64,
    pub ramp_s: f64,
    pub wait_from_speed: f64,
    pub wait_to_speed: f64,
    pub wait_from_s: f64,
    pub wait_to_s: f64,
    pub wait_limit_s: f64,
}

/// Length and pace of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Drive {
    pub loop_time_s: f64,
    #[serde(default)]
    pub start_speed_mps: f64,
    pub tick_s: f64,
    pub goal_radius_m: f64,
    #[serde(default = "anywhere")]
    pub area_m: [f64; 4],
    #[serde(default = "minutes")]
    pub patience_s: f64,
}

/// Settings that every control law shares.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Controller {
    pub steering_limit_rad: f64,
    pub compensate_dead_time: bool,
}

choice!(
    /// Where the vehicle is, for the zones.
    ZoneBy {
        /// By the projection of the measured pose on the path.
        Measured,
        /// By the reference's progress.
        Reference,
    }
);

/// Settings of the safety gate and of the zones.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Supervisor {
    pub speed_limit_mps: f64,
    pub speed_margin_mps: f64,
    pub speed_foresight_s: f64,
    pub speed_gain: f64,
    pub zone_by: ZoneBy,
    pub zone_hysteresis_m: f64,
}

/// Noise on the measured pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Noise {
    pub enabled: bool,
    pub position_sd_m: f64,
    pub heading_half_width_rad: f64,
}

/// The road's edges, and what leaving it costs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Collision {
    pub enabled: bool,
    pub lane_half_width_m: f64,
    pub margin_m: f64,
    pub penalty: f64,
}

choice!(
    /// Gains at the start of an episode.
    EpisodeGains {
        /// Those of the last episode's end.
        CarryOver,
        /// Uniform from the grid.
        Random,
    }
);
choice!(
    /// An action that leaves the grid.
    OutOfRange {
        /// Goes to the bound.
        Clamp,
        /// Leaves all gains as they were.
        Stay,
    }
);
choice!(
    /// For how long the closest state is kept.
    ClosestOver {
        /// The whole training.
        Training,
        /// One episode.
        Episode,
    }
);
choice!(
    /// How the closest state is compared.
    ClosestBy {
        /// By the distance of the mean errors.
        Continuous,
        /// By the distance of the state's bins.
        Binned,
    }
);
choice!(
    /// What the step limit does to an episode.
    StepLimitEffect {
        /// Ends it, and bootstraps through the end.
        Truncates,
        /// Ends it with a state of value 0.
        Terminates,
    }
);
choice!(
    /// Which gains a learner picks.
    Pick {
        /// Its last terminal set.
        LastTerminal,
        /// The set it visited most often.
        MostVisited,
    }
);
choice!(
    /// First gains of a learner.
    FirstGains {
        /// Uniform from the grid.
        Random,
        /// The middle of each axis.
        Centre,
    }
);
choice!(
    /// Choice among equal greedy actions.
    GreedyTies {
        /// Uniform.
        Random,
        /// The first.
        First,
    }
);

/// The learners of the Q-learning tuners.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Learning {
    pub tuner: String,
    pub episodes: u32,
    pub step_limit: u32,
    pub gamma: f64,
    pub epsilon_start: f64,
    pub epsilon_decay_share: f64,
    pub bins: u32,
    pub error_high_cross_m: f64,
    pub error_high_heading_rad: f64,
    pub heading_weight: f64,
    pub episode_gains: EpisodeGains,
    pub out_of_range: OutOfRange,
    pub closest_over: ClosestOver,
    pub closest_by: ClosestBy,
    pub lock_window: u32,
    pub step_limit_effect: StepLimitEffect,
    pub pick: Pick,
    pub first_gains: FirstGains,
    pub greedy_ties: GreedyTies,
}

/// How a set is chosen under noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Robust {
    pub engage_gear: bool,
    pub finalists: u32,
    pub repeats: u32,
    #[serde(default = "fresh_drives")]
    pub fresh: u32,
    pub holdout: u32,
}

fn fresh_drives() -> u32 {
    30
}

/// The keys that differ from run to run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Run {
    pub seed: u64,
    pub alphas: Vec<f64>,
    pub fleet: u32,
    pub memo: bool,
    #[serde(default = "repeats")]
    pub repeats: bool,
    pub realtime: bool,
}

fn repeats() -> bool {
    true
}

choice!(
    /// The vehicle model.
    VehicleModel {
        /// Kinematic single track.
        Kinematic,
        /// Dynamic single track with linear tyres.
        Dynamic,
    }
);

/// The vehicle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in vehicles/tesla_model_3.toml")]
pub struct Vehicle {
    pub name: String,
    pub model: VehicleModel,
    pub wheelbase_m: f64,
    pub tracked_point_m: f64,
    pub body_front_m: f64,
    pub body_rear_m: f64,
    pub body_half_width_m: f64,
    pub steering_limit_rad: f64,
    pub steering_rate_radps: f64,
    pub steering_delay_s: f64,
    pub steering_gain: f64,
    pub steering_offset_rad: f64,
    pub steering_dead_band_rad: f64,
    pub steering_lag_s: f64,
    pub speed_limit_mps: f64,
    pub speed_delay_s: f64,
    pub speed_kp: f64,
    pub speed_ki: f64,
    pub speed_integral_min: f64,
    pub speed_integral_max: f64,
    pub pedal_lag_s: f64,
    pub throttle_accel_mps2: f64,
    pub brake_decel_mps2: f64,
    pub drag_per_s: f64,
    pub rolling_decel_mps2: f64,
    pub mass_kg: f64,
    pub yaw_inertia_kgm2: f64,
    pub front_axle_to_cg_m: f64,
    pub cornering_stiffness_front_npr: f64,
    pub cornering_stiffness_rear_npr: f64,
    #[serde(default)]
    pub rear_slip_s2pm: f64,
    #[serde(default)]
    pub yaw_lag_s2pm: f64,
    #[serde(default)]
    pub understeer_s2pm: f64,
    pub gear_engaged: bool,
    pub gear_drive_s: f64,
    pub gear_reverse_s: f64,
    pub gear_poll_s: f64,
    pub gear_speed_mps: f64,
    /// Keys that its file leaves out without naming another vehicle: their values are those of tesla_model_3.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub borrowed: Vec<String>,
    pub safety: Safety,
    pub ros2: crate::Ros2,
    /// The noise of its odometry; no preset states any.
    #[serde(default, skip_serializing_if = "crate::StatedNoise::is_empty")]
    pub noise: crate::StatedNoise,
    /// How well its values are known; no preset states it.
    #[serde(default, skip_serializing_if = "crate::Uncertainty::is_empty")]
    pub uncertainty: crate::Uncertainty,
    /// Gains that were promoted to this vehicle, by manoeuvre; no preset has any.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub gains: BTreeMap<String, crate::TunedGains>,
}

choice!(
    /// Whether something is watched.
    Watched {
        /// On, except for the paper's manoeuvres with the paper's vehicle.
        Auto,
        /// On.
        On,
        /// Off.
        Off,
    }
);

/// A limit of the vehicle: a number, or "auto", which is derived from other keys.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Limit {
    /// Derived from other keys.
    Auto,
    /// This number.
    Is(f64),
}

impl Limit {
    /// The word for a limit that is derived.
    pub(crate) const AUTO: &str = "auto";

    /// The limit, where `derived` is what "auto" means.
    fn or(self, derived: f64) -> f64 {
        match self {
            Self::Auto => derived,
            Self::Is(number) => number,
        }
    }
}

impl Serialize for Limit {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str(Self::AUTO),
            Self::Is(number) => serializer.serialize_f64(*number),
        }
    }
}

impl<'de> Deserialize<'de> for Limit {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl serde::de::Visitor<'_> for Reader {
            type Value = Limit;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a number, or \"auto\"")
            }

            fn visit_f64<E>(self, number: f64) -> Result<Limit, E> {
                Ok(Limit::Is(number))
            }

            fn visit_i64<E>(self, number: i64) -> Result<Limit, E> {
                Ok(Limit::Is(number as f64))
            }

            fn visit_str<E: serde::de::Error>(self, word: &str) -> Result<Limit, E> {
                if word == Limit::AUTO {
                    return Ok(Limit::Auto);
                }
                Err(E::invalid_value(serde::de::Unexpected::Str(word), &self))
            }
        }
        deserializer.deserialize_any(Reader)
    }
}

/// The wheelbase of a full-size car, m. What depends on a car's size, such as how far it may be from its path, is stated for
/// this one and scaled with the wheelbase.
pub const FULL_SIZE_WHEELBASE_M: f64 = 2.875;

/// An area without bounds.
fn anywhere() -> [f64; 4] {
    [f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY]
}

/// How long a drive waits for people, where a configuration of an earlier version does not say.
fn minutes() -> f64 {
    300.0
}

fn derived() -> Limit {
    Limit::Auto
}

/// Limits for commands to the vehicle, and for the plausibility of its odometry. `inf` switches a limit off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in vehicles/tesla_model_3.toml")]
pub struct Safety {
    pub acceleration_limit_mps2: f64,
    pub deceleration_limit_mps2: f64,
    pub jerk_limit_mps3: f64,
    #[serde(default = "derived")]
    pub full_brake_mps2: Limit,
    pub reverse_limit_mps: f64,
    pub steering_rate_limit_radps: f64,
    pub lateral_acceleration_limit_mps2: f64,
    pub stop_deceleration_mps2: f64,
    pub standstill_mps: f64,
    pub jump_limit_m: f64,
    pub jump_limit_rad: f64,
    pub path_distance_limit_m: Limit,
    pub path_heading_limit_rad: Limit,
    pub watch_response: Watched,
    pub degraded_limit_s: f64,
    pub answer_age_limit_s: f64,
    pub command_age_limit_s: f64,
}

impl Safety {
    /// How fast the commanded speed may fall in a full brake, where that has a limit of its own.
    pub fn own_full_brake_mps2(&self) -> Option<f64> {
        match self.full_brake_mps2 {
            Limit::Auto => None,
            Limit::Is(limit) => Some(limit),
        }
    }

    /// How fast the commanded speed may fall in a full brake.
    pub fn full_brake_mps2(&self) -> f64 {
        self.full_brake_mps2.or(self.deceleration_limit_mps2)
    }
}
