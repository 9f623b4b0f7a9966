//! Studies: `pathtune sweep`, from a study file to its table.

mod support;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use rustix::process::Signal;
use serde_json::Value;
use support::{Sandbox, signal};

/// Four jobs, each of a second at most.
const STUDY: &str = "
    [common]
    maneuver = 'lane_change'
    episodes = 3
    set.'run.alphas' = [[0.5]]
    set.'ranking.max_ticks' = 0
    [[jobs]]
    law = ['paper', 'stanley']
    seed = '1..2'
";

/// What configurations and seeds decide in a folder of results: each job's figures and outcome, by their files.
fn decided(results: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = Vec::new();
    for folder in fs::read_dir(results).unwrap().flatten() {
        let name = folder.file_name();
        if name.len() != 2 {
            continue;
        }
        for file in fs::read_dir(folder.path()).unwrap().flatten() {
            let path = file.path();
            let mut bytes = fs::read(&path).unwrap();
            assert!(!path.to_string_lossy().ends_with(".failed"), "{path:?}");
            if !path.to_string_lossy().ends_with(".outcome.json") {
                assert!(bytes.len() <= 4096, "{path:?}");
                let mut record: Value = serde_json::from_slice(&bytes).unwrap();
                record["trial"] = Value::Null;
                bytes = record.to_string().into_bytes();
            }
            files.push((Path::new(&name).join(file.file_name()), bytes));
        }
    }
    files.sort();
    files
}

fn ok(output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    said
}

/// Asserts that it ended with this code and one line that holds this part.
fn failed(output: &Output, code: i32, part: &str) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{said}");
    assert!(said.lines().last().unwrap_or_default().contains(part), "{said}");
}

#[test]
fn a_study_comes_to_the_same_bytes_however_its_jobs_were_run_and_killed() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("study.toml"), STUDY).unwrap();
    assert!(ok(&sandbox.run(&["sweep", "plan", "study.toml"])).contains("study.jsonl: 4 jobs"));
    let manifest = fs::read(sandbox.path("study.jsonl")).unwrap();
    ok(&sandbox.run(&["sweep", "plan", "study.toml"]));
    assert_eq!(fs::read(sandbox.path("study.jsonl")).unwrap(), manifest);

    // By our engine.
    let said = ok(&sandbox.run(&["sweep", "run", "study.jsonl", "--all", "-j", "1"]));
    assert!(said.contains("4 of 4 jobs are done"), "{said}");
    let said = ok(&sandbox.run(&["sweep", "collect", "study.jsonl"]));
    assert!(said.contains("study.csv"), "{said}");

    // One by one, as another engine runs them, elsewhere; the first is killed on its way, and so is its next trial.
    let run = |index: &'static str| {
        [
            "sweep",
            "run",
            "study.jsonl",
            "--index",
            index,
            "--results",
            "other",
            "--scratch",
            "local",
        ]
    };
    for (kill, bytes) in [(Signal::KILL, 300), (Signal::TERM, 600)] {
        let mut child = sandbox.command(&run("0")).spawn().unwrap();
        let name = ok(&sandbox.run(&["sweep", "status", "study.jsonl", "--json"]));
        assert!(name.contains("\"done\": 4"), "{name}");
        let journal = || {
            let folder = fs::read_dir(sandbox.path("local")).ok()?.flatten().next()?;
            fs::metadata(folder.path().join("journal")).ok().map(|meta| meta.len())
        };
        while journal().is_none_or(|len| len < bytes) && child.try_wait().unwrap().is_none() {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        signal(child.id() as i32, kill);
        let output = child.wait_with_output().unwrap();
        // A fast machine may have come to the end before the signal.
        assert!([None, Some(0), Some(75)].contains(&output.status.code()), "{output:?}");
        sandbox.wait_until_nobody_lives();
    }
    for index in ["3", "1", "0", "2"] {
        ok(&sandbox.run(&run(index)));
        let again = sandbox.run(&run(index));
        ok(&again);
        assert!(String::from_utf8_lossy(&again.stderr).contains("is done already"));
    }
    assert_eq!(fs::read_dir(sandbox.path("local")).unwrap().count(), 0);
    let args = ["sweep", "collect", "study.jsonl", "--results", "other", "--out", "other.csv"];
    ok(&sandbox.run(&args));
    assert_eq!(sandbox.text("other.csv"), sandbox.text("study.csv"));
    let there = decided(&sandbox.path("other"));
    assert_eq!(there.len(), 8);
    assert!(there == decided(&sandbox.path("study.results")));

    // A job is the training that its command says.
    let command = ok(&sandbox.run(&["sweep", "jobs", "study.jsonl", "--index", "3"]));
    let words = shell_words(&command);
    assert_eq!(words[..3], ["pathtune", "train", "lane_change"]);
    let words: Vec<&str> = words[2..].iter().map(String::as_str).collect();
    let digest = sandbox.train("alone", &words)["digest"].as_str().unwrap().to_owned();
    let table = sandbox.text("study.csv");
    let row = table.lines().find(|line| line.starts_with("3,")).unwrap();
    assert!(row.ends_with(&digest), "{row}");
    ok(&sandbox.run(&["clean"]));
    sandbox.assert_clean();
}

/// The words of a command, of which none holds more than a pair of quotes.
fn shell_words(command: &str) -> Vec<String> {
    command.split_whitespace().map(|word| word.replace('\'', "")).collect()
}

/// A job may be the validation of a set, and comes to what `pathtune validate` does.
#[test]
fn a_study_may_validate_sets() {
    let sandbox = Sandbox::new();
    let study = "
        [[jobs]]
        command = 'validate'
        maneuver = 'lane_change'
        objective = 'mse'
        repeats = 2
        gains = ['3,21,21,0.7', '0.1,1,6,0.7']";
    fs::write(sandbox.path("study.toml"), study).unwrap();
    ok(&sandbox.run(&["sweep", "plan", "study.toml"]));
    ok(&sandbox.run(&["sweep", "run", "study.jsonl", "--all", "-j", "1"]));
    ok(&sandbox.run(&["sweep", "collect", "study.jsonl"]));
    let table = sandbox.text("study.csv");
    assert_eq!(table.lines().count(), 3, "{table}");
    let alone = sandbox.json(
        "alone",
        &[
            "validate",
            "lane_change",
            "--gains",
            "3,21,21,0.7",
            "--repeats",
            "2",
            "--objective",
            "mse",
        ],
    );
    let row = &alone["rows"][0];
    for figure in [&row["noise_free"]["mse_m2"], &row["noisy"]["mse_m2_worst"], &alone["digest"]] {
        let figure = figure.as_str().map_or_else(|| figure.to_string(), str::to_owned);
        assert!(table.lines().nth(1).unwrap().contains(&figure), "{figure}: {table}");
    }
    let several = study.replace("gains = ['3,21,21,0.7', '0.1,1,6,0.7']", "");
    fs::write(sandbox.path("several.toml"), several).unwrap();
    failed(&sandbox.run(&["sweep", "plan", "several.toml"]), 64, "a job validates one set");
    sandbox.assert_clean();
}

#[test]
fn damage_costs_one_job_and_wrong_input_is_not_tried_again() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("study.toml"), STUDY.replace("['paper', 'stanley']", "'paper'"))
        .unwrap();
    ok(&sandbox.run(&["sweep", "plan", "study.toml"]));
    let whole = sandbox.text("study.jsonl");
    // The first line names another seed than it was planned with.
    fs::write(
        sandbox.path("study.jsonl"),
        whole.replacen("\"--seed\",\"1\"", "\"--seed\",\"3\"", 1),
    )
    .unwrap();
    let all = ["sweep", "run", "study.jsonl", "--all", "-j", "1"];
    for _ in 0..2 {
        let output = sandbox.run(&all);
        failed(&output, 64, "1 line or record is damaged");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains("study.jsonl:1: damaged"), "{said}");
        assert!(String::from_utf8_lossy(&output.stdout).contains("1 of 1 jobs are done"));
    }
    failed(
        &sandbox.run(&["sweep", "run", "study.jsonl", "--index", "0"]),
        64,
        "study.jsonl:1: damaged",
    );
    failed(&sandbox.run(&["sweep", "run", "study.jsonl", "--index", "2"]), 64, "holds no job 2");
    failed(&sandbox.run(&["sweep", "collect", "study.jsonl"]), 64, "damaged");

    // A line less, which leaves no trace in the others.
    let first = whole.lines().next().unwrap();
    fs::write(sandbox.path("study.jsonl"), format!("{first}\n")).unwrap();
    let output = sandbox.run(&["sweep", "collect", "study.jsonl"]);
    failed(&output, 64, "1 line or record is damaged");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("study.jsonl: 1 job has no line (1); "), "{said}");

    // Whole again: what was done is done.
    fs::write(sandbox.path("study.jsonl"), &whole).unwrap();
    failed(&sandbox.run(&["sweep", "collect", "study.jsonl"]), 75, "1 job has no result");
    let status = ok(&sandbox.run(&["sweep", "status", "study.jsonl"]));
    assert!(status.contains("1 of 2 jobs are done, 1 missing, 0 failed\nmissing: 0"), "{status}");

    // A pipe in a record's place is no record, and nobody waits for its writer.
    ok(&sandbox.run(&["sweep", "run", "study.jsonl", "--index", "0"]));
    let manifest: Value = serde_json::from_str(first).unwrap();
    let job = manifest["job"].as_str().unwrap();
    let record = sandbox.path("study.results").join(&job[..2]).join(format!("{job}.json"));
    fs::remove_file(&record).unwrap();
    assert!(Command::new("mkfifo").arg(&record).status().unwrap().success());
    let output = sandbox.run(&["sweep", "collect", "study.jsonl"]);
    failed(&output, 64, "1 line or record is damaged");
    assert!(String::from_utf8_lossy(&output.stderr).contains("not a regular file"), "{output:?}");
    ok(&sandbox.run(&all));
    ok(&sandbox.run(&["sweep", "collect", "study.jsonl"]));

    // A vehicle's file that has changed since the study was planned.
    fs::write(sandbox.path("car.toml"), "wheelbase_m = 2.5\n").unwrap();
    let study = "[[jobs]]\nmaneuver = 'lane_change'\nvehicle = 'car.toml'\nepisodes = 1\n";
    fs::write(sandbox.path("cars.toml"), study).unwrap();
    ok(&sandbox.run(&["sweep", "plan", "cars.toml"]));
    fs::write(sandbox.path("car.toml"), "wheelbase_m = 2.6\n").unwrap();
    let output = sandbox.run(&["sweep", "run", "cars.jsonl", "--all", "-j", "1"]);
    failed(&output, 64, "1 job has failed");
    let status = ok(&sandbox.run(&["sweep", "status", "cars.jsonl"]));
    assert!(status.contains("failed: job 0 (exit code 64, tried once, last on "), "{status}");
    assert!(status.contains("plan the study again"), "{status}");

    // A mistake in a study is one line, and nothing is written.
    fs::write(sandbox.path("bad.toml"), "[[jobs]]\nmaneuver = 'lane_chang'\n").unwrap();
    failed(&sandbox.run(&["sweep", "plan", "bad.toml"]), 64, "lane_change");
    assert!(!sandbox.path("bad.jsonl").exists());
    failed(&sandbox.run(&["sweep", "run", "cars.jsonl", "--all", "-j", "4096"]), 64, "take -j");
    sandbox.assert_clean();
}

/// The tables of `compare` come from records of trainings that were made apart, and are the same; a tuner that lacks a job
/// is left out and named.
#[test]
fn a_study_that_compares_tuners_prints_the_tables_of_compare() {
    let sandbox = Sandbox::new();
    let study = "
        [common]
        maneuver = 'lane_change'
        compare = 4
        seed = '1..2'
        set.'grid.kl.step' = 10
        [[jobs]]
        tuner = ['random', 'sobol']
        drives = 4";
    fs::write(sandbox.path("study.toml"), study).unwrap();
    ok(&sandbox.run(&["sweep", "plan", "study.toml"]));
    let commands = ok(&sandbox.run(&["sweep", "jobs", "study.jsonl"]));
    assert!(commands.lines().all(|it| it.ends_with(" # compared over 4 drives")), "{commands}");
    ok(&sandbox.run(&["sweep", "run", "study.jsonl", "--all", "-j", "1"]));
    let collected = ok(&sandbox.run(&["sweep", "collect", "study.jsonl"]));
    let args =
        ["compare", "lane_change", "--tuners", "random,sobol", "--seeds", "2", "--drives", "4"];
    let set = ["--set", "grid.kl.step=10"];
    let compared = ok(&sandbox.run(&[&args[..], &set].concat()));
    assert!(collected.contains(compared.trim_end()), "{collected}{compared}");
    let page = sandbox.text("study.html");
    assert!(page.contains("Tuners compared") && page.contains("in the top 1 %"));

    let results = sandbox.path("study.results");
    let paths = |folder: &Path| fs::read_dir(folder).unwrap().flatten().map(|it| it.path());
    let is_of_records = |folder: &PathBuf| folder.file_name().unwrap().len() == 2;
    let folder = paths(&results).find(is_of_records).unwrap();
    let is_record = |file: &PathBuf| !file.to_string_lossy().ends_with(".outcome.json");
    fs::remove_file(paths(&folder).find(is_record).unwrap()).unwrap();
    let output = sandbox.run(&["sweep", "collect", "study.jsonl"]);
    failed(&output, 75, "1 job has no result");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(
        said.contains("left out, because jobs have no result: ") && said.contains(" (1 of 2 jobs)"),
        "{said}"
    );
    sandbox.assert_clean();
}
