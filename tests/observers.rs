//! Observers come, go, freeze and die at random moments, and a training does not notice.

mod support;

use std::fs;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use ipc_types::{Command as WireCommand, Odometry, RawCommand, TrackingError};
use runtime::observer::{MAX_OBSERVERS, Observer, ObserverError};
use rustix::process::Signal;
use support::{Sandbox, signal};

/// Observers that are attached in all.
const OBSERVERS: usize = 200;

#[test]
fn two_hundred_observers_change_nothing_and_leave_nothing() {
    let alone = Sandbox::new();
    let args = ["lane_change", "--no-memo", "--episodes", "12"];
    let digest = alone.train("out", &args)["digest"].clone();

    let sandbox = Sandbox::new();
    let mut spread = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = move |below: u64| {
        spread ^= spread << 13;
        spread ^= spread >> 7;
        spread ^= spread << 17;
        spread % below
    };
    let mut living: Vec<(Child, Instant)> = Vec::new();
    let mut attached = 0;
    let mut trainings = 0;
    while attached < OBSERVERS {
        trainings += 1;
        let out = format!("out{trainings}");
        let mut training = sandbox.start_training(&out, &args);
        training.wait_until_it_drives();
        while attached < OBSERVERS && !training.is_over() {
            let now = Instant::now();
            // Some end in order, some are killed, at once or while they start, and some freeze before.
            living.retain_mut(|(child, until)| {
                if now < *until {
                    return child.try_wait().unwrap().is_none();
                }
                let pid = child.id() as i32;
                match random(4) {
                    0 => signal(pid, Signal::TERM),
                    1 => {
                        signal(pid, Signal::STOP);
                        *until = now + Duration::from_millis(100);
                        return random(2) == 0 || {
                            let _ = child.kill();
                            let _ = child.wait();
                            false
                        };
                    }
                    _ => {
                        let _ = child.kill();
                    }
                }
                signal(pid, Signal::CONT);
                let _ = child.wait();
                false
            });
            if living.len() < 6 {
                let life = Duration::from_micros(random(60_000));
                living.push((observer(&sandbox), now + life));
                attached += 1;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        for (mut child, _) in living.drain(..) {
            let _ = child.kill();
            let _ = child.wait();
        }
        let result = training.succeed();
        assert_eq!(result["digest"], digest);
        for process in result["processes"].as_array().unwrap() {
            assert_eq!(process["restarts"], 0, "{process}");
        }
    }
    sandbox.assert_clean();
}

#[test]
fn there_is_room_for_sixteen_and_the_dead_make_room() {
    let sandbox = Sandbox::new();
    let vehicle = ["--chaos", "delay odometry 2ms"];
    let mut training =
        sandbox.start_training("out", &[&["lane_change", "--no-memo"][..], &vehicle].concat());
    training.wait_for("the run", || sandbox.run(&["status", "--json"]).stdout.len() > 40);
    let mut observers: Vec<Child> = (0..MAX_OBSERVERS).map(|_| observer(&sandbox)).collect();
    let names = sandbox.living_run();
    let places = names.root.join("observers");
    // One that is only just being made has a name that begins with a dot.
    let is_made = |entry: std::io::Result<fs::DirEntry>| {
        entry.is_ok_and(|entry| !entry.file_name().to_string_lossy().starts_with('.'))
    };
    let count = || {
        fs::read_dir(&places)
            .map_or(0, |entries| entries.filter_map(|it| is_made(it).then_some(())).count())
    };
    training.wait_for("all observers", || count() == MAX_OBSERVERS);
    let refused = Observer::attach(&names).err().expect("there is no room");
    assert!(matches!(refused, ObserverError::Full), "{refused}");
    // One that is killed gives its place back only when it was cleaned up behind.
    observers[3].kill().unwrap();
    observers[3].wait().unwrap();
    training.wait_for("a place", || count() == MAX_OBSERVERS - 1);
    let one_more = Observer::attach(&names).unwrap();
    drop(one_more);
    for mut child in observers {
        let _ = child.kill();
        let _ = child.wait();
    }
    training.wait_for("the clean-up", || count() == 0);
    signal(training.id(), Signal::INT);
    assert_eq!(training.finish().status.code(), Some(130));
    sandbox.assert_clean();
}

fn observer(sandbox: &Sandbox) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "observer_process", "--ignored", "--nocapture"])
        .env("XDG_RUNTIME_DIR", sandbox.path("r"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// Not a test: an observer that reads what it gets until it is asked to stop.
#[test]
#[ignore = "a process of the tests above"]
fn observer_process() {
    let Some(names) = runtime::run::living_runs().pop() else { return };
    let Ok(observer) = Observer::attach(&names) else { return };
    let bus = observer.bus();
    let Ok(odometry) = bus.observe::<Odometry>() else { return };
    let Ok(raw_commands) = bus.observe::<RawCommand>() else { return };
    let Ok(commands) = bus.observe::<WireCommand>() else { return };
    let Ok(errors) = bus.observe::<TrackingError>() else { return };
    let until = Instant::now() + Duration::from_secs(30);
    while Instant::now() < until && names.root.exists() {
        while odometry.receive().is_ok_and(|it| it.is_some()) {}
        while raw_commands.receive().is_ok_and(|it| it.is_some()) {}
        while commands.receive().is_ok_and(|it| it.is_some()) {}
        while errors.receive().is_ok_and(|it| it.is_some()) {}
        std::thread::sleep(Duration::from_millis(1));
    }
}
