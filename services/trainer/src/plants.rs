//! What a set does on plants: whether it is fragile, and how far from the path it is on fresh ones.

use config::{OverBy, Parameters, PlantChange, RunConfig};
use outcome::{Alternative, Extent, FreshPlants, Margin, PlantCheck, PlantDrive};
use rollout::Rollout;
use tracking::{DriveRecord, Objective};

use crate::over::{Purpose, on_plant};
use crate::rng::Stream;

/// The part of a mean distance from the path, for a car of full size, below which no set is fragile.
const FLOOR_M: f64 = 0.1;
/// The wheelbase of that car.
const FULL_SIZE_M: f64 = 2.875;
/// How much farther from the path a plausible plant may take a set that is not fragile.
const FRAGILE_FROM: f64 = 2.0;
/// Among how many of the nominally best sets a robust one is looked for.
pub(crate) const ALTERNATIVES: usize = 20;
/// How long a speed is held that counts for the additional dead time.
const HELD_S: f64 = 1.0;
/// Plants drawn anew, which neither chose a set nor told whether it is fragile.
const FRESH: usize = 48;
/// The random stream of the fresh plants.
const FRESH_STREAM: u64 = 0x0066_7265_7368;
/// That of the plants that choose among finalists.
const CHOOSING_STREAM: u64 = 0x6368_6f6f_7365;

/// The vehicle as its file has it and the plants that it may really be, on which sets are driven without noise.
pub(crate) struct Plausible {
    /// The configuration without the faster drive over which a training judges, too.
    nominal: RunConfig,
    changes: Vec<PlantChange>,
    plain: Rollout,
    rollouts: Vec<Rollout>,
}

impl Plausible {
    pub(crate) fn new(config: &RunConfig) -> Self {
        let over = config::Over { by: OverBy::Nominal, ..config.over.clone() };
        let nominal = RunConfig { over, ..config.clone() };
        let changes = nominal.plant_changes();
        let rollouts = changes.iter().map(|it| on_plant(&nominal, it)).collect();
        Self { plain: Rollout::new(&nominal), rollouts, changes, nominal }
    }

    /// The drive of a set on each plant.
    fn drive(&mut self, set: &Parameters) -> Vec<DriveRecord> {
        self.rollouts.iter_mut().map(|rollout| rollout.drive(*set, None)).collect()
    }

    /// The drive of a set with the vehicle as its file has it, and the speed at which Δ counts.
    fn plain(&mut self, set: &Parameters) -> (DriveRecord, f64) {
        plain(&mut self.plain, set, self.nominal.drive.tick_s)
    }

    /// The first plant that shows a set to be fragile, if one does.
    fn why_fragile(&self, plain: &DriveRecord, drives: &[DriveRecord]) -> Option<String> {
        let floor_m = FLOOR_M * self.nominal.vehicle.wheelbase_m / FULL_SIZE_M;
        let is_to_arrive = self.nominal.is_to_arrive();
        let mut named = self.changes.iter().zip(drives);
        named.find_map(|(plant, drive)| {
            why_fragile(&plant.name, drive, plain, floor_m, is_to_arrive)
        })
    }

    /// Whether a set is fragile: by Δ, or by one of the plants.
    pub(crate) fn is_fragile(&mut self, set: &Parameters) -> bool {
        let (plain, speed_mps) = self.plain(set);
        if additional_dead_time(&self.nominal, set, speed_mps).why_fragile().is_some() {
            return true;
        }
        let drives = self.drive(set);
        self.why_fragile(&plain, &drives).is_some()
    }
}

/// A drive of a set, and the speed at which Δ counts.
fn plain(rollout: &mut Rollout, set: &Parameters, tick_s: f64) -> (DriveRecord, f64) {
    let mut speeds = Vec::new();
    let drive = rollout.drive_with(*set, None, |_, tick| speeds.push(tick.observation.speed_mps));
    (drive, held_speed_mps(&speeds, tick_s, HELD_S))
}

/// Which share lacks of the additional dead time that a set has to have in order not to be fragile; 0 if it is not known.
pub(crate) fn lacking_margin(config: &RunConfig, set: &Parameters) -> f64 {
    let over = config::Over { by: OverBy::Nominal, ..config.over.clone() };
    let nominal = RunConfig { over, ..config.clone() };
    let (_, speed_mps) = plain(&mut Rollout::new(&nominal), set, nominal.drive.tick_s);
    let margin = additional_dead_time(&nominal, set, speed_mps);
    let has_s = margin.additional_dead_time_s.unwrap_or(f64::INFINITY);
    (1.0 - has_s / margin.fragile_below_s).max(0.0)
}

/// What a set does on the plants of the configuration, beside sets that are nominally about as good. `near` are these
/// sets, the nominally best first; they may contain the set itself. Where drives are long, they are left out.
pub(crate) fn check(
    config: &RunConfig,
    objective: &Objective,
    set: &Parameters,
    mut near: Vec<Parameters>,
) -> PlantCheck {
    let mut plausible = Plausible::new(config);
    let ticks = config.ticks() * (near.len() * plausible.changes.len()) as u64;
    if ticks > config.ranking.max_ticks {
        near.clear();
    }
    let chosen = plausible.drive(set);
    let values_of =
        |drives: &[DriveRecord]| drives.iter().map(|it| objective.of(it)).collect::<Vec<f64>>();
    let others: Vec<(Parameters, Vec<f64>)> = near
        .iter()
        .filter(|it| *it != set)
        .map(|it| (*it, values_of(&plausible.drive(it))))
        .collect();
    let values = values_of(&chosen);
    let (plain, held_mps) = plausible.plain(set);
    let margin = margin(config, set, held_mps);
    let plants: Vec<PlantDrive> = plausible
        .changes
        .iter()
        .zip(&chosen)
        .enumerate()
        .map(|(plant, (change, drive))| {
            let best = others.iter().map(|(_, of)| of[plant]).fold(values[plant], f64::min);
            PlantDrive {
                name: change.name.clone(),
                value: values[plant],
                regret: (best > 0.0).then(|| values[plant] / best - 1.0),
                path_mean_m: drive.path_mean_m,
                path_max_m: drive.path_max_m,
                arrived: drive.arrived(),
            }
        })
        .collect();
    let missed = config.is_to_arrive() && !plain.arrived();
    let by_plants = match missed {
        true => Some("it does not even arrive with the vehicle as its file has it".to_owned()),
        false => plausible.why_fragile(&plain, &chosen),
    };
    let reasons: Vec<String> = by_plants.into_iter().chain(margin.why_fragile()).collect();
    let worst = |of: &[f64]| of.iter().copied().fold(0.0, f64::max);
    let calmest = others
        .iter()
        .map(|(parameters, of)| (worst(of), parameters))
        .filter(|(value, _)| *value < worst(&values))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let alternative = calmest.map(|(worst_value, parameters)| Alternative {
        gains: config.law.named(parameters),
        value: objective.of(&plausible.plain.drive(*parameters, None)),
        worst_value,
    });
    PlantCheck {
        path_mean_m: plain.path_mean_m,
        path_max_m: Some(plain.path_max_m),
        worst_value: worst(&values),
        fragile: (!reasons.is_empty()).then(|| reasons.join("; and ")),
        margin: Some(margin),
        compared: others.len(),
        fresh: fresh(&plausible.nominal, &plausible.changes, set),
        alternative,
        plants,
    }
}

/// The highest speed that is held for so long, of one speed a tick: an oscillation needs some time to grow, and a car that
/// catches up from rest is fast for a moment only. A shorter drive holds its least speed.
fn held_speed_mps(speeds: &[f64], tick_s: f64, held_s: f64) -> f64 {
    let ticks = (libm::round(held_s / tick_s) as usize).clamp(1, speeds.len().max(1));
    // The least speed of each stretch of so many ticks, by the places of those that may still become one.
    let mut least: std::collections::VecDeque<usize> = std::collections::VecDeque::new();
    let mut highest = 0.0_f64;
    for (tick, speed) in speeds.iter().enumerate() {
        while least.back().is_some_and(|it| speeds[*it] >= *speed) {
            least.pop_back();
        }
        least.push_back(tick);
        if least[0] + ticks <= tick {
            least.pop_front();
        }
        if tick + 1 >= ticks {
            highest = highest.max(speeds[least[0]]);
        }
    }
    highest
}

/// How much later the steering may act at a speed, with the vehicle as its file has it.
pub(crate) fn additional_dead_time(config: &RunConfig, set: &Parameters, speed_mps: f64) -> Margin {
    let known = certificate::additional_dead_time_s(config, set, speed_mps);
    Margin {
        certified: None,
        simulated: None,
        no_certificate: None,
        speed_mps,
        additional_dead_time_s: known.as_ref().ok().copied().filter(|it| it.is_finite()),
        fragile_below_s: config.over.fragile_below_s,
        unknown: known.err(),
    }
}

/// The same, and from where the loop converges: hundreds of simulated starts.
pub fn margin(config: &RunConfig, set: &Parameters, speed_mps: f64) -> Margin {
    let margin = additional_dead_time(config, set, speed_mps);
    if margin.unknown.is_some() {
        return margin;
    }
    let subject = certificate::Subject::new(config, &[*set]).ok();
    let Some(regions) = subject.and_then(|it| it.sets_at(speed_mps).pop()) else { return margin };
    let extent =
        |it: certificate::Extent| Extent { offset_m: it.offset_m, heading_rad: it.heading_rad };
    Margin {
        certified: regions.certified.map(extent),
        simulated: regions.simulated.map(extent),
        no_certificate: regions.no_certificate,
        ..margin
    }
}

/// Why a drive on a plant shows a set to be fragile, if it does.
fn why_fragile(
    name: &str,
    drive: &DriveRecord,
    plain: &DriveRecord,
    floor_m: f64,
    is_to_arrive: bool,
) -> Option<String> {
    if is_to_arrive && plain.arrived() && !drive.arrived() {
        return Some(format!("{name}: it does not arrive"));
    }
    let path_mean_m = drive.path_mean_m;
    let is_far = path_mean_m > FRAGILE_FROM * plain.path_mean_m && path_mean_m > floor_m;
    let times = path_mean_m / plain.path_mean_m.max(f64::MIN_POSITIVE);
    is_far.then(|| {
        format!("{name}: {path_mean_m:.3} m from the path on average, {times:.1} times as far as without")
    })
}

/// Plants whose values are drawn anew, each key between the least and the largest change of it.
pub(crate) fn fresh_plants<'a>(
    config: &RunConfig,
    changes: &'a [PlantChange],
) -> impl Iterator<Item = PlantChange> + 'a {
    drawn_from(config, changes, FRESH_STREAM)
}

fn drawn_from<'a>(
    config: &RunConfig,
    changes: &'a [PlantChange],
    stream: u64,
) -> impl Iterator<Item = PlantChange> + 'a {
    let mut random = Stream::new(config.run.seed, stream);
    std::iter::repeat_with(move || drawn(changes, &mut random))
}

/// The plants that choose among the finalists of a training over plants: drawn anew, and others than those by which the
/// choice is told. The faster drives of the training stay as they are, and as many.
pub(crate) fn choosing_plants(config: &RunConfig) -> Vec<PlantChange> {
    let over = config::Over { by: OverBy::Nominal, ..config.over.clone() };
    let of_car = RunConfig { over, ..config.clone() }.plant_changes();
    let of_training = config.plant_changes();
    let faster = &of_training[of_car.len()..];
    let plants = drawn_from(config, &of_car, CHOOSING_STREAM).take(config.over.choosing as usize);
    plants
        .enumerate()
        .map(|(number, drawn)| {
            let place = number % of_training.len();
            place.checked_sub(of_car.len()).map_or(drawn, |place| faster[place].clone())
        })
        .collect()
}

/// The set on plants that are drawn anew; with noise, if the configuration has it.
fn fresh(config: &RunConfig, changes: &[PlantChange], set: &Parameters) -> FreshPlants {
    let noise = |plant: usize| config.noise.enabled.then(|| Purpose::Telling.seed(config, plant));
    let mut drives: Vec<DriveRecord> = fresh_plants(config, changes)
        .take(FRESH)
        .enumerate()
        .map(|(plant, change)| on_plant(config, &change).drive(*set, noise(plant)))
        .collect();
    drives.sort_by(|a, b| a.path_mean_m.total_cmp(&b.path_mean_m));
    // The value that 95 % of the plants do not exceed.
    let p95 = libm::ceil(0.95 * FRESH as f64) as usize - 1;
    FreshPlants {
        plants: FRESH,
        noise: config.noise.enabled,
        path_mean_p95_m: drives[p95].path_mean_m,
        path_mean_max_m: drives[FRESH - 1].path_mean_m,
        path_max_m: drives.iter().map(|it| it.path_max_m).fold(0.0, f64::max),
        beyond_1_m: drives.iter().filter(|it| it.path_max_m > 1.0).count(),
        not_arrived: drives.iter().filter(|it| !it.arrived()).count(),
    }
}

/// A plant between those that are named.
pub(crate) fn drawn(changes: &[PlantChange], random: &mut Stream) -> PlantChange {
    let mut drawn = PlantChange { name: "drawn".to_owned(), ..PlantChange::default() };
    let mut draw = |of: fn(&PlantChange) -> &std::collections::BTreeMap<String, f64>, none: f64| {
        let mut keys: Vec<&String> = changes.iter().flat_map(|it| of(it).keys()).collect();
        keys.sort_unstable();
        keys.dedup();
        let mut between = |key: &String| {
            let all = changes.iter().map(|it| of(it).get(key).copied().unwrap_or(none));
            let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), by| {
                (low.min(by), high.max(by))
            });
            // Where all plants agree, there are none between them but those towards the vehicle as its file has it.
            let (low, high) =
                if low == high { (low.min(none), high.max(none)) } else { (low, high) };
            low + random.uniform() * (high - low)
        };
        keys.into_iter().map(|key| (key.clone(), between(key))).collect()
    };
    drawn.add = draw(|it| &it.add, 0.0);
    drawn.scale = draw(|it| &it.scale, 1.0);
    drawn
}

#[cfg(test)]
#[path = "plants_tests.rs"]
mod tests;
