//! Sets that a tuned one is compared with, because users would type them in by hand.

use config::NamedParameters;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Measures, ParameterTable};

/// The textbook sets beside a tuned one, driven by our simulator without noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Baselines {
    /// The sets; those of the law that was tuned come first.
    pub sets: Vec<Baseline>,
    /// Number of the set, from 0, that drives nearest the path on average: of those that arrive, if any does.
    pub best: usize,
    /// The tuned set's mean distance from the path over that of the best set; null if that is 0.
    pub ratio: Option<f64>,
    /// Whether the tuned set is nearer to the path than the best of them, and arrives if that one does.
    pub beaten: bool,
}

/// A textbook set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Baseline {
    /// Its law.
    pub law: String,
    /// Whether the dead time of the steering was compensated; null if the car's steering has neither dead time nor lag.
    pub compensated: Option<bool>,
    /// The set, by the names of its law's parameters.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// The measures of a drive with it.
    #[serde(flatten)]
    pub measures: Measures,
}

/// How near to the path sets drive, against how much they turn the wheels: those of the grid than which no other is
/// better by both.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TradeOff {
    /// The sets, from the calmest wheels to the least distance.
    pub sets: Vec<TradedSet>,
}

/// A set on the curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TradedSet {
    /// The set.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// Its distance: the paper's where that is the objective, otherwise the mean distance from the path.
    pub distance_m: f64,
    /// Mean absolute rate of the commanded steering angle.
    pub steering_travel_radps: f64,
}
