//! A car on the other side of DDS: CommonRoad's model behind Cyclone DDS, both in Python.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Program, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use serde_json::Value;

use super::Sandbox;

/// Keeps DDS on this machine, where it is found at the ports that everybody knows: loopback has no multicast.
pub const LOOPBACK: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\"/></Interfaces>\
    <AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
    <MaxAutoParticipantIndex>9</MaxAutoParticipantIndex><Peers><Peer Address=\"127.0.0.1\"/></Peers>\
    </Discovery></Domain></CycloneDDS>";

/// Python with what the car is made of.
pub fn python() -> Option<OsString> {
    let why = "PATHTUNE_PYTHON names no interpreter with cyclonedds and commonroad-vehicle-models";
    let python = std::env::var_os("PATHTUNE_PYTHON").filter(|python| {
        let packages = ["-c", "import cyclonedds, vehiclemodels"];
        Program::new(python).args(packages).output().is_ok_and(|it| it.status.success())
    });
    if python.is_none() {
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "{why}");
        eprintln!("skipped: {why}");
    }
    python
}

/// A domain of its own for each test: below 100, where its ports are nobody else's.
pub fn own_domain() -> u32 {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    1 + (std::process::id() * 10 + NEXT.fetch_add(1, Ordering::Relaxed)) % 99
}

pub struct Peer(Child, PathBuf);

impl Peer {
    pub fn start(sandbox: &Sandbox, python: &OsString, domain: u32, args: &[&str]) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/ros2_car.py");
        let log = sandbox.path("car.log");
        let child = Program::new(python)
            .arg("-B")
            .arg(script)
            .args(["--domain", &domain.to_string(), "--log"])
            .arg(&log)
            .args(args)
            .env("CYCLONEDDS_URI", LOOPBACK)
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

    pub fn wait_until_it_lives(&self) {
        let until = Instant::now() + Duration::from_secs(20);
        while self.log().is_empty() {
            assert!(Instant::now() < until, "the peer does not start");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub fn last(&self, key: &str) -> f64 {
        self.log().last().unwrap()[key].as_f64().unwrap()
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
