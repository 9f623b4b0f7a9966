//! The verdict with which the page of a training opens: what was chosen, what it is worth, and what to do next.

use config::RunConfig;
use maud::{Markup, html};
use outcome::{RunResult, TrainResult};

use crate::axis::{integer, number};
use crate::baselines::name_of;
use crate::page::parameters_text;

/// The verdict on a training whose folder commands may call `folder`.
pub(crate) fn section(
    train: &TrainResult,
    run: &RunResult,
    config: &RunConfig,
    folder: &str,
) -> Markup {
    let is_fragile = train.plants.as_ref().is_some_and(|it| it.fragile.is_some());
    html! {
        ul {
            li { b { "Chosen" } ": " (parameters_text(&config.law, &train.gains)) " of the law " (config.law.name) "." }
            li { b { "Distance from the path" } ": " (distance(train, config)) }
            li { b { "Against textbook sets" } ": " (against(train)) }
            li { b { "On a car that is a little different" } ": " (robust(train)) }
            li { b { "It rests on" } ": " (evidence(train, config)) }
        }
        p { b { "What next" } }
        ul { @for (command, why) in next(run, train, config, folder, is_fragile) {
            li { code { (command) } ": " (why) }
        } }
    }
}

fn distance(train: &TrainResult, config: &RunConfig) -> String {
    let own = (train.measures.path_mean_m, Some(train.measures.path_max_m));
    // Over plants, the set's own figures are those over them.
    let ((mean_m, max_m), whose) = match (&train.plants, train.vehicle_drives.is_some()) {
        (_, true) => (own, "in drives of the vehicle"),
        (Some(it), false) => {
            ((it.path_mean_m, it.path_max_m), "with the vehicle as its file has it")
        }
        (None, false) => (own, "with the vehicle as its file has it"),
    };
    let at_most = max_m.map_or(String::new(), |it| format!(" and {} m at most", number(it, 3)));
    let arrived = if train.measures.arrived || !config.is_to_arrive() {
        ""
    } else {
        ", and it did not arrive"
    };
    let nominal = format!("{} m on average{at_most} {whose}{arrived}", number(mean_m, 3));
    match &train.plants {
        Some(check) => format!(
            "{nominal}; {} m on average in the worst of {} plants that were drawn anew{}{}.",
            number(check.fresh.path_mean_max_m, 3),
            check.fresh.plants,
            if train.vehicle_drives.is_some() { ", in our simulator" } else { "" },
            match check.fresh.not_arrived {
                0 => String::new(),
                _ if !config.is_to_arrive() => String::new(),
                missed => format!(", on {missed} of which it does not arrive"),
            }
        ),
        None => format!("{nominal}."),
    }
}

fn against(train: &TrainResult) -> String {
    let best = train.baselines.as_ref().and_then(|it| Some((it, it.sets.get(it.best)?)));
    let Some((beside, best)) = best else {
        return match &train.paper {
            Some(paper) => format!(
                "the paper has figures for this training, so its set stands beside it: {} m against {} m from the path on \
                 average.",
                number(train.measures.path_mean_m, 3),
                number(paper.measures.path_mean_m, 3)
            ),
            None => "they were not driven beside it.".to_owned(),
        };
    };
    let ratio = beside
        .ratio
        .map_or(String::new(), |ratio| format!(", {} % of its distance", number(100.0 * ratio, 0)));
    let how = if beside.beaten { "better than" } else { "not better than" };
    format!("{how} the best of them, {}{ratio}.", name_of(best))
}

fn robust(train: &TrainResult) -> String {
    match &train.plants {
        None => match &train.simulated_first {
            Some(it) => format!(
                "on {} simulated plants that chose nothing, it was beyond {} m on {} and did not arrive on {}.",
                it.fresh.plants,
                number(it.within_m, 2),
                it.fresh.beyond,
                it.fresh.not_arrived
            ),
            None => "not known.".to_owned(),
        },
        Some(check) => match &check.fragile {
            Some(why) => format!("fragile; {why}."),
            None => "not fragile.".to_owned(),
        },
    }
}

fn evidence(train: &TrainResult, config: &RunConfig) -> String {
    let plants = match config.plants() {
        1 => String::new(),
        count => format!(", each on {count} plants"),
    };
    let what = if config.drives_differ() { "drives" } else { "sets that were driven" };
    let drives = format!("{} {what}{plants}", integer(train.distinct));
    let noise = match &train.noise {
        Some(noise) if config.noise.enabled || config.is_over_plants() => {
            let noisy = if config.noise.enabled { "noisy " } else { "" };
            let on = if config.is_over_plants() { " on fresh plants" } else { "" };
            format!("; {} {noisy}drives{on} that chose nothing", noise.repeats)
        }
        Some(noise) => format!("; {} more drives of each finalist", noise.repeats),
        None if config.noise.enabled => String::new(),
        None => ", without noise".to_owned(),
    };
    let grid = train.grid.as_ref().map_or(String::new(), |grid| {
        format!("; a comparison with all {} sets of the grid", integer(grid.size as u64))
    });
    format!("{drives}{noise}{grid}.")
}

/// Commands for what comes next, and what each is good for.
fn next(
    run: &RunResult,
    train: &TrainResult,
    config: &RunConfig,
    folder: &str,
    is_fragile: bool,
) -> Vec<(String, &'static str)> {
    // With all that it was trained with: the file of the run names the path, the vehicle, and every key.
    let run_folder = option(run, "--out").map_or_else(|| folder.to_owned(), |it| quoted(&it));
    let of = format!("--config {run_folder}/config.toml");
    let values: Vec<String> = train.gains.0.iter().map(|(_, value)| value.to_string()).collect();
    let mut next = Vec::new();
    if is_fragile && config.plants() == 1 && train.vehicle_drives.is_none() {
        let noise = if config.noise.enabled { " --noise" } else { "" };
        next.push((
            format!("pathtune train {of} --over default{noise}"),
            "looks for a set that is not fragile",
        ));
    }
    next.push((
        format!("pathtune validate {of} --gains {}", values.join(",")),
        "drives the set under noise, and on plants",
    ));
    next.push((
        format!("pathtune compare {of}"),
        "tells how many drives other tuners need for as good a set",
    ));
    if !is_fragile && (train.measures.arrived || !config.is_to_arrive()) {
        let file = option(run, "--vehicle").filter(|it| it.contains('.') || it.contains('/'));
        let file = file.map_or_else(|| "car.toml".to_owned(), |it| quoted(&it));
        next.push((
            format!("pathtune gains promote {run_folder} {file}"),
            "writes the set into the file of your vehicle",
        ));
    }
    next.push((
        format!("pathtune drive {of} --realtime --from {run_folder}"),
        "drives it in real time; --replace vehicle=\u{2026} puts your vehicle in the loop",
    ));
    next
}

/// What the command line gave this option, if it did.
fn option(run: &RunResult, name: &str) -> Option<String> {
    let all = &run.run.command;
    all.iter().enumerate().find_map(|(place, word)| match word.strip_prefix(name) {
        Some("") => all.get(place + 1).cloned(),
        Some(rest) => rest.strip_prefix('=').map(str::to_owned),
        None => None,
    })
}

/// A word as a shell takes it.
fn quoted(word: &str) -> String {
    match word.contains(char::is_whitespace) {
        true => format!("'{word}'"),
        false => word.to_owned(),
    }
}
