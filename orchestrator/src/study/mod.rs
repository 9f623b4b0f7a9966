//! Studies: many trainings, which run on one machine or on many. `pathtune sweep` is their command.
//!
//! A *study* is a file that names axes ([`axes`]). Each combination of their values is a *job*, one training. The
//! *manifest* lists all jobs ([`manifest`]), each with its *identity*, a hash of what decides its result ([`identity`]).
//! Running a job ([`job`]) leaves a *record* ([`record`]) in the folder of *results* ([`store`]). Whatever engine starts
//! jobs, on whatever machine, needs to know no more than this: a job whose record is there ends at once, a job without one
//! can be tried any number of times, and every trial comes to the same bytes. `local` is our own engine, for one machine.

mod axes;
mod collect;
mod compared;
mod identity;
mod job;
mod local;
mod manifest;
#[cfg(feature = "parquet")]
mod parquet;
mod plan;
mod progress;
mod record;
mod scripts;
mod status;
mod store;

use std::path::{Path, PathBuf};

use config::RunConfig;
use outcome::{CompareSubject, Compared, Course, StudyComparison, TunerCourses};

use crate::cli::SweepCommand;
use crate::pipeline::services::Services;
use crate::study::manifest::Manifest;
use crate::words::terminal::say;
use crate::words::{Failure, print_line};

/// What a study needs of the parts that this library does not link.
#[derive(Debug, Clone, Copy)]
pub struct StudyTools {
    /// Draws the page of a study beside the table of its jobs; returns the page's path.
    pub draw: fn(&Path, &[StudyComparison]) -> Result<PathBuf, String>,
    /// How the training of a configuration goes with this budget, in drives: what `compare` says of it.
    pub course: fn(&RunConfig, u32) -> Result<Course, String>,
    /// The comparison of trainings that have this in common.
    pub joined: fn(CompareSubject, &[TunerCourses]) -> Compared,
}

/// `pathtune sweep`.
///
/// # Errors
/// As its parts.
pub(crate) fn sweep(
    command: &SweepCommand,
    services: Services,
    tools: StudyTools,
) -> Result<(), Failure> {
    match command {
        SweepCommand::Plan { study, out } => plan::plan(study, out.as_deref()),
        SweepCommand::Jobs { at, index } => {
            let manifest = Manifest::open(&at.manifest)?;
            if let Some(index) = index {
                say!("{}", manifest.job(*index)?.typed());
                return Ok(());
            }
            let mut damaged = status::Damages::default();
            for line in manifest.lines()? {
                match line {
                    Ok(job) => say!("{}", job.typed()),
                    Err(line) => damaged.tell(&line.message),
                }
            }
            damaged.end()
        }
        SweepCommand::Run(args) => match args.index {
            Some(index) => job::run_job(args, index, services, tools),
            None => local::run_all(args),
        },
        SweepCommand::Slurm(args) => print_line(scripts::slurm(args)?.trim_end()),
        SweepCommand::Parallel(args) => print_line(scripts::parallel(args)?.trim_end()),
        SweepCommand::Kubernetes(args) => print_line(scripts::kubernetes(args)?.trim_end()),
        SweepCommand::Status { at, json } => status::status(at, *json),
        SweepCommand::Collect { at, out, parquet } => {
            collect::collect(at, out.as_deref(), *parquet, tools)
        }
    }
}
