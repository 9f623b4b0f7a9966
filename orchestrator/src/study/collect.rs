//! `pathtune sweep collect`: one table of all jobs, and a summary by groups.
//!
//! The table's bytes depend on the study, and on what configurations and seeds decide: not on machines, engines, order or
//! crashes. A job without a record has a line, too, with empty figures. No figure stands for a group that lacks a job.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;

use comfy_table::Table;
use comfy_table::presets::NOTHING;
use outcome::Course;

use crate::cli::StudyArg;
use crate::study::StudyTools;
use crate::study::axes::in_order;
use crate::study::compared::{self, Comparisons};
use crate::study::manifest::{Job, Manifest};
use crate::study::record::Figures;
use crate::study::status::{Damages, jobs_have, ranges};
use crate::study::store::{Standing, Store};
use crate::words::Failure;
use crate::words::tables::digits;
use crate::words::terminal::{say, tell};

/// How many groups are printed; the table holds all of them.
const MOST_GROUPS: usize = 60;

/// Columns with what a record holds.
const FIGURES: [&str; 33] = [
    "resolved_vehicle",
    "resolved_law",
    "resolved_objective",
    "resolved_tuner",
    "run_seed",
    "value",
    "distance",
    "mse_m2",
    "path_mean_m",
    "path_p95_m",
    "path_max_m",
    "arrived",
    "grid_size",
    "rank_value",
    "rank_mean",
    "best_value",
    "paper_value",
    "plain_q_value",
    "random_walk_value",
    "asked",
    "distinct",
    "compared_drives",
    "to_within_2_percent",
    "to_top_1_percent",
    "regret",
    "noisy_mean_mse_m2",
    "noisy_worst_mse_m2",
    "noisy_path_mean_m",
    "noisy_path_max_m",
    "noisy_collisions",
    "resolved_gains",
    "on_bound",
    "digest",
];

/// The figures in the order of the columns.
fn cells(it: &Figures) -> [String; FIGURES.len()] {
    fn or_empty(value: Option<impl ToString>) -> String {
        value.map_or_else(String::new, |value| value.to_string())
    }
    let course = it.course.as_ref();
    [
        it.vehicle.clone(),
        it.law.clone(),
        it.objective.clone(),
        it.tuner.clone(),
        it.seed.to_string(),
        it.value.to_string(),
        it.distance.to_string(),
        it.mse_m2.to_string(),
        it.path_mean_m.to_string(),
        it.path_p95_m.to_string(),
        it.path_max_m.to_string(),
        it.arrived.to_string(),
        or_empty(it.grid_size),
        or_empty(it.rank_value),
        or_empty(it.rank_mean),
        or_empty(it.best_value),
        or_empty(it.paper_value),
        or_empty(it.plain_q_value),
        or_empty(it.random_walk_value),
        it.asked.to_string(),
        it.distinct.to_string(),
        or_empty(course.map(|it| it.drives)),
        or_empty(course.and_then(|it| it.drives_to(Course::within_2_percent_value(it.best_value)))),
        or_empty(course.and_then(|it| it.drives_to(it.top_1_percent_value))),
        or_empty(course.and_then(|it| {
            it.recommended.last().map(|value| Course::regret(*value, it.best_value))
        })),
        or_empty(it.noisy.map(|it| it.mse_m2_mean)),
        or_empty(it.noisy.map(|it| it.mse_m2_worst)),
        or_empty(it.noisy.map(|it| it.path_mean_m)),
        or_empty(it.noisy.map(|it| it.path_max_m)),
        or_empty(it.noisy.map(|it| it.collisions)),
        it.gains.clone(),
        it.on_bound.join(" "),
        it.digest.clone(),
    ]
}

/// Writes the table, and prints the summary.
///
/// # Errors
/// If a line or record is damaged, or a job is missing; the table is written all the same.
pub(crate) fn collect(
    at: &StudyArg,
    out: Option<&Path>,
    parquet: bool,
    tools: StudyTools,
) -> Result<(), Failure> {
    if parquet && cfg!(not(feature = "parquet")) {
        let why = "--parquet: this build writes no Parquet; build pathtune with --features parquet";
        return Err(Failure::User(why.to_owned()));
    }
    let manifest = Manifest::open(&at.manifest)?;
    let store = Store::of(at);
    let out = out.map_or_else(|| at.manifest.with_extension("csv"), Path::to_owned);
    if out == at.manifest {
        let why = "is the manifest itself; name another file";
        return Err(Failure::User(format!("--out {}: {why}", out.display())));
    }
    let mut names = BTreeMap::new();
    for job in manifest.lines()?.flatten() {
        for name in job.axes.into_keys() {
            names.entry(name).or_insert(());
        }
    }
    let axes = in_order(names.keys().map(String::as_str));

    let fail = |error: &dyn std::fmt::Display| {
        Failure::User(format!("{}: cannot be written: {error}", out.display()))
    };
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    let part = out.with_file_name(format!(".{name}.part"));
    let _ = fs::remove_file(&part);
    let file = File::create_new(&part).map_err(|error| fail(&error))?;
    let mut table = csv::Writer::from_writer(BufWriter::new(file));
    let header = ["index", "job", "state"].iter().chain(&axes).chain(&FIGURES);
    table.write_record(header).map_err(|error| fail(&error))?;
    let (mut damages, mut groups) = (Damages::default(), Groups::default());
    let mut comparisons = Comparisons::default();
    let mut lacking = Vec::new();
    let mut lines = manifest.lines()?;
    for line in lines.by_ref() {
        let job = match line {
            Ok(job) => job,
            Err(line) => {
                damages.tell(&line.message);
                continue;
            }
        };
        let (state, figures) = match store.standing(&job.job) {
            Standing::Done(record) => ("done", Some(record.figures)),
            // Whether a trial has failed by now is not the study's.
            Standing::Missing | Standing::Failed(_) => ("missing", None),
            Standing::Damaged(why) => {
                damages.tell(&format!("job {}: {why}; run it again", job.index));
                ("missing", None)
            }
        };
        if figures.is_none() {
            lacking.push(job.index);
        }
        groups.add(&axes, &job, figures.as_ref());
        comparisons.add(&axes, &job, figures.as_ref());
        let (index, values) = (job.index.to_string(), axes.iter().map(|name| job.axes.get(*name)));
        let values = values.map(|value| value.map_or("", String::as_str));
        let cells = figures.as_ref().map_or_else(|| std::array::from_fn(|_| String::new()), cells);
        let row = [&*index, &*job.job, state].into_iter().chain(values);
        table
            .write_record(row.chain(cells.iter().map(String::as_str)))
            .map_err(|error| fail(&error))?;
    }
    lacking.extend(lines.lost());
    lacking.sort_unstable();
    let file = table.into_inner().map_err(|error| fail(&error.into_error()))?;
    file.into_inner().map_err(|error| fail(&error.into_error()))?;
    fs::rename(&part, &out).map_err(|error| fail(&error))?;

    groups.print(&axes)?;
    let compared = comparisons.joined(tools.joined);
    compared::print(&compared)?;
    say!("{}", out.display());
    #[cfg(feature = "parquet")]
    if parquet {
        say!("{}", crate::study::parquet::write(&out)?.display());
    }
    match (tools.draw)(&out, &compared) {
        Ok(page) => say!("{}", page.display()),
        // The table is valid even if its pictures cannot be drawn.
        Err(why) => tell!("pathtune: no page: {why}"),
    }
    if !lacking.is_empty() {
        tell!("pathtune: jobs without a result: {}", ranges(&lacking));
    }
    damages.end()?;
    match lacking.len() {
        0 => Ok(()),
        count => Err(Failure::TryAgain(format!("{} no result yet", jobs_have(count)))),
    }
}

/// Jobs that differ in nothing but the seed.
#[derive(Debug, Default)]
struct Groups {
    /// In the order of their first jobs.
    groups: Vec<Group>,
    /// Places in it, by the values of the axes.
    places: BTreeMap<Vec<String>, usize>,
}

#[derive(Debug, Default)]
struct Group {
    axes: Vec<String>,
    jobs: usize,
    /// The objective's name, as far as it is known.
    objective: Option<String>,
    values: Vec<f64>,
    /// How many chose the best set of the grid, and how many know.
    best: usize,
    ranked: usize,
}

impl Groups {
    fn add(&mut self, axes: &[&str], job: &Job, figures: Option<&Figures>) {
        let of = |name: &&str| job.axes.get(*name).cloned().unwrap_or_default();
        let key: Vec<String> = axes.iter().filter(|name| **name != "seed").map(of).collect();
        let place = *self.places.entry(key.clone()).or_insert(self.groups.len());
        if place == self.groups.len() {
            self.groups.push(Group { axes: key, ..Group::default() });
        }
        let group = &mut self.groups[place];
        group.jobs += 1;
        if let Some(figures) = figures {
            group.objective.get_or_insert_with(|| figures.objective.clone());
            group.values.push(figures.value);
            group.ranked += usize::from(figures.rank_value.is_some());
            group.best += usize::from(figures.rank_value == Some(1));
        }
    }

    fn print(&mut self, axes: &[&str]) -> Result<(), Failure> {
        let named: Vec<&str> = axes.iter().filter(|name| **name != "seed").copied().collect();
        let mut table = Table::new();
        let header = named.iter().copied().chain(HEADER).map(str::to_owned);
        table.load_style(NOTHING).set_header(header);
        for group in self.groups.iter_mut().take(MOST_GROUPS) {
            table.add_row(group.axes.clone().into_iter().chain(group.summary()));
        }
        say!("{}", table.trim_fmt());
        if self.groups.len() > MOST_GROUPS {
            say!("… and {} more groups", self.groups.len() - MOST_GROUPS);
        }
        Ok(())
    }
}

/// What is said of each group.
const HEADER: [&str; 7] =
    ["jobs", "objective", "mean", "median", "least", "largest", "best of grid"];

impl Group {
    fn summary(&mut self) -> [String; HEADER.len()] {
        let objective = self.objective.clone().unwrap_or_default();
        let done = self.values.len();
        if done < self.jobs {
            let none = || "–".to_owned();
            let jobs = format!("{done} of {}", self.jobs);
            return [jobs, objective, none(), none(), none(), none(), none()];
        }
        self.values.sort_by(f64::total_cmp);
        let mean = self.values.iter().sum::<f64>() / done as f64;
        let median = 0.5 * (self.values[(done - 1) / 2] + self.values[done / 2]);
        let best = match self.ranked == done {
            true => format!("{} of {done}", self.best),
            false => "–".to_owned(),
        };
        let shown = |value: f64| digits(value, 4);
        let (least, largest) = (self.values[0], self.values[done - 1]);
        [
            done.to_string(),
            objective,
            shown(mean),
            shown(median),
            shown(least),
            shown(largest),
            best,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::manifest;
    use crate::study::record::tests::record;

    fn tools(
        draw: fn(&Path, &[outcome::StudyComparison]) -> Result<std::path::PathBuf, String>,
    ) -> StudyTools {
        StudyTools {
            draw,
            course: |_, _| Err("no study of these tests compares".to_owned()),
            joined: |_, _| unreachable!("no study of these tests compares"),
        }
    }

    #[test]
    fn missing_jobs_have_empty_figures_and_their_group_no_mean() {
        let tools = tools(|table, _| Ok(table.with_extension("html")));
        let folder = tempfile::tempdir().unwrap();
        let at = StudyArg { manifest: folder.path().join("s.jsonl"), results: None };
        let store = Store::of(&at).make().unwrap();
        let job = |index: u64| Job {
            index,
            job: format!("{index:032x}"),
            axes: [
                ("law", if index < 2 { "a" } else { "b" }.to_owned()),
                ("seed", index.to_string()),
            ]
            .map(|(name, value)| (name.to_owned(), value))
            .into(),
            command: vec!["train".to_owned()],
        };
        manifest::write(&at.manifest, |take| (0..4).try_for_each(|index| take(&job(index))))
            .unwrap();
        for index in [0, 1, 3] {
            store.keep(&record(&job(index).job, index, 0.5 + index as f64), b"").unwrap();
        }
        let why = collect(&at, None, false, tools).unwrap_err();
        assert_eq!(why.code(), 75);
        let text = fs::read_to_string(folder.path().join("s.csv")).unwrap();
        let rows: Vec<Vec<String>> = csv::Reader::from_reader(text.as_bytes())
            .records()
            .map(|row| row.unwrap().iter().map(str::to_owned).collect())
            .collect();
        assert!(text.starts_with("index,job,state,law,seed,resolved_vehicle,"), "{text}");
        assert_eq!(rows.len(), 4);
        assert_eq!(rows[2][2..5], ["missing", "b", "2"]);
        assert!(rows[2][5..].iter().all(String::is_empty));
        assert_eq!((rows[3][2].as_str(), rows[3][5].as_str()), ("done", "tesla, long"));
        assert_eq!(rows[3][10], "3.5");

        let mut groups = Groups::default();
        for index in 0..4 {
            let record = record(&job(index).job, index, 0.5 + index as f64);
            groups.add(&["law", "seed"], &job(index), (index != 2).then_some(&record.figures));
        }
        let said: Vec<String> =
            groups.groups.iter_mut().map(|group| group.summary().join(" ")).collect();
        let whole = "2 distance 1.0000 1.0000 0.5000 1.5000 2 of 2";
        assert_eq!(said, [whole, "1 of 2 distance – – – – –"]);

        store.keep(&record(&job(2).job, 2, 2.5), b"").unwrap();
        collect(&at, None, false, tools).unwrap();
        let whole = fs::read_to_string(folder.path().join("s.csv")).unwrap();
        // A damaged record is named, and its job has no figures.
        let path = store.folder.join("00").join(format!("{}.json", job(2).job));
        fs::write(&path, "{").unwrap();
        assert_eq!(collect(&at, None, false, tools).unwrap_err().code(), 64);
        assert_eq!(fs::read_to_string(folder.path().join("s.csv")).unwrap(), text);
        assert_ne!(whole, text);
    }

    /// `PATHTUNE_JOBS=100000 cargo test --release -p orchestrator --lib collect -- --nocapture` tells time and memory.
    #[test]
    fn a_large_study_is_collected_job_by_job() {
        let jobs = std::env::var("PATHTUNE_JOBS").map_or(300, |count| count.parse().unwrap());
        let tools = tools(|_, _| Err("not here".to_owned()));
        let folder = tempfile::tempdir().unwrap();
        let at = StudyArg { manifest: folder.path().join("s.jsonl"), results: None };
        let store = Store::of(&at).make().unwrap();
        // Spread as hashes are.
        let job = |index: u64| Job {
            index,
            job: format!("{:016x}{index:016x}", index.wrapping_mul(0x9e37_79b9_7f4a_7c15)),
            axes: [("seed".to_owned(), index.to_string())].into(),
            command: vec!["train".to_owned(), "--seed".to_owned(), index.to_string()],
        };
        let started = std::time::Instant::now();
        manifest::write(&at.manifest, |take| (0..jobs).try_for_each(|index| take(&job(index))))
            .unwrap();
        let planned = started.elapsed();
        for index in 0..jobs {
            store.keep(&record(&job(index).job, index, 1.0 / (1 + index) as f64), b"{}").unwrap();
        }
        let kept = started.elapsed() - planned;
        collect(&at, None, false, tools).unwrap();
        let collected = started.elapsed() - planned - kept;
        let status = fs::read_to_string("/proc/self/status").unwrap();
        let peak = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or_default();
        println!(
            "{jobs} jobs: manifest {planned:.1?}, records {kept:.1?}, collect {collected:.1?}; {peak}"
        );
        let text = fs::read_to_string(folder.path().join("s.csv")).unwrap();
        assert_eq!(text.lines().count() as u64, 1 + jobs);
        assert!(text.lines().skip(1).all(|line| line.split(',').nth(2) == Some("done")));
    }
}
