//! The tables of `compare` for a study whose jobs ask for them: trainings that differ in nothing but tuner and seed, joined
//! from their records alone.
//!
//! A tuner of which a job has no result is left out and named. Tuners stand in one table if they had the same seeds.

use std::collections::BTreeMap;

use outcome::{CompareSubject, Compared, Course, StudyComparison, TunerCourses};

use crate::study::axes::{COMPARE, compared_over};
use crate::study::manifest::Job;
use crate::study::record::Figures;
use crate::words::terminal::say;
use crate::words::{Failure, comparison};

/// How many comparisons are printed; the page holds all of them.
const MOST_PRINTED: usize = 12;
/// Axes in which trainings differ that are compared with each other, besides those of `set` below [`OF_TUNER`].
const APART: [&str; 5] = ["seed", "tuner", "drives", "episodes", "fleet"];
const OF_TUNER: &str = "set.tuner.";
/// Axes that the head of a table names anyway.
const NAMED: [&str; 6] = ["maneuver", "vehicle", "law", "objective", "noise", COMPARE];

/// The comparisons of a study, in the order of their first jobs.
#[derive(Debug, Default)]
pub(crate) struct Comparisons {
    all: Vec<Family>,
    /// Places in it, by what the jobs have in common.
    places: BTreeMap<Vec<String>, usize>,
}

/// Jobs that are compared with each other.
#[derive(Debug)]
struct Family {
    /// What they have in common beyond what their results say.
    of: String,
    subject: Option<CompareSubject>,
    tuners: Vec<Tuner>,
}

/// Jobs of a family that differ in nothing but the seed.
#[derive(Debug)]
struct Tuner {
    /// The axes in which it differs from others of its family.
    apart: Vec<(String, String)>,
    /// As its results call it.
    name: Option<String>,
    jobs: usize,
    courses: Vec<(u64, Course)>,
}

impl Comparisons {
    /// Takes a job, if it is compared; `figures` are those of its record.
    pub(crate) fn add(&mut self, axes: &[&str], job: &Job, figures: Option<&Figures>) {
        if compared_over(&job.axes).is_none() {
            return;
        }
        let of = |name: &&str| job.axes.get(*name).cloned().unwrap_or_default();
        let is_apart = |name: &&&str| APART.contains(*name) || name.starts_with(OF_TUNER);
        let common: Vec<&str> = axes.iter().filter(|it| !is_apart(it)).copied().collect();
        let key: Vec<String> = common.iter().map(of).collect();
        let place = *self.places.entry(key).or_insert(self.all.len());
        if place == self.all.len() {
            let told = common.iter().filter(|name| !NAMED.contains(name) && !of(name).is_empty());
            let told: Vec<String> = told.map(|name| format!("{name} = {}", of(name))).collect();
            self.all.push(Family { of: told.join(", "), subject: None, tuners: Vec::new() });
        }
        let family = &mut self.all[place];
        let apart: Vec<(String, String)> = axes
            .iter()
            .filter(|name| is_apart(name) && **name != "seed" && !of(name).is_empty())
            .map(|name| ((*name).to_owned(), of(name)))
            .collect();
        let place = family.tuners.iter().position(|it| it.apart == apart).unwrap_or_else(|| {
            let new = Tuner { apart, name: None, jobs: 0, courses: Vec::new() };
            family.tuners.push(new);
            family.tuners.len() - 1
        });
        let tuner = &mut family.tuners[place];
        tuner.jobs += 1;
        let Some(figures) = figures else { return };
        let Some(course) = &figures.course else { return };
        tuner.name.get_or_insert_with(|| figures.tuner.clone());
        tuner.courses.push((figures.seed, course.clone()));
        family.subject.get_or_insert_with(|| CompareSubject {
            maneuver: figures.maneuver.clone(),
            vehicle: figures.vehicle.clone(),
            law: figures.law.clone(),
            objective: figures.objective.clone(),
        });
    }

    /// The comparisons, each of tuners with the same seeds.
    pub(crate) fn joined(
        self,
        join: fn(CompareSubject, &[TunerCourses]) -> Compared,
    ) -> Vec<StudyComparison> {
        let mut all = Vec::new();
        for Family { of, subject, tuners } in self.all {
            let names: Vec<String> = tuners.iter().map(|it| it.label(&tuners)).collect();
            let mut lacking = Vec::new();
            let mut by_seeds: Vec<(Vec<u64>, Vec<TunerCourses>)> = Vec::new();
            for (tuner, name) in tuners.into_iter().zip(names) {
                let done = tuner.courses.len();
                if done < tuner.jobs {
                    lacking.push(format!("{name} ({done} of {} jobs)", tuner.jobs));
                    continue;
                }
                let seeds: Vec<u64> = tuner.courses.iter().map(|(seed, _)| *seed).collect();
                match by_seeds.iter_mut().find(|(of_others, _)| *of_others == seeds) {
                    Some((_, beside)) => beside.push((name, tuner.courses)),
                    None => by_seeds.push((seeds, vec![(name, tuner.courses)])),
                }
            }
            let Some(subject) = subject else { continue };
            for (_, tuners) in by_seeds {
                let (of, lacking) = (of.clone(), std::mem::take(&mut lacking));
                let compared = join(subject.clone(), &tuners);
                all.push(StudyComparison { of, lacking, compared });
            }
        }
        all
    }
}

impl Tuner {
    /// Its name, and what tells it from another of the same name.
    fn label(&self, all: &[Self]) -> String {
        let named = self.apart.iter().find(|(name, _)| name == "tuner").map(|(_, value)| value);
        let name = self.name.as_ref().or(named).map_or("the default tuner", String::as_str);
        let others = all.iter().filter(|it| it.apart != self.apart && it.name == self.name);
        let others: Vec<&Self> = others.collect();
        let differs = |it: &&(String, String)| others.iter().any(|other| !other.apart.contains(it));
        let told: Vec<String> = self
            .apart
            .iter()
            .filter(differs)
            .map(|(key, value)| format!("{} = {value}", key.trim_start_matches(OF_TUNER)))
            .collect();
        match told.is_empty() {
            true => name.to_owned(),
            false => format!("{name}, {}", told.join(", ")),
        }
    }
}

/// Prints comparisons as `pathtune compare` does.
///
/// # Errors
/// If they cannot be written to standard output.
pub(crate) fn print(all: &[StudyComparison]) -> Result<(), Failure> {
    for it in all.iter().take(MOST_PRINTED) {
        say!("");
        if !it.of.is_empty() {
            say!("{}:", it.of);
        }
        comparison::print(&it.compared.result)?;
        if !it.lacking.is_empty() {
            say!("left out, because jobs have no result: {}", it.lacking.join(", "));
        }
    }
    if all.len() > MOST_PRINTED {
        say!("… and {} more comparisons", all.len() - MOST_PRINTED);
    }
    if !all.is_empty() {
        say!("");
    }
    Ok(())
}
