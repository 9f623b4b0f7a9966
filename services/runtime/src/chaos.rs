//! Injected faults: what `--chaos` asks for, carried out in the process where the timing is exact.
//!
//! A script is a list of faults, separated by `;`:
//!
//! - `kill ROLE@drive=N,tick=K` kills the process once batch N has reached tick K;
//! - `stop ROLE@drive=N,tick=K for 2s` freezes it for that time;
//! - `drop TOPIC p=0.001` loses messages with that probability;
//! - `delay TOPIC 5ms` sends them late;
//! - `random:RATE` kills random processes, RATE of them per second; the orchestrator does that.
//!
//! Each scripted fault fires once in a run: a file in the run's folder records it, and outlives the process that fired.

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use ipc_types::WakeRole;
use rustix::process::{Signal, getpid, kill_process};

use crate::Counters;

/// Name of the variable that carries the script to the processes.
pub(crate) const SCRIPT: &str = "PATHTUNE_CHAOS";
/// Name of the variable that carries the seed.
pub(crate) const SEED: &str = "PATHTUNE_CHAOS_SEED";

/// Topics whose loss the pipeline repairs by driving the batch again.
const TOPICS: [&str; 3] = ["odometry", "raw_command", "command"];

/// A parsed script.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Script {
    /// The faults, in the order of the script.
    pub faults: Vec<Fault>,
    /// Random kills per second.
    pub random_per_s: f64,
}

/// One fault.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the module's documentation says it")]
pub enum Fault {
    Kill { role: WakeRole, drive: u64, tick: u64 },
    Stop { role: WakeRole, drive: u64, tick: u64, time: Duration },
    Drop { topic: String, probability: f64 },
    Delay { topic: String, time: Duration },
}

impl Script {
    /// Parses a script.
    ///
    /// # Errors
    /// If a fault is malformed; the error says which one, and why.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut script = Self::default();
        for fault in text.split(';').map(str::trim).filter(|fault| !fault.is_empty()) {
            if let Some(rate) = fault.strip_prefix("random:") {
                script.random_per_s =
                    number(rate, 0.0, 1000.0).map_err(|why| in_fault(fault, &why))?;
                continue;
            }
            script.faults.push(Fault::parse(fault).map_err(|why| in_fault(fault, &why))?);
        }
        Ok(script)
    }
}

fn in_fault(fault: &str, why: &str) -> String {
    format!("{fault:?}: {why}")
}

impl Fault {
    fn parse(text: &str) -> Result<Self, String> {
        let words: Vec<&str> = text.split_whitespace().collect();
        match words[..] {
            ["kill", place] => {
                let (role, drive, tick) = parse_place(place)?;
                Ok(Fault::Kill { role, drive, tick })
            }
            ["stop", place, "for", time] => {
                let (role, drive, tick) = parse_place(place)?;
                Ok(Fault::Stop { role, drive, tick, time: parse_time(time)? })
            }
            ["drop", topic, share] => {
                let share = share.strip_prefix("p=").ok_or("needs p=PROBABILITY")?;
                Ok(Fault::Drop {
                    topic: parse_topic(topic)?,
                    probability: number(share, 0.0, 1.0)?,
                })
            }
            ["delay", topic, time] => {
                Ok(Fault::Delay { topic: parse_topic(topic)?, time: parse_time(time)? })
            }
            _ => Err("is none of: kill ROLE@drive=N,tick=K; stop ROLE@drive=N for 2s; \
                      drop TOPIC p=0.001; delay TOPIC 5ms; random:RATE"
                .to_owned()),
        }
    }
}

/// `ROLE@drive=N[,tick=K]`.
fn parse_place(text: &str) -> Result<(WakeRole, u64, u64), String> {
    let (role, place) = text.split_once('@').ok_or("needs ROLE@drive=N,tick=K")?;
    let role = match role {
        "simulator" | "vehicle" => WakeRole::Vehicle,
        "controller" => WakeRole::Controller,
        "supervisor" => WakeRole::Supervisor,
        "trainer" => WakeRole::Trainer,
        "recorder" => WakeRole::Recorder,
        _ => {
            return Err(format!(
                "{role} is not a role; there are simulator, controller, supervisor, trainer, recorder"
            ));
        }
    };
    let (mut drive, mut tick) = (None, 0);
    for part in place.split(',') {
        let parse = |text: &str| text.parse::<u64>().map_err(|_| format!("{text} is not a number"));
        match part.split_once('=') {
            Some(("drive", value)) => drive = Some(parse(value)?),
            Some(("tick", value)) => tick = parse(value)?,
            _ => return Err(format!("{part} is neither drive=N nor tick=K")),
        }
    }
    Ok((role, drive.ok_or("needs drive=N")?, tick))
}

fn parse_topic(text: &str) -> Result<String, String> {
    if TOPICS.contains(&text) {
        return Ok(text.to_owned());
    }
    Err(format!("{text} is not a topic to disturb; there are {}", TOPICS.join(", ")))
}

/// `2s`, `300ms`, `50us`.
fn parse_time(text: &str) -> Result<Duration, String> {
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let factor = match &text[split..] {
        "s" => 1.0,
        "ms" => 1e-3,
        "us" => 1e-6,
        _ => return Err(format!("{text} is not a time; write it as in 2s, 300ms or 50us")),
    };
    Ok(Duration::from_secs_f64(number(&text[..split], 0.0, 1e6)? * factor))
}

fn number(text: &str, low: f64, high: f64) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (low..=high).contains(&number) => Ok(number),
        _ => Err(format!("{text} is not a number in [{low}, {high}]")),
    }
}

/// The part of a script that this process carries out itself.
#[derive(Debug)]
pub(crate) struct Saboteur {
    pending: Vec<(usize, Fault)>,
    root: PathBuf,
}

impl Saboteur {
    /// The faults that the environment asks of the process in this role; usually none.
    pub(crate) fn from_env(role: WakeRole, root: &Path) -> Option<Self> {
        let script = Script::parse(&std::env::var(SCRIPT).ok()?).ok()?;
        let pending: Vec<_> = script
            .faults
            .into_iter()
            .enumerate()
            .filter(|(_, fault)| match fault {
                Fault::Kill { role: target, .. } | Fault::Stop { role: target, .. } => {
                    *target == role
                }
                Fault::Drop { .. } | Fault::Delay { .. } => false,
            })
            .collect();
        (!pending.is_empty()).then(|| Self { pending, root: root.to_owned() })
    }

    /// Fires the faults that are due.
    pub(crate) fn strike(&mut self, now: Counters) {
        let root = &self.root;
        self.pending.retain(|(index, fault)| {
            let (Fault::Kill { drive, tick, .. } | Fault::Stop { drive, tick, .. }) = fault else {
                return false;
            };
            if now.batch < *drive || (now.batch == *drive && now.tick < *tick) {
                return true;
            }
            let mark = root.join(format!("{FIRED}{index}"));
            if OpenOptions::new().write(true).create_new(true).open(mark).is_err() {
                return false;
            }
            let signal = match fault {
                Fault::Stop { time, .. } => {
                    let _ = Command::new("/proc/self/exe")
                        .args(["service", "wake"])
                        .args([getpid().as_raw_nonzero().to_string(), time.as_millis().to_string()])
                        .stdin(Stdio::null())
                        .spawn();
                    Signal::STOP
                }
                _ => Signal::KILL,
            };
            let _ = kill_process(getpid(), signal);
            false
        });
    }
}

const FIRED: &str = "fired-";

/// How many scripted faults of a run have fired.
pub fn fired(root: &Path) -> usize {
    let entries = std::fs::read_dir(root).into_iter().flatten().flatten();
    entries
        .filter(|entry| entry.file_name().as_encoded_bytes().starts_with(FIRED.as_bytes()))
        .count()
}

/// What an outlet does to its messages.
#[derive(Debug)]
pub(crate) struct Disturbance {
    probability: f64,
    delay: Duration,
    spread: std::cell::RefCell<Spread>,
}

impl Disturbance {
    /// The faults that the environment asks of the outlets on a topic; usually none.
    pub(crate) fn from_env(topic: &str) -> Option<Self> {
        let script = Script::parse(&std::env::var(SCRIPT).ok()?).ok()?;
        let seed = std::env::var(SEED).ok().and_then(|seed| seed.parse().ok()).unwrap_or(1u64);
        // A different stream for each process and start; otherwise a lost message would be lost again each time.
        let spread = Spread::new(seed ^ (u64::from(std::process::id()) << 20) ^ topic.len() as u64);
        let mut new = Self { probability: 0.0, delay: Duration::ZERO, spread: spread.into() };
        for fault in script.faults {
            match fault {
                Fault::Drop { topic: on, probability } if on == topic => {
                    new.probability = probability
                }
                Fault::Delay { topic: on, time } if on == topic => new.delay = time,
                _ => {}
            }
        }
        (new.probability > 0.0 || !new.delay.is_zero()).then_some(new)
    }

    /// Waits, and returns whether the message is lost.
    pub(crate) fn swallows(&self) -> bool {
        std::thread::sleep(self.delay);
        self.spread.borrow_mut().uniform() < self.probability
    }
}

/// Random numbers for spreading events in time (xorshift64). No result depends on them.
#[derive(Debug, Clone)]
pub struct Spread(u64);

impl Spread {
    /// The stream of a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Wakes a process that froze itself, after a time: the helper that carries out `stop … for 2s`.
pub fn wake_later(pid: i32, time: Duration) {
    std::thread::sleep(time);
    if let Some(pid) = rustix::process::Pid::from_raw(pid) {
        let _ = kill_process(pid, Signal::CONT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_text_makes_the_parser_panic(text in "(kill|stop|drop|delay|random:)?[ -~é]{0,60}") {
            let _ = Script::parse(&text);
        }
    }

    #[test]
    fn a_script_is_read() {
        let script = Script::parse(
            "kill controller@drive=12,tick=300; stop simulator@drive=20 for 2s; \
             drop command p=0.001; delay odometry 5ms; random:2.5;",
        )
        .unwrap();
        let ms = Duration::from_millis;
        assert_eq!(
            script.faults,
            [
                Fault::Kill { role: WakeRole::Controller, drive: 12, tick: 300 },
                Fault::Stop { role: WakeRole::Vehicle, drive: 20, tick: 0, time: ms(2000) },
                Fault::Drop { topic: "command".to_owned(), probability: 0.001 },
                Fault::Delay { topic: "odometry".to_owned(), time: ms(5) },
            ]
        );
        assert_eq!(script.random_per_s, 2.5);
    }

    #[test]
    fn mistakes_name_the_fault_and_what_is_wrong() {
        for (text, part) in [
            ("kill pilot@drive=1", "pilot is not a role"),
            ("kill controller", "ROLE@drive=N"),
            ("kill controller@tick=1", "needs drive=N"),
            ("kill controller@drive=x", "x is not a number"),
            ("stop simulator@drive=1 for ever", "is not a time"),
            ("drop command p=2", "2 is not a number in [0, 1]"),
            ("drop gains p=0.1", "gains is not a topic"),
            ("delay odometry 5", "5 is not a time"),
            ("explode", "is none of"),
            ("random:NaN", "not a number"),
            ("random:é", "not a number"),
        ] {
            let error = Script::parse(text).unwrap_err();
            assert!(error.contains(part), "{error:?} lacks {part:?}");
        }
    }
}
