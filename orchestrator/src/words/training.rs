//! The table at the end of a training.

use config::{NamedParameters, RunConfig};
use outcome::{
    Comparison, Finalist, Interval, Measures, NoiseChoice, RunResult, SetStanding, Spread,
    TrainResult, VehicleDrives, Verdict,
};

use crate::words::tables::{
    MeasureColumns, Ranks, digits, header, note_off_grid, objective_column, say_effort, set_cells,
    size_with, table_of,
};
use crate::words::terminal::say;
use crate::words::{Failure, baselines, plants, simulated};

/// Prints the table of a training, whose figures they are, and how the set was chosen.
pub(super) fn print(
    it: &TrainResult,
    result: &RunResult,
    config: &RunConfig,
) -> Result<(), Failure> {
    let RunResult { drives, run, .. } = result;
    let grid_size = it.grid.map_or(0, |grid| grid.size);
    let measures = MeasureColumns::new(config, it.grid.is_some());
    let ranks = it.grid.map_or(Ranks::default(), |grid| Ranks {
        value: Some(grid.rank_value),
        distance: Some(grid.rank_distance),
        mse: Some(grid.rank_mse),
        path: Some(grid.rank_path),
    });
    let mut rows = vec![TrainingRow {
        name: format!("tuned ({})", it.tuner),
        gains: &it.gains,
        measures: &it.measures,
        spread: it.spread,
        off_grid: it.off_grid,
        ranks,
    }];
    rows.extend(it.paper.as_ref().map(|set| TrainingRow::of("the paper's set", set)));
    let found = [("found by plain Q", &it.plain_q), ("found by a random walk", &it.random_walk)];
    let found = found.into_iter().filter_map(|(name, it)| Some((name, &it.as_ref()?.set)));
    rows.extend(found.map(|(name, set)| TrainingRow::of(name, set)));

    let mut table = table_of(&header("", &config.law, measures.header()));
    for row in &rows {
        let mut cells = vec![row.name.clone()];
        cells.extend(set_cells(&config.law, std::slice::from_ref(row.gains)));
        cells.extend(measures.cells(row.measures, row.ranks, size_with(grid_size, row.off_grid)));
        table.add_row(cells);
    }
    say!("{table}");

    if let Some(drives) = &it.vehicle_drives {
        print_vehicle_drives(drives, &rows, config)?;
    }
    match (&it.grid, &it.vehicle_drives) {
        (Some(grid), _) => {
            let of_objective = objective_column(config).map_or(String::new(), |objective| {
                format!("{objective} {}, ", digits(grid.best_value, 4))
            });
            say!(
                "ranks among all {} sets of the grid, {}; its best: {of_objective}distance {}, mse {} m², {} m off \
                 the path",
                grid.size,
                config.ranked_how(),
                digits(grid.best_distance, 4),
                digits(grid.best_mse_m2, 4),
                digits(grid.best_path_mean_m, 4),
            );
            note_off_grid(rows.iter().any(|row| row.off_grid), grid.size)?;
        }
        (None, Some(_)) if config.tuner.has_budget() => {
            say!("not ranked: the vehicle makes no more drives than its budget");
        }
        (None, Some(drives)) if drives.by_clock => say!(
            "not ranked: the vehicle paces by the clock, so the {} sets of the grid are not driven",
            config.grid().len()
        ),
        (None, _) => say!(
            "not ranked: the grid of {} sets takes more ticks than ranking.max_ticks",
            config.grid().len()
        ),
    }
    say_effort("steering of the tuned set", &it.measures, config)?;
    // Under noise and over plants, other drives than this one choose.
    // Learners vote for a set; a search takes the least value that it has seen.
    let is_least = it.noise.is_none() && config.tuner.has_budget();
    if is_least && !it.measures.broken_limits(&config.objective.limits).is_empty() {
        say!("  no set was found that keeps all limits: it would rank before this one");
    }
    baselines::print(it, config)?;
    if let Some(check) = &it.plants {
        if it.vehicle_drives.is_some() {
            say!(
                "\nin our simulator, with the vehicle as its file has it, and not the vehicle itself:"
            );
        }
        plants::print(check, config)?;
    }
    if !it.on_bound.is_empty() {
        let bounds = it.on_bound.join(", ");
        say!("on a bound of the grid: {bounds}; better gains may lie beyond it");
    }
    if let Some(simulated) = &it.simulated_first {
        simulated::print(simulated, config)?;
    }
    if let Some(drives) = it.could_stop_after {
        say!(
            "could stop at drive {drives} of {}: from there on {} neither found nor expected a set that is better by more than 1 %",
            it.asked,
            it.tuner
        );
    }
    if let Some(of) = &it.predicted {
        say!(
            "under noise: {} {} [{}, {}] by the model of {}, with {} of the {} drives; the interval holds 95 % if the model does. \
             So few drives leave none to choose among finalists: 30 --drives or more do",
            config.objective.name,
            digits(of.predicted, 4),
            digits(of.low, 4),
            digits(of.high, 4),
            it.tuner,
            of.drives,
            it.asked,
        );
    }
    if let Some(noise) = &it.noise {
        let rank = it.grid.and_then(|grid| Some((grid.rank_mean?, grid.size)));
        print_choice_by_means(noise, rank, config)?;
    }
    let beside = [("plain Q", &it.plain_q), ("the random walk", &it.random_walk)];
    let beside: Vec<String> = beside
        .iter()
        .filter_map(|(name, beside)| Some(format!("{} by {name}", beside.as_ref()?.asked)))
        .collect();
    let beside = match beside.is_empty() {
        true => String::new(),
        false => format!(" ({})", beside.join(", ")),
    };
    let for_table = match drives.for_table {
        0 => String::new(),
        count => format!(", {count} more for this table"),
    };
    let (what, on_plants) = match config.plants() {
        ..2 => ("drives", String::new()),
        plants => ("sets", format!(" on {plants} plants each")),
    };
    say!(
        "{} {what} asked for{beside}, {} driven{on_plants}{for_table}, {} again after a crash; the grid holds {}",
        drives.asked,
        drives.driven,
        run.drives.reissued,
        config.grid().len(),
    );
    Ok(())
}

/// A row of the table of a training.
struct TrainingRow<'a> {
    name: String,
    gains: &'a NamedParameters,
    measures: &'a Measures,
    spread: Option<Spread>,
    off_grid: bool,
    ranks: Ranks,
}

impl<'a> TrainingRow<'a> {
    fn of(name: &str, set: &'a SetStanding) -> Self {
        let SetStanding { gains, measures, spread, off_grid, .. } = set;
        let (spread, off_grid) = (*spread, *off_grid);
        Self { name: name.to_owned(), gains, measures, spread, off_grid, ranks: Ranks::of(set) }
    }
}

/// Says whose drives the figures are, and how certain they are if the vehicle does not repeat itself.
fn print_vehicle_drives(
    drives: &VehicleDrives,
    rows: &[TrainingRow],
    config: &RunConfig,
) -> Result<(), Failure> {
    if drives.repeats {
        say!(
            "all figures are of drives that the vehicle made; none is computed with our simulator"
        );
        return Ok(());
    }
    let of_grid = match drives.of_grid_set {
        0 => String::new(),
        count => format!("; each other set of the grid was driven {count} times"),
    };
    say!(
        "all figures are means over drives that the vehicle made; none is computed with our simulator{of_grid}\n\
         the vehicle does not repeat itself (--deterministic declares one that does): the same training comes to \
         another result and digest the next time"
    );
    for row in rows {
        let Some(spread) = &row.spread else { continue };
        let within = |it: Interval, count| {
            format!("[{}, {}]", digits(it.low, count), digits(it.high, count))
        };
        let of_objective = objective_column(config).map_or(String::new(), |objective| {
            format!("{objective} {}, ", within(spread.value, 4))
        });
        say!(
            "{}: 95 % intervals over {} drives: {of_objective}distance {}, mse {} m², {} m off the path",
            row.name,
            spread.drives,
            within(spread.distance, 4),
            within(spread.mse_m2, 4),
            within(spread.path_mean_m, 4),
        );
    }
    Ok(())
}

/// Says what a choice over plants left aside.
fn print_choice_over_plants(
    noise: &NoiseChoice,
    chosen: &Finalist,
    config: &RunConfig,
) -> Result<(), Failure> {
    if chosen.not_arrived > 0 {
        say!(
            "it did not arrive on {} of the {} plants that chose, and no other of these sets on fewer",
            chosen.not_arrived,
            noise.choosing
        );
    }
    let objective = &config.objective.name;
    let is_nearer =
        |it: &&Finalist| it.fragile && it.visits > 0 && it.mean_value < chosen.mean_value;
    let nearer = noise.finalists.iter().filter(is_nearer);
    let nearer = nearer.min_by(|a, b| a.mean_value.total_cmp(&b.mean_value));
    if let (false, Some(other)) = (chosen.fragile, nearer) {
        say!(
            "better on the fresh plants, but fragile: {} with mean {objective} {}",
            plants::named(&other.gains),
            digits(other.mean_value, 4)
        );
    }
    Ok(())
}

/// Prints how the set was chosen by means, and how certain that choice is. `rank` is its place, and among how many.
fn print_choice_by_means(
    noise: &NoiseChoice,
    rank: Option<(usize, usize)>,
    config: &RunConfig,
) -> Result<(), Failure> {
    let Some(chosen) = noise.finalists.first() else { return Ok(()) };
    let objective = &config.objective.name;
    let is_over_plants = config.is_over_plants();
    let drives = if is_over_plants { "fresh plants" } else { "drives" };
    let under_noise = if config.noise.enabled { "under noise: " } else { "" };
    say!(
        "{under_noise}mean {objective} {} [{}, {}] over {} {drives}{}; it was the {} of {} sets {}",
        digits(chosen.mean_value, 4),
        digits(chosen.low, 4),
        digits(chosen.high, 4),
        noise.repeats,
        if config.noise.enabled || is_over_plants { " that chose nothing" } else { "" },
        if is_over_plants { "first" } else { "best" },
        // The paper's set stands beside them, wherever the training never was.
        noise.finalists.iter().filter(|it| it.visits > 0).count().max(1),
        match is_over_plants {
            true => format!("on {} other plants", noise.choosing),
            false => format!("in {} drives each", noise.choosing),
        },
    );
    if is_over_plants {
        print_choice_over_plants(noise, chosen, config)?;
    }
    // A vehicle without a gear selector takes no time for it.
    let has_gear = config.vehicle.gear_drive_s > 0.0;
    if config.noise.enabled && config.vehicle.gear_engaged && has_gear {
        say!("all drives, noise-free ones too, began with the drive gear engaged");
    }
    // Without noise and plants there is nothing that two drives have in common.
    let (paired, same) = match config.noise.enabled || is_over_plants {
        true => ("paired ", "the same "),
        false => ("", "each one's "),
    };
    let against = |name: &str, it: &Comparison| -> Result<(), Failure> {
        if it.gains == chosen.gains {
            return Ok(());
        }
        let verdict = match it.verdict {
            Verdict::Better => "better than",
            Verdict::Worse => "worse than",
            Verdict::Undecided => "not distinguishable from",
        };
        say!(
            "{verdict} {name}: {paired}difference {} [{}, {}] over {same}{} {drives}",
            digits(it.difference, 4),
            digits(it.low, 4),
            digits(it.high, 4),
            noise.repeats,
        );
        Ok(())
    };
    let recommended =
        if is_over_plants { "what the training's plants" } else { "what single drives" };
    against(&format!("{recommended} recommend"), &noise.against_recommended)?;
    if let Some(paper) = &noise.against_paper {
        against("the paper's set", paper)?;
    }
    if let Some((rank, size)) = rank {
        let seeds = noise.holdout;
        say!("rank {rank} of {size} by the mean {objective} over {seeds} other noise seeds");
    }
    Ok(())
}
