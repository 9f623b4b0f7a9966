//! Two users on one machine: neither reads, writes, stops or sweeps what is the other's.

mod support;

use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, symlink};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use support::{Sandbox, signal};

/// A user with a folder of their own.
struct User {
    id: u32,
    home: PathBuf,
    runtime: Option<PathBuf>,
}

impl User {
    /// `has_runtime`: whether there is an XDG_RUNTIME_DIR.
    fn new(sandbox: &Sandbox, name: &str, id: u32, has_runtime: bool) -> Self {
        let folder = |name: &str| {
            let path = sandbox.path(name);
            fs::create_dir(&path).unwrap();
            chown(&path, Some(id), Some(id)).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o700)).unwrap();
            path
        };
        let home = folder(name);
        // A socket's path has room for 108 bytes.
        let runtime = has_runtime.then(|| folder(&format!("{name}x")));
        Self { id, home, runtime }
    }

    /// The folder of this user's runs.
    fn root(&self) -> PathBuf {
        match &self.runtime {
            Some(runtime) => runtime.join("pathtune"),
            None => PathBuf::from(format!("/tmp/pathtune-{}", self.id)),
        }
    }

    fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new("setpriv");
        let id = self.id.to_string();
        command.args(["--reuid", &id, "--regid", &id, "--clear-groups"]).args(words);
        command.current_dir(&self.home).env_remove("XDG_RUNTIME_DIR").stdin(Stdio::null());
        if let Some(runtime) = &self.runtime {
            command.env("XDG_RUNTIME_DIR", runtime);
        }
        command
    }

    fn run(&self, words: &[&str]) -> Output {
        self.command(words).output().unwrap()
    }

    fn start(&self, words: &[&str]) -> Child {
        self.command(words).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    }
}

/// Ids that no other test and no user has.
fn ids() -> [u32; 2] {
    let first = 2_000_000 + 2 * std::process::id();
    [first, first + 1]
}

/// The binary where every user may start it; `None` if this process may not become another user.
fn binary(sandbox: &Sandbox) -> Option<String> {
    if !rustix::process::geteuid().is_root() {
        let why = "SKIPPED two_users: needs root, to become another user";
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "{why}");
        eprintln!("{why}");
        return None;
    }
    fs::set_permissions(sandbox.path("."), fs::Permissions::from_mode(0o755)).unwrap();
    let binary = sandbox.path("pathtune");
    fs::copy(env!("CARGO_BIN_EXE_pathtune"), &binary).unwrap();
    fs::set_permissions(&binary, fs::Permissions::from_mode(0o755)).unwrap();
    Some(binary.to_str().unwrap().to_owned())
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned()
}

/// Waits for the only run in a user's folder to drive.
fn name_of_run(user: &User, child: &mut Child) -> String {
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        let journal = fs::metadata(user.home.join("out/journal"));
        if journal.is_ok_and(|it| it.len() > 700) {
            let mut names = fs::read_dir(user.root()).unwrap().flatten();
            return names.find_map(|it| it.file_name().into_string().ok()).unwrap();
        }
        assert!(child.try_wait().unwrap().is_none() && Instant::now() < until, "it does not drive");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_run_is_nobody_else_s_with_a_runtime_folder_and_without() {
    for has_runtime in [true, false] {
        let sandbox = Sandbox::new();
        let Some(pathtune) = binary(&sandbox) else { return };
        let [first, second] = ids();
        let owner = User::new(&sandbox, "a", first, has_runtime);
        let other = User::new(&sandbox, "b", second, has_runtime);
        let args = [&pathtune, "train", "lane_change", "--no-memo", "--episodes", "5000", "-q"];
        let mut child = owner.start(&[&args[..], &["--out", "out"]].concat());
        let run = name_of_run(&owner, &mut child);
        let segments = runtime::run::segments_of(u64::from_str_radix(&run, 16).unwrap());
        assert!(segments.len() > 20, "{segments:?}");

        // Neither listed, read, written nor removed.
        let script = "ls \"$0\" 2>/dev/null && echo listed
            for f in \"$@\"; do
                head -c 1 /dev/shm/$f > /dev/null 2>&1 && echo read $f
                (: >> /dev/shm/$f) 2>/dev/null && echo wrote $f
                rm -f /dev/shm/$f 2>/dev/null && echo removed $f
            done; echo done";
        let root = owner.root();
        let mut words = vec!["sh", "-c", script, root.to_str().unwrap()];
        words.extend(segments.iter().map(String::as_str));
        assert_eq!(said(&other.run(&words)), "done\n");
        // Not seen, and neither stopped nor swept: in the other's own folder, and in the owner's.
        let meddler =
            User { id: other.id, home: other.home.clone(), runtime: owner.runtime.clone() };
        for user in [&other, &meddler] {
            assert!(!said(&user.run(&[&pathtune, "status"])).contains(&run));
            for command in ["stop", "monitor", "record", "rearm"] {
                let output = user.run(&[&pathtune, command, &run]);
                assert_eq!(output.status.code(), Some(64), "{command}: {}", said(&output));
            }
            assert!(user.run(&[&pathtune, "stop"]).status.code() == Some(64));
            assert!(user.run(&[&pathtune, "clean"]).status.success());
        }
        let beside = other.run(&[&pathtune, "drive", "lane_change", "-q", "--out", "out"]);
        assert!(beside.status.success(), "{}", said(&beside));
        // It is alive, with all that it had.
        assert!(child.try_wait().unwrap().is_none());
        for name in &segments {
            let meta = fs::metadata(Path::new("/dev/shm").join(name));
            assert!(meta.is_ok_and(|it| it.uid() == first && it.mode() & 0o077 == 0), "{name}");
        }
        assert!(said(&owner.run(&[&pathtune, "status"])).contains(&run));
        signal(child.id() as i32, Signal::INT);
        assert_eq!(child.wait().unwrap().code(), Some(130));
        assert!(!owner.root().exists() && !other.root().exists());
    }
}

#[test]
fn what_a_stranger_put_in_the_place_of_a_runtime_folder_is_left_alone_and_told() {
    let sandbox = Sandbox::new();
    let Some(pathtune) = binary(&sandbox) else { return };
    // Not those of the other test.
    let [owner, stranger] = ids().map(|id| id + 20_000_000);
    let owner = User::new(&sandbox, "a", owner, false);
    let home = User::new(&sandbox, "b", stranger, false).home;
    let root = owner.root();
    let run = root.join("00000000000000aa");
    let makes: [&dyn Fn(); 3] = [
        &|| {
            fs::create_dir_all(&run).unwrap();
            for path in [&root, &run] {
                chown(path, Some(stranger), Some(stranger)).unwrap();
                fs::set_permissions(path, fs::Permissions::from_mode(0o777)).unwrap();
            }
        },
        &|| symlink(&home, &root).unwrap(),
        &|| fs::write(&root, "mine").unwrap(),
    ];
    for make in makes {
        make();
        let args = ["train", "lane_change", "--episodes", "1", "--out", "out"];
        let output = owner.run(&[&[&pathtune[..]], &args[..]].concat());
        let told = said(&output);
        assert_eq!((output.status.code(), told.lines().count()), (Some(64), 1), "{told}");
        assert!(
            told.contains(root.to_str().unwrap()) && told.contains("XDG_RUNTIME_DIR"),
            "{told}"
        );
        assert!(said(&owner.run(&[&pathtune, "status"])).contains("no run is alive"));
        assert_eq!(owner.run(&[&pathtune, "stop"]).status.code(), Some(64));
        assert!(owner.run(&[&pathtune, "clean"]).status.success());
        // It stands as it stood.
        let kind = fs::symlink_metadata(&root).unwrap();
        assert!(!kind.is_dir() || run.is_dir());
        match kind.is_dir() {
            true => fs::remove_dir_all(&root).unwrap(),
            false => fs::remove_file(&root).unwrap(),
        }
    }
}
