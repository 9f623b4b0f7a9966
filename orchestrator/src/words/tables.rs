//! The tables at the end of a training, a validation and a sweep of the grid.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, Table};
use config::{Gains, RunConfig};
use serde_json::Value;

use crate::words::Failure;
use crate::words::terminal::say;

/// The table of a training, and what else is worth knowing of it.
pub(crate) fn print_training(config: &RunConfig, result: &Value) -> Result<(), Failure> {
    let size = result["grid"]["size"].as_u64().unwrap_or_default();
    let mut table = table_of(&["", "Kv", "Kl", "Ks", "Ki", "distance", "rank", "mse m²", "rank"]);
    let mut row = |name: &str, set: &Value, ranks: &Value| {
        let rank = |key: &str| format!("{}/{size}", whole(&ranks[key]));
        let mut cells = vec![name.to_owned()];
        cells.extend(gains_of(&set["gains"]).to_array().map(trim));
        cells.extend([digits(&set["distance"], 4), rank("rank_distance")]);
        cells.extend([digits(&set["mse_m2"], 4), rank("rank_mse")]);
        table.add_row(cells);
    };
    let tuner = match config.learning.tuner {
        config::Tuner::EducatedQ => "tuned (educated Q)",
        config::Tuner::Q => "tuned (Q)",
    };
    row(tuner, result, &result["grid"]);
    row("plain Q beside it", &result["plain_q"], &result["plain_q"]);
    if !result["paper"].is_null() {
        row("the paper's set", &result["paper"], &result["paper"]);
    }
    say!("{table}");

    let grid = &result["grid"];
    say!(
        "ranks among all {size} sets of the grid, noise-free; its best: distance {}, mse {} m²",
        digits(&grid["best_distance"], 4),
        digits(&grid["best_mse_m2"], 4),
    );
    let bounds = words(&result["on_bound"]);
    if !bounds.is_empty() {
        say!("on a bound of the grid: {bounds}; better gains may lie beyond it");
    }
    print_choice_under_noise(config, result)?;
    let drives = &result["drives"];
    say!(
        "{} drives asked for ({} by plain Q), {} driven, {} again behind a crash; the grid holds {size}",
        drives["asked"],
        result["plain_q"]["asked"],
        drives["driven"],
        drives["reissued"],
    );
    print_how_it_went(result)
}

/// How the gains were chosen under noise, and how sure that is.
fn print_choice_under_noise(config: &RunConfig, result: &Value) -> Result<(), Failure> {
    let noise = &result["noise"];
    let Some(chosen) = noise["finalists"].get(0) else { return Ok(()) };
    say!(
        "under noise: mean distance {} [{}, {}] over {} drives, the best of {} sets driven again",
        digits(&chosen["mean_distance"], 4),
        digits(&chosen["low"], 4),
        digits(&chosen["high"], 4),
        noise["repeats"],
        noise["finalists"].as_array().map_or(0, Vec::len),
    );
    if config.vehicle.gear_engaged {
        say!("all of it, the noise-free figures too, with the drive gear engaged from the start");
    }
    for (name, key) in
        [("the learners' vote", "against_voted"), ("the paper's set", "against_paper")]
    {
        let against = &noise[key];
        if against.is_null() || against["gains"] == chosen["gains"] {
            continue;
        }
        let verdict = match against["verdict"].as_str() {
            Some("better") => "better than",
            Some("worse") => "worse than",
            _ => "not to be told from",
        };
        say!(
            "{verdict} {name}: paired difference {} [{}, {}] over the same {} drives",
            digits(&against["difference"], 4),
            digits(&against["low"], 4),
            digits(&against["high"], 4),
            noise["repeats"],
        );
    }
    say!(
        "rank {}/{} by the mean distance over {} other noise seeds",
        whole(&result["grid"]["rank_mean_distance"]),
        whole(&result["grid"]["size"]),
        noise["holdout"],
    );
    Ok(())
}

/// The table of a validation.
pub(crate) fn print_validation(_: &RunConfig, result: &Value) -> Result<(), Failure> {
    let rows = || result["rows"].as_array().into_iter().flatten();
    let gains = |row: &Value| {
        let sets = row["gains"].as_array().into_iter().flatten();
        let sets: Vec<String> =
            sets.map(|set| gains_of(set).to_array().map(trim).join(" ")).collect();
        let mark = if row["chosen_by_paper"] == true { "* " } else { "" };
        format!("{mark}{}", sets.join(" / "))
    };
    let mut table = table_of(&[
        "noise-free",
        "mse m²",
        "paper",
        "factor",
        "along",
        "cross",
        "distance",
        "max cross m",
        "at limit",
        "collisions",
    ]);
    for row in rows() {
        let plain = &row["noise_free"];
        let limited = 100.0 * plain["steering_limited"].as_f64().unwrap_or_default();
        table.add_row([
            gains(row),
            digits(&plain["mse_m2"], 3),
            digits(&plain["paper_mse_m2"], 3),
            digits(&plain["factor"], 2),
            digits(&plain["along_m2"], 3),
            digits(&plain["cross_m2"], 3),
            digits(&plain["distance"], 3),
            digits(&plain["max_cross_track_m"], 2),
            format!("{limited:.1} %"),
            whole(&plain["collisions"]).to_string(),
        ]);
    }
    say!("{table}");
    let mut table =
        table_of(&["with noise", "mean mse m²", "95 %", "worst", "paper", "factor", "collisions"]);
    for row in rows() {
        let noisy = &row["noisy"];
        let interval =
            format!("[{}, {}]", digits(&noisy["mse_m2_low"], 3), digits(&noisy["mse_m2_high"], 3));
        table.add_row([
            gains(row),
            digits(&noisy["mse_m2_mean"], 3),
            interval,
            digits(&noisy["mse_m2_worst"], 3),
            digits(&noisy["paper_mse_m2"], 3),
            digits(&noisy["factor"], 2),
            whole(&noisy["collisions"]).to_string(),
        ]);
    }
    say!("\n{table}");
    let collisions = |kind: &str| rows().any(|row| whole(&row[kind]["collisions"]) > 0);
    if collisions("noise_free") || collisions("noisy") {
        say!(
            "a collision ends a drive; the ticks that it cuts off score the last error, so that mse and distance are \
             those of no whole drive"
        );
    }
    say!(
        "worst and mean of {} drives; the paper gives the worst of 10; *: its choice",
        result["repeats"]
    );
    if let Some(factor) = result["rms_factor"].as_f64() {
        say!("rms factor against the paper {factor:.3}");
    }
    for row in rows().filter(|row| row["switches"].get(0).is_some()) {
        let switches: Vec<String> = row["switches"]
            .as_array()
            .into_iter()
            .flatten()
            .map(|it| format!("{} at tick {}", it["name"].as_str().unwrap_or_default(), it["tick"]))
            .collect();
        say!("gains of {} switched: {}", gains(row), switches.join(", "));
    }
    print_how_it_went(result)
}

/// The tables of a sweep of the grid.
pub(crate) fn print_grid(_: &RunConfig, result: &Value) -> Result<(), Failure> {
    let size = whole(&result["size"]);
    let header = ["Kv", "Kl", "Ks", "Ki", "distance", "rank", "mse m²", "rank", "on a bound"];
    let cells = |set: &Value| {
        let mut cells = gains_of(&set["gains"]).to_array().map(trim).to_vec();
        cells.extend([digits(&set["distance"], 4), whole(&set["rank_distance"]).to_string()]);
        cells.extend([digits(&set["mse_m2"], 4), whole(&set["rank_mse"]).to_string()]);
        cells.push(words(&set["on_bound"]));
        cells
    };
    for (title, key) in [
        ("best by distance", "best_by_distance"),
        ("best by mse", "best_by_mse"),
        ("asked for", "sets"),
    ] {
        let sets: Vec<&Value> = result[key].as_array().into_iter().flatten().collect();
        if sets.is_empty() {
            continue;
        }
        let mut table = table_of(&[&[title][..], &header[..]].concat());
        for set in sets {
            let name = match set["name"].as_str() {
                Some("paper") => "the paper's",
                name => name.unwrap_or_default(),
            };
            table.add_row([vec![name.to_owned()], cells(set)].concat());
        }
        say!("{table}\n");
    }
    let mut table = table_of(&["sets of the grid within", "by distance", "by mse"]);
    for flat in result["flatness"].as_array().into_iter().flatten() {
        table.add_row([
            format!("{:.0} % of the best", 100.0 * flat["within"].as_f64().unwrap_or_default()),
            format!("{}/{size}", whole(&flat["sets_by_distance"])),
            format!("{}/{size}", whole(&flat["sets_by_mse"])),
        ]);
    }
    say!("{table}\n");
    let mut table = table_of(&["variance explained by", "Kv", "Kl", "Ks", "Ki"]);
    for (name, key) in [("distance", "share_distance"), ("mse", "share_mse")] {
        let share = |gain: &str| {
            let share = result["main_effects"][gain][key].as_f64().unwrap_or(f64::NAN);
            format!("{:.1} %", 100.0 * share)
        };
        table.add_row([vec![name.to_owned()], Gains::NAMES.map(share).to_vec()].concat());
    }
    say!("{table}");
    print_how_it_went(result)
}

/// Crashes, speed and digest of a run.
/// The table of a single drive.
pub(crate) fn print_drive(config: &RunConfig, result: &Value) -> Result<(), Failure> {
    let mut table =
        table_of(&["", "Kv", "Kl", "Ks", "Ki", "mse m²", "along m²", "cross m²", "max cross m"]);
    let due = config.maneuvers_due();
    for (index, set) in result["gains"].as_array().into_iter().flatten().enumerate() {
        let one_for_all = result["gains"].as_array().is_some_and(|sets| sets.len() == 1);
        let mut cells = vec![if one_for_all { "all" } else { due[index] }.to_owned()];
        cells.extend(gains_of(set).to_array().map(trim));
        if index == 0 {
            cells.extend(["mse_m2", "along_m2", "cross_m2"].map(|key| digits(&result[key], 4)));
            cells.push(digits(&result["max_cross_track_m"], 2));
        }
        table.add_row(cells);
    }
    say!("{table}");
    let reason = match result["reason"].as_str() {
        Some("goal") => "at the path's end",
        Some("collision") => "in a collision",
        _ => "with its time",
    };
    let poses = if result["true_poses"] == true { "true" } else { "measured" };
    say!(
        "{} s driven; it ended {reason}; errors are those of the {poses} poses",
        digits(&result["driven_s"], 1)
    );
    if result["joined"] == true {
        say!("the controller was restarted on the way: errors are those since then");
    }
    print_how_it_went(result)
}

fn print_how_it_went(result: &Value) -> Result<(), Failure> {
    let recovery = &result["recovery"];
    if recovery["recoveries"].as_u64().unwrap_or_default() > 0 {
        let time = &recovery["death_to_tick_ms"];
        say!(
            "{} faults injected, {} recoveries; from death to the next tick p50 {} ms, p99 {} ms, max {} ms",
            recovery["injected"],
            recovery["recoveries"],
            digits(&time["p50"], 0),
            digits(&time["p99"], 0),
            digits(&time["max"], 0),
        );
    }
    say!(
        "{} s of driving in {} s: {} x real time",
        digits(&result["vehicle_s"], 0),
        digits(&result["wall_s"], 1),
        digits(&result["real_time_factor"], 0),
    );
    say!("digest {}", result["digest"].as_str().unwrap_or_default());
    Ok(())
}

/// A table without lines, its numbers to the right.
pub(crate) fn table_of(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(NOTHING).set_header(header);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

fn gains_of(value: &Value) -> Gains {
    Gains::from_array(Gains::NAMES.map(|name| value[name].as_f64().unwrap_or(f64::NAN)))
}

/// A number with so many digits behind the point; a dash where there is none.
pub(crate) fn digits(value: &Value, count: usize) -> String {
    value.as_f64().map_or("–".to_owned(), |number| format!("{number:.count$}"))
}

fn whole(value: &Value) -> u64 {
    value.as_u64().unwrap_or_default()
}

fn words(value: &Value) -> String {
    let words: Vec<&str> =
        value.as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    words.join(", ")
}

/// A gain with as many digits as it needs.
pub(crate) fn trim(gain: f64) -> String {
    let text = format!("{gain:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
