//! What attacks and loaded machines once broke: each test names what must not happen again.

mod support;

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use rustix::process::Signal;
use support::{Sandbox, signal};

const SHORT: [&str; 4] = ["lane_change", "--episodes", "5", "--no-memo"];

#[test]
fn a_process_that_is_stopped_is_noticed_and_replaced() {
    let sandbox = Sandbox::new();
    let mut training = sandbox.start_training("out", &SHORT);
    training.wait_until_it_drives();
    let pid = sandbox.service("controller").unwrap();
    signal(pid, Signal::STOP);
    training
        .wait_for("the restart", || sandbox.service("controller").is_some_and(|new| new != pid));
    training.succeed();
    sandbox.assert_clean();
}

#[test]
fn what_gives_up_says_how_to_go_on() {
    let sandbox = Sandbox::new();
    let args = ["train", "lane_change", "--no-memo", "--restart-budget", "0", "--out", "out"];
    let chaos = ["--chaos", "kill simulator@drive=2", "--quiet"];
    let output = sandbox.run(&[&args[..], &chaos].concat());
    assert_eq!(output.status.code(), Some(70));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let last = said.trim_end().lines().last().unwrap();
    assert!(last.contains("pathtune train --resume") && last.ends_with("/out"), "{said}");
    sandbox.resume_training("out", &["--quiet"]).succeed();
    sandbox.assert_clean();
}

#[test]
fn a_kill_at_the_start_of_a_resume_leaves_every_file_whole() {
    let sandbox = Sandbox::new();
    let mut training =
        sandbox.start_training("out", &["lane_change", "--episodes", "8", "--no-memo", "--quiet"]);
    training.wait_until_it_drives();
    signal(training.id(), Signal::KILL);
    training.finish();
    let files = ["config.toml", "launch.toml"].map(|name| sandbox.path("out").join(name));
    let before = files.clone().map(|file| fs::read(file).unwrap());
    for delay_us in (0..20_000).step_by(400) {
        let resumed = sandbox.resume_training("out", &["--quiet"]);
        std::thread::sleep(Duration::from_micros(delay_us));
        signal(resumed.id(), Signal::KILL);
        resumed.finish();
        for (file, before) in files.iter().zip(&before) {
            assert!(fs::read(file).unwrap() == *before, "{file:?} after {delay_us} µs");
        }
    }
    // A runtime folder without a lock is that of a run which is just starting, for ten seconds: it may still be there.
    sandbox.resume_training("out", &["--quiet"]).succeed();
}

#[test]
fn links_in_a_run_s_folder_are_not_followed() {
    let sandbox = Sandbox::new();
    sandbox.train("out", &["lane_change", "--episodes", "1"]);
    let victim = sandbox.path("victim");
    fs::create_dir(&victim).unwrap();
    fs::write(victim.join("mine.svg"), "mine").unwrap();
    fs::remove_dir_all(sandbox.path("out/report")).unwrap();
    symlink(&victim, sandbox.path("out/report")).unwrap();
    let output = sandbox.run(&["report", "out"]);
    assert!(!output.status.success());
    assert_eq!(fs::read_dir(&victim).unwrap().count(), 1);
    let lock = sandbox.path("out/lock");
    fs::remove_file(&lock).unwrap();
    symlink(victim.join("mine.svg"), &lock).unwrap();
    let output = sandbox.run(&["train", "--resume", "out", "--quiet"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(64), "{said}");
    assert!(said.contains("link"), "{said}");
    assert_eq!(fs::read_to_string(victim.join("mine.svg")).unwrap(), "mine");
}

#[test]
fn what_kills_left_is_removed_by_the_next_call() {
    let sandbox = Sandbox::new();
    sandbox.train("out", &["lane_change", "--episodes", "1"]);
    fs::write(sandbox.path("car.toml"), "name = \"mine\"\n").unwrap();
    let left = [".car.toml.part", "out/report/index.part-1234", "out/report/old.part"];
    for file in left {
        fs::write(sandbox.path(file), "half of it").unwrap();
    }
    assert!(sandbox.run(&["gains", "promote", "out", "car.toml", "--dry-run"]).status.success());
    assert!(sandbox.run(&["report", "out"]).status.success());
    for file in left {
        assert!(!sandbox.path(file).exists(), "{file}");
    }
}

#[test]
fn a_runtime_folder_that_others_can_enter_is_not_believed() {
    let sandbox = Sandbox::new();
    // A folder as a stranger would make it, with a state that names a process of the user's.
    let mut sleeper = Command::new("sleep").arg("60").stdin(Stdio::null()).spawn().unwrap();
    let base = sandbox.path("r/pathtune");
    let root = base.join("00000000000000aa");
    fs::create_dir_all(&root).unwrap();
    let state = |pid: u32| {
        format!(
            r#"{{"run":"00000000000000aa","pid":{pid},"maneuver":"x","folder":"/","batch":1,"attempt":0,"tick":0,"processes":[]}}"#
        )
    };
    let open = fs::Permissions::from_mode(0o777);
    for folder in [&base, &root] {
        fs::set_permissions(folder, open.clone()).unwrap();
    }
    let lock = fs::File::create(root.join("lock")).unwrap();
    lock.lock().unwrap();
    for pid in [sleeper.id(), u32::MAX] {
        fs::write(root.join("run.json"), state(pid)).unwrap();
        assert_eq!(sandbox.run(&["stop"]).status.code(), Some(64));
    }
    assert!(sleeper.try_wait().unwrap().is_none(), "a process that is no run was signalled");
    let _ = sleeper.kill();
    let _ = sleeper.wait();
}

/// The pid of a run means nothing in another container: it is asked by a file in its folder.
#[test]
fn stop_from_another_container_stops_the_run_and_nobody_else() {
    let sandbox = Sandbox::new();
    let unshare = ["--pid", "--fork", "--mount-proc", "--kill-child"];
    let works = Command::new("unshare").args(unshare).arg("true").output();
    if !works.is_ok_and(|output| output.status.success()) {
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "no namespaces");
        eprintln!("skipped: this user may not make namespaces");
        return;
    }
    let in_container = |args: &[&str]| {
        let binary = sandbox.command::<&str>(&[]).get_program().to_owned();
        let mut command = Command::new("unshare");
        command
            .args(unshare)
            .arg(binary)
            .args(args)
            .current_dir(sandbox.path("."))
            .env("XDG_RUNTIME_DIR", sandbox.path("r"))
            .stdin(Stdio::null());
        command
    };
    let mut run = in_container(&["train", "lane_change", "--no-memo", "--quiet", "--out", "out"])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let since = std::time::Instant::now();
    while !sandbox.has_living_run() {
        assert!(since.elapsed() < Duration::from_secs(30), "it does not drive");
        std::thread::sleep(Duration::from_millis(50));
    }
    let stopped = in_container(&["stop"]).output().unwrap();
    assert!(stopped.status.success(), "{}", String::from_utf8_lossy(&stopped.stderr));
    assert_eq!(run.wait().unwrap().code(), Some(130));
}

#[test]
fn stop_names_a_run_elsewhere_only_if_it_is_named() {
    let sandbox = Sandbox::new();
    let mut training = sandbox.start_training("out", &["lane_change", "--no-memo"]);
    training.wait_until_it_drives();
    fs::create_dir(sandbox.path("elsewhere")).unwrap();
    let stop = |args: &[&str]| {
        let args = [&["stop"], args].concat();
        sandbox.command(&args).current_dir(sandbox.path("elsewhere")).output().unwrap()
    };
    let refused = stop(&[]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(64), "{said}");
    assert!(said.contains("pathtune stop "), "{said}");
    let name = said.trim_end().rsplit(' ').next().unwrap().to_owned();
    assert!(stop(&[&name]).status.success());
    assert_eq!(training.finish().status.code(), Some(130));
    sandbox.assert_clean();
}

#[test]
fn variables_of_ours_in_the_user_s_environment_do_not_reach_the_processes() {
    let sandbox = Sandbox::new();
    let mut command = sandbox.command(&["train", "lane_change", "--episodes", "1", "--out", "out"]);
    command.env("PATHTUNE_CHAOS", "kill simulator@drive=1").env("PATHTUNE_FIFO", "99");
    assert!(command.output().unwrap().status.success());
    let result = sandbox.result("out");
    for process in result["processes"].as_array().unwrap() {
        assert_eq!(process["restarts"], 0, "{process}");
    }
    assert!(!sandbox.text("out/logs/simulator.log").contains("chaos"));
}

#[test]
fn pipes_and_devices_are_refused_as_files() {
    let sandbox = Sandbox::new();
    let pipe = sandbox.path("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    fs::write(sandbox.path("mine.toml"), "name = \"mine\"\n").unwrap();
    let check = |args: &[&str]| {
        let output = sandbox.run(&[&["train"], args].concat());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(64), "{args:?}: {said}");
        assert_eq!(said.trim_end().lines().count(), 1, "{said}");
    };
    // Those that a run has left, too.
    let run = sandbox.path("left");
    fs::create_dir_all(run.join("logs")).unwrap();
    fs::copy(sandbox.path("mine.toml"), run.join("config.toml")).unwrap();
    for name in ["result.json", "logs/simulator.log"] {
        fs::hard_link(&pipe, run.join(name)).unwrap();
    }
    for args in [
        &["report", "left"][..],
        &["gains", "promote", "left", "mine.toml"],
        &["gains", "promote", "left", "pipe"],
        &["drive", "lane_change", "--from", "left"],
    ] {
        assert!(!sandbox.run(args).status.success(), "{args:?}");
    }
    assert!(sandbox.run(&["logs", "left"]).status.success());
    for file in ["pipe", "/dev/zero"] {
        assert!(Path::new(file).is_absolute() || pipe.exists());
        check(&["--path", file]);
        check(&["lane_change", "--config", file]);
        check(&["lane_change", "--vehicle", file]);
        check(&["lane_change", "--law", file]);
        check(&["lane_change", "--launch", file]);
    }
    sandbox.assert_clean();
}

/// A run under limits that a shell sets; returns what it says, and its exit code.
fn under(sandbox: &Sandbox, limit: &str, args: &str) -> (String, Option<i32>) {
    let script = format!("{limit}; exec {} {args}", env!("CARGO_BIN_EXE_pathtune"));
    let output = Command::new("sh")
        .args(["-c", &script])
        .current_dir(sandbox.path("."))
        .env("XDG_RUNTIME_DIR", sandbox.path("r"))
        .stdin(Stdio::null())
        .output()
        .unwrap();
    (String::from_utf8_lossy(&output.stderr).into_owned(), output.status.code())
}

#[test]
fn limits_that_are_too_low_are_told_in_a_line() {
    let sandbox = Sandbox::new();
    let train = "train lane_change --episodes 1 --quiet --out out";
    for (limit, args, part) in [
        ("ulimit -n 20", train, "ulimit -n 4096"),
        ("ulimit -n 20", "conformance -- pathtune service simulator", "ulimit -n 4096"),
        ("ulimit -s 128", train, "ulimit -s 8192"),
        ("ulimit -s 128", "config list", "ulimit -s 8192"),
        ("ulimit -f 100", train, "ulimit -f unlimited"),
        ("ulimit -f 100", "grid lane_change --out out", "ulimit -f unlimited"),
        ("export PATHTUNE_LOG_MIB=none", train, "PATHTUNE_LOG_MIB"),
    ] {
        let (said, code) = under(&sandbox, limit, args);
        assert_eq!(code, Some(64), "{limit}: {args}: {said}");
        assert!(said.contains(part) && said.lines().count() == 1, "{limit}: {args}: {said}");
        assert!(!sandbox.path("out").exists());
    }
    // Where no run is checked for it, a file that becomes too long is an error, too.
    let (said, code) = under(&sandbox, "ulimit -f 1; exec >long", "schema --python");
    assert!(code == Some(1) && said.contains("File too large"), "{code:?}: {said}");
    // What may be raised is raised.
    let (said, code) = under(&sandbox, "ulimit -S -n 20; ulimit -S -s 512", train);
    assert_eq!(code, Some(0), "{said}");
    sandbox.assert_clean();
}

#[test]
fn an_observer_without_shared_memory_is_refused_in_a_line() {
    let works = Command::new("unshare").args(["--mount", "true"]).output();
    if !works.is_ok_and(|output| output.status.success()) {
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "no namespaces");
        eprintln!("skipped: this user may not make namespaces");
        return;
    }
    let sandbox = Sandbox::new();
    let script = format!(
        "mount -t tmpfs -o size=64m none /dev/shm || exit 1\n\
         run() {{ {} \"$@\"; }}\n\
         run train lane_change --no-memo --quiet --out out >train.out 2>&1 & pid=$!\n\
         until run status --json | grep -q '\"batch\":[1-9]'; do sleep .1; done\n\
         head -c 80m /dev/zero >/dev/shm/full 2>/dev/null\n\
         run monitor --once; echo \"monitor $?\"\n\
         run record --for 1s; echo \"record $?\"\n\
         run stop; echo \"stop $?\"; wait $pid; echo \"train $?\"\n",
        env!("CARGO_BIN_EXE_pathtune")
    );
    let output = Command::new("unshare")
        .args(["--mount", "sh", "-c", &script])
        .current_dir(sandbox.path("."))
        .env("XDG_RUNTIME_DIR", sandbox.path("r"))
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let (told, said) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    for end in ["monitor 64", "record 64", "stop 0", "train 130"] {
        assert!(told.contains(end), "{told}{said}");
    }
    assert_eq!(said.matches("/dev/shm is too small: an observer needs 4 MiB").count(), 2, "{said}");
    assert_eq!(said.trim().lines().count(), 2, "{said}");
}

#[test]
fn starts_do_not_race_with_ends_nor_with_the_clean_up() {
    let sandbox = Sandbox::new();
    let is_over = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                assert!(sandbox.run(&["clean"]).status.success());
            }
        });
        let workers: Vec<_> = (0..3)
            .map(|worker| {
                let sandbox = &sandbox;
                scope.spawn(move || {
                    for number in 0..3 {
                        // The shortest run that there is.
                        let out = format!("out{worker}-{number}");
                        sandbox.json(&out, &["drive", "lane_change"]);
                    }
                })
            })
            .collect();
        let ends: Vec<_> = workers.into_iter().map(|worker| worker.join()).collect();
        is_over.store(true, std::sync::atomic::Ordering::Relaxed);
        assert!(ends.iter().all(Result::is_ok));
    });
    sandbox.assert_clean();
}

#[test]
fn status_says_where_a_run_is_and_how_iceoryx2_sees_it() {
    let sandbox = Sandbox::new();
    let mut training = sandbox.start_training("out", &["lane_change", "--no-memo", "--quiet"]);
    training.wait_until_it_drives();
    let names = sandbox.living_run();
    let status = sandbox.run(&["status", "--json", &format!("{:016x}", names.run)[..6]]);
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
    let run = &status["runs"][0];
    assert_eq!(run["root"], names.root.display().to_string());
    assert_eq!(run["prefix"], names.prefix());
    assert_eq!(run["folder"], fs::canonicalize(sandbox.path("out")).unwrap().display().to_string());
    let printed = sandbox.run(&["status", "--iox2"]);
    let config: toml::Table = toml::from_str(&String::from_utf8_lossy(&printed.stdout)).unwrap();
    assert_eq!(config["global"]["prefix"].as_str(), Some(&*names.prefix()));
    // A run is named alike everywhere: by its number or its folder, after the command.
    let number = format!("{:016x}", names.run);
    for args in [
        &["status", "out"][..],
        &["logs", "out"],
        &["monitor", &number, "--once"],
        &["monitor", "--run", "out", "--once"],
        &["record", "out", "--for", "100ms"],
        &["stop", "out"],
    ] {
        let output = sandbox.run(args);
        assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
    assert_eq!(training.finish().status.code(), Some(130));
    sandbox.assert_clean();
}
