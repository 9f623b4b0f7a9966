//! The command line of `pathtune sweep`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// What to do with a study: many trainings, each of them one job.
#[derive(Debug, Subcommand)]
#[command(after_help = "Examples:
  pathtune sweep plan study.toml
  pathtune sweep run study.jsonl --all -j 2
  pathtune sweep run study.jsonl --index 7
  pathtune sweep status study.jsonl
  pathtune sweep collect study.jsonl")]
pub enum SweepCommand {
    /// List all jobs of a study file in a manifest, one JSON line for each
    Plan {
        /// The study file
        study: PathBuf,
        /// The manifest to write [default: the study file with the ending .jsonl]
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Print the command of each job, or of one
    Jobs {
        /// Where the study is.
        #[command(flatten)]
        at: StudyArg,
        /// Only the job with this index
        #[arg(long, value_name = "N")]
        index: Option<u64>,
    },
    /// Run one job, or all that are not done; exit code 0: done, 64: wrong input, trying again is useless, 75: try again
    Run(RunJobsArgs),
    /// Print a script that runs the jobs as a job array of Slurm
    Slurm(SlurmArgs),
    /// Print a script that runs the jobs by GNU parallel
    Parallel(EngineArgs),
    /// Print a manifest that runs the jobs as an indexed Job of Kubernetes
    Kubernetes(KubernetesArgs),
    /// Say how many jobs are done, which are missing, and why others failed
    Status {
        /// Where the study is.
        #[command(flatten)]
        at: StudyArg,
        /// Print it as JSON
        #[arg(long)]
        json: bool,
    },
    /// Write the results of all jobs into one CSV file and a page with pictures, and print them by groups that differ in
    /// nothing but the seed
    Collect {
        /// Where the study is.
        #[command(flatten)]
        at: StudyArg,
        /// The table to write [default: the manifest with the ending .csv]
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Write the table as a Parquet file, too (a build with the feature parquet)
        #[arg(long)]
        parquet: bool,
    },
}

/// Where a study is.
#[derive(Debug, Clone, Args)]
pub struct StudyArg {
    /// The manifest that `sweep plan` wrote
    pub manifest: PathBuf,
    /// Folder with the record of each job that is done [default: the manifest with the ending .results]
    #[arg(long, value_name = "DIR")]
    pub results: Option<PathBuf>,
}

/// Options of `sweep run`.
#[derive(Debug, Args)]
pub struct RunJobsArgs {
    /// Where the study is.
    #[command(flatten)]
    pub at: StudyArg,
    /// Run the job with this index, counted from 0
    #[arg(long, value_name = "N", required_unless_present = "all", conflicts_with = "all")]
    pub index: Option<u64>,
    /// Run all jobs that are not done; the same command goes on after an interruption
    #[arg(long)]
    pub all: bool,
    /// With --all, the number of jobs that run at once, each on a core of its own [default: the cores of this machine
    /// that may be used]
    #[arg(short, long, value_name = "CORES", requires = "all", value_parser = clap::value_parser!(u32).range(1..))]
    pub jobs: Option<u32>,
    /// With --all, how often a job is tried that fails for another reason than wrong input
    #[arg(long, value_name = "N", requires = "all", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub tries: u32,
    /// Folder for what a job writes while it runs, such as its journal; give one on a local disk if the results are on a
    /// shared one [default: work in the folder of the results]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    /// Keep the whole folder of each job below the scratch folder, not only its outcome and record
    #[arg(long)]
    pub keep: bool,
    /// Run on this core alone
    #[arg(long, value_name = "CORE", conflicts_with = "all")]
    pub core: Option<usize>,
    /// Do not show progress
    #[arg(long, short)]
    pub quiet: bool,
    /// The process that started this one, as one of several: this one ends in order when it dies.
    #[arg(long, hide = true, conflicts_with = "all")]
    pub under: Option<i32>,
}

/// Options of every script for another engine.
#[derive(Debug, Args)]
pub struct EngineArgs {
    /// Where the study is.
    #[command(flatten)]
    pub at: StudyArg,
    /// Folder on a local disk for what a job writes while it runs [default: one in $TMPDIR or /tmp]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    /// The program, as the machines that run the jobs find it [default: this one]
    #[arg(long, value_name = "FILE")]
    pub program: Option<PathBuf>,
}

/// Options of `sweep slurm`.
#[derive(Debug, Args)]
pub struct SlurmArgs {
    /// Those of every script.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// The most tasks of the array; with more jobs than these, each task runs several (MaxArraySize of slurm.conf is the
    /// limit, usually 1001)
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..))]
    pub tasks: u32,
    /// How often a task is started in all
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub tries: u32,
}

/// Options of `sweep kubernetes`.
#[derive(Debug, Args)]
pub struct KubernetesArgs {
    /// Those of every script.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// Image of a container with the program in its PATH
    #[arg(long, value_name = "IMAGE", default_value = "pathtune:latest")]
    pub image: String,
    /// Claim of a volume that all pods may write, with the manifest and the files that it names
    #[arg(long, value_name = "NAME", default_value = "pathtune-study")]
    pub claim: String,
    /// Where pods find this volume
    #[arg(long, value_name = "DIR", default_value = "/study")]
    pub mount: String,
    /// The most pods at once
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    pub parallelism: u32,
    /// How often a job is tried
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub tries: u32,
}
