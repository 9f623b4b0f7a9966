//! Recordings: nothing missing, nothing changed, nothing left behind, and readable by others.

mod support;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, UNIX_EPOCH};

use config::{Layers, Parameters, RunConfig};
use ipc_types::layout::Bytes;
use ipc_types::{
    BatchHeader, Command as VehicleCommand, DriveReport, DriveRequest, Odometry, TickHeader,
    TrackingError, WirePose,
};
use recorder::reading::Recording;
use rollout::{Rollout, TickRecord};
use rustix::process::Signal;
use serde_json::Value;
use support::{Sandbox, signal};
use tracking::Pose;

const TICK_TOPICS: [&str; 4] = ["odometry", "raw_command", "command", "tracking_error"];

fn config(maneuver: &str) -> RunConfig {
    let mut layers = Layers::maneuver(maneuver).unwrap();
    layers.set("collision.enabled=true").unwrap();
    layers.resolve().unwrap()
}

fn parse<H: Bytes, M: Bytes>(mut bytes: &[u8]) -> (H, Vec<M>) {
    let header = H::take(&mut bytes).unwrap();
    let mut items = Vec::new();
    while !bytes.is_empty() {
        items.push(M::take(&mut bytes).unwrap());
    }
    (header, items)
}

fn all<H: Bytes, M: Bytes>(recording: &Recording, topic: &str) -> Vec<(H, Vec<M>)> {
    recording.of(topic).map(|message| parse(&message.data)).collect()
}

/// Ticks of each batch, in their order: those of its longest drive.
fn ticks_by_batch(recording: &Recording) -> Vec<(u64, u64)> {
    all::<BatchHeader, DriveReport>(recording, "drive_report")
        .iter()
        .map(|(header, reports)| {
            (header.attempt.batch, reports.iter().map(|report| report.ticks).max().unwrap())
        })
        .collect()
}

fn assert_whole(recording: &Recording) {
    assert_eq!(recording.cut_off, None);
    let end = recording.end.as_ref().expect("ended in order");
    assert_eq!(end["gaps"], "0", "{end:?}");
    let batches = ticks_by_batch(recording);
    assert!(!batches.is_empty());
    let ticks: u64 = batches.iter().map(|(_, ticks)| ticks).sum();
    for topic in TICK_TOPICS {
        assert_eq!(recording.of(topic).count() as u64, ticks, "{topic}");
        assert_eq!(end[&format!("messages.{topic}")], ticks.to_string());
        let mut due =
            batches.iter().flat_map(|(batch, ticks)| (0..*ticks).map(move |it| (*batch, it)));
        for message in recording.of(topic) {
            let header = TickHeader::take(&mut &message.data[..]).unwrap();
            assert_eq!(Some((header.attempt.batch, header.tick)), due.next(), "{topic}");
        }
    }
}

fn wire(pose: Pose) -> WirePose {
    WirePose { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad }
}

fn bytes_of(value: &impl Bytes) -> Vec<u8> {
    let mut bytes = Vec::new();
    value.put(&mut bytes);
    bytes
}

/// A validation of one gain set, recorded: its folder, and its result.
fn record(sandbox: &Sandbox, maneuver: &str, more: &[&str]) -> (PathBuf, Value) {
    let args = ["validate", maneuver, "--repeats", "2", "--fleet", "1", "--record"];
    let result = sandbox.json("out", &[&args[..], more].concat());
    (sandbox.path("out"), result)
}

/// Compares every tick of a recording of drives with plain calls, bit for bit; tells how many there were.
fn compare_with_rollout(recording: &Recording, config: &RunConfig, sets: &[Parameters]) -> usize {
    let by_zone = config.sets_by_zone(sets);
    let odometry = all::<TickHeader, Odometry>(recording, "odometry");
    let commands = all::<TickHeader, VehicleCommand>(recording, "command");
    let errors = all::<TickHeader, TrackingError>(recording, "tracking_error");
    let mut at = 0;
    for (header, requests) in all::<BatchHeader, DriveRequest>(recording, "drive_request") {
        assert!(ipc_types::has(requests[0].flags, DriveRequest::LOGGED));
        let noise = ipc_types::has(requests[0].flags, DriveRequest::NOISE);
        let mut records: Vec<TickRecord> = Vec::new();
        Rollout::new(config).drive_scheduled(
            &by_zone,
            noise.then_some(requests[0].seed),
            |_, record| records.push(*record),
        );
        for record in &records {
            let ((head, seen), (_, passed)) = (&odometry[at], &commands[at]);
            assert_eq!(head.attempt, header.attempt);
            let observed = record.observation;
            let mut wanted = bytes_of(&wire(observed.measured));
            wire(observed.truth).put(&mut wanted);
            observed.speed_mps.put(&mut wanted);
            observed.yaw_rate_radps.put(&mut wanted);
            observed.steering_rad.put(&mut wanted);
            assert_eq!(&bytes_of(&seen[0])[..wanted.len()], wanted);
            assert_eq!(passed[0].speed_mps.to_bits(), record.passed.speed_mps.to_bits());
            assert_eq!(passed[0].steering_rad.to_bits(), record.passed.steering_rad.to_bits());
            assert_eq!(passed[0].zone as usize, record.zone);
            let error = errors[at].1[0];
            assert_eq!(
                error.cross_track_m.to_bits(),
                record.decision.error.cross_track_m.to_bits()
            );
            at += 1;
        }
    }
    assert_eq!(at, odometry.len());
    at
}

#[test]
fn a_run_is_recorded_from_its_first_tick_bit_for_bit() {
    let sets = [("lane_change", "3,21,21,.7"), ("circuit", "3,21,21,.7/3.4,21,1,.84")];
    for (maneuver, gains) in sets {
        let sandbox = Sandbox::new();
        let (out, result) = record(&sandbox, maneuver, &["--gains", gains]);
        sandbox.assert_clean();
        let path = out.join("recording.mcap");
        let recording = Recording::read(&path).unwrap();
        assert_whole(&recording);
        let config = config(maneuver);
        let ticks =
            compare_with_rollout(&recording, &config, &config.law.parse_sets(gains).unwrap());
        assert_eq!(recording.beginning["from_first_tick"], "true");
        assert_eq!(recording.beginning["maneuver"], maneuver);
        assert_eq!(recording.end.as_ref().unwrap()["digest"], result["digest"]);
        for name in ["config.toml", "launch.toml", "sweep.toml"] {
            assert_eq!(recording.attachments[name], std::fs::read(out.join(name)).unwrap());
        }
        // In lockstep the stamps advance with the vehicle's time.
        let odom: Vec<_> = recording.messages.iter().filter(|it| it.topic == "/odom").collect();
        assert_eq!(odom.len(), ticks);
        for (tick, message) in odom.iter().enumerate() {
            assert_eq!(message.log_time_ns, tick as u64 * 10_000_000);
        }
        assert_python_agrees(&sandbox, &path, ticks);
    }
}

#[test]
fn recording_changes_no_digest_and_survives_a_kill() {
    let sandbox = Sandbox::new();
    let args = ["lane_change", "--episodes", "10"];
    let alone = sandbox.train("alone", &args);
    let recorded = sandbox.train("recorded", &[&args[..], &["--record"]].concat());
    assert_eq!(alone["digest"], recorded["digest"]);
    let recording = Recording::read(&sandbox.path("recorded/recording.mcap")).unwrap();
    assert_whole(&recording);
    assert_eq!(recording.end.unwrap()["digest"], alone["digest"]);

    // In several files, each of which can be read alone.
    let split = ["--record", "--record-split", "1M"];
    let result = sandbox.train("split", &[&args[..], &split].concat());
    assert_eq!(alone["digest"], result["digest"]);
    let mut ticks = 0;
    let mut files = 0;
    for number in 1.. {
        let path = sandbox.path(&format!("split/recording-{number:04}.mcap"));
        if !path.exists() {
            break;
        }
        let part = Recording::read(&path).unwrap();
        assert_eq!(part.cut_off, None);
        ticks += part.of("odometry").count();
        files += 1;
    }
    assert!(files > 1);
    assert_eq!(ticks, recording_ticks(&sandbox.path("recorded/recording.mcap")));

    // Killed on the way, by itself and from outside: nothing of the training changes.
    let fault = ["--record", "--chaos", "kill recorder@drive=20,tick=100"];
    let killed = sandbox.train("killed", &[&args[..], &fault].concat());
    assert_eq!(alone["digest"], killed["digest"]);
    let cut = Recording::read(&sandbox.path("killed/recording.mcap")).unwrap();
    assert!(cut.end.is_none());
    let rest = Recording::read(&sandbox.path("killed/recording-2.mcap")).unwrap();
    assert_eq!(rest.beginning["from_first_tick"], "false");
    assert_eq!(rest.beginning["continues"], "recording.mcap");
    assert_eq!(rest.end.as_ref().unwrap()["gaps"], "0");
    let requests = all::<BatchHeader, DriveRequest>(&rest, "drive_request");
    // The last request is heard again; what was under way is driven again, unless it had just ended.
    let [last, next, ..] = &requests[..] else { panic!("{} requests", requests.len()) };
    let [last, next] = [last, next].map(|it| (it.0.attempt.batch, it.0.attempt.attempt));
    assert!([(20, 1), (21, 1)].contains(&last), "{last:?}");
    assert!([(last.0, 2), (last.0 + 1, 1)].contains(&next), "{last:?}, {next:?}");
    sandbox.assert_clean();
}

fn recording_ticks(path: &Path) -> usize {
    Recording::read(path).unwrap().of("odometry").count()
}

#[test]
fn a_file_cut_off_by_a_kill_is_read_up_to_its_last_chunk() {
    let sandbox = Sandbox::new();
    let args = ["circuit", "--no-memo", "--episodes", "6", "--record"];
    let mut training = sandbox.start_training("out", &args);
    let path = sandbox.path("out/recording.mcap");
    training.wait_for("some chunks", || {
        std::fs::metadata(&path).is_ok_and(|meta| meta.len() > 3_000_000)
    });
    // Whatever stands in the file now was closed; the kill may cost no more than what comes now.
    signal(sandbox.service("recorder").unwrap(), Signal::KILL);
    training.wait_for("another file", || sandbox.path("out/recording-2.mcap").exists());
    let cut = Recording::read(&path).unwrap();
    assert!(cut.cut_off.is_some() && cut.end.is_none());
    let headers: Vec<TickHeader> =
        cut.of("odometry").map(|it| TickHeader::take(&mut &it.data[..]).unwrap()).collect();
    assert!(headers.len() > 1000, "{} ticks", headers.len());
    for pair in headers.windows(2) {
        let next =
            if pair[0].attempt.batch == pair[1].attempt.batch { pair[0].tick + 1 } else { 0 };
        assert_eq!(pair[1].tick, next);
    }
    // A frozen one is replaced as well.
    signal(sandbox.service("recorder").unwrap(), Signal::STOP);
    training.wait_for("a third file", || sandbox.path("out/recording-3.mcap").exists());
    signal(training.id(), Signal::INT);
    assert_eq!(training.finish().status.code(), Some(130));
    sandbox.assert_clean();
}

#[test]
fn a_run_is_recorded_from_another_terminal() {
    let sandbox = Sandbox::new();
    let args = ["lane_change", "--no-memo", "--episodes", "16"];
    let alone = sandbox.train("alone", &args);
    let mut training = sandbox.start_training("out", &args);
    training.wait_until_it_drives();
    let mine = sandbox.run(&["record", "--out", "mine.mcap", "--for", "500ms"]);
    assert!(mine.status.success(), "{}", String::from_utf8_lossy(&mine.stderr));
    let recording = Recording::read(&sandbox.path("mine.mcap")).unwrap();
    assert_eq!(recording.cut_off, None);
    assert_eq!(recording.beginning["from_first_tick"], "false");
    let end = recording.end.as_ref().unwrap();
    let gaps: u64 = end["gaps"].parse().unwrap();
    let told = String::from_utf8_lossy(&mine.stderr).contains("gaps");
    assert_eq!(told, gaps > 0, "{end:?}");
    // What was missed is exactly what is not there.
    let first: TickHeader = parse::<_, Odometry>(&recording.of("odometry").next().unwrap().data).0;
    let reports = ticks_by_batch(&recording);
    let last = reports.last().unwrap().0;
    let heard = recording
        .of("odometry")
        .map(|it| parse::<TickHeader, Odometry>(&it.data).0)
        .filter(|header| (first.attempt.batch + 1..=last).contains(&header.attempt.batch))
        .count() as u64;
    let driven: u64 = reports
        .iter()
        .filter(|(batch, _)| *batch > first.attempt.batch)
        .map(|(_, ticks)| ticks)
        .sum();
    let missed: u64 = end["missed.odometry"].parse().unwrap();
    assert!(heard <= driven && driven - heard <= missed, "{heard} of {driven}, {missed} missed");
    // Once more, until the run is over.
    let rest = sandbox.run(&["record"]);
    assert!(rest.status.success(), "{}", String::from_utf8_lossy(&rest.stderr));
    assert_eq!(training.succeed()["digest"], alone["digest"]);
    assert!(sandbox.path("out/recording.mcap").exists());
    let nobody = sandbox.run(&["record"]);
    assert_eq!(nobody.status.code(), Some(64));
    sandbox.assert_clean();
}

#[test]
fn recording_unreadable_for_ros2_bag() {
    let Some(python) = python() else { return };
    let sandbox = Sandbox::new();
    let args = ["drive", "lane_change", "--quiet", "--record", "--gains", "3,21,21,.7"];
    assert!(sandbox.run(&[&args[..], &["--out", "out"]].concat()).status.success());
    let file = sandbox.path("out/recording.mcap");
    let convert = ["-m", "rosbags.convert", "--src", "out/recording.mcap", "--dst", "bag"];
    let output =
        Command::new(&python).args(convert).current_dir(sandbox.path(".")).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{}{told}", String::from_utf8_lossy(&output.stdout));
    // Every message of every topic is in the bag.
    let mut messages: BTreeMap<String, usize> = BTreeMap::new();
    for message in Recording::read(&file).unwrap().messages {
        *messages.entry(message.topic).or_default() += 1;
    }
    let count = "import json, pathlib, rosbags.highlevel as it\n\
                 with it.AnyReader([pathlib.Path('bag')]) as reader:\n    \
                 print(json.dumps({c.topic: c.msgcount for c in reader.connections if c.msgcount}))";
    let output =
        Command::new(&python).args(["-c", count]).current_dir(sandbox.path(".")).output().unwrap();
    let there: BTreeMap<String, usize> = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(there, messages);
    assert!(there["/tf"] == there["/odom"] && there["/path"] == 1, "{there:?}");
}

#[test]
fn by_the_clock_a_recording_has_the_wall_clock_and_says_what_it_lacks() {
    let unix_ns = || UNIX_EPOCH.elapsed().unwrap().as_nanos() as u64;
    let sandbox = Sandbox::new();
    let since_ns = unix_ns();
    let args = ["lane_change", "--realtime", "--record", "--gains", "3,21,21,.7"];
    let mut drive = sandbox.start("drive", "out", &args);
    let recording = sandbox.path("out/recording.mcap");
    drive.wait_for("a second of driving", || {
        std::fs::metadata(&recording).is_ok_and(|meta| meta.len() > 40_000)
    });
    // For a tenth of a second no tick is answered: shorter than anybody takes it for frozen.
    let controller = sandbox.service("controller").unwrap();
    signal(controller, Signal::STOP);
    std::thread::sleep(Duration::from_millis(100));
    signal(controller, Signal::CONT);
    let output = drive.finish();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{}", sandbox.story("out", &output));

    let read = Recording::read(&recording).unwrap();
    let result = sandbox.result("out");
    let facts = &result["run"]["recording"];
    assert_eq!(
        (&facts["file"], &facts["missed"]),
        (&"recording.mcap".into(), &0.into()),
        "{facts}"
    );
    for topic in TICK_TOPICS {
        assert_eq!(facts["topics"][topic]["messages"], read.of(topic).count(), "{topic}");
    }
    let unsent = facts["topics"]["raw_command"]["unsent"].as_u64().unwrap();
    assert!(unsent >= 5, "{facts}");
    assert!(told.contains("messages that no process sent: ") && told.contains("of raw_command"));
    let end = read.end.as_ref().unwrap();
    assert_eq!((&end["gaps"], &end["unsent.raw_command"]), (&"0".into(), &unsent.to_string()));

    // A gap does not cost the CSV, which has every tick that all processes sent.
    let lacking = result["drives_lacking"]["drive"].as_u64().unwrap();
    assert!(
        lacking >= 5 && told.contains(&format!("drives/drive.csv lacks {lacking} ticks")),
        "{told}"
    );
    let mut csv = csv::Reader::from_path(sandbox.path("out/drives/drive.csv")).unwrap();
    let ticks: Vec<u64> = csv.records().map(|row| row.unwrap()[0].parse().unwrap()).collect();
    assert!(ticks.len() > 300 && ticks.windows(2).all(|pair| pair[0] < pair[1]));

    // Its time is the wall clock's, in the file as in the messages.
    let origin_ns: u64 = read.beginning["wall_clock_origin_ns"].parse().unwrap();
    let mut last_ns = since_ns;
    for message in read.of("odometry") {
        let header = TickHeader::take(&mut &message.data[..]).unwrap();
        assert_eq!(message.log_time_ns, origin_ns + header.odometry_sent_ns);
        assert!((last_ns..=unix_ns()).contains(&message.log_time_ns));
        last_ns = message.log_time_ns;
    }
    let refused = sandbox.run(&["replay", "out/recording.mcap"]);
    let why = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(64) && why.contains("was driven by the clock"), "{why}");
    sandbox.assert_clean();
}

/// An interpreter with the packages that read recordings.
fn python() -> Option<OsString> {
    let python = std::env::var_os("PATHTUNE_PYTHON");
    if python.is_none() {
        let why = "PATHTUNE_PYTHON names no interpreter with mcap, mcap-ros2-support and rosbags";
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "{why}");
        eprintln!("skipped: {why}");
    }
    python
}

/// What Python's readers make of a recording.
fn assert_python_agrees(sandbox: &Sandbox, path: &Path, ticks: usize) {
    let Some(python) = python() else { return };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_recording.py");
    let output = Command::new(python)
        .arg(script)
        .args([path.as_os_str(), ticks.to_string().as_ref()])
        .current_dir(sandbox.path("."))
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success() && told.contains("agreed"),
        "{told}{}",
        String::from_utf8_lossy(&output.stderr)
    );
}
