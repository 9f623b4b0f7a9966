//! Every door through which a file comes in, against every kind of file that is none: one line, exit code 64, and neither
//! memory nor time without bound.

mod support;

use std::fs;
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};

use support::Sandbox;

/// A kind of file, and how to make one.
type Kind = (&'static str, fn(&Path));

fn write(path: &Path, bytes: impl AsRef<[u8]>) {
    fs::write(path, bytes).unwrap();
}

fn sparse(path: &Path, bytes: u64) {
    fs::File::create(path).unwrap().set_len(bytes).unwrap();
}

const KINDS: [Kind; 21] = [
    ("missing", |_| {}),
    ("a folder", |path| fs::create_dir(path).unwrap()),
    ("a pipe", |path| {
        assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    }),
    ("a socket", |path| drop(UnixListener::bind(path).unwrap())),
    ("a device without end", |path| symlink("/dev/zero", path).unwrap()),
    ("a device without content", |path| symlink("/dev/null", path).unwrap()),
    ("a link to nothing", |path| symlink("/nowhere/at/all", path).unwrap()),
    ("a link to itself", |path| symlink(path.file_name().unwrap(), path).unwrap()),
    ("8 GiB of nothing", |path| sparse(path, 8 << 30)),
    ("300 MiB of nothing", |path| sparse(path, 300 << 20)),
    ("another encoding", |path| write(path, b"n\xe4me = '\xfc'\n")),
    ("UTF-16", |path| write(path, b"\xff\xfen\0a\0m\0e\0\n\0")),
    ("bytes", |path| write(path, (0..=255).cycle().take(9000).collect::<Vec<u8>>())),
    ("brackets without end", |path| write(path, format!("a = {}", "[".repeat(100_000)))),
    ("braces without end", |path| write(path, "{\"a\":".repeat(50_000))),
    ("dots without end", |path| write(path, format!("{}b = 1\n", "a.".repeat(50_000)))),
    ("a line without end", |path| write(path, "x".repeat(3 << 20))),
    ("values without end", |path| write(path, format!("a = [{}]\n", "1,".repeat(3 << 20)))),
    ("a key twice", |path| write(path, "seed = 1\r\nseed = 2\r\n")),
    ("control characters", |path| write(path, "\u{feff}\u{1b}[2J\u{1b}]0;x\u{7} = 1\n")),
    ("the magic of a recording", |path| {
        write(path, [&b"\x89MCAP0\r\n"[..], &[0xff; 300]].concat());
    }),
];

/// Doors to a file that the user names: `FILE` is replaced.
const DOORS: [&str; 24] = [
    "train --path FILE",
    "drive --path FILE --gains 3,21,21,0.7",
    "train lane_change --config FILE",
    "train lane_change --vehicle FILE",
    "train lane_change --law FILE",
    "train lane_change --launch FILE",
    "train lane_change --over FILE",
    "drive lane_change --gains 3,21,21,0.7 --envelope FILE",
    "drive lane_change --from FILE",
    "calibrate lane_change --from FILE",
    "calibrate FILE",
    "certify FILE",
    "certify --check FILE",
    "identify --vehicle FILE car.toml",
    "identify --vehicle car.toml FILE",
    "replay FILE",
    "replay recording.mcap --config FILE",
    "gains promote run FILE",
    "gains show FILE lane_change",
    "gains rollback FILE",
    "sweep plan FILE",
    "sweep run FILE --index 0",
    "excite --vehicle FILE",
    "conformance --vehicle FILE -- true",
];

/// Doors to a file of a run's folder, which is named `run`.
const OF_RUNS: [(&str, &str); 9] = [
    ("result.json", "report run"),
    ("result.json", "drive lane_change --from run"),
    ("result.json", "gains promote run car.toml"),
    ("config.toml", "gains promote run car.toml"),
    ("config.toml", "certify run"),
    ("config.toml", "calibrate run"),
    ("config.toml", "train --resume run"),
    ("launch.toml", "train --resume run"),
    ("journal", "train --resume run --quiet"),
];

/// A journal that is not there yet, or of which nothing is there, is begun.
const BEGUN: [&str; 2] = ["missing", "a device without content"];

fn copy_run(from: &Path, to: &Path) {
    fs::create_dir_all(to.join("logs")).unwrap();
    for name in ["config.toml", "launch.toml", "result.json", "journal"] {
        fs::copy(from.join(name), to.join(name)).unwrap();
    }
}

/// What is wrong with the answer, if anything.
fn ask(folder: &Path, runtime: &Path, door: &str, name: &str) -> Option<String> {
    // Neither more memory than this, nor more time.
    let script = format!("ulimit -v 1500000; exec timeout 100 \"$0\" {door}");
    let output = Command::new("sh")
        .args(["-c", &script, env!("CARGO_BIN_EXE_pathtune")])
        .current_dir(folder)
        .env("XDG_RUNTIME_DIR", runtime)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let is_long = said.chars().count() > 1200;
    let is_odd = said.trim_end().chars().any(char::is_control);
    let is_named = said.contains(name);
    let as_it_should = output.status.code() == Some(64) && !is_long && !is_odd && is_named;
    let brief: String = said.chars().take(600).collect();
    (!as_it_should).then(|| format!("{}: {brief:?}", output.status))
}

#[test]
fn whatever_comes_through_a_door_is_told_in_a_line() {
    let sandbox = Sandbox::new();
    let recorded =
        ["drive", "lane_change", "--gains", "3,21,21,0.7", "--record", "--out", "drive", "-q"];
    assert!(sandbox.run(&recorded).status.success());
    sandbox.train("trained", &["lane_change", "--episodes", "1"]);
    let named = DOORS.map(|door| (door.replace("FILE", "it.x"), None));
    let of_runs = OF_RUNS.map(|(file, door)| (door.to_owned(), Some(file)));
    let doors: Vec<_> = named.into_iter().chain(of_runs).collect();
    let next = AtomicUsize::new(0);
    let answer = |index: usize| -> Option<String> {
        let ((door, of_run), (kind, make)) =
            (&doors[index / KINDS.len()], KINDS[index % KINDS.len()]);
        let folder = sandbox.path(&format!("f{index}"));
        fs::create_dir(&folder).unwrap();
        write(&folder.join("car.toml"), "base = \"f1tenth\"\n");
        let (drive, trained) = (sandbox.path("drive"), sandbox.path("trained"));
        let file = match of_run {
            Some(name) => {
                copy_run(&trained, &folder.join("run"));
                fs::remove_file(folder.join("run").join(name)).unwrap();
                folder.join("run").join(name)
            }
            None => {
                symlink(&trained, folder.join("run")).unwrap();
                symlink(drive.join("recording.mcap"), folder.join("recording.mcap")).unwrap();
                folder.join("it.x")
            }
        };
        make(&file);
        let is_begun = *of_run == Some("journal") && BEGUN[..1].contains(&kind);
        let name = of_run.unwrap_or("it.x");
        let wrong = if is_begun { None } else { ask(&folder, &sandbox.path("r"), door, name) };
        fs::remove_dir_all(&folder).unwrap();
        wrong.map(|wrong| format!("`{door}`, {name} being {kind}: {wrong}"))
    };
    let count = doors.len() * KINDS.len();
    let worker = || {
        let mut wrong = Vec::new();
        while let Some(index) = Some(next.fetch_add(1, Ordering::Relaxed)).filter(|it| *it < count)
        {
            wrong.extend(answer(index));
        }
        wrong
    };
    let wrong: Vec<String> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..4).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().flat_map(|it| it.join().unwrap()).collect()
    });
    assert!(wrong.is_empty(), "{} of {count}:\n{}", wrong.len(), wrong.join("\n"));
    sandbox.assert_clean();
}
