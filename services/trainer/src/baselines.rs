//! The sets beside a tuned one: those of textbooks, and those of the grid that trade distance for calm wheels.

use config::RunConfig;
use outcome::{Baseline, Baselines, Measures, TradeOff, TradedSet};
use tracking::Objective;

use crate::Ranking;
use crate::over::PlantRollouts;
use crate::ranking::measures_of;

/// The textbook sets beside one with these measures; `None` for the paper's law where its figures are the yardstick.
pub(crate) fn baselines(
    config: &RunConfig,
    objective: &Objective,
    tuned: &Measures,
) -> Option<Baselines> {
    if config.has_figures_of_the_paper() {
        return None;
    }
    let weight = config.learning.heading_weight;
    let sets: Vec<Baseline> = config
        .textbook_sets()
        .iter()
        .map(|it| {
            let drive =
                PlantRollouts::of_ranking(&it.config, *objective).drive(it.parameters, None);
            Baseline {
                law: it.config.law.name.clone(),
                compensated: it.compensated,
                gains: it.config.law.named(&it.parameters),
                measures: measures_of(objective, weight, &drive),
            }
        })
        .collect();
    Some(against(sets, config.is_to_arrive(), tuned))
}

/// The sets, with the verdict on the tuned one.
fn against(sets: Vec<Baseline>, is_to_arrive: bool, tuned: &Measures) -> Baselines {
    // What does not arrive is behind all that arrive, where drives are to.
    let order = |it: &Measures| (is_to_arrive && !it.arrived, it.path_mean_m);
    let is_nearer = |a: &Measures, b: &Measures| {
        let (of_a, of_b) = (order(a), order(b));
        of_a.0.cmp(&of_b.0).then(of_a.1.total_cmp(&of_b.1)).is_lt()
    };
    let mut best = 0;
    for (index, set) in sets.iter().enumerate() {
        if is_nearer(&set.measures, &sets[best].measures) {
            best = index;
        }
    }
    let of_best = &sets[best].measures;
    let ratio = (of_best.path_mean_m > 0.0).then(|| tuned.path_mean_m / of_best.path_mean_m);
    let beaten = is_nearer(tuned, of_best);
    Baselines { sets, best, ratio, beaten }
}

/// The curve of the grid's sets; `None` if the grid was not driven.
pub(crate) fn trade_off(config: &RunConfig, ranking: &Ranking) -> Option<TradeOff> {
    let is_paper_s = config.objective.name == "distance";
    let distance = |it: &Measures| if is_paper_s { it.distance } else { it.path_mean_m };
    let mut sets: Vec<(usize, &Measures)> = ranking.measures().iter().enumerate().collect();
    sets.retain(|(_, it)| distance(it).is_finite() && (it.arrived || !config.is_to_arrive()));
    sets.sort_by(|(_, a), (_, b)| {
        let by_travel = a.steering_travel_radps.total_cmp(&b.steering_travel_radps);
        by_travel.then(distance(a).total_cmp(&distance(b)))
    });
    let grid = ranking.grid();
    let mut front: Vec<TradedSet> = Vec::new();
    for (index, measures) in sets {
        let distance_m = distance(measures);
        if front.last().is_none_or(|last| distance_m < last.distance_m) {
            front.push(TradedSet {
                gains: config.law.named(&grid.set(grid.position(index))),
                distance_m,
                steering_travel_radps: measures.steering_travel_radps,
            });
        }
    }
    (!front.is_empty()).then_some(TradeOff { sets: front })
}

#[cfg(test)]
mod tests {
    use config::{Layers, NamedParameters};

    use super::*;

    fn config(maneuver: &str, sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver(maneuver).unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    fn measures(path_mean_m: f64, arrived: bool) -> Measures {
        Measures { path_mean_m, arrived, ..Measures::default() }
    }

    #[test]
    fn the_best_arrives_and_a_tuned_set_must_be_nearer_still() {
        let gains = NamedParameters::default();
        let set = |path_mean_m, arrived| Baseline {
            law: "stanley".to_owned(),
            compensated: None,
            gains: gains.clone(),
            measures: measures(path_mean_m, arrived),
        };
        let sets = vec![set(0.01, false), set(0.2, true), set(0.1, true)];
        let verdict = |to_arrive, tuned| {
            let it = against(sets.clone(), to_arrive, &tuned);
            (it.best, it.beaten, it.ratio.unwrap())
        };
        assert_eq!(verdict(true, measures(0.05, true)), (2, true, 0.5));
        assert_eq!(verdict(true, measures(0.1, true)), (2, false, 1.0));
        assert_eq!(verdict(true, measures(0.05, false)), (2, false, 0.5));
        assert_eq!(verdict(false, measures(0.02, true)), (0, false, 2.0));
    }

    #[test]
    fn textbook_sets_are_driven_where_the_paper_has_no_figures() {
        let objective = |config: &RunConfig| Objective::new(config);
        let papers = config("lane_change", &[]);
        assert_eq!(baselines(&papers, &objective(&papers), &measures(0.1, false)), None);
        // Another law on the paper's path stands beside the paper's set, too.
        let other = config("lane_change", &["law_preset=stanley"]);
        let beside = baselines(&other, &objective(&other), &measures(0.0, false)).unwrap();
        let papers = beside.sets.iter().find(|it| it.law == "paper").unwrap();
        assert_eq!(papers.gains.get("kv"), Some(3.0));
        let late = config("smooth_lane", &["vehicle.steering_delay_s=0.2", "law_preset=stanley"]);
        let beside = baselines(&late, &objective(&late), &measures(0.0, true)).unwrap();
        assert_eq!(beside.sets.len(), 6);
        assert!(beside.beaten);
        let [with, without] = [0, 1].map(|index| &beside.sets[index]);
        assert_eq!((with.compensated, without.compensated), (Some(true), Some(false)));
        assert_ne!(with.measures.path_mean_m, without.measures.path_mean_m);
        assert!(with.measures.steering_travel_radps > 0.0);
    }

    #[test]
    fn on_the_curve_less_distance_costs_more_travel() {
        let config = config(
            "lane_change",
            &["grid.kv={min=3.0,max=3.0,step=1.0}", "grid.kl={min=1.0,max=21.0,step=10.0}"],
        );
        let ranking = Ranking::by_rollout(&config);
        let curve = trade_off(&config, &ranking).unwrap().sets;
        assert!(curve.is_sorted_by(|a, b| {
            a.distance_m > b.distance_m && a.steering_travel_radps < b.steering_travel_radps
        }));
        for set in ranking.measures() {
            let is_reached = curve.iter().any(|it| {
                it.distance_m <= set.distance
                    && it.steering_travel_radps <= set.steering_travel_radps
            });
            assert!(is_reached);
        }
    }
}
