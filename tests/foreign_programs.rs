//! Programs of the user's in a role: whatever they start ends with them, and whatever they print is bounded.

mod support;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use support::{Sandbox, signal};

/// A vehicle that starts another process, which leaves its session and forgets where it comes from. Returns its command,
/// and an argument by which the other process is known.
fn vehicle_with_a_stray(sandbox: &Sandbox, more: &str) -> (String, String) {
    let nanos = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    let mark = format!("98765.{}", nanos.as_nanos());
    let script = format!(
        "#!/bin/sh\nenv -i setsid sh -c 'sleep {mark} & sleep {mark}' &\n{more}\nexec {} service simulator\n",
        env!("CARGO_BIN_EXE_pathtune")
    );
    let path = sandbox.path("vehicle.sh");
    fs::write(&path, script).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    (format!("vehicle={}", path.display()), mark)
}

/// How many processes have this argument.
fn count(mark: &str) -> usize {
    let has_it = |entry: &fs::DirEntry| {
        let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        line.split(|byte| *byte == 0).any(|word| word == mark.as_bytes())
    };
    fs::read_dir("/proc").unwrap().flatten().filter(has_it).count()
}

fn wait_until_gone(mark: &str) {
    let until = Instant::now() + Duration::from_secs(10);
    while count(mark) > 0 {
        assert!(Instant::now() < until, "{} processes live on", count(mark));
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn after_kill_9_of_the_orchestrator_nothing_of_a_foreign_program_lives_on() {
    let sandbox = Sandbox::new();
    let (vehicle, mark) = vehicle_with_a_stray(&sandbox, "");
    let args = ["lane_change", "--no-memo", "--quiet", "--replace", &vehicle];
    let mut training = sandbox.start_training("out", &args);
    training.wait_until_it_drives();
    assert_eq!(count(&mark), 2);
    signal(training.id(), Signal::KILL);
    training.finish();
    wait_until_gone(&mark);
    sandbox.wait_until_nobody_lives();
    // Its guardian may be killed as well; then the orchestrator does its work.
    let mut training = sandbox.resume_training("out", &["--quiet"]);
    training.wait_for("the stray", || count(&mark) == 2);
    let guardian = sandbox.service("guardian").unwrap();
    signal(guardian, Signal::KILL);
    training.wait_for("another guardian", || {
        sandbox.service("guardian").is_some_and(|new| new != guardian) && count(&mark) == 2
    });
    training.interrupt();
    assert_eq!(training.finish().status.code(), Some(130));
    assert_eq!(count(&mark), 0);
    sandbox.assert_clean();
}

/// As above, where no control group can be made.
#[test]
fn what_a_foreign_program_has_started_ends_with_it_without_a_control_group() {
    let sandbox = Sandbox::new();
    let (vehicle, mark) = vehicle_with_a_stray(&sandbox, "");
    let Some(mut run) = train_without_control_groups(&sandbox, &vehicle, &mark) else { return };
    signal(run.id() as i32, Signal::KILL);
    run.wait().unwrap();
    wait_until_gone(&mark);
    sandbox.wait_until_nobody_lives();
    // What a kill leaves of the run itself is swept by the next command.
    assert!(sandbox.run(&["clean"]).status.success());
    sandbox.assert_clean();
}

#[test]
fn what_orchestrator_and_guardian_leave_when_both_are_killed_is_ended_by_the_next_command() {
    let sandbox = Sandbox::new();
    let (vehicle, mark) = vehicle_with_a_stray(&sandbox, "");
    let Some(mut run) = train_without_control_groups(&sandbox, &vehicle, &mark) else { return };
    let guardian = sandbox.service("guardian").unwrap();
    // So that it cannot do its work before it is killed.
    signal(guardian, Signal::STOP);
    signal(run.id() as i32, Signal::KILL);
    signal(guardian, Signal::KILL);
    run.wait().unwrap();
    sandbox.wait_until_nobody_lives();
    assert_eq!(count(&mark), 2, "nobody is left who could end them");
    assert!(sandbox.run(&["clean"]).status.success());
    assert_eq!(count(&mark), 0);
    sandbox.assert_clean();
}

/// A training that drives, where no control group can be made; none if this user may not make namespaces.
fn train_without_control_groups(sandbox: &Sandbox, vehicle: &str, mark: &str) -> Option<Child> {
    let hide = "mount -t tmpfs none /sys/fs/cgroup && exec \"$0\" \"$@\"";
    let hidden = ["--mount", "sh", "-c", hide];
    let works = Command::new("unshare").args(hidden).arg("true").output();
    if !works.is_ok_and(|output| output.status.success()) {
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "no namespaces");
        eprintln!("skipped: this user may not make namespaces");
        return None;
    }
    // unshare and sh become the orchestrator.
    let run = Command::new("unshare")
        .args(hidden)
        .arg(env!("CARGO_BIN_EXE_pathtune"))
        .args(["train", "lane_change", "--no-memo", "--quiet", "--out", "out"])
        .args(["--replace", vehicle])
        .current_dir(sandbox.path("."))
        .env("XDG_RUNTIME_DIR", sandbox.path("r"))
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let until = Instant::now() + Duration::from_secs(60);
    while !(sandbox.has_living_run() && count(mark) == 2) {
        assert!(Instant::now() < until, "it does not drive");
        std::thread::sleep(Duration::from_millis(20));
    }
    Some(run)
}

#[test]
fn a_program_that_prints_without_end_does_not_fill_the_disk() {
    let sandbox = Sandbox::new();
    let (vehicle, mark) = vehicle_with_a_stray(&sandbox, "yes 'a line of no use' &");
    let mut command = sandbox.command(&["train", "lane_change", "--no-memo", "--out", "out"]);
    let child = command
        .args(["--replace", &vehicle])
        .env("PATHTUNE_LOG_MIB", "1")
        // Our own logs are long, too.
        .env("PATHTUNE_LOG", "trace")
        .spawn()
        .unwrap();
    let log = sandbox.path("out/logs/vehicle.log");
    let until = Instant::now() + Duration::from_secs(60);
    while !runtime::log_file::is_cut(&log) {
        assert!(Instant::now() < until, "the log is not cut");
        std::thread::sleep(Duration::from_millis(50));
    }
    // It is looked for once a second, on a loaded machine less often. What is told stands in our own log, too.
    let own =
        ["orchestrator.log", "orchestrator.log.old"].map(|it| sandbox.path("out/logs").join(it));
    let is_told = || {
        let texts = own.iter().map(|log| fs::read(log).unwrap_or_default());
        texts
            .into_iter()
            .any(|text| String::from_utf8_lossy(&text).contains("vehicle writes a long log"))
    };
    while !is_told() {
        assert!(Instant::now() < until, "nothing is told of the cut");
        std::thread::sleep(Duration::from_millis(5));
    }
    signal(child.id() as i32, Signal::INT);
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert_eq!(said.matches("vehicle writes a long log").count(), 1, "{said}");
    assert!(said.contains("go on with: pathtune train --resume"), "{said}");
    assert!(sandbox.text("out/logs/vehicle.log").lines().next().unwrap().contains("left out"));
    for entry in fs::read_dir(sandbox.path("out/logs")).unwrap().flatten() {
        let bytes = entry.metadata().unwrap().len();
        assert!(bytes <= (512 << 10) + 1024, "{:?}: {bytes} bytes", entry.file_name());
    }
    assert_eq!(count(&mark), 0);
    sandbox.assert_clean();
}
