//! Faults of all kinds, mixed at random, the first moments of a resume among them: one digest, and nothing left.

mod support;

use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::process::Output;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use support::load::Load;
use support::{Sandbox, Training, signal};

const TRAINING: [&str; 4] = ["lane_change", "--no-memo", "--episodes", "6"];
const SERVICES: [&str; 4] = ["simulator", "supervisor", "controller", "trainer"];
/// Messages are lost all the time; and nobody is given up for the number of the faults alone.
const FAULTY: [&str; 4] = ["--chaos", "drop command p=0.000005", "--restart-budget", "100000"];

/// A number from the environment, for long forms by hand.
fn by_hand(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).ok().and_then(|number| number.parse().ok()).unwrap_or(otherwise)
}

/// One training after the other is killed, frozen, stopped and resumed at random moments.
///
/// `PATHTUNE_FAULTS` sets how many faults there are, `PATHTUNE_LOAD` how many busy processes compute beside them on each
/// core, and `PATHTUNE_FAULT_SEED` where the random moments begin.
#[test]
fn a_thousand_mixed_faults_change_no_byte() {
    let wanted = by_hand("PATHTUNE_FAULTS", 16);
    let seed = by_hand("PATHTUNE_FAULT_SEED", 1);
    let sandbox = Sandbox::new();
    let calm = sandbox.train("calm", &TRAINING);
    let _load = Load::each_core(0);
    let mut faults =
        Faults { state: seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1, told: Told::default() };
    let mut trainings = 0;
    while faults.told.all() < wanted {
        let out = format!("faulty{trainings}");
        // One ring or two.
        let rings = ["1", "2"][(seed + trainings) as usize % 2];
        faults.strike(&sandbox, &out, rings, wanted);
        let result = sandbox.result(&out);
        let told = format!("seed {seed}, training {trainings}: {:?}", faults.told);
        assert_eq!(result["digest"], calm["digest"], "{told}");
        assert_eq!(result["learners"], calm["learners"], "{told}");
        trainings += 1;
        println!("{told}");
    }
    sandbox.clean();
    sandbox.assert_clean();
}

/// How many faults of each kind there were.
#[derive(Debug, Default)]
struct Told {
    kills: u64,
    freezes: u64,
    orchestrators: u64,
    first_20_ms: u64,
    stops: u64,
}

impl Told {
    fn all(&self) -> u64 {
        self.kills + self.freezes + self.orchestrators + self.first_20_ms + self.stops
    }
}

struct Faults {
    state: u64,
    told: Told,
}

impl Faults {
    fn random(&mut self, below: u64) -> u64 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        (self.state >> 11) % below
    }

    /// A training to its end, with faults as long as some are wanted.
    fn strike(&mut self, sandbox: &Sandbox, out: &str, rings: &str, wanted: u64) {
        let more = ["--quiet", "--rings", rings];
        let mut training = sandbox.start_training(out, &[&TRAINING[..], &FAULTY, &more].concat());
        let mut struck_at = 0;
        while self.told.all() < wanted && !training.is_over() {
            // Three of four wait until the training has got on since the last one: a training that is struck faster than
            // it recovers only recovers.
            let moves = self.random(4) > 0;
            while moves && journal(sandbox, out) <= struck_at && !training.is_over() {
                std::thread::sleep(Duration::from_millis(2));
            }
            std::thread::sleep(Duration::from_millis(self.random(90)));
            // Not before there is anything to go on with.
            if !sandbox.path(out).join("launch.toml").exists() {
                continue;
            }
            struck_at = journal(sandbox, out);
            let kind = self.random(8);
            match (kind, sandbox.service(SERVICES[kind as usize % 4])) {
                (6, _) => {
                    self.told.orchestrators += 1;
                    signal(training.id(), Signal::KILL);
                    training = self.resume(sandbox, out, training);
                }
                (7, _) => {
                    self.told.stops += 1;
                    training.interrupt();
                    training = self.resume(sandbox, out, training);
                }
                (4 | 5, Some(pid)) => {
                    self.told.freezes += 1;
                    signal(pid, Signal::STOP);
                    if kind == 5 {
                        std::thread::sleep(Duration::from_millis(self.random(300)));
                        signal(pid, Signal::CONT);
                    }
                }
                (_, Some(pid)) => {
                    self.told.kills += 1;
                    signal(pid, Signal::KILL);
                }
                (_, None) => {}
            }
        }
        training.succeed();
    }

    /// Goes on with a training that ends. Every other resume is killed within its first 20 ms, again and again.
    fn resume<'a>(
        &mut self,
        sandbox: &'a Sandbox,
        out: &str,
        mut training: Training<'a>,
    ) -> Training<'a> {
        loop {
            ended_as_asked(sandbox, out, training.finish());
            let since = Instant::now();
            training = sandbox.resume_training(out, &[&FAULTY[..], &["--quiet"]].concat());
            if self.random(2) == 0 {
                return training;
            }
            let moment = Duration::from_micros(self.random(20_000));
            while own_time(since, training.id()) < moment && !training.is_over() {
                std::thread::sleep(Duration::from_micros(200));
            }
            self.told.first_20_ms += 1;
            signal(training.id(), Signal::KILL);
        }
    }
}

/// How much of a training is written down.
fn journal(sandbox: &Sandbox, out: &str) -> u64 {
    fs::metadata(sandbox.path(out).join("journal")).map_or(0, |file| file.len())
}

/// The time since then in which a process did not wait for a processor: a loaded machine makes its first moments long.
fn own_time(since: Instant, pid: i32) -> Duration {
    let text = fs::read_to_string(format!("/proc/{pid}/schedstat")).unwrap_or_default();
    let waited = text.split_whitespace().nth(1).and_then(|number| number.parse().ok());
    since.elapsed().saturating_sub(Duration::from_nanos(waited.unwrap_or_default()))
}

/// Killed, stopped as asked, or over before it could be: anything else is a failure.
fn ended_as_asked(sandbox: &Sandbox, out: &str, output: Output) {
    let status = output.status;
    // Asked to stop before it listens, it ends by that signal.
    let asked = matches!(status.signal(), Some(2 | 9)) || matches!(status.code(), Some(0 | 130));
    assert!(asked, "{}", sandbox.story(out, &output));
}
