//! Bad input: one clear line, exit code 64, and nothing left behind.

mod support;

use std::fs;

use support::Sandbox;

/// Runs with bad input; the one line on stderr must hold all parts.
fn check(sandbox: &Sandbox, args: &[&str], parts: &[&str]) {
    let mut all = vec!["train"];
    all.extend(args);
    if !args.contains(&"--out") {
        all.extend(["--out", "out"]);
    }
    let output = sandbox.run(&all);
    let stderr = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(64), "{all:?}: {stderr}");
    assert_eq!(stderr.trim_end().lines().count(), 1, "{all:?}: {stderr}");
    for part in parts {
        assert!(stderr.contains(part), "{all:?}: {part:?} is missing in {stderr:?}");
    }
    assert!(!sandbox.path("out").exists(), "{all:?} left its folder");
    sandbox.assert_clean();
}

#[test]
fn mistakes_in_options() {
    let sandbox = Sandbox::new();
    check(&sandbox, &["lane_chnage"], &["lane_chnage", "did you mean lane_change?"]);
    check(&sandbox, &["lane_change", "--alphas", "0.1,1.5"], &["--alphas", "1.5", "(0, 1]"]);
    check(&sandbox, &["lane_change", "--alphas", "0"], &["--alphas", "0", "(0, 1]"]);
    check(&sandbox, &["lane_change", "--alphas", "nan"], &["--alphas", "NaN"]);
    check(&sandbox, &["lane_change", "--episodes", "0"], &["--episodes", "[1, 100000]"]);
    check(
        &sandbox,
        &["lane_change", "--set", "learning.gama=1"],
        &["learning.gama", "learning.gamma"],
    );
    check(
        &sandbox,
        &["lane_change", "--set", "drive.tick_s=1.0"],
        &["drive.tick_s", "[0.001, 0.1]"],
    );
    check(&sandbox, &["lane_change", "--config", "none.toml"], &["none.toml"]);
    let weighted = ["lane_change", "--objective", "weighted", "--set"];
    let of = |weights: &'static str| [&weighted[..], &[weights]].concat();
    let negative = of("objective.settings.path_weight=-1");
    check(&sandbox, &negative, &["objective.settings.path_weight", "-1", "[0, "]);
    let none = [
        &of("objective.settings.path_weight=0")[..],
        &["--set", "objective.settings.mse_weight=0"],
    ];
    check(&sandbox, &none.concat(), &["objective.settings", "all 0"]);
    let best = ["lane_change", "--tuner", "cem", "--set", "tuner.settings.best=30"];
    check(&sandbox, &best, &["tuner.settings.best", "30", "tuner.settings.population = 10"]);
    check(
        &sandbox,
        &["lane_change", "--replace", "vehicle=/no/such/program --fast"],
        &["vehicle", "/no/such/program", "not an executable"],
    );
    check(&sandbox, &["lane_change", "--replace", "pilot=x"], &["pilot", "vehicle"]);
    check(&sandbox, &["lane_change", "--replace", "vehicle='unclosed"], &["vehicle", "quote"]);
    check(&sandbox, &["lane_change", "--set", "learning.gam\nma=1"], &["learning.gam ma"]);
    check(&sandbox, &["lane_change", "--set", "grid.kv={min=}"], &["grid.kv"]);
    let row = "paper=[{gains=[],mse_m2=1,noisy_mse_m2=1}]";
    check(&sandbox, &["lane_change", "--set", row], &["paper[0].gains", "is empty"]);
    check(&sandbox, &["lane_change", "--set", "maneuver=../x"], &["maneuver", "cannot be changed"]);
    check(&sandbox, &["lane_change", "--chaos", "kill pilot@drive=1"], &["--chaos", "pilot"]);
}

#[test]
fn mistakes_of_the_command_line_itself_have_the_same_code() {
    let sandbox = Sandbox::new();
    for args in [
        &["train"][..],
        &["train", "lane_change", "--fleet", "x"],
        &["train", "lane_change", "--fleet", "257"],
        &["train", "lane_change", "--tuner", "sarsa"],
        &["train", "lane_change", "--nonsense"],
        &["train", "--resume", "here", "--seed", "1"],
        &["fly"],
    ] {
        let output = sandbox.run(args);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(64), "{args:?}: {stderr}");
        assert_eq!(stderr.lines().count(), 1, "{args:?}: {stderr}");
    }
    // A negative number is the value of its option, which is named.
    let negative = sandbox.run(&["train", "lane_change", "--drives", "-1"]);
    let stderr = String::from_utf8(negative.stderr).unwrap();
    assert_eq!(negative.status.code(), Some(64), "{stderr}");
    assert!(stderr.contains("'-1' for '--drives"), "{stderr}");
    assert_eq!(sandbox.run(&[]).status.code(), Some(64));
    let resumed = sandbox.run(&["train", "--resume", "nowhere"]);
    let stderr = String::from_utf8(resumed.stderr).unwrap();
    assert_eq!(resumed.status.code(), Some(64), "{stderr}");
    assert!(stderr.contains("nowhere/config.toml: no training to go on with"), "{stderr}");
    assert!(sandbox.run(&["--help"]).status.success());
    assert!(sandbox.run(&["train", "--help"]).status.success());
}

#[test]
fn mistakes_in_files() {
    let sandbox = Sandbox::new();
    let file = |text: &str, parts: &[&str]| {
        fs::write(sandbox.path("my.toml"), text).unwrap();
        check(&sandbox, &["lane_change", "--config", "my.toml"], parts);
    };
    file("[learning]\nepisodes = 3\nepsilon = 1\n", &["my.toml:3", "learning.epsilon"]);
    file("[grid]\nkv = { min = 3.0, max = 1.0, step = 0.5 }", &["my.toml:2", "kv", "reversed"]);
    file("[grid]\nkv = { min = 1.0, max = 2.0, step = 0.0 }", &["my.toml:2", "kv", "step"]);
    file("[grid]\nkv = []", &["my.toml:2", "kv"]);
    file("seed = [", &["my.toml:1"]);
    file("\u{0}\u{1}", &["my.toml:1"]);
    let plants = "[[plants]]\nname = 'late'\n[[plants]]\nadd = { steering_delay_s = 0.2 }\n";
    fs::write(sandbox.path("plants.toml"), plants).unwrap();
    check(&sandbox, &["lane_change", "--over", "plants.toml"], &["plants.toml:3", "`name`"]);
    let launch = |text: &str, parts: &[&str]| {
        fs::write(sandbox.path("launch.toml"), text).unwrap();
        check(&sandbox, &["lane_change", "--launch", "launch.toml"], parts);
    };
    launch("[[process]]\nrole = 'vehicle'\nspeed = 3", &["launch.toml:3", "speed"]);
    launch("[[process]]\nrole = 'vehicle'", &["launch.toml", "supervisor"]);
}

#[test]
fn a_vehicle_file_that_names_a_vehicle_file() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("v.toml"), "vehicle_preset = 'v.toml'").unwrap();
    fs::write(sandbox.path("my.toml"), "vehicle_preset = 'v.toml'").unwrap();
    check(
        &sandbox,
        &["lane_change", "--config", "my.toml"],
        &["v.toml:1", "vehicle_preset", "unknown"],
    );
    fs::write(sandbox.path("v.toml"), "wheelbase_m = 3.0").unwrap();
    let result = sandbox.train("out", &["lane_change", "--episodes", "1", "--config", "my.toml"]);
    let plain = sandbox.train("plain", &["lane_change", "--episodes", "1"]);
    assert_ne!(result["digest"], plain["digest"]);
    let quoted = "vehicle_preset=\"tesla_model_3\"";
    let same = sandbox.train("same", &["lane_change", "--episodes", "1", "--set", quoted]);
    assert_eq!(same["digest"], plain["digest"]);
}

#[test]
fn streams_that_are_closed_or_full_stop_no_training() {
    let sandbox = Sandbox::new();
    let binary = env!("CARGO_BIN_EXE_pathtune");
    for (out, script, code) in [
        ("a", format!("{binary} train lane_change --no-memo --episodes 8 --out a 2>/dev/full"), 0),
        (
            "b",
            format!(
                "{binary} train lane_change --episodes 2 --out b 2>&1 -q | true; exit ${{PIPESTATUS[0]}}"
            ),
            0,
        ),
        ("c", format!("{binary} train lane_change --episodes 2 --out c >&- 2>&- <&-"), 0),
        ("d", format!("{binary} train lane_change --episodes 2 --out d >/dev/full"), 1),
    ] {
        let status = std::process::Command::new("bash")
            .args(["-c", &script])
            .current_dir(sandbox.path("."))
            .env("XDG_RUNTIME_DIR", sandbox.path("r"))
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .status()
            .unwrap();
        assert_eq!(status.code(), Some(code), "{script}");
        assert!(sandbox.path(out).join("result.json").exists(), "{script}");
        sandbox.assert_clean();
    }
}

#[test]
fn runtime_folders_of_any_length_do() {
    let sandbox = Sandbox::new();
    for length in [16, 18, 19, 20, 32, 33, 120] {
        let base = sandbox.path("x");
        let name = "y".repeat(length - base.as_os_str().len().min(length - 1) - 1);
        let folder = base.join(if name.is_empty() { "y" } else { &name });
        fs::create_dir_all(&folder).unwrap();
        let output = sandbox
            .command(&["train", "lane_change", "--episodes", "1", "--out", &format!("o{length}")])
            .env("XDG_RUNTIME_DIR", &folder)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{length}: {said}");
        // One that is too long is not passed over silently.
        let told = format!("XDG_RUNTIME_DIR={} has", folder.display());
        assert_eq!(said.contains(&told), folder.as_os_str().len() > 18, "{length}: {said}");
    }
}

#[test]
fn folders_that_cannot_be_used() {
    let sandbox = Sandbox::new();
    fs::create_dir(sandbox.path("full")).unwrap();
    fs::write(sandbox.path("full/file"), "kept").unwrap();
    check(&sandbox, &["lane_change", "--out", "full"], &["full", "holds files"]);
    assert_eq!(fs::read_to_string(sandbox.path("full/file")).unwrap(), "kept");
    check(&sandbox, &["lane_change", "--out", "full/file"], &["full/file"]);
    check(&sandbox, &["lane_change", "--out", "full/file/below"], &["full/file/below"]);
    check(&sandbox, &["lane_change", "--out", "/proc/nothing"], &["/proc/nothing"]);
}

#[test]
fn a_shared_memory_that_is_too_small() {
    let sandbox = Sandbox::new();
    // A mount of our own, where this user may make one.
    let script = format!(
        "mount -t tmpfs -o size=1m tmpfs /dev/shm || exit 99; exec {} train lane_change --out out",
        env!("CARGO_BIN_EXE_pathtune")
    );
    let output = std::process::Command::new("unshare")
        .args(["--mount", "--map-root-user", "sh", "-c", &script])
        .current_dir(sandbox.path("."))
        .env("XDG_RUNTIME_DIR", sandbox.path("r"))
        .output();
    let skipped = "SKIPPED a_shared_memory_that_is_too_small: needs unshare and mounts";
    let Ok(output) = output else { return skip(skipped) };
    let stderr = String::from_utf8_lossy(&output.stderr);
    if output.status.code() == Some(99) || stderr.contains("unshare") {
        return skip(skipped);
    }
    assert_eq!(output.status.code(), Some(64), "{stderr}");
    for part in ["/dev/shm is too small", "needs", "MiB"] {
        assert!(stderr.contains(part), "{stderr}");
    }
    assert!(!sandbox.path("out").exists());
    sandbox.assert_clean();
}

/// Skips by name; where CI has installed everything, a skip is a failure.
fn skip(message: &str) {
    assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "{message}");
    eprintln!("{message}");
}

#[test]
fn a_replacement_that_never_works_ends_within_its_budget() {
    let sandbox = Sandbox::new();
    let output = sandbox.run(&[
        "train",
        "lane_change",
        "--replace",
        "controller=sh -c 'echo out of petrol; exit 3'",
        "--out",
        "out",
    ]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(70), "{stderr}");
    let last = stderr.trim_end().lines().last().unwrap();
    for part in ["gave up", "controller", "exit code 3", "out of petrol", "controller.log"] {
        assert!(last.contains(part), "{part:?} is missing in {last:?}");
    }
    sandbox.assert_clean();
}

#[test]
fn presets_are_shown_and_written() {
    let sandbox = Sandbox::new();
    let shown = String::from_utf8(sandbox.run(&["config", "show"]).stdout).unwrap();
    assert!(shown.contains("[learning]") && shown.contains("wheelbase_m"));
    let one = String::from_utf8(sandbox.run(&["config", "show", "roundabout"]).stdout).unwrap();
    assert!(one.contains("radius_m = 18.0") && !one.contains("wheelbase_m"));
    let key = String::from_utf8(sandbox.run(&["config", "show", "goal_radius_m"]).stdout).unwrap();
    assert!(key.contains("A drive ends early") && key.contains("goal_radius_m = 0.2"), "{key}");
    let typo = sandbox.run(&["config", "show", "goal_radios_m"]);
    assert_eq!(typo.status.code(), Some(64));
    let told = String::from_utf8(typo.stderr).unwrap();
    assert!(told.contains("did you mean drive.goal_radius_m"), "{told}");
    let typo = sandbox.run(&["config", "show", "f1tenht"]);
    let told = String::from_utf8(typo.stderr).unwrap();
    assert!(typo.status.code() == Some(64) && told.contains("did you mean f1tenth"), "{told}");
    assert!(sandbox.run(&["config", "init", "mine"]).status.success());
    assert!(sandbox.path("mine/maneuvers/lane_change.toml").exists());
    assert!(
        sandbox.path("mine/overlay.toml").exists() && !sandbox.path("mine/readings.toml").exists()
    );
    let folder = sandbox.run(&["drive", "lane_change", "--config", "mine"]);
    let told = String::from_utf8(folder.stderr).unwrap();
    assert!(told.contains("is a folder") && told.contains("overlay.toml"), "{told}");
    assert_eq!(sandbox.run(&["config", "init", "mine"]).status.code(), Some(64));
}
