//! A car on the other side of DDS: CommonRoad's model behind Cyclone DDS or, as a ROS 2 node, behind Fast DDS.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener};
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Program, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::netns::Host;
use super::{Sandbox, signal};

/// Keeps DDS on this machine, where it is found at the ports that everybody knows: loopback has no multicast.
pub const LOOPBACK: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\"/></Interfaces>\
    <AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
    <MaxAutoParticipantIndex>9</MaxAutoParticipantIndex><Peers><Peer Address=\"127.0.0.1\"/></Peers>\
    </Discovery></Domain></CycloneDDS>";

/// Python with what the car behind Cyclone DDS is made of.
pub fn python() -> Option<OsString> {
    python_with("cyclonedds, vehiclemodels")
}

/// Python with what the ROS 2 node is made of.
pub fn python_with_ros() -> Option<OsString> {
    python_with("rclpy, nav_msgs.msg, geometry_msgs.msg, vehiclemodels")
}

fn python_with(modules: &str) -> Option<OsString> {
    let python = std::env::var_os("PATHTUNE_PYTHON").filter(|python| {
        let import = format!("import {modules}");
        Program::new(python).args(["-c", &import]).output().is_ok_and(|it| it.status.success())
    });
    if python.is_none() {
        let why = format!("PATHTUNE_PYTHON names no interpreter with {modules}");
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "{why}");
        eprintln!("skipped: {why}");
    }
    python
}

/// A domain of its own for each test, whichever process it runs in: below 100, where its ports are nobody else's. It is
/// claimed by a name that the machine gives once, for as long as this process lives.
pub fn own_domain() -> u32 {
    static CLAIMED: Mutex<Vec<UnixListener>> = Mutex::new(Vec::new());
    let claim = |domain: u32| {
        let name =
            SocketAddr::from_abstract_name(format!("pathtune-test-domain-{domain}")).unwrap();
        UnixListener::bind_addr(&name).ok()
    };
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        // Not all from the same end, so that few meet.
        let first = std::process::id() * 10 % 99;
        if let Some((domain, claimed)) =
            (0..99).map(|it| 1 + (first + it) % 99).find_map(|it| Some((it, claim(it)?)))
        {
            CLAIMED.lock().unwrap().push(claimed);
            return domain;
        }
        assert!(Instant::now() < until, "every domain is taken");
        std::thread::sleep(Duration::from_millis(100));
    }
}

pub struct Peer(Child, PathBuf);

/// What a car speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Speaks {
    Cyclone,
    /// By way of rclpy.
    Fast,
}

impl Peer {
    /// A car on this machine, found over loopback.
    pub fn start(sandbox: &Sandbox, python: &OsString, domain: u32, args: &[&str]) -> Self {
        let mut program = Program::new(python);
        program.env("CYCLONEDDS_URI", LOOPBACK);
        Self::spawn(sandbox, program, Speaks::Cyclone, domain, args)
    }

    /// A car on a host of its own, found as DDS finds whoever is on its networks.
    pub fn on(
        host: &Host,
        sandbox: &Sandbox,
        python: &OsString,
        speaks: Speaks,
        args: &[&str],
    ) -> Self {
        let mut program = host.enter(python);
        program.env_remove("CYCLONEDDS_URI");
        Self::spawn(sandbox, program, speaks, 0, args)
    }

    fn spawn(
        sandbox: &Sandbox,
        mut program: Program,
        speaks: Speaks,
        domain: u32,
        args: &[&str],
    ) -> Self {
        let script = match speaks {
            Speaks::Cyclone => "tests/peers/ros2_car.py",
            Speaks::Fast => "tests/peers/rclpy_car.py",
        };
        let is = |what: &str| args.contains(&what);
        let who = match (is("--driver"), is("--ear")) {
            (true, _) => "driver.log",
            (_, true) => "ear.log",
            _ => "car.log",
        };
        let log = sandbox.path(who);
        let child = program
            .arg("-B")
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join(script))
            .args(["--domain", &domain.to_string(), "--log"])
            .arg(&log)
            .args(args)
            // Where ROS 2 writes its own logs.
            .env("ROS_LOG_DIR", sandbox.path("ros"))
            .stdin(Stdio::null())
            .spawn()
            .unwrap();
        Self(child, log)
    }

    /// What the car wrote down.
    pub fn log(&self) -> Vec<Value> {
        let text = fs::read_to_string(&self.1).unwrap_or_default();
        // The last line may be half written.
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    /// The longest time between two commands that it heard, and its own longest step meanwhile, in milliseconds.
    pub fn longest_silence_ms(&self) -> [f64; 2] {
        let log = self.log();
        let number = |line: &Value, key: &str| line[key].as_u64().unwrap();
        let news: Vec<usize> = (1..log.len())
            .filter(|at| number(&log[*at], "heard") > number(&log[at - 1], "heard"))
            .collect();
        let ms = |from: usize, to: usize| {
            (number(&log[to], "t_ns") - number(&log[from], "t_ns")) as f64 / 1e6
        };
        let (first, last) = (news[0], news[news.len() - 1]);
        let silence = news.windows(2).map(|pair| ms(pair[0], pair[1])).fold(0.0, f64::max);
        [silence, (first..last).map(|at| ms(at, at + 1)).fold(0.0, f64::max)]
    }

    pub fn signal(&self, what: rustix::process::Signal) {
        signal(self.0.id() as i32, what);
    }

    /// Stops it for a while. On a busy machine its threads go on for a moment after the signal was sent.
    pub fn freeze(&self) {
        self.signal(rustix::process::Signal::STOP);
        let threads = format!("/proc/{}/task", self.0.id());
        let is_stopped = |thread: fs::DirEntry| {
            let stat = fs::read_to_string(thread.path().join("stat")).unwrap_or_default();
            stat.rsplit_once(") ").is_none_or(|(_, rest)| rest.starts_with('T'))
        };
        let until = Instant::now() + Duration::from_secs(20);
        while !fs::read_dir(&threads).unwrap().flatten().all(is_stopped) {
            assert!(Instant::now() < until, "the peer does not stop");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Files in shared memory that its library, Fast DDS, has opened.
    pub fn shared_files(&self) -> BTreeSet<PathBuf> {
        shared_files(self.0.id())
    }

    pub fn wait_until_it_lives(&self) {
        let until = Instant::now() + Duration::from_secs(20);
        while self.log().is_empty() {
            assert!(Instant::now() < until, "the peer does not start");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub fn last(&self, key: &str) -> f64 {
        let text = fs::read_to_string(&self.1).unwrap_or_default();
        // The last line may be half written.
        let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
        let line = whole.rsplit_once('\n').map_or(whole, |(_, line)| line);
        serde_json::from_str::<Value>(line).expect("a line of the peer's log")[key]
            .as_f64()
            .unwrap()
    }
}

/// Files in shared memory that Fast DDS has opened in a process.
fn shared_files(pid: u32) -> BTreeSet<PathBuf> {
    let maps = fs::read_to_string(format!("/proc/{pid}/maps")).unwrap_or_default();
    let mapped = maps.lines().filter_map(|line| Some(PathBuf::from(line.split_once('/')?.1)));
    let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
    let open = open.filter_map(|it| fs::read_link(it.path()).ok());
    mapped
        .map(|path| Path::new("/").join(path))
        .chain(open)
        .filter(|path| path.parent() == Some(Path::new("/dev/shm")))
        .filter(|path| path.to_string_lossy().contains("fastdds"))
        .collect()
}

/// Removes what a peer that has ended left of them, unless somebody else has it open.
fn sweep(mut left: BTreeSet<PathBuf>) {
    left.retain(|path| path.exists());
    if !left.is_empty() {
        for pid in super::pids() {
            for path in shared_files(pid as u32) {
                left.remove(&path);
            }
        }
    }
    for path in left {
        let _ = fs::remove_file(path);
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // Fast DDS has files in shared memory that it removes at its end, if it comes to that.
        let shared = shared_files(self.0.id());
        signal(self.0.id() as i32, rustix::process::Signal::INT);
        let until = Instant::now() + Duration::from_secs(2);
        while matches!(self.0.try_wait(), Ok(None)) && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(10));
        }
        let _ = self.0.kill();
        let _ = self.0.wait();
        sweep(shared);
    }
}
