//! The table of parameter sets that trainings and grids share: a row for each set, with its measures and, if the grid
//! was driven, its ranks.

use config::{NamedParameters, RunConfig};
use maud::{Markup, html};
use outcome::{GridStanding, Measures, RankedSet, SetStanding};

use crate::axis::{integer, number};
use crate::page::{parameter_cells_marked, parameter_heads, table};

/// How hard a drive was on wheels and passengers, and how well it kept up with the reference.
pub(crate) fn effort(it: &Measures) -> String {
    format!(
        "The commanded steering angle moved by {} rad/s on average ({} at the 95th percentile); the lateral acceleration \
         was {} m/s² at the 95th percentile and at most {}, the lateral jerk {} m/s³ and at most {}; {} % of the path had \
         been covered when the reference reached its end.",
        number(it.steering_travel_radps, 3),
        number(it.steering_rate_p95_radps, 3),
        number(it.lateral_acceleration_p95_mps2, 2),
        number(it.lateral_acceleration_max_mps2, 2),
        number(it.lateral_jerk_p95_mps3, 1),
        number(it.lateral_jerk_max_mps3, 1),
        number(100.0 * it.progress_in_time, 1),
    )
}

/// One row of the table.
#[derive(Debug)]
pub(crate) struct Row<'a> {
    pub(crate) name: String,
    pub(crate) gains: &'a NamedParameters,
    pub(crate) measures: &'a Measures,
    pub(crate) ranks: Ranks,
    /// Whether it lies between the sets of the grid: then it is ranked as one more.
    pub(crate) off_grid: bool,
    /// Names of the parameters that lie on a bound of the grid.
    pub(crate) on_bound: &'a [String],
}

/// The ranks of a set among all sets of the grid.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Ranks {
    value: Option<usize>,
    path: Option<usize>,
    distance: Option<usize>,
    mse: Option<usize>,
}

impl From<&GridStanding> for Ranks {
    fn from(of: &GridStanding) -> Self {
        Self {
            value: Some(of.rank_value),
            path: Some(of.rank_path),
            distance: Some(of.rank_distance),
            mse: Some(of.rank_mse),
        }
    }
}

impl From<&RankedSet> for Ranks {
    fn from(of: &RankedSet) -> Self {
        Self {
            value: Some(of.rank_value),
            path: Some(of.rank_path),
            distance: Some(of.rank_distance),
            mse: Some(of.rank_mse),
        }
    }
}

impl From<&SetStanding> for Ranks {
    fn from(of: &SetStanding) -> Self {
        Self {
            value: of.rank_value,
            path: of.rank_path,
            distance: of.rank_distance,
            mse: of.rank_mse,
        }
    }
}

impl<'a> Row<'a> {
    /// A set of the grid.
    pub(crate) fn of_grid(name: impl Into<String>, set: &'a RankedSet) -> Self {
        let RankedSet { gains, measures, on_bound, off_grid, .. } = set;
        let (ranks, off_grid) = (set.into(), *off_grid);
        Self { name: name.into(), gains, measures, ranks, off_grid, on_bound }
    }

    /// A set with which the tuned one is compared.
    pub(crate) fn beside(name: impl Into<String>, set: &'a SetStanding) -> Self {
        let SetStanding { gains, measures, off_grid, .. } = set;
        let (ranks, off_grid) = (set.into(), *off_grid);
        Self { name: name.into(), gains, measures, ranks, off_grid, on_bound: &[] }
    }
}

/// The objective's name with its unit, as axes show it.
pub(crate) fn objective_title(config: &RunConfig) -> String {
    let unit = if config.objective.unit.is_empty() { "no unit" } else { &config.objective.unit };
    format!("{} [{unit}]", config.objective.name)
}

/// Whether the objective is this measure itself, with nothing added for drives that do not arrive; then one column
/// shows both.
pub(crate) fn is_objective(config: &RunConfig, measure: &str) -> bool {
    config.objective.name == measure && !config.objective.is_adjusted()
}

/// The heads of the three columns of the distance from the path, below [`path_group`].
pub(crate) fn path_heads() -> Markup {
    html! { th.number { "mean" } th.number { "95 %" } th.number { "largest" } }
}

/// The title above them.
pub(crate) const PATH_GROUP: &str = "distance from the path [m]";

/// The distance from the path: its mean, its 95th percentile and its largest value.
pub(crate) fn path_cells(of: &Measures) -> Markup {
    html! {
        @for metres in [of.path_mean_m, of.path_p95_m, of.path_max_m] { td.number { (number(metres, 3)) } }
    }
}

/// Whether a drive arrived, as shown in tables.
pub(crate) fn arrived(of: &Measures) -> &'static str {
    if of.arrived { "yes" } else { "no" }
}

/// The table. Without the size of a grid it has no ranks.
pub(crate) fn standings<'a>(
    config: &RunConfig,
    size: Option<usize>,
    rows: impl IntoIterator<Item = Row<'a>>,
) -> Markup {
    let shows_distance = !is_objective(config, "distance");
    let shows_mse = !is_objective(config, "mse");
    let ranked = usize::from(size.is_some());
    let rank_head = html! { @if size.is_some() { th.number { "rank" } } };
    let rank_cell = |row: &Row, rank: Option<usize>| {
        let size = size.map(|size| size + usize::from(row.off_grid));
        html! {
            @if let Some(size) = size {
                td.number {
                    @if let Some(rank) = rank { (integer(rank as u64)) " / " (integer(size as u64)) } @else { "–" }
                }
            }
        }
    };
    table(
        html! {
            tr {
                th {}
                th.group colspan=(config.law.count()) { "parameters" }
                th.group colspan=(1 + ranked) { "objective" }
                th.group colspan=(3 + ranked) { (PATH_GROUP) }
                @if shows_distance { th.group colspan=(1 + ranked) { "the paper’s distance" } }
                @if shows_mse { th.group colspan=(1 + ranked) { "mse" } }
                th {}
            }
            tr {
                th {} (parameter_heads(&config.law))
                th.number { (objective_title(config)) } (rank_head)
                (path_heads()) (rank_head)
                @if shows_distance { th.number { "[m]" } (rank_head) }
                @if shows_mse { th.number { "[m²]" } (rank_head) }
                th { "arrived" }
            }
        },
        html! {
            @for row in rows {
                tr {
                    td { (row.name) }
                    (parameter_cells_marked(&config.law, row.gains, row.on_bound))
                    td.number { (number(row.measures.value, 4)) } (rank_cell(&row, row.ranks.value))
                    (path_cells(row.measures)) (rank_cell(&row, row.ranks.path))
                    @if shows_distance { td.number { (number(row.measures.distance, 4)) } (rank_cell(&row, row.ranks.distance)) }
                    @if shows_mse { td.number { (number(row.measures.mse_m2, 4)) } (rank_cell(&row, row.ranks.mse)) }
                    td { (arrived(row.measures)) }
                }
            }
        },
    )
}
