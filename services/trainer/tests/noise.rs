//! The choice under noise, over several trainings: `PATHTUNE_NOISE_SEEDS` says how many.

use std::sync::atomic::{AtomicU64, Ordering};

use config::{Layers, Parameters, RunConfig};
use rollout::Rollout;
use tracking::DriveRecord;
use trainer::{Finalists, objective_of, rank_mean, train_by_rollout};

fn noisy_roundabout() -> RunConfig {
    let mut layers = Layers::maneuver("roundabout").unwrap();
    layers.set("noise.enabled=true").unwrap();
    // So many noisy drives of each set tell its rank well enough; a hundred take a minute.
    layers.set("robust.holdout=25").unwrap();
    layers.resolve().unwrap()
}

#[test]
#[allow(clippy::disallowed_methods, reason = "a test may start threads")]
fn the_choice_under_noise_lies_in_the_best_twentieth() {
    let config = noisy_roundabout();
    let count = std::env::var("PATHTUNE_NOISE_SEEDS").map_or(6, |text| text.parse().unwrap());
    let seeds: Vec<u64> = (1..=count).collect();
    let next = AtomicU64::new(0);
    let mut chosen: Vec<(u64, Parameters)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..std::thread::available_parallelism().map_or(1, usize::from))
            .map(|_| {
                scope.spawn(|| {
                    let mut chosen = Vec::new();
                    while let Some(seed) = seeds.get(next.fetch_add(1, Ordering::Relaxed) as usize)
                    {
                        let mut config = config.clone();
                        config.run.seed = *seed;
                        chosen.push((*seed, choose(&config)));
                    }
                    chosen
                })
            })
            .collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap()).collect()
    });
    chosen.sort_by_key(|(seed, _)| *seed);

    // Many seeds choose the same set; each set is ranked once.
    let mut ranks: Vec<(Parameters, usize)> = Vec::new();
    let mut rank = |set: Parameters| match ranks.iter().find(|(known, _)| *known == set) {
        Some((_, rank)) => *rank,
        None => {
            let rank = rank_mean(&config, &objective_of(&config), &set, |_| {});
            ranks.push((set, rank));
            rank
        }
    };
    let best = config.grid().len() / 20;
    let good = chosen
        .iter()
        .filter(|(seed, set)| {
            let rank = rank(*set);
            println!("seed {seed}: {set:?}, rank {rank} of {}", config.grid().len());
            rank <= best
        })
        .count();
    assert!(5 * good >= 4 * seeds.len(), "{good} of {count} in the best {best}");
}

/// A whole training under noise by plain calls, and the choice among its finalists.
fn choose(config: &RunConfig) -> Parameters {
    let training = train_by_rollout(config);
    let finalists = Finalists::new(config, &training);
    let mut rollout = Rollout::new(config);
    let records: Vec<DriveRecord> = finalists
        .drives()
        .iter()
        .map(|drive| rollout.drive(drive.by_zone[0], drive.seed))
        .collect();
    finalists.choose(config, &objective_of(config), &records).parameters
}
