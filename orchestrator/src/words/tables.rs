//! The tables at the end of a run.
//!
//! Two quantities must not be confused. The *cross-track error* is measured against the current reference,
//! which moves on with time. *Off the path* is the distance of the pose from the nearest point of the path.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, Table};
use config::{LawConfig, NamedParameters, RunConfig};
use ipc_types::Safety;
use outcome::{
    GridResult, MainEffect, Measures, Outcome, RankedSet, Run, RunResult, SetStanding, SingleDrive,
    ValidateResult, ValidatedRow,
};

use crate::words::terminal::say;
use crate::words::{Failure, laps, plants, training};

/// Prints the tables of a run, and what else is worth knowing about it.
pub(crate) fn print_result(result: &RunResult, config: &RunConfig) -> Result<(), Failure> {
    match &result.decided.outcome {
        Outcome::Train(it) => training::print(it, result, config)?,
        Outcome::Validate(it) => print_validation(it, config)?,
        Outcome::Grid(it) => print_grid(it, config)?,
        Outcome::Drive(it) => print_drive(it, config)?,
    }
    laps::print(result.decided.outcome.laps())?;
    print_how_it_went(&result.run)?;
    say!("digest {}", result.decided.outcome.digest());
    Ok(())
}

/// How many sets a rank is among: those of the grid, and the set itself if it is none of them.
pub(super) fn size_with(grid_size: usize, off_grid: bool) -> usize {
    grid_size + usize::from(off_grid)
}

pub(super) fn note_off_grid(any: bool, size: usize) -> Result<(), Failure> {
    if any {
        say!("of {}: a set between those of the grid, ranked as one more", size + 1);
    }
    Ok(())
}

fn print_validation(it: &ValidateResult, config: &RunConfig) -> Result<(), Failure> {
    let has_paper = it.rows.iter().any(|row| row.noise_free.paper_mse_m2.is_some());
    let beside_paper = if has_paper { &["paper", "factor"][..] } else { &[] };
    let of_paper = |paper_mse_m2: Option<f64>, factor: Option<f64>| {
        let cells = [or_dash(paper_mse_m2, 3), or_dash(factor, 2)];
        cells.into_iter().take(beside_paper.len())
    };
    let name = |row: &ValidatedRow| if row.chosen_by_paper { "*" } else { "" }.to_owned();

    let measures = MeasureColumns::new(config, false);
    let last = ["along m²", "cross m²", "max cross-track error m", "at limit", "collisions"];
    let columns = measures.header().chain(beside_paper.iter().copied()).chain(last);
    let mut table = table_of(&header("noise-free", &config.law, columns));
    for row in &it.rows {
        let plain = &row.noise_free;
        let mut cells = vec![name(row)];
        cells.extend(set_cells(&config.law, &row.gains));
        cells.extend(measures.cells(&plain.measures, Ranks::default(), 0));
        cells.extend(of_paper(plain.paper_mse_m2, plain.factor));
        cells.extend([
            digits(plain.along_m2, 3),
            digits(plain.cross_m2, 3),
            digits(plain.max_cross_track_m, 2),
            format!("{:.1} %", 100.0 * plain.steering_limited),
            plain.collisions.to_string(),
        ]);
        table.add_row(cells);
    }
    say!("{table}");

    let first = ["mean mse m²", "95 %", "worst"];
    let last = ["off the path: mean m", "max m", "collisions"];
    let columns = first.into_iter().chain(beside_paper.iter().copied()).chain(last);
    let mut table = table_of(&header("with noise", &config.law, columns));
    for row in &it.rows {
        let noisy = &row.noisy;
        let mut cells = vec![name(row)];
        cells.extend(set_cells(&config.law, &row.gains));
        cells.extend([
            digits(noisy.mse_m2_mean, 3),
            format!("[{}, {}]", digits(noisy.mse_m2_low, 3), digits(noisy.mse_m2_high, 3)),
            digits(noisy.mse_m2_worst, 3),
        ]);
        cells.extend(of_paper(noisy.paper_mse_m2, noisy.factor));
        cells.extend([
            digits(noisy.path_mean_m, 3),
            digits(noisy.path_max_m, 3),
            noisy.collisions.to_string(),
        ]);
        table.add_row(cells);
    }
    say!("\n{table}");
    if it.rows.iter().any(|row| row.noise_free.collisions + row.noisy.collisions > 0) {
        say!(
            "a collision ends a drive; each tick that it cuts off counts with the last error, so that mse and distance are \
             not those of a whole drive"
        );
    }
    let of_paper = if has_paper { "; the paper gives the worst of 10; *: its choice" } else { "" };
    say!("worst and mean of {} drives{of_paper}", it.repeats);
    for row in &it.rows {
        if let Some(check) = &row.plants {
            let set: Vec<String> = row.gains.iter().map(plants::named).collect();
            say!("{}: {}", set.join(" / "), plants::verdict(check, config));
        }
    }
    if let Some(factor) = it.rms_factor {
        say!("rms factor against the paper {factor:.3}");
    }
    for row in it.rows.iter().filter(|row| !row.switches.is_empty()) {
        let switches: Vec<String> =
            row.switches.iter().map(|it| format!("{} at tick {}", it.name, it.tick)).collect();
        let sets: Vec<String> = row
            .gains
            .iter()
            .map(|set| set.values().map(trim).collect::<Vec<_>>().join(" "))
            .collect();
        say!("gains of {} switched: {}", sets.join(" / "), switches.join(", "));
    }
    Ok(())
}

fn print_grid(it: &GridResult, config: &RunConfig) -> Result<(), Failure> {
    let objective = objective_column(config);
    let measures = MeasureColumns::new(config, true);
    let cells = |name: &str, set: &RankedSet| {
        let ranks = Ranks {
            value: Some(set.rank_value),
            distance: Some(set.rank_distance),
            mse: Some(set.rank_mse),
            path: Some(set.rank_path),
        };
        let mut cells = vec![name.to_owned()];
        cells.extend(set_cells(&config.law, std::slice::from_ref(&set.gains)));
        cells.extend(measures.cells(&set.measures, ranks, size_with(it.size, set.off_grid)));
        cells.push(set.on_bound.join(", "));
        cells
    };
    let named = it.sets.iter().map(|named| match &*named.name {
        "paper" => ("the paper's", &named.set),
        name => (name, &named.set),
    });
    fn unnamed(sets: &[RankedSet]) -> Vec<(&str, &RankedSet)> {
        sets.iter().map(|set| ("", set)).collect()
    }
    let by_objective = objective.map_or(String::new(), |name| format!("best by {name}"));
    let tables = [
        (&*by_objective, if objective.is_some() { unnamed(&it.best) } else { Vec::new() }),
        ("best by distance", unnamed(&it.best_by_distance)),
        ("best by mse", unnamed(&it.best_by_mse)),
        ("nearest the path", unnamed(&it.best_by_path)),
        ("asked for", named.collect()),
    ];
    for (title, sets) in tables.iter().filter(|(_, sets)| !sets.is_empty()) {
        let columns = measures.header().chain(["on a bound"]);
        let mut table = table_of(&header(title, &config.law, columns));
        for (name, set) in sets {
            table.add_row(cells(name, set));
        }
        say!("{table}\n");
    }
    note_off_grid(it.sets.iter().any(|named| named.set.off_grid), it.size)?;
    if let (Some(check), Some(best)) = (&it.plants, it.best.first()) {
        say!("best by {}, {}:", config.objective.name, plants::named(&best.gains));
        plants::print(check, config)?;
        say!("");
    }

    let by_objective = objective.map(|name| format!("by {name}"));
    let mut columns = vec!["sets of the grid within"];
    columns.extend(by_objective.as_deref());
    columns.extend(["by distance", "by mse", "off the path"]);
    let mut table = table_of(&columns);
    for flat in &it.flatness {
        let mut cells = vec![format!("{:.0} % of the best", 100.0 * flat.within)];
        let counts = [flat.sets_by_distance, flat.sets_by_mse, flat.sets_by_path];
        cells.extend(
            objective
                .map(|_| flat.sets_by_value)
                .into_iter()
                .chain(counts)
                .map(|count| format!("{count} of {}", it.size)),
        );
        table.add_row(cells);
    }
    say!("{table}\n");

    let mut table = table_of(&header("variance explained by", &config.law, []));
    type Share = fn(&MainEffect) -> f64;
    let of_value: Share = |it| it.share_value;
    let of_objective = objective.map(|name| (name, of_value));
    let shares: [(&str, Share); 3] = [
        ("distance", |it| it.share_distance),
        ("mse", |it| it.share_mse),
        ("off the path, mean", |it| it.share_path),
    ];
    for (name, share) in of_objective.into_iter().chain(shares) {
        let of_parameter = |key: &str| match it.main_effects.get(key) {
            Some(effect) => format!("{:.1} %", 100.0 * share(effect)),
            None => "–".to_owned(),
        };
        let mut cells = vec![name.to_owned()];
        cells.extend(config.law.keys().map(of_parameter));
        table.add_row(cells);
    }
    say!("{table}");
    Ok(())
}

/// The figures of one drive, with its sets: those of a manoeuvre where they differ.
fn print_table_of_drive(it: &SingleDrive, config: &RunConfig) -> Result<(), Failure> {
    let measures = MeasureColumns::new(config, false);
    let last = ["along m²", "cross m²", "max cross-track error m"];
    let mut table = table_of(&header("", &config.law, measures.header().chain(last)));
    let due = config.maneuvers_due();
    for (index, set) in it.gains.iter().enumerate() {
        let name = match it.gains.len() {
            1 => "all",
            _ => due.get(index).copied().unwrap_or_default(),
        };
        let mut cells = vec![name.to_owned()];
        cells.extend(set_cells(&config.law, std::slice::from_ref(set)));
        if index == 0 {
            cells.extend(measures.cells(&it.measures, Ranks::default(), 0));
            cells.extend([digits(it.along_m2, 4), digits(it.cross_m2, 4)]);
            cells.push(digits(it.max_cross_track_m, 2));
        }
        table.add_row(cells);
    }
    say!("{table}");
    Ok(())
}

fn print_drive(it: &SingleDrive, config: &RunConfig) -> Result<(), Failure> {
    // An excitation follows no path: its distances from the one of its configuration mean nothing.
    let follows_path = config.law.follows_path;
    if follows_path {
        print_table_of_drive(it, config)?;
    }
    let reason = match &*it.reason {
        "goal" => "at the path's end",
        "collision" => "in a collision",
        "held" => "because the vehicle did not follow",
        "stopped" => "because the gate stopped the vehicle",
        _ => "with its time",
    };
    let poses = if it.true_poses { "true" } else { "measured" };
    say!(
        "{} s driven; it ended {reason}; all figures are of the {poses} poses",
        digits(it.driven_s, 1)
    );
    if let Some(it) = &it.envelope {
        let (score, threshold) = (digits(it.score, 2), digits(it.threshold, 2));
        let worst = it.worst.replace('_', " ");
        match (it.out_at_s, &it.out_by) {
            (Some(at_s), Some(by)) => say!(
                "out of its envelope after {} s, by {} over {} s: score {score}, where {threshold} is the limit{}",
                digits(at_s, 1),
                by.replace('_', " "),
                it.out_over_s.unwrap_or_default(),
                if it.action.is_none() { "; it was not stopped for that" } else { "" }
            ),
            _ => say!(
                "within its envelope: score {score} by {worst} over {} s, where {threshold} is the limit",
                it.over_s
            ),
        }
    }
    say_effort("steering", &it.measures, config)?;
    if let Some(it) = it.fastest.filter(|_| follows_path) {
        say!(
            "at its fastest {} m/s, where the path says {} m/s",
            digits(it.speed_mps, 2),
            digits(it.path_speed_mps, 2)
        );
    }
    for it in &it.refused {
        let at_s = |tick: u64| digits(tick as f64 * config.drive.tick_s, 1);
        let until = it.until_tick.map_or("its end".to_owned(), |tick| format!("{} s", at_s(tick)));
        say!(
            "a change of gains was put off from {} s to {until}: the new ones were not certain to hold the vehicle (V above 1)",
            at_s(it.from_tick)
        );
    }
    let how = how_stopped(it);
    let only_told = ipc_types::Safety::reason_names(ipc_types::Safety::TOLD);
    let (told, slowed): (Vec<String>, Vec<String>) =
        it.slowed_for.iter().cloned().partition(|reason| only_told.contains(&&**reason));
    for (what, reasons) in [
        (format!("stopped the vehicle{how}"), &it.stopped_for),
        ("slowed down the vehicle".to_owned(), &slowed),
        ("noticed".to_owned(), &told),
    ] {
        if !reasons.is_empty() {
            say!("the gate {what}: {}", in_words(reasons));
        }
    }
    if it.joined {
        say!(
            "the controller was restarted during the drive: the figures cover the time since then"
        );
    }
    Ok(())
}

/// Prints how hard a drive was on wheels and passengers, and how well it kept up with the reference.
pub(super) fn say_effort(whose: &str, it: &Measures, config: &RunConfig) -> Result<(), Failure> {
    // A drive that ends by its time ends before the path does.
    let covered = match config.is_to_arrive() {
        true => {
            let percent = 100.0 * it.progress_in_time;
            format!("; {percent:.1} % of the path covered in the reference's time")
        }
        false => String::new(),
    };
    say!(
        "{whose}: {} rad/s on average, {} at the 95th percentile; lateral acceleration {} m/s² (95 %), {} at most; lateral \
         jerk {} m/s³ (95 %), {} at most{covered}",
        digits(it.steering_travel_radps, 3),
        digits(it.steering_rate_p95_radps, 3),
        digits(it.lateral_acceleration_p95_mps2, 2),
        digits(it.lateral_acceleration_max_mps2, 2),
        digits(it.lateral_jerk_p95_mps3, 1),
        digits(it.lateral_jerk_max_mps3, 1),
    );
    for (key, value, limit) in it.broken_limits(&config.objective.limits) {
        say!(
            "  breaks a limit: {} where objective.limits.{key} is {}",
            digits(value, 3),
            trim(limit)
        );
    }
    Ok(())
}

/// How the gate stopped a vehicle, in words behind a space; nothing if that is not known.
pub(crate) fn how_stopped(it: &SingleDrive) -> String {
    let how = it.stopped_how.as_deref().map(Safety::words_of_action);
    how.map(|how| format!(" {how}")).unwrap_or_default()
}

/// Reasons of the gate in words.
pub(crate) fn in_words(reasons: &[String]) -> String {
    reasons.iter().map(|name| Safety::words_of(name)).collect::<Vec<_>>().join(", ")
}

/// Prints the crashes and the speed of a run.
fn print_how_it_went(run: &Run) -> Result<(), Failure> {
    let recovery = &run.recovery;
    if recovery.recoveries > 0 {
        let time_ms = recovery.death_to_tick_ms;
        say!(
            "{} faults injected, {} recoveries; from death to the next tick p50 {} ms, p99 {} ms, max {} ms",
            recovery.injected,
            recovery.recoveries,
            or_dash(time_ms.p50, 0),
            or_dash(time_ms.p99, 0),
            or_dash(time_ms.max, 0),
        );
    }
    say!(
        "{} s of driving in {} s: {} x real time",
        digits(run.vehicle_s, 0),
        digits(run.wall_s, 1),
        digits(run.real_time_factor, 0),
    );
    Ok(())
}

/// Heading of the objective's value, if that is not the value of another column.
pub(super) fn objective_column(config: &RunConfig) -> Option<&str> {
    let objective = &config.objective;
    let is_a_column = ["distance", "mse", "path", "path_max"].contains(&&*objective.name);
    match is_a_column {
        // With a cap, a limit or a price, a drive may have another value than the column of that name shows.
        true => objective.is_adjusted().then_some("objective"),
        false => Some(&objective.name),
    }
}

/// Columns for the measures of a drive.
#[derive(Clone, Copy)]
pub(super) struct MeasureColumns<'a> {
    /// The objective's value comes first, under this name.
    objective: Option<&'a str>,
    /// Each is followed by its rank in the grid.
    ranked: bool,
    /// Whether drives are meant to arrive at the end of the path; those that end by time are not.
    arrival: bool,
}

impl<'a> MeasureColumns<'a> {
    pub(super) fn new(config: &'a RunConfig, ranked: bool) -> Self {
        let arrival = config.objective.cap_wheelbases > 0.0;
        Self { objective: objective_column(config), ranked, arrival }
    }

    pub(super) fn header(self) -> impl Iterator<Item = &'a str> {
        let rank = self.ranked.then_some("rank");
        let judged =
            self.objective.into_iter().chain(["distance", "mse m²", "off the path: mean m"]);
        let judged = judged.flat_map(move |name| std::iter::once(name).chain(rank));
        judged.chain(["p95 m", "max m"]).chain(self.arrival.then_some("arrived"))
    }

    pub(super) fn cells(self, it: &Measures, ranks: Ranks, size: usize) -> Vec<String> {
        let rank =
            |rank: Option<usize>| rank.map_or("–".to_owned(), |it| format!("{it} of {size}"));
        let mut cells = Vec::new();
        let mut judged = |value: f64, of: Option<usize>| {
            cells.push(digits(value, 4));
            cells.extend(self.ranked.then(|| rank(of)));
        };
        if self.objective.is_some() {
            judged(it.value, ranks.value);
        }
        judged(it.distance, ranks.distance);
        judged(it.mse_m2, ranks.mse);
        judged(it.path_mean_m, ranks.path);
        cells.extend([digits(it.path_p95_m, 3), digits(it.path_max_m, 3)]);
        cells.extend(self.arrival.then(|| if it.arrived { "yes" } else { "no" }.to_owned()));
        cells
    }
}

/// Ranks of a set among all of the grid.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Ranks {
    pub(super) value: Option<usize>,
    pub(super) distance: Option<usize>,
    pub(super) mse: Option<usize>,
    pub(super) path: Option<usize>,
}

impl Ranks {
    pub(super) fn of(set: &SetStanding) -> Self {
        Self {
            value: set.rank_value,
            distance: set.rank_distance,
            mse: set.rank_mse,
            path: set.rank_path,
        }
    }
}

/// A title, the symbol of each parameter, and further columns.
pub(super) fn header<'a>(
    title: &'a str,
    law: &'a LawConfig,
    columns: impl IntoIterator<Item = &'a str>,
) -> Vec<&'a str> {
    std::iter::once(title).chain(law.symbols()).chain(columns).collect()
}

/// One cell for each parameter of a law, with its values in all the sets.
pub(crate) fn set_cells(law: &LawConfig, sets: &[NamedParameters]) -> Vec<String> {
    let value = |set: &NamedParameters, key: &str| set.get(key).map_or("–".to_owned(), trim);
    let cell = |key: &str| sets.iter().map(|set| value(set, key)).collect::<Vec<_>>().join(" / ");
    law.keys().map(cell).collect()
}

/// A table without lines, with numbers aligned to the right.
pub(crate) fn table_of(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(NOTHING).set_header(header);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

/// Prints a table whose first column stands left and all others right.
///
/// # Errors
/// If it cannot be written to standard output.
pub fn print_table(
    header: &[&str],
    rows: impl IntoIterator<Item = Vec<String>>,
) -> Result<(), Failure> {
    let mut table = table_of(header);
    for row in rows {
        table.add_row(row);
    }
    say!("{table}");
    Ok(())
}

/// A number with `count` digits after the decimal point.
pub(crate) fn digits(number: f64, count: usize) -> String {
    format!("{number:.count$}")
}

/// The same, or a dash if there is no number.
pub(super) fn or_dash(number: Option<f64>, count: usize) -> String {
    number.map_or("–".to_owned(), |number| digits(number, count))
}

/// A parameter with as many digits as it needs.
pub(crate) fn trim(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_and_cells_match_with_and_without_objective_and_ranks() {
        for objective in [None, Some("path")] {
            for ranked in [false, true] {
                let columns = MeasureColumns { objective, ranked, arrival: ranked };
                let header: Vec<&str> = columns.header().collect();
                let measures = Measures { value: 2.0, distance: 1.0, ..Measures::default() };
                let ranks = Ranks { value: Some(7), distance: Some(3), ..Ranks::default() };
                let cells = columns.cells(&measures, ranks, 750);
                assert_eq!(header.len(), cells.len());
                let at = |name: &str| header.iter().position(|it| *it == name).unwrap();
                assert_eq!(cells[at("distance")], "1.0000");
                assert_eq!(header.contains(&"path"), objective.is_some());
                if ranked {
                    assert_eq!(cells[at("distance") + 1], "3 of 750");
                    assert_eq!(cells[at("mse m²") + 1], "–");
                }
                if objective.is_some() {
                    assert_eq!(cells[at("path")], "2.0000");
                }
            }
        }
    }

    #[test]
    fn each_parameter_has_a_column_whatever_the_order_in_the_file() {
        let law = config::paper_law();
        let set = |values: [f64; 4]| {
            let names = ["ki", "ks", "kl", "kv"].map(str::to_owned);
            NamedParameters(names.into_iter().zip(values).collect())
        };
        let sets = [set([0.7, 21.0, 11.0, 3.0]), set([0.84, 1.0, 21.0, 3.4])];
        assert_eq!(set_cells(&law, &sets[..1]), ["3", "11", "21", "0.7"]);
        assert_eq!(set_cells(&law, &sets), ["3 / 3.4", "11 / 21", "21 / 1", "0.7 / 0.84"]);
    }

    #[test]
    fn numbers_have_the_digits_they_need() {
        assert_eq!([trim(3.0), trim(0.7), trim(1e-1), trim(1000.0)], ["3", "0.7", "0.1", "1000"]);
    }
}
