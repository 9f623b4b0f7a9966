//! The result of a training: its table with notes on its limits, how it learnt, and the effect of noise.

use std::collections::BTreeMap;

use config::{LawConfig, RunConfig};
use maud::{Markup, html};
use outcome::{
    Comparison, LearnerSummary, NoiseChoice, RunResult, TrainResult, VehicleDrives, Verdict,
};

use crate::ReportError;
use crate::axis::{Axis, integer, number, optional, short};
use crate::baselines;
use crate::canvas::{HALF, Stroke, WIDE, text_width};
use crate::chart::{Chart, Line};
use crate::episodes::{EPISODES_FILE, Episode};
use crate::page::{
    Page, parameter_cells, parameter_heads, parameter_title, parameters_text, symbol, table,
};
use crate::panels::{Interval, Panel, Shown, intervals, panels};
use crate::plants;
use crate::standings::{Ranks, Row, objective_title, standings};
use crate::verdict;

/// Up to this many episodes, each has a marker; more markers would hide the line.
const MOST_MARKERS: usize = 60;
/// The largest number of learners in one picture: that many lines can be distinguished in print.
const MOST_LINES: usize = 30;

/// Adds the sections of a training to the page. `episodes` are those of each learner; `None` if the run left no file.
/// Commands may call the run's folder `folder`.
pub(crate) fn sections(
    page: &mut Page,
    train: &TrainResult,
    run: &RunResult,
    episodes: Option<&[Vec<Episode>]>,
    config: &RunConfig,
    folder: &str,
) -> Result<(), ReportError> {
    page.section("Verdict", verdict::section(train, run, config, folder));
    page.section("Result", result(train, run, episodes, config));
    if let Some(beside) = &train.baselines {
        page.section("Beside textbook sets", baselines::section(beside, train, config));
    }
    if let Some(check) = &train.plants {
        let title = match train.vehicle_drives {
            None => "On plants like this car",
            Some(_) => "On plants like this car, in our simulator",
        };
        page.section(title, plants::section(check, config));
    }
    if let Some(curve) = &train.trade_off {
        let body = baselines::curve(page, curve, train, config)?;
        page.section("Distance against steering travel", body);
    }
    if let Some(episodes) = episodes.filter(|all| all.iter().any(|of| !of.is_empty())) {
        let body = learning(page, train, episodes, config)?;
        page.section("Learning", body);
    }
    if !train.learners.is_empty() {
        page.section("Learners", learner_table(&train.learners, config));
    }
    let usage = usage(&train.learners, &config.law);
    if !usage.is_empty() {
        let words = "Bars: how often each value of each parameter was driven, over all learners.";
        let picture = panels("parameter-usage", words, "drives [count]", &usage, Shown::Bars)?;
        let figure = page.figure(
            picture,
            "How often each value of each parameter was driven, all learners together.",
        );
        page.section("Parameter usage", html! { div.figures { (figure) } });
    }
    if let Some(noise) = &train.noise {
        let has_rank = train.grid.is_some_and(|grid| grid.rank_mean.is_some());
        let body = finalists(page, noise, has_rank, config)?;
        page.section(
            if config.noise.enabled { "Finalists under noise" } else { "Finalists" },
            body,
        );
    }
    Ok(())
}

fn result(
    train: &TrainResult,
    run: &RunResult,
    episodes: Option<&[Vec<Episode>]>,
    config: &RunConfig,
) -> Markup {
    let tuned = Row {
        name: format!("tuned ({})", train.tuner),
        gains: &train.gains,
        measures: &train.measures,
        ranks: train.grid.as_ref().map(Ranks::from).unwrap_or_default(),
        off_grid: train.off_grid,
        on_bound: &train.on_bound,
    };
    let rows = [
        Some(tuned),
        train.paper.as_ref().map(|set| Row::beside("the paper’s set", set)),
        train.plain_q.as_ref().map(|it| Row::beside("found by plain Q", &it.set)),
        train.random_walk.as_ref().map(|it| Row::beside("found by a random walk", &it.set)),
    ];
    html! {
        (standings(config, train.grid.as_ref().map(|grid| grid.size), rows.into_iter().flatten()))
        (notes(train, run, config))
        @match episodes {
            None => p { "The run’s folder holds no " code { (EPISODES_FILE) } ", so the progress of the learners is not shown." },
            Some(all) if all.iter().all(Vec::is_empty) && train.learners.iter().all(|it| it.episodes == 0) => {
                p { "The tuner " (train.tuner) " has no episodes; " code { "drives.csv" } " holds its steps." }
            }
            Some(all) if all.iter().all(Vec::is_empty) => {
                p { code { (EPISODES_FILE) } " holds no episode, so the progress of the learners is not shown." }
            }
            Some(_) => {}
        }
    }
}

/// What the figures do and do not say.
fn notes(train: &TrainResult, run: &RunResult, config: &RunConfig) -> Markup {
    let RunResult { drives, run, .. } = run;
    let objective = config.objective.name.as_str();
    html! {
        ul {
            @if let Some(drives) = &train.vehicle_drives {
                (vehicle_drives(drives, train))
                @if !config.has_figures_of_the_paper() {
                    li { "Textbook sets are not beside it: they are driven by our simulator alone." }
                }
            }
            @if let Some(grid) = &train.grid {
                li {
                    "Ranks are among all " (integer(grid.size as u64)) " sets of the grid, " (config.ranked_how()) "; its best: "
                    @if !["distance", "mse", "path"].contains(&objective) { (objective) " " (number(grid.best_value, 4)) ", " }
                    "distance " (number(grid.best_distance, 4)) ", mse " (number(grid.best_mse_m2, 4))
                    " m², mean distance from the path " (number(grid.best_path_mean_m, 3)) " m."
                }
                @if let Some(rank) = grid.rank_mean {
                    li {
                        "By its mean " (objective) " under noise the tuned set has rank " (integer(rank as u64)) " of "
                        (integer(grid.size as u64)) "."
                    }
                }
            } @else if train.vehicle_drives.is_some() && config.tuner.has_budget() {
                li { "There are no ranks: the vehicle makes no more drives than its budget." }
            } @else if train.vehicle_drives.is_some_and(|drives| drives.by_clock) {
                li { "There are no ranks: the vehicle paces by the clock, so the sets of the grid are not driven." }
            } @else {
                li {
                    "There are no ranks: the grid takes more ticks than ranking.max_ticks ("
                    (integer(config.ranking.max_ticks)) ") and was not driven."
                }
            }
            @if !train.on_bound.is_empty() {
                li {
                    "† On a bound of the grid: "
                    (train.on_bound.iter().map(|key| symbol(&config.law, key)).collect::<Vec<_>>().join(", "))
                    "; better values may lie beyond it."
                }
            }
            li {
                "The tuner minimises the objective: " (objective) " (" (config.objective.summary) "). "
                @if objective == "distance" {
                    "It does not contain the error along the track; the mse, the paper’s figure of merit, does. "
                }
                "A set can be best by one measure and mediocre by another."
            }
            li {
                "The yardstick for every law is the distance from the path: from the vehicle’s pose (the true one, "
                "where it is known) to the nearest point of the path, as its mean, its 95th percentile and its largest value."
            }
            li {
                (integer(drives.asked)) @if config.plants() > 1 { " sets" } @else { " drives" } " asked for, "
                (integer(drives.driven)) " driven"
                @if config.plants() > 1 { " on " (integer(config.plants() as u64)) " plants each" } ", "
                (integer(run.drives.reissued)) " again after a crash"
                @if drives.for_table > 0 { ", " (integer(drives.for_table)) " more for the table" }
                @if let Some(grid) = &train.grid { "; the grid holds " (integer(grid.size as u64)) }
                "."
                @for (name, beside) in [("Plain Q", &train.plain_q), ("The random walk", &train.random_walk)] {
                    @if let Some(beside) = beside {
                        " " (name) " asked for " (integer(beside.asked)) ", " (integer(beside.distinct)) " of them different."
                    }
                }
            }
            @if run.recovery.recoveries > 0 {
                li { (integer(run.recovery.injected)) " faults injected, " (integer(run.recovery.recoveries)) " recoveries." }
            }
            li {
                (number(run.vehicle_s, 0)) " s of driving in " (number(run.wall_s, 1)) " s: "
                (number(run.real_time_factor, 0)) " × real time."
            }
        }
    }
}

/// Whose drives the figures are, and how certain they are if the vehicle does not repeat itself.
fn vehicle_drives(drives: &VehicleDrives, train: &TrainResult) -> Markup {
    let paper = train.paper.as_ref().and_then(|set| set.spread);
    let spreads = [("The tuned set", train.spread), ("The paper’s set", paper)];
    let within = |it: outcome::Interval, digits| html! { "[" (number(it.low, digits)) ", " (number(it.high, digits)) "]" };
    html! {
        li {
            "All figures are of drives that the vehicle made; none is computed with our simulator."
            @if !drives.repeats {
                " It does not repeat itself: the figures are means, and the same training comes to another result and digest "
                "the next time."
                @if drives.of_grid_set > 0 {
                    " Each other set of the grid was driven " (integer(drives.of_grid_set.into())) " times."
                }
            }
        }
        @for (name, spread) in spreads {
            @if let Some(spread) = spread {
                li {
                    (name) ", 95 % intervals over " (integer(spread.drives.into())) " drives: objective "
                    (within(spread.value, 4)) ", distance " (within(spread.distance, 4)) ", mse " (within(spread.mse_m2, 4))
                    " m², mean distance from the path " (within(spread.path_mean_m, 3)) " m."
                }
            }
        }
    }
}

/// The name of a learner on the page: its learning rate, if it has one.
fn name_of(index: usize, learner: &LearnerSummary) -> String {
    match learner.alpha {
        Some(alpha) => format!("α = {}", short(alpha)),
        None => format!("learner {index}"),
    }
}

fn learning(
    page: &mut Page,
    train: &TrainResult,
    episodes: &[Vec<Episode>],
    config: &RunConfig,
) -> Result<Markup, ReportError> {
    let longest = episodes.iter().map(Vec::len).max().unwrap_or(0);
    let lines = |height: fn(&Episode) -> f64| -> Vec<Line> {
        let learners = train.learners.iter().zip(episodes).enumerate().take(MOST_LINES);
        learners
            .map(|(index, (learner, episodes))| {
                let mut look = Stroke::of_many(index);
                if longest > MOST_MARKERS {
                    look.marker = None;
                }
                let points = episodes.iter().enumerate();
                let points = points.map(|(place, of)| ((place + 1) as f64, height(of)));
                Line::new(name_of(index, learner), points, look)
            })
            .collect()
    };
    let chart = |name: &str, words: &str, y_name: &str, lines: &[Line]| {
        Chart {
            name,
            words,
            width: HALF * 2.0 + 20.0,
            height: 270.0,
            x: Axis::of_counts(longest),
            x_name: "episode [count]",
            y_name,
            lines,
            legend_rows: 1,
            borders: &[],
        }
        .draw()
    };
    let which = if train.learners.len() > MOST_LINES {
        format!("one line for each of the first {MOST_LINES} learners")
    } else {
        "one line for each learner".to_owned()
    };
    let returns = chart(
        "learning-rewards",
        &format!("Sum of rewards of each episode, {which}."),
        "sum of rewards [no unit]",
        &lines(|episode| episode.return_),
    )?;
    let returns = page.figure(returns, &format!("Sum of rewards per episode, {which}."));
    let objective = &config.objective.name;
    let values = chart(
        "learning-values",
        &format!("Objective ({objective}) at the end of each episode, {which}."),
        &objective_title(config),
        &lines(|episode| episode.last_value),
    )?;
    let values = page.figure(
        values,
        &format!("The objective ({objective}) in the last step of each episode, {which}."),
    );
    Ok(html! {
        div.figures { (returns) }
        @if train.learners.iter().any(|learner| learner.alpha.is_some()) {
            p {
                "The sum of an episode’s rewards telescopes to 1/(1 + v" sub { "end" } ") − 1/(1 + v" sub { "start" }
                "), v being the objective, less penalties: it depends only on the two ends of the episode, so that a flat "
                "curve proves nothing."
            }
        }
        div.figures { (values) }
    })
}

fn learner_table(learners: &[LearnerSummary], config: &RunConfig) -> Markup {
    let law = &config.law;
    let locked = |learner: &LearnerSummary| {
        let locked = learner.locked.iter();
        let texts: Vec<_> =
            locked.map(|(key, value)| format!("{} {}", symbol(law, key), short(*value))).collect();
        if texts.is_empty() { "–".to_owned() } else { texts.join(", ") }
    };
    // Not every tuner has episodes.
    let has_episodes = learners.iter().any(|learner| learner.episodes > 0);
    table(
        html! { tr {
            th { "learner" } (parameter_heads(law)) th { "locked" }
            @if has_episodes { th.number { "episodes" } th.number { "ended by a terminal state" } }
            th.number { "drives" }
            th.number { "best " (objective_title(config)) }
        } },
        html! {
            @for (index, learner) in learners.iter().enumerate() {
                tr {
                    td { (name_of(index, learner)) }
                    (parameter_cells(law, &learner.gains))
                    td { (locked(learner)) }
                    @if has_episodes {
                        td.number { (integer(learner.episodes.into())) }
                        td.number { (integer(learner.terminated.into())) }
                    }
                    td.number { (integer(learner.drives.into())) }
                    td.number { (optional(learner.best, 4)) }
                }
            }
        },
    )
}

/// Counts of each value of each parameter, over all learners.
fn usage(learners: &[LearnerSummary], law: &LawConfig) -> Vec<Panel> {
    let mut panels = Vec::new();
    for parameter in &law.parameters {
        // Values come from one grid: the same value has the same bits in every learner.
        let mut counts: BTreeMap<u64, (f64, f64)> = BTreeMap::new();
        let uses = learners.iter().filter_map(|learner| learner.usage.get(&parameter.key));
        for used in uses.flatten() {
            let count = counts.entry(used.value.to_bits()).or_insert((used.value, 0.0));
            count.1 += used.count as f64;
        }
        let mut points: Vec<_> = counts.into_values().collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        if !points.is_empty() {
            panels.push(Panel { name: parameter_title(parameter), points });
        }
    }
    panels
}

fn finalists(
    page: &mut Page,
    noise: &NoiseChoice,
    has_rank: bool,
    config: &RunConfig,
) -> Result<Markup, ReportError> {
    let law = &config.law;
    let (is_noisy, is_over_plants) = (config.noise.enabled, config.is_over_plants());
    let title = objective_title(config);
    let finalists = &noise.finalists;
    let figure = if finalists.is_empty() {
        None
    } else {
        let mut labels: Vec<String> =
            finalists.iter().map(|finalist| parameters_text(law, &finalist.gains)).collect();
        // The names of many parameters would leave no room for the intervals; they are in the table.
        if labels.iter().any(|label| text_width(label) > 0.4 * WIDE) {
            labels = (1..=labels.len()).map(|place| format!("finalist {place}")).collect();
        }
        let rows: Vec<Interval> = finalists
            .iter()
            .zip(labels)
            .map(|(finalist, label)| Interval {
                label,
                mean: finalist.mean_value,
                low: finalist.low,
                high: finalist.high,
            })
            .collect();
        let words = "Mean objective of each finalist, with its interval.";
        let picture = intervals("finalists", words, &format!("mean {title}"), &rows)?;
        let caption =
            format!("The finalists: mean {} with its 95 % interval.", config.objective.name);
        Some(page.figure(picture, &caption))
    };
    Ok(html! {
        p {
            @if is_over_plants {
                "Each finalist was driven" @if is_noisy { " under noise" } " on " (integer(noise.choosing))
                " plants that were drawn anew, the same for all of them. The set was chosen that arrives on the most of them, \
                 is not fragile, and has the best mean, in this order."
            } @else {
                "Each finalist was driven again" @if is_noisy { " under noise" } ", " (integer(noise.choosing)) " times"
                @if is_noisy { ", each time with the same noise for all of them" }
                ", and the set with the best mean was chosen."
            }
            @if is_noisy || is_over_plants {
                " The figures below are of " (integer(noise.repeats)) " further " @if is_over_plants { "plants" } @else { "drives of each" }
                ", which chose nothing."
            }
            @if has_rank { " Its rank by the mean is over " (integer(noise.holdout.into())) " other noise seeds." }
            @if is_noisy && config.vehicle.gear_engaged && config.vehicle.gear_drive_s > 0.0 {
                " The drive gear was engaged from the start; therefore even the noise-free figures differ from those of a "
                "validation."
            }
        }
        @if let Some(against) = &noise.against_paper { (comparison("the paper’s set", against, config)) }
        (comparison("the set that the tuner recommends by single drives", &noise.against_recommended, config))
        @if let Some(figure) = figure {
            div.figures { (figure) }
            (table(
                html! { tr {
                    th { "finalist" } (parameter_heads(law))
                    th.number { "mean " (title) } th.number { "from" } th.number { "to" } th.number { "visits" }
                } },
                html! {
                    @for (index, finalist) in finalists.iter().enumerate() {
                        tr {
                            td { (index + 1) }
                            (parameter_cells(law, &finalist.gains))
                            td.number { (number(finalist.mean_value, 4)) }
                            td.number { (number(finalist.low, 4)) }
                            td.number { (number(finalist.high, 4)) }
                            td.number { (integer(finalist.visits.into())) }
                        }
                    }
                },
            ))
        }
    })
}

/// What a paired difference says about the tuned set.
fn comparison(other: &str, against: &Comparison, config: &RunConfig) -> Markup {
    let (verdict, why) = match against.verdict {
        Verdict::Better => ("better", "."),
        Verdict::Worse => ("worse", "."),
        Verdict::Undecided => {
            ("undecided", ". The interval contains 0: neither is shown to be better.")
        }
    };
    html! {
        p {
            "Tuned less " (other) " (" (parameters_text(&config.law, &against.gains)) "), mean "
            (config.objective.name) ": " (number(against.difference, 4))
            " (from " (number(against.low, 4)) " to " (number(against.high, 4)) "): "
            b { (verdict) } (why)
        }
    }
}
