//! Nothing lost: kills, freezes, lost messages, full disks, other users; the same digest, and nothing left.

mod support;

use std::fs;
use std::io::Write;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::process::Command as Program;
use std::time::{Duration, Instant};

use ipc_types::{Command, Odometry};
use runtime::Bus;
use rustix::process::Signal;
use serde_json::Value;
use support::{Sandbox, signal};

/// A training of some seconds, that drives every step.
const TRAINING: [&str; 4] = ["lane_change", "--episodes", "6", "--no-memo"];
const SERVICES: [&str; 4] = ["simulator", "supervisor", "controller", "trainer"];

fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
    TRAINING.iter().copied().chain(more.iter().copied()).collect()
}

/// Kills until the training is over: any service, or the orchestrator, at any moment, start-up included.
///
/// `PATHTUNE_KILLS` sets how many; the seed of a failure is in its message.
#[test]
fn kills_at_random_moments_change_no_byte() {
    let kills: u32 =
        std::env::var("PATHTUNE_KILLS").ok().and_then(|kills| kills.parse().ok()).unwrap_or(40);
    let sandbox = Sandbox::new();
    let episodes = if kills > 100 { "80" } else { "6" };
    let args = ["lane_change", "--no-memo", "--episodes", episodes];
    let calm = sandbox.train("calm", &args);

    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = |below: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) % below
    };
    let mut training =
        sandbox.start_training("killed", &[&args[..], &["--restart-budget", "100000"]].concat());
    let (mut done, mut orchestrators, mut last) = (0, 0, training.id());
    while done < kills {
        std::thread::sleep(Duration::from_millis(random(90)));
        if training.is_over() {
            break;
        }
        let name = match random(5) {
            4 => "orchestrator",
            index => SERVICES[index as usize],
        };
        if name == "orchestrator" {
            // Not before there is anything to go on with.
            if !sandbox.path("killed/launch.toml").exists() {
                continue;
            }
            last = training.id();
            signal(last, Signal::KILL);
            training.finish();
            orchestrators += 1;
            training = sandbox.resume_training("killed", &["--restart-budget", "100000"]);
        } else if let Some(pid) = sandbox.service(name) {
            signal(pid, Signal::KILL);
        } else {
            continue;
        }
        done += 1;
    }
    let result = training.succeed();
    println!("{done} kills, {orchestrators} of them of the orchestrator (last pid {last})");
    assert!(done >= kills / 2, "the training ended after {done} kills");
    assert_eq!(result["digest"], calm["digest"], "after {done} kills");
    assert_eq!(result["learners"], calm["learners"]);
    sandbox.clean();
    sandbox.assert_clean();
}

#[test]
fn a_killed_clean_up_helper_is_replaced() {
    let sandbox = Sandbox::new();
    let args = ["lane_change", "--episodes", "12", "--no-memo", "--restart-budget", "1000"];
    let calm = sandbox.train("calm", &args);
    let mut training = sandbox.start_training("out", &args);
    let mut helpers = 0;
    // A helper lives for some milliseconds, and may be missed on a busy machine.
    for name in ["simulator", "controller"].into_iter().cycle().take(20) {
        if helpers == 2 || training.is_over() {
            break;
        }
        training.wait_until_it_drives();
        let pid = sandbox.service(name).unwrap();
        signal(pid, Signal::KILL);
        let until = Instant::now() + Duration::from_millis(300);
        while Instant::now() < until {
            if let Some(helper) = sandbox.service("cleaner") {
                signal(helper, Signal::KILL);
                helpers += 1;
                break;
            }
        }
        training.wait_for("the restart", || sandbox.service(name).is_some_and(|new| new != pid));
    }
    let result = training.succeed();
    println!("{helpers} helpers killed");
    assert!(helpers > 0, "no helper was seen");
    assert_eq!(result["digest"], calm["digest"]);
    sandbox.assert_clean();
}

/// An observer that never reads is to the run what a stopped one is.
#[test]
fn an_observer_that_does_not_read_changes_nothing() {
    let sandbox = Sandbox::new();
    let calm = sandbox.train("calm", &TRAINING);
    let mut training = sandbox.start_training("out", &TRAINING);
    training.wait_until_it_drives();
    let run = sandbox.living_run();
    {
        let bus = Bus::attach(&run, 5).unwrap();
        let odometry = bus.observe::<Odometry>().unwrap();
        let commands = bus.observe::<Command>().unwrap();
        // Somebody with another layout under the same topic does not connect.
        assert!(bus.open_as::<Odometry, Command>().is_err());
        assert!(bus.open_as::<Odometry, Odometry>().is_ok());
        std::thread::sleep(Duration::from_secs(1));
        assert!(odometry.receive().unwrap().is_some() && commands.receive().unwrap().is_some());
    }
    assert_eq!(training.succeed()["digest"], calm["digest"]);
    sandbox.assert_clean();
}

#[test]
fn scripted_faults_change_no_byte_and_are_told() {
    let sandbox = Sandbox::new();
    let calm = sandbox.train("calm", &TRAINING);
    let script = "kill controller@drive=12,tick=300; kill simulator@drive=20; \
                  kill supervisor@drive=30,tick=499; kill trainer@drive=40; \
                  stop controller@drive=50,tick=7 for 3s; drop command p=0.00002";
    let result = sandbox.train("faulty", &with(&["--chaos", script]));
    assert_eq!(result["digest"], calm["digest"]);
    assert_eq!(result["run"]["recovery"]["injected"], 5, "{}", result["run"]["recovery"]);
    assert!(
        result["run"]["recovery"]["recoveries"].as_u64().unwrap() >= 4,
        "{}",
        result["run"]["recovery"]
    );
    let restarts = |name: &str| {
        let processes = result["processes"].as_array().unwrap();
        processes.iter().find(|process| process["name"] == name).unwrap()["restarts"].clone()
    };
    assert_eq!(restarts("simulator"), 1);
    assert_eq!(restarts("controller"), 2);
    sandbox.assert_clean();
}

#[test]
fn a_terminal_that_nobody_reads_holds_up_nobody() {
    let sandbox = Sandbox::new();
    let calm = sandbox.train("calm", &TRAINING);
    // Full to the last byte: whoever writes one more waits until somebody reads.
    let (unread, mut terminal) = std::io::pipe().unwrap();
    let capacity = rustix::pipe::fcntl_getpipe_size(&terminal).unwrap();
    terminal.write_all(&vec![b'.'; capacity]).unwrap();
    let faults = ["--chaos", "kill controller@drive=3,tick=50", "--out", "held"];
    let mut command = sandbox.command(&["train"]);
    let mut training = command.args(with(&faults)).stderr(terminal).spawn().unwrap();
    // A loaded machine is slow: the calm training took its time, too.
    let until = Instant::now() + Duration::from_secs(600);
    let status = loop {
        match training.try_wait().unwrap() {
            Some(status) => break status,
            None if Instant::now() > until => {
                training.kill().unwrap();
                panic!("the training waits for its terminal");
            }
            None => std::thread::sleep(Duration::from_millis(10)),
        }
    };
    drop(unread);
    let held = sandbox.result("held");
    assert!(status.success());
    assert_eq!(held["run"]["recovery"]["injected"], 1, "{}", held["run"]["recovery"]);
    assert_eq!(held["digest"], calm["digest"]);
    sandbox.assert_clean();
}

#[test]
fn a_slow_process_is_not_taken_for_a_frozen_one() {
    let sandbox = Sandbox::new();
    let args = ["lane_change", "--episodes", "1", "--set", "drive.loop_time_s=1.5"];
    let calm = sandbox.train("calm", &args);
    let slow = [&args[..], &["--chaos", "delay odometry 5ms"]].concat();
    let slow = sandbox.train("slow", &slow);
    assert_eq!(slow["digest"], calm["digest"]);
    assert_eq!(slow["run"]["recovery"]["recoveries"], 0, "{}", slow["run"]["recovery"]);
    sandbox.assert_clean();
}

#[test]
fn a_frozen_service_is_replaced_within_a_second() {
    let sandbox = Sandbox::new();
    let calm = sandbox.train("calm", &TRAINING);
    for name in SERVICES {
        let mut training = sandbox.start_training(name, &TRAINING);
        training.wait_until_it_drives();
        let pid = sandbox.service(name).unwrap();
        signal(pid, Signal::STOP);
        let frozen = Instant::now();
        training
            .wait_for("the replacement", || sandbox.service(name).is_some_and(|new| new != pid));
        println!("{name}: replaced {:?} after it froze", frozen.elapsed());
        let result = training.succeed();
        assert_eq!(result["digest"], calm["digest"], "{name}");
    }
    sandbox.assert_clean();
}

#[test]
fn a_command_that_never_becomes_ready_ends_by_deadline() {
    let sandbox = Sandbox::new();
    let args = ["--replace", "controller=sleep 1000", "--restart-budget", "0", "--out", "out"];
    let output = sandbox.run(&[&["train", "lane_change"][..], &args].concat());
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(70), "{stderr}");
    let last = stderr.trim_end().lines().last().unwrap();
    assert!(last.contains("controller") && last.contains("not ready within 5 s"), "{last}");
    sandbox.assert_clean();
}

#[test]
fn two_trainings_at_once_do_not_meet_and_one_folder_takes_one() {
    let sandbox = Sandbox::new();
    let alone = sandbox.train("alone", &TRAINING);
    let mut first = sandbox.start_training("first", &TRAINING);
    let second = sandbox.start_training("second", &TRAINING);
    first.wait_until_it_drives();
    for args in [&["train", "--resume", "first"][..], &["train", "lane_change", "--out", "first"]] {
        let output = sandbox.run(args);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(64), "{stderr}");
        assert!(stderr.contains("first"), "{stderr}");
    }
    assert_eq!(first.succeed()["digest"], alone["digest"]);
    assert_eq!(second.succeed()["digest"], alone["digest"]);
    sandbox.assert_clean();
}

#[test]
fn a_stopped_training_goes_on_to_the_same_digest() {
    let sandbox = Sandbox::new();
    let calm = sandbox.train("calm", &TRAINING);
    let mut training = sandbox.start_training("stopped", &TRAINING);
    training.wait_until_it_drives();
    let status = sandbox.run(&["status", "--json"]);
    let status: Value = serde_json::from_slice(&status.stdout).unwrap();
    let run = &status["runs"][0];
    assert_eq!(run["maneuver"], "lane_change");
    assert_eq!(run["pid"], training.id());
    assert_eq!(run["processes"].as_array().unwrap().len(), 4);
    let logs = sandbox.run(&["logs", "--process", "simulator"]);
    assert!(String::from_utf8_lossy(&logs.stdout).contains("ready"));
    assert!(sandbox.run(&["stop"]).status.success());
    assert_eq!(training.finish().status.code(), Some(130));
    let result = sandbox.resume_training("stopped", &[]).succeed();
    assert_eq!(result["digest"], calm["digest"]);
    assert_eq!(result["learners"], calm["learners"]);
    // A finished one has nothing left to drive, and says the same once more.
    let again = sandbox.resume_training("stopped", &[]).succeed();
    assert_eq!(again["digest"], calm["digest"]);
    assert_eq!(again["drives"], calm["drives"]);
    assert_eq!(again["run"]["drives"]["reported"], 0);
    assert_eq!(sandbox.run(&["stop"]).status.code(), Some(64));
    sandbox.assert_clean();
}

#[test]
fn what_a_killed_orchestrator_left_is_listed_and_cleaned() {
    let sandbox = Sandbox::new();
    let mut training = sandbox.start_training("out", &TRAINING);
    training.wait_until_it_drives();
    signal(training.id(), Signal::KILL);
    training.finish();
    sandbox.wait_until_nobody_lives();
    let dry = sandbox.run(&["clean", "--dry-run"]);
    assert!(String::from_utf8_lossy(&dry.stdout).contains("would remove"));
    let doctor = sandbox.run(&["doctor", "--json"]);
    let doctor: Value = serde_json::from_slice(&doctor.stdout).unwrap();
    let leftovers = doctor["checks"].as_array().unwrap().last().unwrap();
    assert_eq!(leftovers["ok"], false);
    assert!(sandbox.run(&["clean"]).status.success());
    sandbox.assert_clean();
}

#[test]
fn a_full_disk_leaves_a_journal_that_goes_on() {
    let sandbox = Sandbox::new();
    let calm = sandbox.train("calm", &TRAINING);
    // A disk of our own, too small for the journal; then a larger one with what was written.
    let script = format!(
        "mkdir small && mount -t tmpfs -o size=200k tmpfs small || exit 99
         {bin} train {args} --out small/out --quiet --restart-budget 1; echo first $?
         mount -o remount,size=50m small
         {bin} train --resume small/out --quiet; echo second $?
         cp small/out/result.json result.json",
        bin = env!("CARGO_BIN_EXE_pathtune"),
        args = TRAINING.join(" ")
    );
    let Some(output) = in_own_mounts(&sandbox, &script) else {
        return skip("a_full_disk_leaves_a_journal_that_goes_on");
    };
    let (stdout, stderr) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(stdout.contains("first 70") || stdout.contains("first 1"), "{stdout}{stderr}");
    assert!(stderr.contains("No space left"), "{stderr}");
    assert!(stdout.contains("second 0"), "{stdout}{stderr}");
    let result: Value =
        serde_json::from_slice(&fs::read(sandbox.path("result.json")).unwrap()).unwrap();
    assert_eq!(result["digest"], calm["digest"]);
    sandbox.assert_clean();
}

#[test]
fn a_shared_memory_that_fills_up_ends_the_run_clearly() {
    let sandbox = Sandbox::new();
    let calm = sandbox.train("calm", &TRAINING);
    // Room enough to begin; then somebody else takes the rest.
    let script = format!(
        "mount -t tmpfs -o size=8m tmpfs /dev/shm || exit 99
         {bin} train {args} --out out --quiet --restart-budget 2 & pid=$!
         sleep 1; dd if=/dev/zero of=/dev/shm/other bs=1k 2>/dev/null
         for service in simulator controller supervisor; do pkill -9 -P $pid -f \"service $service\"; done
         wait $pid; echo first $?
         rm /dev/shm/other
         {bin} train --resume out --quiet; echo second $?
         ls /dev/shm | wc -l",
        bin = env!("CARGO_BIN_EXE_pathtune"),
        args = "lane_change --episodes 6 --no-memo"
    );
    let Some(output) = in_own_mounts(&sandbox, &script) else {
        return skip("a_shared_memory_that_fills_up_ends_the_run_clearly");
    };
    let (stdout, stderr) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(stdout.contains("first 70"), "{stdout}{stderr}");
    assert!(stderr.contains("/dev/shm"), "{stderr}");
    assert!(stdout.contains("second 0"), "{stdout}{stderr}");
    assert_eq!(stdout.trim_end().lines().last(), Some("0"), "segments are left: {stdout}");
    assert_eq!(sandbox.result("out")["digest"], calm["digest"]);
    sandbox.assert_clean();
}

#[test]
fn another_user_sees_nothing_of_a_run() {
    if !rustix::process::geteuid().is_root() {
        return skip("another_user_sees_nothing_of_a_run");
    }
    let sandbox = Sandbox::new();
    // Others may come as far as the runtime folder: what protects the run is its own.
    for folder in [".", "r"] {
        fs::set_permissions(sandbox.path(folder), fs::Permissions::from_mode(0o755)).unwrap();
    }
    let mut training = sandbox.start_training("out", &TRAINING);
    training.wait_until_it_drives();
    let runtime = sandbox.path("r/pathtune");
    assert_eq!(fs::metadata(&runtime).unwrap().mode() & 0o777, 0o700);
    let run = sandbox.only_run();
    let segments = runtime::run::segments_of(run);
    assert!(segments.len() > 20);
    for name in &segments {
        let mode = fs::metadata(format!("/dev/shm/{name}")).unwrap().mode();
        assert_eq!(mode & 0o077, 0, "{name} is open to others: {mode:o}");
    }
    // As another user: list the folder, read and write each segment.
    let script = format!(
        "ls {dir} 2>/dev/null && echo listed
         for f in /dev/shm/{prefix}*; do
             head -c 1 $f >/dev/null 2>&1 && echo read $f
             (: >> $f) 2>/dev/null && echo wrote $f
         done; echo done",
        dir = runtime.display(),
        prefix = runtime::run::prefix(run),
    );
    let output = Program::new("setpriv")
        .args(["--reuid", "65534", "--regid", "65534", "--clear-groups", "sh", "-c", &script])
        .output()
        .unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stdout), "done\n");
    signal(training.id(), Signal::INT);
    training.finish();
    sandbox.assert_clean();
}

/// Runs a script with mounts of its own, where this user may have them.
fn in_own_mounts(sandbox: &Sandbox, script: &str) -> Option<std::process::Output> {
    let output = Program::new("unshare")
        .args(["--mount", "--map-root-user", "sh", "-c", script])
        .current_dir(sandbox.path("."))
        .env("XDG_RUNTIME_DIR", sandbox.path("r"))
        .output()
        .ok()?;
    let refused = output.status.code() == Some(99)
        || String::from_utf8_lossy(&output.stderr).starts_with("unshare");
    (!refused).then_some(output)
}

/// Skips by name; where CI has installed everything, a skip is a failure.
fn skip(name: &str) {
    assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "{name} was skipped");
    eprintln!("SKIPPED {name}: needs root, or mounts of its own");
}
