//! The recorder from another terminal: an observer of a run that is under way. It does not disturb the run, and may
//! miss messages; what it has missed is counted.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use config::{RunConfig, read_small};
use runtime::observer::Observer;
use runtime::run::{RunNames, living_runs};

pub use crate::listener::Summary;

use crate::listener::{Listener, Look};
use crate::service::{STEM, settings};
use crate::tape::{Files, Tape};

/// Time between two looks when nothing comes: an observer's buffer holds more than arrives meanwhile.
const NAP: Duration = Duration::from_micros(500);
/// Time between two checks whether the run is still alive.
const LIFE_EVERY: Duration = Duration::from_millis(200);

/// What to record, and for how long.
#[derive(Debug, Clone)]
pub struct Options {
    /// The run.
    pub names: RunNames,
    /// Its output folder.
    pub folder: PathBuf,
    /// The file; a new one in the run's folder if none is given.
    pub out: Option<PathBuf>,
    /// How long to record; by default until the run ends, or a signal comes.
    pub time: Option<Duration>,
    /// Size at which the next file begins.
    pub split_bytes: Option<u64>,
}

/// Records a living run until it ends, the time is over, or a signal comes.
///
/// # Errors
/// If the run cannot be observed, or the file cannot be written.
pub fn record(options: &Options) -> Result<Summary> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone())?;
    }
    let path = options.folder.join("config.toml");
    let text = read_small(&path).with_context(|| format!("failed to read {path:?}"))?;
    let config = RunConfig::from_resolved(&text)?;
    let observer = Observer::attach(&options.names)?;
    let stem = match &options.out {
        Some(out) => out.with_extension(""),
        None => options.folder.join(STEM),
    };
    let files = Files::first_free(stem, options.split_bytes);
    let tape = Tape::start(settings(files, &options.folder, &config, options.names.run, false))?;
    let mut listener = Listener::new(observer.bus(), tape)?;
    let (since, mut looked) = (Instant::now(), Instant::now());
    while !stop.load(Ordering::Relaxed) && options.time.is_none_or(|time| since.elapsed() < time) {
        if listener.listen()? == Look::Nothing {
            std::thread::sleep(NAP);
        }
        if looked.elapsed() >= LIFE_EVERY {
            looked = Instant::now();
            if !is_alive(&options.names) {
                break;
            }
        }
    }
    listener.finish(digest(&options.folder))
}

fn is_alive(names: &RunNames) -> bool {
    living_runs().iter().any(|living| living.run == names.run)
}

/// The digest of a run that has ended meanwhile.
fn digest(folder: &Path) -> Option<String> {
    let text = read_small(&folder.join("result.json")).ok()?;
    let result: serde_json::Value = serde_json::from_str(&text).ok()?;
    Some(result["digest"].as_str()?.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_digest_is_read_from_a_regular_file_only() {
        let folder = tempfile::tempdir().unwrap();
        let result = folder.path().join("result.json");
        fs::write(&result, r#"{ "digest": "80a2" }"#).unwrap();
        assert_eq!(digest(folder.path()).as_deref(), Some("80a2"));
        fs::remove_file(&result).unwrap();
        // Opening a pipe would wait for somebody who writes, and a device never ends.
        assert!(std::process::Command::new("mkfifo").arg(&result).status().unwrap().success());
        assert_eq!(digest(folder.path()), None);
        // A sparse file of any length is refused before it fills the memory.
        fs::remove_file(&result).unwrap();
        fs::File::create(&result).unwrap().set_len(1 << 40).unwrap();
        assert_eq!(digest(folder.path()), None);
    }
}
