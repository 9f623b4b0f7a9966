//! What a training that simulated first says of its choice: by the vehicle's drives, and by plants that chose nothing.

use config::{Parameters, RunConfig};
use outcome::{FreshDrives, OfDrives, SimulatedFirst, TextbookDriven};
use tracking::{DriveRecord, Objective};

use super::ensemble::plants;
use super::{Belief, Ensemble, Reading, log_value};
use crate::over::{Purpose, on_plant};
use crate::statistics::clopper_pearson;

/// Plants drawn anew, and the sets that are best in belief among which the best one on each of them is looked for.
const FRESH: usize = 48;
const COMPARED: usize = 64;
const FRESH_STREAM: u64 = 0x7265_706f_7274;
/// The normal distribution's 97.5th percentile.
const Z: f64 = 1.959_963_984_540_054;

/// A drive of the vehicle in the ring.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Driven {
    /// Number of its set.
    pub(crate) candidate: u32,
    /// Its value by the objective.
    pub(crate) value: f64,
    /// Its measures.
    pub(crate) record: DriveRecord,
}

impl Driven {
    /// The drive as the belief sees it.
    pub(crate) fn reading(&self) -> Reading {
        Reading { candidate: self.candidate as usize, log: log_value(self.value) }
    }
}

/// What came out. `chosen` is the number of the set that is recommended.
pub(crate) fn simulated_first(
    config: &RunConfig,
    objective: &Objective,
    ensemble: &Ensemble,
    driven: &[Driven],
    chosen: usize,
    could_stop_after: Option<u32>,
) -> SimulatedFirst {
    let within_m = config.tuner.settings.number("within_m");
    let candidates = ensemble.candidates();
    let readings: Vec<Reading> = driven.iter().map(Driven::reading).collect();
    let belief = Belief::new(candidates, &readings, ensemble.noise());
    let of_set = |number: usize| {
        let (mean, sd) = belief.sets[number];
        let [predicted, low, high] = [mean, mean - Z * sd, mean + Z * sd].map(libm::exp);
        OfDrives {
            drives: driven.iter().filter(|it| it.candidate as usize == number).count() as u64,
            predicted,
            low,
            high,
        }
    };
    let textbook = ensemble.textbook();
    let was_driven = driven.iter().any(|it| it.candidate as usize == textbook);
    let beyond = driven.iter().filter(|it| is_beyond(&it.record, within_m)).count() as u64;
    let mut missed = driven.iter().filter(|it| config.is_to_arrive() && !it.record.arrived());
    let not_arrived = missed.clone().count() as u64;
    let chosen_did_not_arrive = missed.any(|it| it.candidate as usize == chosen);
    let worst_m = driven.iter().map(|it| it.record.path_max_m).fold(0.0, f64::max);
    let (beyond_low, beyond_high) = clopper_pearson(beyond, driven.len() as u64);
    SimulatedFirst {
        plants: ensemble.plants(),
        candidates: candidates.len(),
        on_all: candidates.iter().filter(|it| !it.is_out).count(),
        within_m,
        within: candidates.iter().filter(|it| it.stays_within(within_m)).count(),
        drives: driven.len() as u64,
        beyond,
        not_arrived,
        chosen_did_not_arrive,
        beyond_low,
        beyond_high,
        worst_m,
        chosen: of_set(chosen),
        chosen_simulated_worst_m: candidates[chosen].worst_m,
        textbook: TextbookDriven {
            gains: config.law.named(&candidates[textbook].set),
            is_chosen: textbook == chosen,
            simulated_worst_m: candidates[textbook].worst_m,
            driven: was_driven.then(|| of_set(textbook)),
        },
        could_stop_after,
        fresh: fresh(config, objective, ensemble, &belief, chosen, within_m),
    }
}

/// Whether a drive left the strip around the path.
fn is_beyond(record: &DriveRecord, within_m: f64) -> bool {
    record.path_max_m.is_nan() || record.path_max_m > within_m
}

/// The chosen set on plants that chose nothing, beside the sets that are best in belief.
fn fresh(
    config: &RunConfig,
    objective: &Objective,
    ensemble: &Ensemble,
    belief: &Belief,
    chosen: usize,
    within_m: f64,
) -> FreshDrives {
    let candidates = ensemble.candidates();
    let mut order: Vec<usize> = (0..candidates.len())
        .filter(|it| candidates[*it].stays_within(within_m) && *it != chosen)
        .collect();
    order.sort_by(|a, b| belief.sets[*a].0.total_cmp(&belief.sets[*b].0).then(a.cmp(b)));
    order.truncate(COMPARED);
    // The named plants chose: only those behind them are new.
    let named = config.plant_changes().len();
    let changes = plants(config, named + FRESH, FRESH_STREAM).split_off(named);
    let (mut beyond, mut not_arrived) = (0, 0);
    let (mut metres, mut shares, mut means) = (Vec::new(), Vec::new(), Vec::new());
    let mut worst_m: f64 = 0.0;
    for (plant, change) in changes.iter().enumerate() {
        let mut rollout = on_plant(config, change);
        // The same noise for all sets.
        let noise = config.noise.enabled.then(|| Purpose::Telling.seed(config, plant));
        let mut drive = |set: Parameters| rollout.drive(set, noise);
        let own = drive(candidates[chosen].set);
        let others: Vec<DriveRecord> = order.iter().map(|it| drive(candidates[*it].set)).collect();
        let value = objective.of(&own);
        let best = others
            .iter()
            .map(|it| (objective.of(it), it.path_mean_m))
            .fold((value, own.path_mean_m), |best, it| if it.0 < best.0 { it } else { best });
        metres.push((own.path_mean_m - best.1).max(0.0));
        shares.push(if best.0 > 0.0 { value / best.0 - 1.0 } else { 0.0 });
        means.push(own.path_mean_m);
        worst_m = worst_m.max(own.path_max_m);
        beyond += u64::from(is_beyond(&own, within_m));
        not_arrived += u64::from(!own.arrived());
    }
    let (beyond_low, beyond_high) = clopper_pearson(beyond, FRESH as u64);
    FreshDrives {
        plants: FRESH,
        compared: order.len(),
        beyond,
        beyond_low,
        beyond_high,
        not_arrived,
        path_max_m: worst_m,
        path_mean_p95_m: at(&mut means, 0.95),
        off_best_median_m: at(&mut metres, 0.5),
        off_best_p95_m: at(&mut metres, 0.95),
        regret_median: at(&mut shares, 0.5),
        regret_p95: at(&mut shares, 0.95),
    }
}

/// The value that a share of them does not exceed.
fn at(values: &mut [f64], share: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values[(libm::ceil(share * values.len() as f64) as usize).max(1) - 1]
}
