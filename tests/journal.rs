//! The journal and its checkpoints, from outside: long trainings go on at once, damage is told, nothing is swallowed whole.

mod support;

use std::fs;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use support::{Sandbox, signal};

/// A number from the environment, for long forms by hand.
fn by_hand(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).ok().and_then(|number| number.parse().ok()).unwrap_or(otherwise)
}

/// Kills the orchestrator of a training whose steps are mostly remembered, at random moments and while a checkpoint is
/// written.
///
/// `PATHTUNE_LONG_EPISODES` and `PATHTUNE_LONG_KILLS` set how long it is and how often it is killed.
#[test]
fn a_long_training_goes_on_from_where_it_was_killed() {
    let episodes = by_hand("PATHTUNE_LONG_EPISODES", 1000).to_string();
    let kills = by_hand("PATHTUNE_LONG_KILLS", 6);
    let sandbox = Sandbox::new();
    let args = ["lane_change", "--episodes", &episodes];
    let calm = sandbox.train("calm", &args);

    let part = sandbox.path("killed/checkpoint.part");
    let journal = sandbox.path("killed/journal");
    let length = || fs::metadata(&journal).map_or(0, |meta| meta.len());
    let mut training = sandbox.start_training("killed", &[&args[..], &["--quiet"]].concat());
    let (mut done, mut in_write, mut slowest) = (0, 0, Duration::ZERO);
    let mut resumed = Instant::now();
    let mut before = 0;
    while done < kills {
        // It goes on: there is more in the journal than before.
        while length() <= before && !training.is_over() {
            std::thread::sleep(Duration::from_millis(1));
        }
        if done > 0 {
            println!("resumed after {:?}", resumed.elapsed());
            slowest = slowest.max(resumed.elapsed());
        }
        // Every other one while a checkpoint is written, or some time later.
        let until = Instant::now() + Duration::from_millis(100 + done * 7919 % 400);
        let mut writes = false;
        while Instant::now() < until || (done % 2 == 1 && !writes && !training.is_over()) {
            writes = part.exists();
            if writes && done % 2 == 1 {
                break;
            }
            std::thread::sleep(Duration::from_micros(50));
        }
        if training.is_over() {
            break;
        }
        signal(training.id(), Signal::KILL);
        training.finish();
        sandbox.wait_until_nobody_lives();
        in_write += u64::from(part.exists());
        done += 1;
        before = length();
        resumed = Instant::now();
        training = sandbox.resume_training("killed", &["--quiet"]);
    }
    let result = training.succeed();
    println!(
        "{done} kills, {in_write} of them in a checkpoint's write; resumed after {slowest:?} at most"
    );
    assert!(done > 0, "the training ended before it was killed");
    assert_eq!(result["digest"], calm["digest"]);
    assert_eq!(result["learners"], calm["learners"]);
    for name in ["journal", "drives.csv", "episodes.csv", "outcome.json"] {
        let of = |out: &str| fs::read(sandbox.path(out).join(name)).unwrap();
        assert!(of("killed") == of("calm"), "{name} differs after {done} kills");
    }
    assert!(!part.exists());
    sandbox.clean();
    sandbox.assert_clean();
}

#[test]
fn a_damaged_journal_is_refused_with_its_offset() {
    let sandbox = Sandbox::new();
    sandbox.train("out", &["lane_change", "--episodes", "2"]);
    let journal = sandbox.path("out/journal");
    let mut bytes = fs::read(&journal).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&journal, &bytes).unwrap();
    // With a checkpoint behind the damage, nobody needs what is damaged.
    for name in ["checkpoint", "checkpoint.previous"] {
        let _ = fs::remove_file(sandbox.path("out").join(name));
    }
    let output = sandbox.run(&["train", "--resume", "out", "--quiet"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    // Another start of the trainer would not mend it.
    assert_eq!((output.status.code(), stderr.lines().count()), (Some(64), 1), "{stderr}");
    assert!(stderr.contains("damaged at byte"), "{stderr}");
    assert_eq!(fs::read(&journal).unwrap(), bytes, "the journal was touched");
    sandbox.assert_clean();
}

#[test]
fn a_sparse_journal_is_refused_without_being_read_into_memory() {
    let sandbox = Sandbox::new();
    sandbox.train("out", &["lane_change", "--episodes", "1"]);
    let journal = fs::File::options().write(true).open(sandbox.path("out/journal")).unwrap();
    journal.set_len(2 << 30).unwrap();
    // No process may have more than 1.5 GB.
    let script = format!(
        "ulimit -v 1500000; exec {} train --resume out --quiet",
        env!("CARGO_BIN_EXE_pathtune")
    );
    let output = std::process::Command::new("sh")
        .args(["-c", &script])
        .current_dir(sandbox.path("."))
        .env("XDG_RUNTIME_DIR", sandbox.path("r"))
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(64), "{stderr}");
    assert!(stderr.contains("a record without an end"), "{stderr}");
    sandbox.assert_clean();
}
