//! The rest of the ring around the adapter: the test itself, on the run's shared memory.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Child;
use std::time::{Duration, Instant};

use config::{Layers, RunConfig};
use ipc_types::{
    Attempt, BatchHeader, Command, DriveRequest, Odometry, Status, TickHeader, WirePose, has,
};
use runtime::clock::now_ns;
use runtime::run::{RunNames, segments_of};
use runtime::{Attachment, Bus, Inlet, Outlet, Wait};
use rustix::process::Signal;

use crate::support::{Sandbox, signal};

/// The rest of the ring.
pub(super) struct Ring {
    attachment: Attachment,
    requests: Outlet<DriveRequest>,
    commands: Outlet<Command>,
    odometry: Inlet<Odometry>,
    pub(super) status: Inlet<Status>,
    pub(super) bus: Bus,
    pub(super) adapter: Child,
    log: PathBuf,
    pub(super) newest_status: Status,
    batch: u64,
    /// Everything that the vehicle has published.
    pub(super) heard: Vec<(TickHeader, Odometry)>,
    // The last to go.
    leftovers: Option<Leftovers>,
}

/// Removes what a failed test leaves.
struct Leftovers(RunNames);

impl Drop for Leftovers {
    fn drop(&mut self) {
        self.0.remove();
    }
}

impl Ring {
    /// Creates a run and starts the adapter in it.
    pub(super) fn start(sandbox: &Sandbox, domain: u32, vehicle: &str, settings: &[&str]) -> Self {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set_vehicle("--vehicle", vehicle).unwrap();
        layers.set(&format!("vehicle.ros2.domain_id={domain}")).unwrap();
        layers.set("vehicle.ros2.network='127.0.0.1'").unwrap();
        for setting in settings {
            layers.set(setting).unwrap();
        }
        let config: RunConfig = layers.resolve().unwrap();
        let run = now_ns() << 8 | u64::from(domain);
        let root = sandbox.path("r").join("pathtune").join(format!("{run:016x}"));
        fs::create_dir_all(&root).unwrap();
        let folder = sandbox.path("out");
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("config.toml"), toml::to_string(&config).unwrap()).unwrap();
        let attachment = Attachment {
            names: RunNames { run, root },
            folder,
            max_len: 1,
            ring: 0,
            incarnation: 1,
            core: None,
            wait: Wait::default(),
            fifo: None,
            parent: std::process::id() as i32,
            chaos: None,
        };
        let bus = Bus::create(&attachment.names, 1).unwrap();
        let log = sandbox.path("adapter.log");
        let adapter = Self::spawn(sandbox, &attachment, &log);
        Self {
            leftovers: Some(Leftovers(attachment.names.clone())),
            requests: bus.outlet().unwrap(),
            commands: bus.outlet().unwrap(),
            odometry: bus.observe().unwrap(),
            status: bus.observe().unwrap(),
            attachment,
            bus,
            adapter,
            log,
            newest_status: Status::default(),
            batch: 0,
            heard: Vec::new(),
        }
    }

    fn spawn(sandbox: &Sandbox, attachment: &Attachment, log: &Path) -> Child {
        let log = fs::OpenOptions::new().create(true).append(true).open(log).unwrap();
        sandbox
            .command(&["service", "ros2-vehicle"])
            .envs(attachment.to_env())
            .stdout(log.try_clone().unwrap())
            .stderr(log)
            .spawn()
            .unwrap()
    }

    /// Kills the adapter and starts it again, as the orchestrator does.
    pub(super) fn kill_and_restart(&mut self, sandbox: &Sandbox) {
        self.adapter.kill().unwrap();
        self.adapter.wait().unwrap();
        // What it had still published is of the time before the kill.
        self.turn(&mut |_| None);
        self.bus.clean_dead_nodes();
        self.attachment.incarnation += 1;
        self.newest_status = Status::default();
        self.adapter = Self::spawn(sandbox, &self.attachment, &self.log);
    }

    pub(super) fn told(&self) -> String {
        fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Takes what has come; answers each odometry with what `answer` makes of it.
    pub(super) fn turn(&mut self, answer: &mut dyn FnMut(&Odometry) -> Option<Command>) {
        self.bus.look_for_readers();
        while let Some(status) = self.status.receive().unwrap() {
            self.newest_status = status.items()[0];
        }
        while let Some(received) = self.odometry.receive().unwrap() {
            let (mut header, odometry) = (received.header(), received.items()[0]);
            self.heard.push((header, odometry));
            if let Some(command) = answer(&odometry) {
                header.supervisor_sent_ns = now_ns();
                self.commands.send(header, 1, |_| command).unwrap();
            }
        }
        std::thread::sleep(Duration::from_micros(500));
    }

    pub(super) fn drive(
        &mut self,
        time: Duration,
        mut answer: impl FnMut(&Odometry) -> Option<Command>,
    ) -> Vec<(TickHeader, Odometry)> {
        let (from, until) = (self.heard.len(), Instant::now() + time);
        while Instant::now() < until {
            self.turn(&mut answer);
        }
        self.heard[from..].to_vec()
    }

    pub(super) fn wait_for(
        &mut self,
        what: &str,
        within: Duration,
        mut is_so: impl FnMut(&Self) -> bool,
    ) {
        let until = Instant::now() + within;
        while !is_so(self) {
            assert!(Instant::now() < until, "waited in vain for {what}: {}", self.told());
            let ended = self.adapter.try_wait().unwrap();
            assert!(ended.is_none(), "ended while waiting for {what}: {}", self.told());
            self.turn(&mut |_| None);
        }
    }

    pub(super) fn is_at_start(&self) -> bool {
        self.newest_status.state == Status::READY
            && has(self.newest_status.pacing, Status::REAL_TIME)
            && has(self.newest_status.pacing, Status::AT_START)
    }

    pub(super) fn request(&mut self) {
        self.batch += 1;
        let (run, batch) = (self.attachment.names.run, self.batch);
        let attempt = Attempt { run, batch, attempt: 1, reserved: 0 };
        let header = BatchHeader { attempt, sent_ns: now_ns(), ..BatchHeader::default() };
        let request = DriveRequest { flags: DriveRequest::REAL_TIME, ..Default::default() };
        self.requests.send(header, 1, |_| request).unwrap();
    }

    /// Asks the adapter to stop; waits for a good end.
    pub(super) fn stop(mut self) -> String {
        signal(self.adapter.id() as i32, Signal::INT);
        // A busy machine is slow.
        let until = Instant::now() + Duration::from_secs(20);
        let status = loop {
            if let Some(status) = self.adapter.try_wait().unwrap() {
                break status;
            }
            assert!(Instant::now() < until, "does not stop: {}", self.told());
            std::thread::sleep(Duration::from_millis(5));
        };
        assert!(status.success(), "{status}: {}", self.told());
        let told = self.told();
        // Behind the adapter and us nothing is left, but for what the run's end removes.
        let leftovers = self.leftovers.take();
        let run = self.attachment.names.run;
        drop(self);
        let mut left = segments_of(run);
        left.retain(|name| !name.ends_with(".global_mgmt"));
        assert_eq!(left, Vec::<String>::new());
        drop(leftovers);
        assert_eq!(segments_of(run), Vec::<String>::new());
        told
    }
}

impl Drop for Ring {
    fn drop(&mut self) {
        let _ = self.adapter.kill();
        let _ = self.adapter.wait();
    }
}

/// Follows the line y = `y_m`.
pub(super) fn follow(y_m: f64, speed_mps: f64) -> impl Fn(&Odometry) -> Option<Command> {
    move |seen| {
        let WirePose { y_m: at_m, yaw_rad, .. } = seen.measured;
        let steering_rad = (0.5 * (y_m - at_m) - 1.2 * yaw_rad).clamp(-0.4, 0.4);
        Some(Command { speed_mps, steering_rad, ..Command::default() })
    }
}
