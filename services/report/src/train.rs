//! What a training has come to: its table with the honest notes, how it learnt, and what noise makes of it.

use std::collections::BTreeMap;

use config::{Gains, RunConfig, Tuner};
use maud::{Markup, html};

use crate::ReportError;
use crate::axis::{Axis, gain, integer, number, optional};
use crate::canvas::{HALF, Stroke};
use crate::chart::{Chart, Line};
use crate::page::{GAIN_UNITS, Page, gain_cells, gain_heads, gains_text, table};
use crate::panels::{Interval, Panel, Shown, intervals, panels};
use crate::result::{Finalist, Learner, NoiseOutcome, SetStanding, Train};

/// Markers stand at every episode up to this many; beyond it they would hide the line.
const MOST_MARKERS: usize = 60;

/// Adds the sections of a training to the page.
pub(crate) fn sections(
    page: &mut Page,
    train: &Train,
    config: &RunConfig,
) -> Result<(), ReportError> {
    page.section("Result", result(train, config));
    if train.learners.iter().any(|learner| !learner.episodes.is_empty()) {
        let body = learning(page, &train.learners)?;
        page.section("Learning", body);
    }
    let usage = usage(&train.learners);
    if !usage.is_empty() {
        let words = "Bars: how often each value of each gain was driven, over all learners.";
        let picture = panels("gain-usage", words, "drives [count]", &usage, Shown::Bars)?;
        let figure = page.figure(
            picture,
            "How often each value of each gain was driven, all learners together.",
        );
        page.section("Gain usage", html! { div.figures { (figure) } });
    }
    if let Some(noise) = &train.noise {
        let body = under_noise(page, noise)?;
        page.section("Finalists under noise", body);
    }
    Ok(())
}

fn result(train: &Train, config: &RunConfig) -> Markup {
    let tuner = match config.learning.tuner {
        Tuner::EducatedQ => "tuned (educated Q)",
        Tuner::Q => "tuned (Q)",
    };
    let standing = train.grid.as_ref();
    let tuned = SetStanding {
        gains: train.gains,
        distance: train.distance,
        mse_m2: train.mse_m2,
        rank_distance: standing.and_then(|grid| grid.rank_distance),
        rank_mse: standing.and_then(|grid| grid.rank_mse),
    };
    let size = standing.map(|grid| grid.size);
    let rank = |rank: Option<u64>| match (rank, size) {
        (Some(rank), Some(size)) => format!("{} / {}", integer(rank), integer(size)),
        (Some(rank), None) => integer(rank),
        (None, _) => "–".to_owned(),
    };
    let row = |name: &str, set: &SetStanding, on_bound: &[String]| {
        let cells = Gains::NAMES.iter().zip(set.gains.to_array()).map(|(name, value)| {
            let is_on_bound = on_bound.iter().any(|bound| bound == name);
            html! {
                td.number { @if is_on_bound { span.bound { (gain(value)) } span.mark { "†" } } @else { (gain(value)) } }
            }
        });
        html! {
            tr {
                td { (name) }
                @for cell in cells { (cell) }
                td.number { (number(set.distance, 4)) }
                td.number { (rank(set.rank_distance)) }
                td.number { (number(set.mse_m2, 4)) }
                td.number { (rank(set.rank_mse)) }
            }
        }
    };
    html! {
        (table(
            html! { tr {
                th {} (gain_heads())
                th.number { "distance" } th.number { "rank" } th.number { "mse [m²]" } th.number { "rank" }
            } },
            html! {
                (row(tuner, &tuned, &train.on_bound))
                @if let Some(plain) = &train.plain_q { (row("plain Q beside it", &plain.set, &[])) }
                @if let Some(paper) = &train.paper { (row("the paper’s set", paper, &[])) }
            },
        ))
        (notes(train))
    }
}

/// What the figures do and do not say.
fn notes(train: &Train) -> Markup {
    html! {
        ul {
            @if let Some(grid) = &train.grid {
                li {
                    "Ranks are among all " (integer(grid.size)) " sets of the grid, noise-free"
                    @if let (Some(distance), Some(mse)) = (grid.best_distance, grid.best_mse_m2) {
                        "; its best: distance " (number(distance, 4)) ", mse " (number(mse, 4)) " m²"
                    }
                    "."
                }
                @if let Some(rank) = grid.rank_mean_distance {
                    li { "By its mean distance under noise the tuned set has rank " (integer(rank)) " of " (integer(grid.size)) "." }
                }
            }
            @if !train.on_bound.is_empty() {
                li { "† On a bound of the grid: " (train.on_bound.iter().map(|name| name.replacen('k', "K", 1)).collect::<Vec<_>>().join(", ")) "; better gains may lie beyond it." }
            }
            li {
                "The distance is what the learner minimises. It hardly sees Kv, because the error along the track is not in it; "
                "the mse is the paper’s figure of merit, which does. A set can be best by one and mediocre by the other."
            }
            @if let Some(drives) = &train.drives {
                li {
                    (integer(drives.asked)) " drives asked for"
                    @if let Some(asked) = train.plain_q.as_ref().and_then(|plain| plain.asked) {
                        " (" (integer(asked)) " by plain Q)"
                    }
                    ", " (integer(drives.driven)) " driven, " (integer(drives.reissued)) " again behind a crash"
                    @if let Some(grid) = &train.grid { "; the grid holds " (integer(grid.size)) }
                    "."
                }
            }
            @if let Some(recovery) = train.recovery.as_ref().filter(|recovery| recovery.recoveries > 0) {
                li { (integer(recovery.injected)) " faults injected, " (integer(recovery.recoveries)) " recoveries." }
            }
            @if let (Some(vehicle), Some(wall), Some(factor)) = (train.vehicle_s, train.wall_s, train.real_time_factor) {
                li { (number(vehicle, 0)) " s of driving in " (number(wall, 1)) " s: " (number(factor, 0)) " × real time." }
            }
        }
    }
}

fn learning(page: &mut Page, learners: &[Learner]) -> Result<Markup, ReportError> {
    let longest = learners.iter().map(|learner| learner.episodes.len()).max().unwrap_or(0);
    let lines = |height: &dyn Fn(&crate::result::Episode) -> Option<f64>| -> Vec<Line> {
        learners
            .iter()
            .enumerate()
            .map(|(index, learner)| {
                let mut look = Stroke::of_many(index);
                if longest > MOST_MARKERS {
                    look.marker = None;
                }
                let points = learner
                    .episodes
                    .iter()
                    .enumerate()
                    .filter_map(|(episode, of)| Some(((episode + 1) as f64, height(of)?)));
                Line::new(format!("α = {}", gain(learner.alpha)), points, look)
            })
            .collect()
    };
    let chart = |name, words, y_name, lines: &[Line]| {
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
    let returns = chart(
        "learning-rewards",
        "Sum of rewards of each episode, one line a learner.",
        "sum of rewards [no unit]",
        &lines(&|episode| Some(episode.return_)),
    )?;
    let returns = page.figure(returns, "Sum of rewards per episode, one line a learner.");
    let ends = lines(&|episode| episode.distances.last().copied());
    let distances = if ends.iter().any(|line| !line.points.is_empty()) {
        let picture = chart(
            "learning-distances",
            "Distance at the end of each episode, one line a learner.",
            "distance at the end [m]",
            &ends,
        )?;
        Some(page.figure(
            picture,
            "Distance to the goal at the end of each episode, one line a learner.",
        ))
    } else {
        None
    };
    Ok(html! {
        div.figures { (returns) }
        p {
            "The sum of an episode’s rewards telescopes to 1/(1 + d" sub { "end" } ") − 1/(1 + d" sub { "start" }
            "), less penalties: it tells its two ends and nothing between them, so that a flat curve proves nothing."
        }
        @if let Some(distances) = distances { div.figures { (distances) } }
        (learner_table(learners))
    })
}

fn learner_table(learners: &[Learner]) -> Markup {
    table(
        html! { tr {
            th.number { "α" } (gain_heads()) th { "locked" }
            th.number { "episodes" } th.number { "ended by a terminal state" } th.number { "steps" }
        } },
        html! {
            @for learner in learners {
                tr {
                    td.number { (gain(learner.alpha)) }
                    (gain_cells(&learner.gains))
                    td {
                        @if learner.locked.is_empty() { "–" }
                        @for (index, (name, value)) in learner.locked.iter().enumerate() {
                            @if index > 0 { ", " }
                            (name) " " (gain(*value))
                        }
                    }
                    td.number { (learner.episodes.len()) }
                    td.number { (learner.episodes.iter().filter(|episode| episode.terminated).count()) }
                    td.number { (integer(learner.episodes.iter().map(|episode| episode.steps).sum())) }
                }
            }
        },
    )
}

/// Counts of each value of each gain, over all learners.
fn usage(learners: &[Learner]) -> Vec<Panel> {
    let mut panels = Vec::new();
    for (name, title) in Gains::NAMES.iter().zip(GAIN_UNITS) {
        // Values come from one grid: the same value has the same bits in every learner.
        let mut counts: BTreeMap<u64, (f64, f64)> = BTreeMap::new();
        let uses = learners.iter().filter_map(|learner| learner.usage.as_ref()?.get(*name));
        for used in uses.flatten() {
            counts.entry(used.value.to_bits()).or_insert((used.value, 0.0)).1 += used.count;
        }
        let mut points: Vec<_> = counts.into_values().collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        if !points.is_empty() {
            panels.push(Panel { name: title.to_owned(), points });
        }
    }
    panels
}

fn under_noise(page: &mut Page, noise: &NoiseOutcome) -> Result<Markup, ReportError> {
    let figure = if noise.finalists.is_empty() {
        None
    } else {
        let rows: Vec<Interval> = noise
            .finalists
            .iter()
            .map(|Finalist { gains, mean_distance, low, high, .. }| Interval {
                label: gains_text(gains),
                mean: *mean_distance,
                low: *low,
                high: *high,
            })
            .collect();
        let words = "Mean distance of each finalist under noise, with its interval.";
        let picture = intervals("finalists", words, "mean distance [m]", &rows)?;
        Some(page.figure(picture, "The finalists under noise: mean distance with its interval."))
    };
    Ok(html! {
        @if noise.repeats.is_some() || noise.holdout.is_some() {
            p {
                "Each finalist was driven again under noise"
                @if let Some(repeats) = noise.repeats { ", " (integer(repeats)) " times" }
                ", each time with the same noise for all of them, and the best mean was chosen."
                @if let Some(holdout) = noise.holdout {
                    " Its rank by the mean distance is over " (integer(holdout)) " other noise seeds."
                }
                " The drive gear was engaged from the start, unless the configuration says otherwise; so even the "
                "noise-free figures are not those of a validation."
            }
        }
        @if let Some(against) = &noise.against_paper {
            p {
                "Tuned less the paper’s set, mean distance: " (number(against.difference, 4))
                " (from " (number(against.low, 4)) " to " (number(against.high, 4)) "): "
                b { (against.verdict) } "."
                @if against.verdict == "undecided" { " The interval holds 0: neither is shown to be better." }
            }
        }
        @if let Some(figure) = figure {
            div.figures { (figure) }
            (table(
                html! { tr {
                    (gain_heads()) th.number { "mean distance" } th.number { "from" } th.number { "to" } th.number { "visits" }
                } },
                html! {
                    @for finalist in &noise.finalists {
                        tr {
                            (gain_cells(&finalist.gains))
                            td.number { (number(finalist.mean_distance, 4)) }
                            td.number { (number(finalist.low, 4)) }
                            td.number { (number(finalist.high, 4)) }
                            td.number { (optional(finalist.visits.map(|visits| visits as f64), 0)) }
                        }
                    }
                },
            ))
        }
    })
}
