//! The one harness of the end-to-end tests: the built binary, driven from outside, in a sandbox of its own.
//!
//! Each sandbox has its own runtime folder, so that tests run in parallel without meeting, and can tell
//! exactly what they left behind.

#![allow(dead_code, unreachable_pub, reason = "each test file uses its own part")]

pub mod conformance;
pub mod dds;
pub mod load;
pub mod netns;
pub mod onlooker;

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::TempDir;

/// Python with the packages that CommonRoad's multi-body car needs, or `None` where tests may be skipped.
pub fn python_with_a_multi_body_car() -> Option<String> {
    let why = "PATHTUNE_PYTHON names no interpreter with iceoryx2 and commonroad-vehicle-models";
    let python = std::env::var("PATHTUNE_PYTHON").ok().filter(|python| {
        let packages = ["-c", "import iceoryx2, vehiclemodels"];
        Command::new(python).args(packages).output().is_ok_and(|it| it.status.success())
    });
    if python.is_none() {
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "{why}");
        eprintln!("skipped: {why}");
    }
    python
}

/// A place of its own for one test.
pub struct Sandbox {
    folder: TempDir,
}

impl Sandbox {
    pub fn new() -> Self {
        // Short: a socket's path has room for 108 bytes.
        let folder = TempDir::with_prefix_in("pt", "/tmp").unwrap();
        fs::create_dir(folder.path().join("r")).unwrap();
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The binary with these arguments, in this sandbox.
    pub fn command<S: AsRef<OsStr>>(&self, args: &[S]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pathtune"));
        command
            .args(args)
            .current_dir(self.folder.path())
            .env("XDG_RUNTIME_DIR", self.path("r"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    /// Runs the binary to its end.
    pub fn run(&self, args: &[&str]) -> Output {
        self.command(args).output().unwrap()
    }

    /// A training to its end; returns its result.
    pub fn train(&self, out: &str, args: &[&str]) -> Value {
        let mut all = vec!["train"];
        all.extend(args);
        all.extend(["--out", out, "--quiet"]);
        let output = self.run(&all);
        assert!(output.status.success(), "{all:?}: {}", self.story(out, &output));
        self.result(out)
    }

    /// A command that prints its result as JSON, to its end.
    pub fn json(&self, out: &str, args: &[&str]) -> Value {
        let output = self.run(&[args, &["--out", out, "--json"]].concat());
        assert!(output.status.success(), "{args:?}: {}", self.story(out, &output));
        let result: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(result, self.result(out));
        result
    }

    /// Starts a training in the background.
    pub fn start_training(&self, out: &str, args: &[&str]) -> Training<'_> {
        self.start("train", out, args)
    }

    /// Starts a run in the background.
    pub fn start(&self, command: &str, out: &str, args: &[&str]) -> Training<'_> {
        let mut all = vec![command];
        all.extend(args);
        all.extend(["--out", out]);
        let child = self.command(&all).spawn().unwrap();
        Training { sandbox: self, child: Some(child), out: out.to_owned() }
    }

    /// Goes on with a training in the background.
    pub fn resume_training(&self, out: &str, args: &[&str]) -> Training<'_> {
        let mut all = vec!["train", "--resume", out];
        all.extend(args);
        let child = self.command(&all).spawn().unwrap();
        Training { sandbox: self, child: Some(child), out: out.to_owned() }
    }

    /// Whether a run of this sandbox is alive and drives.
    pub fn has_living_run(&self) -> bool {
        let status = self.run(&["status", "--json"]);
        let status: Value = serde_json::from_slice(&status.stdout).unwrap_or_default();
        status["runs"][0]["batch"].as_u64().unwrap_or_default() > 0
    }

    /// The one living run of this sandbox.
    pub fn living_run(&self) -> runtime::run::RunNames {
        let status = self.run(&["status", "--json"]);
        let status: Value = serde_json::from_slice(&status.stdout).unwrap();
        let name = status["runs"][0]["run"].as_str().unwrap();
        let root = self.path("r").join("pathtune").join(name);
        runtime::run::RunNames { run: u64::from_str_radix(name, 16).unwrap(), root }
    }

    /// The one run that this sandbox has seen.
    pub fn only_run(&self) -> u64 {
        let runs = self.runs();
        assert_eq!(runs.len(), 1);
        runs[0]
    }

    pub fn result(&self, out: &str) -> Value {
        let path = self.path(out).join("result.json");
        let text = fs::read(&path).unwrap_or_else(|error| panic!("{path:?}: {error}"));
        serde_json::from_slice(&text).unwrap()
    }

    /// A file of the sandbox, as far as it is text.
    pub fn text(&self, name: &str) -> String {
        String::from_utf8_lossy(&fs::read(self.path(name)).unwrap_or_default()).into_owned()
    }

    /// Everything that helps to understand a failed run.
    pub fn story(&self, out: &str, output: &Output) -> String {
        let mut story = format!(
            "{}\n{}{}",
            output.status,
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr)
        );
        for entry in fs::read_dir(self.path(out).join("logs")).into_iter().flatten().flatten() {
            let text = fs::read_to_string(entry.path()).unwrap_or_default();
            story += &format!("--- {:?}\n{text}", entry.file_name());
        }
        story
    }

    /// Ids of the processes of this sandbox's runs.
    pub fn processes(&self) -> Vec<i32> {
        let mark = format!("PATHTUNE_ROOT={}", self.path("r").display());
        pids().filter(|pid| file_holds(format!("/proc/{pid}/environ"), &mark)).collect()
    }

    /// Waits until a killed orchestrator's processes have followed it.
    pub fn wait_until_nobody_lives(&self) {
        let until = Instant::now() + Duration::from_secs(5);
        while !self.processes().is_empty() {
            assert!(Instant::now() < until, "orphans are left: {:?}", self.processes());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Id of the living process of a service, if there is one.
    pub fn service(&self, name: &str) -> Option<i32> {
        self.processes()
            .into_iter()
            .find(|pid| file_holds(format!("/proc/{pid}/cmdline"), &format!("service\0{name}\0")))
    }

    /// Removes what killed runs left. The folder of a run that was killed before it was locked stays for ten seconds: it
    /// might be just starting.
    pub fn clean(&self) {
        let since = Instant::now();
        while self.path("r/pathtune").exists() && since.elapsed() < Duration::from_secs(20) {
            assert!(self.run(&["clean"]).status.success());
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Asserts that no process, segment or file of any run of this sandbox is left.
    pub fn assert_clean(&self) {
        assert_eq!(self.processes(), Vec::<i32>::new(), "processes are left");
        let runtime = self.path("r").join("pathtune");
        assert!(!runtime.exists(), "{runtime:?} is left");
        for run in self.runs() {
            let left = runtime::run::segments_of(run);
            assert!(left.is_empty(), "segments are left: {left:?}");
        }
    }

    /// The runs that this sandbox has seen, from their logs.
    fn runs(&self) -> Vec<u64> {
        let mut runs = Vec::new();
        for entry in fs::read_dir(self.folder.path()).unwrap().flatten() {
            let log = entry.path().join("logs/orchestrator.log");
            let text = fs::read_to_string(log).unwrap_or_default();
            for part in text.split("run{run=\"").skip(1) {
                runs.extend(part.get(..16).and_then(|digits| u64::from_str_radix(digits, 16).ok()));
            }
        }
        runs.sort_unstable();
        runs.dedup();
        runs
    }
}

/// A training in the background.
pub struct Training<'a> {
    sandbox: &'a Sandbox,
    child: Option<Child>,
    out: String,
}

impl Training<'_> {
    pub fn id(&self) -> i32 {
        self.child.as_ref().unwrap().id() as i32
    }

    pub fn is_over(&mut self) -> bool {
        self.child.as_mut().unwrap().try_wait().unwrap().is_some()
    }

    /// Waits until every service is ready and drives are made.
    pub fn wait_until_it_drives(&mut self) {
        let journal = self.sandbox.path(&self.out).join("journal");
        self.wait_for("the first drives", || {
            fs::metadata(&journal).is_ok_and(|meta| meta.len() > 700)
        });
    }

    pub fn wait_for(&mut self, what: &str, mut condition: impl FnMut() -> bool) {
        let until = Instant::now() + Duration::from_secs(60);
        while !condition() {
            assert!(!self.is_over(), "the training ended while waiting for {what}");
            assert!(Instant::now() < until, "waited in vain for {what}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Asks it to stop.
    pub fn interrupt(&self) {
        signal(self.id(), Signal::INT);
    }

    /// Waits for the end.
    pub fn finish(mut self) -> Output {
        self.child.take().unwrap().wait_with_output().unwrap()
    }

    /// Waits for a good end; returns the result.
    pub fn succeed(self) -> Value {
        let (sandbox, out) = (self.sandbox, self.out.clone());
        let output = self.finish();
        assert!(output.status.success(), "{}", sandbox.story(&out, &output));
        sandbox.result(&out)
    }
}

impl Drop for Training<'_> {
    /// Behind a test that failed on the way: says how the run stood.
    fn drop(&mut self) {
        let Some(mut child) = self.child.take() else { return };
        let stood = child.try_wait();
        let _ = child.kill();
        let Ok(output) = child.wait_with_output() else { return };
        if std::thread::panicking() {
            eprintln!("it stood: {stood:?}; {}", self.sandbox.story(&self.out, &output));
        }
    }
}

pub fn signal(pid: i32, signal: Signal) {
    let _ = kill_process(Pid::from_raw(pid).unwrap(), signal);
}

fn pids() -> impl Iterator<Item = i32> {
    fs::read_dir("/proc")
        .unwrap()
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
}

fn file_holds(path: impl AsRef<Path>, text: &str) -> bool {
    let bytes = fs::read(path).unwrap_or_default();
    bytes.windows(text.len()).any(|window| window == text.as_bytes())
}
