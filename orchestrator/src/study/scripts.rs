//! `pathtune sweep slurm`, `parallel` and `kubernetes`: what other engines need in order to run a study.
//!
//! Each prints a whole script or manifest, to be read and changed before it is used. Pure but for the names of files. All
//! of them rest on the same three things: the index of a job, its exit code (64: never again, 75: try again), and that a
//! job which is done ends at once.

use std::path::{Path, PathBuf};

use crate::cli::{EngineArgs, KubernetesArgs, SlurmArgs};
use crate::study::manifest::Manifest;
use crate::study::store::Store;
use crate::words::Failure;

/// Main memory that a job is given, in MiB: that of a pipeline with its shared memory, and room.
const JOB_MIB: u64 = 256;
/// Shared memory that a job is given, in MiB.
const SHARED_MIB: u64 = 64;

/// Names a folder in memory for the transport's many small files, each of which it syncs. On a disk they make a job's start
/// a second longer.
const RUNTIME_FOLDER: &str = r#"# Small files of a run, which are faster in memory.
if [ ! -d "${XDG_RUNTIME_DIR:-}" ]; then
    export XDG_RUNTIME_DIR=/dev/shm/pt-$(id -u)
    mkdir -p -m 700 "$XDG_RUNTIME_DIR"
fi"#;

/// What every script is about.
struct Subject {
    /// Name of the study, fit to name a job.
    name: String,
    manifest: PathBuf,
    results: PathBuf,
    /// Number of jobs.
    jobs: u64,
}

impl Subject {
    fn of(args: &EngineArgs) -> Result<Self, Failure> {
        let jobs = Manifest::open(&args.at.manifest)?.len();
        let manifest = std::path::absolute(&args.at.manifest)?;
        let results = std::path::absolute(Store::of(&args.at).folder)?;
        let stem = manifest.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
        let name: String = stem
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
            .take(40)
            .collect();
        Ok(Self { name: name.trim_matches('-').to_owned(), manifest, results, jobs })
    }
}

fn quoted(path: &Path) -> String {
    shell_words::quote(&path.to_string_lossy()).into_owned()
}

/// The file of this program, as other machines are told it.
fn program(args: &EngineArgs) -> String {
    let own = || std::env::current_exe().unwrap_or_else(|_| PathBuf::from("pathtune"));
    quoted(&args.program.clone().unwrap_or_else(own))
}

/// A script for `sbatch`.
///
/// # Errors
/// If the manifest cannot be read.
pub(crate) fn slurm(args: &SlurmArgs) -> Result<String, Failure> {
    let Subject { name, manifest, results, jobs } = Subject::of(&args.engine)?;
    let program = program(&args.engine);
    let tasks = jobs.min(u64::from(args.tasks));
    let last_task = tasks.saturating_sub(1);
    let last_job = jobs.saturating_sub(1);
    let tries = args.tries;
    let scratch = args
        .engine
        .scratch
        .as_deref()
        .map_or_else(|| "\"${TMPDIR:-/tmp}/pathtune-sweep-$(id -u)\"".to_owned(), quoted);
    let (manifest, results) = (quoted(&manifest), quoted(&results));
    Ok(format!(
        r#"#!/bin/bash
# {jobs} jobs in {tasks} tasks; task T runs the jobs T, T+{tasks}, T+{twice}, … Hand in with: sbatch THIS_FILE
# Hand it in again whenever jobs are missing: those that are done end at once.
#SBATCH --job-name={name}
#SBATCH --array=0-{last_task}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --mem={JOB_MIB}M
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=/dev/null
# Asks the job to stop half a minute before its time is over; then it goes on from there.
#SBATCH --signal=B:TERM@30
set -u
program={program}
manifest={manifest}
results={results}
# On a local disk: journals stay off the shared file system, and only outcome and record are copied back. A task that
# comes back to this node goes on from what it left here.
scratch={scratch}
{RUNTIME_FOLDER}
again=0 wrong=0 job=
trap 'stopped=1; [ -n "$job" ] && kill -TERM "$job" 2>/dev/null' TERM
stopped=0
for ((index = SLURM_ARRAY_TASK_ID; index <= {last_job}; index += {tasks})); do
    "$program" sweep run "$manifest" --index "$index" --results "$results" --scratch "$scratch" --quiet &
    job=$!
    wait "$job"
    code=$?
    # A signal ends the first wait before the job has ended.
    while kill -0 "$job" 2>/dev/null; do wait "$job"; code=$?; done
    job=
    case $code in
        0) ;;
        64) wrong=1 ;;
        *) again=1 ;;
    esac
    [ "$stopped" = 1 ] && {{ again=1; break; }}
done
# Back into the queue, unless it was there often enough.
if [ "$again" = 1 ] && [ "${{SLURM_RESTART_COUNT:-0}}" -lt {restarts} ]; then
    scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_${{SLURM_ARRAY_TASK_ID}}" && exit 75
fi
[ "$again" = 1 ] && exit 75
[ "$wrong" = 1 ] && exit 64
exit 0
"#,
        twice = 2 * tasks,
        restarts = tries.saturating_sub(1),
    ))
}

/// A script that calls GNU parallel.
///
/// # Errors
/// If the manifest cannot be read.
pub(crate) fn parallel(args: &EngineArgs) -> Result<String, Failure> {
    let Subject { name, manifest, results, jobs } = Subject::of(args)?;
    let program = program(args);
    let last_job = jobs.saturating_sub(1);
    let scratch = args
        .scratch
        .as_deref()
        .map_or_else(|| "\"${TMPDIR:-/tmp}/pathtune-sweep-$(id -u)\"".to_owned(), quoted);
    let log = quoted(&manifest.with_extension("joblog"));
    let (manifest, results) = (quoted(&manifest), quoted(&results));
    Ok(format!(
        r#"#!/bin/bash
# {name}: {jobs} jobs by GNU parallel, each on a core of its own.
# Run it again to go on, and to try jobs again that failed. For several machines, put --sshlogin 8/host1,8/host2 into
# `options` and take out the part with taskset; the folders below must be seen by all of them.
set -u
export program={program}
export manifest={manifest}
export results={results}
export scratch={scratch}
{RUNTIME_FOLDER}
options=(--jobs "$(nproc)" --joblog {log} --resume-failed --env program,manifest,results,scratch)
one() {{
    # The cores that this script may use; slot S takes the S-th of them.
    mapfile -t cores < <(taskset -cp $$ | sed 's/.*: //' | tr , '\n' | while IFS=- read -r from to; do seq "$from" "${{to:-$from}}"; done)
    core=${{cores[$((($2 - 1) % ${{#cores[@]}}))]}}
    "$program" sweep run "$manifest" --index "$1" --results "$results" --scratch "$scratch" --core "$core" --quiet
}}
export -f one
SHELL=$(type -p bash) parallel "${{options[@]}}" --env one one '{{1}}' '{{%}}' ::: $(seq 0 {last_job})
# The exit code is the number of jobs that failed, at most 101.
"#
    ))
}

/// A manifest of an indexed Job for Kubernetes.
///
/// # Errors
/// If the manifest cannot be read.
pub(crate) fn kubernetes(args: &KubernetesArgs) -> Result<String, Failure> {
    let Subject { name, jobs, .. } = Subject::of(&args.engine)?;
    let program = args.engine.program.as_deref().unwrap_or(Path::new("pathtune")).to_string_lossy();
    let mount = args.mount.trim_end_matches('/');
    let file_name =
        |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let text = |text: &str| serde_json::to_string(text).expect("a text");
    let manifest = format!("{mount}/{}", file_name(&args.engine.at.manifest));
    let results = format!("{mount}/{}", file_name(&Store::of(&args.engine.at).folder));
    let again = args.tries.saturating_sub(1);
    let parallelism = jobs.min(u64::from(args.parallelism));
    let shell = "exec \"$0\" sweep run \"$1\" --index \"$JOB_COMPLETION_INDEX\" --results \"$2\" --scratch /scratch --quiet";
    let name = if name.is_empty() { "study" } else { &name };
    Ok(format!(
        r#"# {jobs} jobs, one pod each. The claim holds the study's manifest and the files that it names; results go there, too.
# Kubernetes 1.29 or newer. Hand in with: kubectl apply -f THIS_FILE
apiVersion: batch/v1
kind: Job
metadata:
  name: pathtune-{name}
spec:
  completionMode: Indexed
  completions: {jobs}
  parallelism: {parallelism}
  backoffLimitPerIndex: {again}
  maxFailedIndexes: {jobs}
  podFailurePolicy:
    rules:
      # Wrong input: trying again is useless.
      - action: FailIndex
        onExitCodes:
          containerName: job
          operator: In
          values: [64]
      # A node that was drained is no failure of the job.
      - action: Ignore
        onPodConditions:
          - type: DisruptionTarget
            status: "True"
  template:
    spec:
      restartPolicy: Never
      containers:
        - name: job
          image: {image}
          command: ["/bin/sh", "-c", {shell}, {program}, {manifest}, {results}]
          env:
            # Small files of a run, which are faster in memory.
            - {{ name: XDG_RUNTIME_DIR, value: /dev/shm }}
          resources:
            # Whole numbers, the same for both: with the static CPU manager the pod has its core to itself.
            requests: {{ cpu: "1", memory: {JOB_MIB}Mi }}
            limits: {{ cpu: "1", memory: {JOB_MIB}Mi }}
          volumeMounts:
            - {{ name: study, mountPath: {mount} }}
            - {{ name: scratch, mountPath: /scratch }}
            - {{ name: shared-memory, mountPath: /dev/shm }}
      volumes:
        - name: study
          persistentVolumeClaim: {{ claimName: {claim} }}
        - name: scratch
          emptyDir: {{}}
        - name: shared-memory
          emptyDir: {{ medium: Memory, sizeLimit: {SHARED_MIB}Mi }}
"#,
        image = text(&args.image),
        claim = text(&args.claim),
        shell = text(shell),
        program = text(&program),
        manifest = text(&manifest),
        results = text(&results),
        mount = text(mount),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::StudyArg;
    use crate::study::manifest::{self, Job};

    /// The options for a study of so many jobs, in a folder whose name needs quotes.
    fn study(folder: &Path, jobs: u64) -> EngineArgs {
        let manifest = folder.join("my study.jsonl");
        let job = |index: u64| Job {
            index,
            job: format!("{index:032x}"),
            axes: std::collections::BTreeMap::new(),
            command: vec!["train".to_owned()],
        };
        manifest::write(&manifest, |take| (0..jobs).try_for_each(|index| take(&job(index))))
            .unwrap();
        let at = StudyArg { manifest, results: None };
        EngineArgs { at, scratch: None, program: Some(PathBuf::from("/opt/path tune")) }
    }

    /// Asserts that a shell can read a script.
    fn check_syntax(script: &str) {
        use std::io::Write;
        let mut shell = std::process::Command::new("bash")
            .arg("-n")
            .stdin(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        shell.stdin.take().unwrap().write_all(script.as_bytes()).unwrap();
        assert!(shell.wait().unwrap().success(), "{script}");
    }

    #[test]
    fn each_job_has_a_place_and_names_are_quoted() {
        let folder = tempfile::tempdir().unwrap();
        let quoted = |name: &str| format!("'{}/{name}'", folder.path().display());
        for (jobs, array, last) in [(1, "0-0", 0), (40, "0-39", 39), (2500, "0-999", 2499)] {
            let engine = study(folder.path(), jobs);
            let script = slurm(&SlurmArgs { engine, tasks: 1000, tries: 3 }).unwrap();
            check_syntax(&script);
            assert!(script.contains(&format!("#SBATCH --array={array}\n")), "{script}");
            assert!(script.contains(&format!("index <= {last}; index += ")), "{script}");
            assert!(
                script.contains(&format!("manifest={}\n", quoted("my study.jsonl"))),
                "{script}"
            );
            assert!(script.contains("program='/opt/path tune'\n"), "{script}");
            let script = parallel(&study(folder.path(), jobs)).unwrap();
            check_syntax(&script);
            assert!(script.contains(&format!("$(seq 0 {last})")), "{script}");
            assert!(
                script.contains(&format!("results={}\n", quoted("my study.results"))),
                "{script}"
            );
        }
        let args = KubernetesArgs {
            engine: study(folder.path(), 40),
            image: "tuner: latest".to_owned(),
            claim: "disk".to_owned(),
            mount: "/data/".to_owned(),
            parallelism: 64,
            tries: 3,
        };
        let text = kubernetes(&args).unwrap();
        for part in [
            "name: pathtune-my-study\n",
            "completions: 40\n",
            "parallelism: 40\n",
            "image: \"tuner: latest\"\n",
            "\"/data/my study.jsonl\", \"/data/my study.results\"]",
            "backoffLimitPerIndex: 2\n",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }
}
