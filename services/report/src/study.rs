//! The page of a study: the table that `pathtune sweep collect` writes, by groups of jobs that differ in nothing but the
//! seed.
//!
//! Jobs without a result are counted and named; their group has neither a mean nor a place in a comparison.

use std::collections::BTreeMap;
use std::path::Path;

use config::{BoundedLines, open_regular};
use maud::{Markup, html};
use outcome::StudyComparison;

use crate::ReportError;
use crate::axis::{Axis, integer, number};
use crate::canvas::{Marker, Picture, Stroke, WIDE};
use crate::chart::{Chart, Line};
use crate::compared;
use crate::page::{Page, table};

/// The most groups in one picture: a legend of more is as tall as the picture.
const MOST_GROUPS: usize = 12;

/// Jobs that differ in nothing but the seed.
#[derive(Debug, Default, PartialEq)]
struct Group {
    /// The values of the axes.
    axes: Vec<String>,
    objective: String,
    /// The objective's value of each job that is done, in the order of the jobs.
    values: Vec<f64>,
    /// Indices of jobs without a result.
    missing: Vec<String>,
    /// Jobs whose rank in the grid is known, and those that chose its best set.
    ranked: usize,
    best: usize,
}

/// What a study's table holds.
#[derive(Debug, Default)]
struct Study {
    /// Names of the axes but the seed.
    axes: Vec<String>,
    /// In the order of their first jobs.
    groups: Vec<Group>,
}

/// The page of the study whose table this is, and its pictures.
pub(crate) fn page_of(
    path: &Path,
    comparisons: &[StudyComparison],
) -> Result<(String, Vec<Picture>), ReportError> {
    let study = read(path)?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let (mut done, mut missing) = (0, Vec::new());
    for group in &study.groups {
        done += group.values.len();
        missing.extend(group.missing.iter().map(String::as_str));
    }
    let facts = html! {
        dl.facts {
            dt { "Jobs" } dd { (integer((done + missing.len()) as u64)) }
            dt { "Without a result" } dd {
                @if missing.is_empty() { "none" }
                @else {
                    (missing.len()) ": " (missing.iter().take(200).copied().collect::<Vec<_>>().join(", "))
                    @if missing.len() > 200 { ", …" }
                }
            }
        }
    };
    let mut page = Page::titled(&format!("{name}: study"), facts);
    page.section("Groups", groups_table(&study));
    let mut objectives: Vec<&str> = Vec::new();
    for group in study.groups.iter().filter(|group| !group.values.is_empty()) {
        if !objectives.contains(&group.objective.as_str()) {
            objectives.push(&group.objective);
        }
    }
    let mut figures = Vec::new();
    for objective in objectives {
        let numbered: Vec<(usize, &Group)> = (1..)
            .zip(&study.groups)
            .filter(|(_, group)| group.objective == objective && !group.values.is_empty())
            .collect();
        for part in numbered.chunks(MOST_GROUPS) {
            let picture = dots(objective, part)?;
            let caption = format!(
                "The {objective} of each job, in its group, from the least to the largest value; the smaller the \
                 better."
            );
            figures.push(page.figure(picture, &caption));
        }
    }
    page.section("Values", html! { div.figures { @for figure in figures { (figure) } } });
    compared::sections(&mut page, comparisons)?;
    Ok(page.finish_without_config())
}

fn groups_table(study: &Study) -> Markup {
    let head = html! {
        tr {
            th.number { "group" }
            @for name in &study.axes { th { (name) } }
            th.number { "jobs" } th { "objective" } th.number { "mean" } th.number { "median" }
            th.number { "least" } th.number { "largest" } th.number { "best of grid" }
        }
    };
    let body = html! {
        @for (index, group) in study.groups.iter().enumerate() {
            tr {
                td.number { (index + 1) }
                @for value in &group.axes { td { (value) } }
                @let (done, all) = (group.values.len(), group.values.len() + group.missing.len());
                td.number { @if done == all { (all) } @else { (done) " of " (all) } }
                td { (group.objective) }
                @for cell in group.summary() { td.number { (cell) } }
            }
        }
    };
    html! {
        (table(head, body))
        p.small {
            "A group that lacks a job has no figures. “Best of grid” counts the jobs that chose the best set of all; a \
             dash means that the grid was not driven."
        }
    }
}

impl Group {
    /// Mean, median, least and largest value, and how many chose the best set of the grid.
    fn summary(&self) -> [String; 5] {
        let count = self.values.len();
        if !self.missing.is_empty() || count == 0 {
            return std::array::from_fn(|_| "–".to_owned());
        }
        let sorted = self.sorted();
        let mean = self.values.iter().sum::<f64>() / count as f64;
        let median = 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]);
        let best = match self.ranked == count {
            true => format!("{} of {count}", self.best),
            false => "–".to_owned(),
        };
        let shown = |value: f64| number(value, 4);
        [shown(mean), shown(median), shown(sorted[0]), shown(sorted[count - 1]), best]
    }

    fn sorted(&self) -> Vec<f64> {
        let mut sorted = self.values.clone();
        sorted.sort_by(f64::total_cmp);
        sorted
    }
}

/// A column of dots for each group.
fn dots(objective: &str, groups: &[(usize, &Group)]) -> Result<Picture, ReportError> {
    let lines: Vec<Line> = groups
        .iter()
        .enumerate()
        .map(|(place, (number, group))| {
            let sorted = group.sorted();
            // Side by side within the column, so that equal values do not hide each other.
            let width = 0.7 / sorted.len() as f64;
            let first = (place + 1) as f64 - 0.35 + 0.5 * width;
            let points =
                sorted.iter().enumerate().map(|(at, value)| (first + at as f64 * width, *value));
            let label = format!("{number}: {}", group.axes.join(", "));
            let colour = Stroke::of_many(place).colour;
            let look =
                Stroke { marker: Some(Marker::Disc), hidden: true, ..Stroke::solid(colour, 1.0) };
            Line::new(label, points, look)
        })
        .collect();
    let mut x = Axis::of_counts(groups.len());
    x.ticks = groups
        .iter()
        .enumerate()
        .map(|(place, (number, _))| ((place + 1) as f64, number.to_string()))
        .collect();
    let words = format!("The {objective} of each job, by groups");
    Chart {
        name: &format!("study-{objective}"),
        words: &words,
        width: WIDE,
        height: 320.0,
        x,
        x_name: "group",
        y_name: objective,
        lines: &lines,
        legend_rows: 0,
        borders: &[],
    }
    .draw()
}

fn read(path: &Path) -> Result<Study, ReportError> {
    let wrong = |line: Option<u64>, problem: String| ReportError::malformed(path, line, problem);
    let file = open_regular(path)
        .map_err(|problem| ReportError::Read { path: path.to_owned(), problem })?;
    let mut reader = csv::Reader::from_reader(BoundedLines::new(file));
    let header = reader.headers().map_err(|error| wrong(Some(1), error.to_string()))?.clone();
    let place = |name: &str| {
        let place = header.iter().position(|column| column == name);
        place.ok_or_else(|| wrong(Some(1), format!("there is no column {name}")))
    };
    let (index, state, value) = (place("index")?, place("state")?, place("value")?);
    let (objective, rank) = (place("resolved_objective")?, place("rank_value")?);
    // The axes stand between these two.
    let axes: Vec<usize> =
        (state + 1..place("resolved_vehicle")?).filter(|at| &header[*at] != "seed").collect();
    let mut study =
        Study { axes: axes.iter().map(|at| header[*at].to_owned()).collect(), groups: Vec::new() };
    let mut places: BTreeMap<Vec<String>, usize> = BTreeMap::new();
    for row in reader.records() {
        let row = row
            .map_err(|error| wrong(error.position().map(csv::Position::line), error.to_string()))?;
        let line = row.position().map(csv::Position::line);
        let key: Vec<String> = axes.iter().map(|at| row[*at].to_owned()).collect();
        let groups = &mut study.groups;
        let place = *places.entry(key.clone()).or_insert(groups.len());
        if place == groups.len() {
            groups.push(Group { axes: key, ..Group::default() });
        }
        let group = &mut groups[place];
        if &row[state] != "done" {
            group.missing.push(row[index].to_owned());
            continue;
        }
        let read: Option<f64> = row[value].parse().ok().filter(|value: &f64| value.is_finite());
        let read =
            read.ok_or_else(|| wrong(line, format!("value: {:?} is no number", &row[value])))?;
        group.values.push(read);
        row[objective].clone_into(&mut group.objective);
        group.ranked += usize::from(!row[rank].is_empty());
        group.best += usize::from(&row[rank] == "1");
    }
    Ok(study)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn groups_are_told_apart_and_one_that_lacks_a_job_has_no_mean() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("laws.csv");
        let text = "index,job,state,law,seed,resolved_vehicle,resolved_objective,value,rank_value\n\
                    0,a,done,paper,1,car,distance,0.5,1\n\
                    1,b,done,paper,2,car,distance,1.5,2\n\
                    2,c,done,<b>,1,car,path,0.25,\n\
                    3,d,missing,<b>,2,,,,\n";
        fs::write(&path, text).unwrap();
        let study = read(&path).unwrap();
        assert_eq!(study.axes, ["law"]);
        assert_eq!(study.groups[0].summary().join(" "), "1.0000 1.0000 0.5000 1.5000 1 of 2");
        assert_eq!(study.groups[1].summary().join(" "), "– – – – –");
        let (html, pictures) = page_of(&path, &[]).unwrap();
        assert_eq!(pictures.len(), 2);
        assert!(html.contains("1: 3"), "{html}");
        assert!(html.contains("&lt;b&gt;") && !html.contains("<b>,"), "{html}");
        for (from, to, part) in [
            ("0.25", "x", "laws.csv:4: value"),
            ("0.25", "inf", "laws.csv:4: value"),
            (",rank_value", ",rank", "laws.csv:1: there is no column rank_value"),
            ("1,b,done,", "1,b,", "laws.csv:3: "),
        ] {
            fs::write(&path, text.replacen(from, to, 1)).unwrap();
            let why = page_of(&path, &[]).unwrap_err().to_string();
            assert!(why.contains(part) && !why.contains('\n'), "{why}");
        }
    }
}
