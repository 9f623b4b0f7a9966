//! Replays: nothing differs where nothing was changed, and what was changed shows at the first tick that it can.

mod support;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use config::{Layers, Parameters, RunConfig};
use rollout::Rollout;
use rustix::process::Signal;
use support::Sandbox;

fn config(maneuver: &str) -> RunConfig {
    let mut layers = Layers::maneuver(maneuver).unwrap();
    layers.set("collision.enabled=true").unwrap();
    layers.resolve().unwrap()
}

fn record(sandbox: &Sandbox, maneuver: &str, gains: &str) -> String {
    let args = ["validate", maneuver, "--repeats", "2", "--gains", gains, "--record"];
    sandbox.json("out", &[&args[..], &["--fleet", "1"]].concat());
    sandbox.path("out/recording.mcap").display().to_string()
}

/// Exit code, standard output and standard error.
fn told(output: &Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

/// The commands of a noise-free drive along recorded poses: those of the drive that was recorded, answered with other
/// gains. Returns the first tick whose raw command differs.
fn first_difference(config: &RunConfig, was: &[Parameters], is: &[Parameters]) -> u64 {
    let mut recorded = Vec::new();
    let by_zone = config.sets_by_zone(was);
    Rollout::new(config).drive_scheduled(&by_zone, None, |_, record| recorded.push(*record));
    let mut replayed = Vec::new();
    let by_zone = config.sets_by_zone(is);
    Rollout::new(config).drive_scheduled(&by_zone, None, |_, record| replayed.push(*record));
    // Until the first difference both drives are the same, poses included.
    let differs = recorded.iter().zip(&replayed).position(|(was, is)| {
        let (was, is) = (was.decision.command, is.decision.command);
        was.speed_mps.to_bits() != is.speed_mps.to_bits()
            || was.yaw_rate_radps.to_bits() != is.yaw_rate_radps.to_bits()
            || was.steering_rad.to_bits() != is.steering_rad.to_bits()
    });
    differs.unwrap() as u64
}

#[test]
fn what_was_not_changed_does_not_differ() {
    for (maneuver, gains) in [("lane_change", "3,21,21,.7"), ("circuit", "3,21,21,.7/3.4,21,1,.84")]
    {
        let sandbox = Sandbox::new();
        let file = record(&sandbox, maneuver, gains);
        for more in [&[][..], &["--gains", gains]] {
            let output = sandbox.run(&[&["replay", &file][..], more].concat());
            let (code, out, err) = told(&output);
            assert_eq!(code, Some(0), "{out}{err}");
            let ticks = 3 * config(maneuver).ticks();
            assert!(out.starts_with("no difference: "), "{out}");
            if maneuver == "circuit" {
                continue;
            }
            assert!(out.contains(&format!("{ticks} ticks of 3 batches")), "{out}");
        }
        sandbox.assert_clean();
    }
}

#[test]
fn a_changed_gain_shows_at_the_first_tick_that_it_can() {
    let sandbox = Sandbox::new();
    let (was, is) = ("3,21,21,.7/3.4,21,1,.84", "3,21,21,.7/3.4,21,1.5,.84");
    let file = record(&sandbox, "circuit", was);
    let config = config("circuit");
    let parse = |text: &str| config.law.parse_sets(text).unwrap();
    let tick = first_difference(&config, &parse(was), &parse(is));
    let output = sandbox.run(&["replay", &file, "--gains", is]);
    let (code, out, err) = told(&output);
    assert_eq!(code, Some(1), "{out}{err}");
    assert!(out.contains(&format!("batch 1, tick {tick}, slot 0, raw_command.")), "{tick}: {out}");
    assert!(out.contains("recorded ") && out.contains("replayed "), "{out}");
    // Before it nothing differs.
    let switch_s = (tick as f64 * 0.01).to_string();
    let early = sandbox.run(&["replay", &file, "--gains", is, "--to", &switch_s]);
    // Noisy batches come later, and switch at ticks of their own: only the first batch is sure.
    let out = told(&early).1;
    assert!(!out.contains("batch 1,"), "{out}");
    sandbox.assert_clean();
}

#[test]
fn the_clock_paces_a_replay_and_a_stretch_can_be_chosen() {
    let sandbox = Sandbox::new();
    let file = record(&sandbox, "lane_change", "3,21,21,.7");
    let since = std::time::Instant::now();
    let output = sandbox.run(&["replay", &file, "--speed", "10", "--from", "1", "--to", "2"]);
    let (code, out, err) = told(&output);
    assert_eq!(
        (code, out.trim_end()),
        (Some(0), "no difference: 300 ticks of 3 batches compared"),
        "{err}"
    );
    assert!(since.elapsed().as_secs_f64() >= 1.4);
    let output = sandbox.run(&["replay", &file, "--gains", "3,21,16,.7", "--to", "0"]);
    assert_eq!(output.status.code(), Some(0));
    sandbox.assert_clean();
}

#[test]
fn a_split_recording_is_replayed_from_its_first_file() {
    let sandbox = Sandbox::new();
    let args = ["train", "lane_change", "--episodes", "10", "--quiet", "--out", "out"];
    let split = ["--record", "--record-split", "1M"];
    assert!(sandbox.run(&[&args[..], &split].concat()).status.success());
    let part = |number: u32| format!("out/recording-{number:04}.mcap");
    assert!(sandbox.path(&part(3)).exists());
    let output = sandbox.run(&["replay", &part(1)]);
    let (code, out, err) = told(&output);
    assert_eq!(code, Some(0), "{out}{err}");
    let drives = sandbox.result("out")["run"]["drives"].clone();
    let driven = drives["reported"].as_u64().unwrap() + drives["beside"].as_u64().unwrap();
    let compared: u64 = out.split_whitespace().nth(2).unwrap().parse().unwrap();
    // A fleet's drives are compared together, and each tick once.
    assert!(compared >= driven * config("lane_change").ticks() / 6, "{out}{drives}");
    // From the middle nothing can be driven again; and no part may be missing.
    let refused = |file: String, why: &str| {
        let (code, out, err) = told(&sandbox.run(&["replay", &file]));
        assert_eq!(code, Some(64), "{out}{err}");
        assert!(err.contains(why) && err.trim_end().lines().count() == 1, "{err}");
    };
    refused(part(2), "is part 2 of a recording, after recording-0001.mcap; name the first one");
    fs::copy(sandbox.path(&part(3)), sandbox.path(&part(2))).unwrap();
    refused(part(1), "recording-0002.mcap is not part 2");
    fs::remove_file(sandbox.path(&part(2))).unwrap();
    refused(part(1), "is continued in recording-0002.mcap");
    sandbox.assert_clean();
}

#[test]
fn a_recording_with_a_flipped_bit_is_refused_or_the_same() {
    let sandbox = Sandbox::new();
    let args = ["drive", "lane_change", "--quiet", "--record", "--gains", "3,21,21,.7"];
    assert!(sandbox.run(&[&args[..], &["--out", "out"]].concat()).status.success());
    let bytes = fs::read(sandbox.path("out/recording.mcap")).unwrap();
    let flips: usize = std::env::var("PATHTUNE_FLIPS").map_or(40, |it| it.parse().unwrap());
    let flipped = sandbox.path("flipped.mcap").display().to_string();
    let mut same = 0;
    for flip in 0..flips {
        let bit = (flip * 8 * bytes.len() + 5 * flip) / flips;
        let mut changed = bytes.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        fs::write(&flipped, changed).unwrap();
        // In bounded memory, however large the numbers in the file.
        let replay = "ulimit -v 2000000; exec \"$0\" replay \"$1\"";
        let output = Command::new("sh")
            .args(["-c", replay, env!("CARGO_BIN_EXE_pathtune"), &flipped])
            .env("XDG_RUNTIME_DIR", sandbox.path("r"))
            .output()
            .unwrap();
        let (code, out, err) = told(&output);
        match code {
            Some(0) => same += usize::from(out.starts_with("no difference: 500 ticks")),
            code => {
                assert!(code == Some(64) && err.trim_end().lines().count() == 1, "{bit}: {err}")
            }
        }
    }
    assert!(same < flips / 2, "{same}");
    sandbox.assert_clean();
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let sandbox = Sandbox::new();
    let file = record(&sandbox, "lane_change", "3,21,21,.7");
    let bytes = fs::read(&file).unwrap();
    let cut = sandbox.path("cut.mcap");
    fs::write(&cut, &bytes[..bytes.len() - bytes.len() / 4]).unwrap();
    let text = sandbox.path("text.mcap");
    fs::write(&text, "x_m,y_m\n").unwrap();
    let old = sandbox.path("old.mcap");
    let layout = recorder::layout_digest();
    let at = bytes.windows(layout.len()).position(|it| it == layout.as_bytes()).unwrap();
    let mut changed = bytes.clone();
    changed[at..at + layout.len()].fill(b'0');
    fs::write(&old, changed).unwrap();
    // A first record of 2^64 - 1 bytes.
    let endless = sandbox.path("endless.mcap");
    let mut changed = bytes.clone();
    changed[9..17].fill(0xff);
    fs::write(&endless, changed).unwrap();
    let folder = sandbox.path("folder");
    fs::create_dir(&folder).unwrap();
    for (file, more, part) in [
        (folder.display().to_string(), &[][..], "not a regular file"),
        (endless.display().to_string(), &[], "was cut off"),
        (old.display().to_string(), &[], "was made by an earlier version of pathtune; "),
        (cut.display().to_string(), &[], "cut off"),
        (text.display().to_string(), &[], "not a recording"),
        (sandbox.path("none.mcap").display().to_string(), &[], "failed to read"),
        (file.clone(), &["--gains", "3,21,21"], "holds 3 numbers"),
        (file.clone(), &["--set", "drive.colour=1"], "no such key"),
        (file, &["--speed", "0"], "--speed"),
    ] {
        let output = sandbox.run(&[&["replay", &file][..], more].concat());
        let (code, out, err) = told(&output);
        assert_eq!(code, Some(64), "{part}: {out}{err}");
        assert!(err.contains(part) && err.trim_end().lines().count() == 1, "{part}: {err}");
    }
    sandbox.assert_clean();
}

#[test]
fn a_replay_works_in_a_folder_that_nobody_else_knows() {
    let sandbox = Sandbox::new();
    let args = ["drive", "lane_change", "--quiet", "--record", "--gains", "3,21,21,.7"];
    assert!(sandbox.run(&[&args[..], &["--out", "out"]].concat()).status.success());
    let temporary = sandbox.path("t");
    fs::create_dir(&temporary).unwrap();
    let args = ["replay", "out/recording.mcap", "--realtime"];
    let replay = sandbox.command(&args).env("TMPDIR", &temporary).spawn().unwrap();
    let until = Instant::now() + Duration::from_secs(30);
    let folder = loop {
        let entry = fs::read_dir(&temporary).unwrap().flatten().next();
        match entry.filter(|it| it.path().join("config.toml").exists()) {
            Some(entry) => break entry,
            None => assert!(Instant::now() < until, "no folder"),
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    let name = folder.file_name().into_string().unwrap();
    assert!(name.starts_with("pathtune-replay-") && !name.contains(&replay.id().to_string()));
    assert_eq!(folder.metadata().unwrap().permissions().mode() & 0o777, 0o700);
    support::signal(replay.id() as i32, Signal::INT);
    let output = replay.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{:?}", told(&output));
    assert_eq!(fs::read_dir(&temporary).unwrap().count(), 0, "{name} is left");
    sandbox.assert_clean();
}

#[test]
fn what_a_killed_replay_leaves_is_removed_and_what_a_living_one_needs_is_not() {
    let sandbox = Sandbox::new();
    let args = ["drive", "lane_change", "--quiet", "--record", "--gains", "3,21,21,.7"];
    assert!(sandbox.run(&[&args[..], &["--out", "out"]].concat()).status.success());
    let temporary = sandbox.path("t");
    // A folder of that name which others may enter is not ours.
    let open = temporary.join("pathtune-replay-open");
    fs::create_dir_all(&open).unwrap();
    fs::set_permissions(&open, fs::Permissions::from_mode(0o755)).unwrap();
    let here = |args: &[&str]| {
        let mut command = sandbox.command(args);
        command.env("TMPDIR", &temporary);
        command
    };
    let mut replay = here(&["replay", "out/recording.mcap", "--realtime"]).spawn().unwrap();
    let wait = |what: &str, done: &dyn Fn() -> bool| {
        let until = Instant::now() + Duration::from_secs(30);
        while !done() {
            assert!(Instant::now() < until, "{what}");
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    let folders = || fs::read_dir(&temporary).unwrap().flatten().collect::<Vec<_>>();
    wait("no folder", &|| folders().iter().any(|it| it.path().join("launch.toml").exists()));
    // Old enough to be taken for left, but for its lock.
    std::thread::sleep(Duration::from_millis(2200));
    let clean = || assert!(here(&["clean"]).output().unwrap().status.success());
    clean();
    assert_eq!(folders().len(), 2);
    replay.kill().unwrap();
    replay.wait().unwrap();
    wait("the folder is left", &|| {
        clean();
        folders().len() == 1
    });
    assert!(open.exists());
    sandbox.assert_clean();
}
