//! The process: the vehicle role in real time, between the run's shared memory and the ROS 2 network.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};
use config::RunConfig;
use ipc_types::{Attempt, Command, DriveRequest, Odometry, Status, WakeRole};
use runtime::clock::now_ns;
use runtime::{Attachment, Bus, Counters, Inlet, Outlet, Service, join, serve};
use serde::{Deserialize, Serialize};

use crate::Refused;
use crate::car::{Begun, Car};
use crate::frames::{Alignment, Reader, Unusable};
use crate::missing::driven_by_others;
use crate::ros::Ros;
use crate::stop::Setpoint;

/// How many commands to stop the car gets when the process ends; next, the time between them.
const STOPS: u32 = 5;
const BETWEEN_STOPS: Duration = Duration::from_millis(20);
/// Longest time between two looks at the network.
const LOOK_NS: u64 = 5_000_000;
/// After how long something missing is reported for the first time; next, the time until it is reported again.
const FIRST_TOLD_NS: u64 = 2_000_000_000;
const TOLD_AGAIN_NS: u64 = 10_000_000_000;
/// Time between looks at which peers there are.
const LOOK_AROUND_NS: u64 = 500_000_000;

pub(crate) fn run() -> Result<()> {
    let (attachment, bus, config) = join()?;
    // Before this process is moved to the ring's core, so that the network's threads stay on the other cores.
    let is_first = attachment.incarnation == 1;
    // After a crash the car must not be left alone for longer than necessary; its previous driver was this adapter.
    let ros = Ros::join(&config.vehicle.ros2, is_first)?;
    attachment.take_place();
    let mut adapter = Adapter::new(&attachment, &bus, &config, ros)?;
    serve(&attachment, &bus, WakeRole::Vehicle, &mut adapter)
}

struct Adapter {
    requests: Inlet<DriveRequest>,
    commands: Inlet<Command>,
    odometry: Outlet<Odometry>,
    ros: Ros,
    reader: Reader,
    car: Car,
    batch_file: PathBuf,
    /// A drive that an earlier incarnation of this process had begun.
    begun_before: Option<Begun>,
    look_ns: u64,
    notices: Notices,
}

/// What has been reported, so that it is not reported all the time.
struct Notices {
    due_ns: u64,
    /// When to report next that odometry, or a reader of the commands, is missing.
    odometry_ns: u64,
    hearers_ns: u64,
    start_ns: u64,
    others: usize,
    has_odometry: bool,
    unusable: Option<Unusable>,
    failures: u64,
}

impl Adapter {
    fn new(attachment: &Attachment, bus: &Bus, config: &RunConfig, ros: Ros) -> Result<Self> {
        let now_ns = now_ns();
        let batch_file = attachment.folder.join("ros2-vehicle.toml");
        let begun_before =
            (attachment.incarnation > 1).then(|| BatchFile::read(&batch_file)).flatten();
        Ok(Self {
            requests: bus.inlet()?,
            commands: bus.inlet()?,
            odometry: bus.outlet()?,
            ros,
            reader: Reader::new(&config.vehicle, config.path.start),
            car: Car::new(config, attachment.names.run),
            batch_file,
            begun_before,
            look_ns: 0,
            notices: Notices {
                due_ns: now_ns,
                odometry_ns: now_ns + FIRST_TOLD_NS,
                hearers_ns: now_ns + FIRST_TOLD_NS,
                start_ns: 0,
                others: 0,
                has_odometry: false,
                unusable: None,
                failures: 0,
            },
        })
    }

    /// Takes what the network has brought.
    fn look(&mut self, now_ns: u64) {
        self.look_ns = now_ns + LOOK_NS;
        loop {
            let odometry = match self.ros.next_odometry() {
                Ok(None) => break,
                Ok(Some(odometry)) => odometry,
                Err(why) => {
                    self.car.reject();
                    self.notices.say_failure("an odometry message cannot be read", &why);
                    continue;
                }
            };
            match self.reader.read(&odometry) {
                Ok(reading) => self.car.see(reading, now_ns),
                Err(why) => {
                    self.car.reject();
                    if self.notices.unusable.as_ref() != Some(&why) {
                        tracing::warn!("{why}");
                        self.notices.unusable = Some(why);
                    }
                }
            }
        }
        if self.ros.has_collided() {
            tracing::warn!("the car reports a collision");
            self.car.collide();
        }
    }

    fn tell(&mut self, setpoint: Setpoint) {
        if let Err(why) = self.ros.tell(setpoint) {
            self.notices.say_failure("a command could not be sent", &why);
        }
    }

    fn take_request(&mut self) -> Result<bool> {
        let Some(request) = self.requests.receive_newest()? else { return Ok(false) };
        let header = request.header();
        let now_ns = now_ns();
        if self.car.request(header, request.items(), now_ns) {
            if let Some(begun) = self.begun_before.take() {
                self.car.rejoin(begun, header.sent_ns, now_ns);
            }
            let joined = !self.car.is_awaited();
            let Attempt { batch, attempt, .. } = header.attempt;
            tracing::info!(batch, attempt, joined, "requested");
            self.notices.start_ns = now_ns;
        }
        Ok(true)
    }

    fn step(&mut self) -> Result<()> {
        self.look(now_ns());
        let now_ns = now_ns();
        let offset = self.car.offset(now_ns);
        let step = self.car.step(now_ns);
        if let Some(begun) = step.begun {
            // Written before any process hears of the drive: the process that is started after a crash must not begin
            // it again.
            BatchFile::write(&self.batch_file, begun)
                .with_context(|| format!("failed to write {:?}", self.batch_file))?;
            let off = offset.unwrap_or_default();
            let (distance_m, heading_rad) = (off.distance_m, off.heading_rad);
            tracing::info!(
                batch = begun.attempt.batch,
                "the drive begins {distance_m:.3} m and {heading_rad:.3} rad off the path's start"
            );
        }
        if let Some((header, odometry)) = step.odometry {
            self.odometry.send(header, 1, |_| odometry)?;
        }
        if let Some(setpoint) = step.setpoint {
            self.tell(setpoint);
        }
        Ok(())
    }

    /// Says what is missing.
    ///
    /// # Errors
    /// If another program drives the car, and this one has not yet.
    fn tell_what_is_missing(&mut self, now_ns: u64) -> Result<()> {
        self.notices.due_ns = now_ns + LOOK_AROUND_NS;
        let age_ns = self.car.odometry_age_ns(now_ns);
        if age_ns.is_some_and(|age_ns| age_ns < LOOK_AROUND_NS) {
            if !self.notices.has_odometry {
                tracing::info!("odometry arrives");
            }
            self.notices.has_odometry = true;
            // If it stops, report that at once.
            self.notices.odometry_ns = 0;
        } else if now_ns >= self.notices.odometry_ns {
            self.notices.has_odometry = false;
            self.notices.odometry_ns = now_ns + TOLD_AGAIN_NS;
            let why = self.ros.no_odometry();
            match age_ns {
                None => tracing::warn!("{why}"),
                Some(age_ns) => {
                    tracing::warn!("{why}; the last message came {:.1} s ago", age_ns as f64 * 1e-9)
                }
            }
        }
        if now_ns >= self.notices.hearers_ns {
            let told = self.ros.nobody_hears().inspect(|why| tracing::warn!("{why}"));
            let wait_ns = if told.is_some() { TOLD_AGAIN_NS } else { LOOK_AROUND_NS };
            self.notices.hearers_ns = now_ns + wait_ns;
        }
        let others = self.ros.other_drivers();
        if others > self.notices.others {
            let why = driven_by_others(self.ros.drive_topic(), others);
            // Discovery may take longer than a start may. Once the car is on the road, it is too late to leave it to
            // another driver.
            if !self.car.has_driven() && self.begun_before.is_none() {
                return Err(Refused(why).into());
            }
            tracing::warn!("{why}");
        }
        self.notices.others = others;
        if self.car.is_awaited() && now_ns >= self.notices.start_ns {
            self.notices.start_ns = now_ns + FIRST_TOLD_NS;
            match self.car.offset(now_ns) {
                None => tracing::warn!("the drive waits for odometry"),
                Some(off) => tracing::warn!(
                    "the drive waits for the car to stand at the path's start: it is {:.2} m and {:.2} rad off",
                    off.distance_m,
                    off.heading_rad
                ),
            }
        }
        Ok(())
    }
}

impl Notices {
    fn say_failure(&mut self, what: &str, why: &str) {
        self.failures += 1;
        if self.failures.is_power_of_two() {
            tracing::warn!(times = self.failures, "{what}: {why}");
        }
    }
}

impl Drop for Adapter {
    /// However this process ends, as long as it can still send anything, the car stops.
    fn drop(&mut self) {
        if !self.car.has_driven() {
            return;
        }
        for _ in 0..STOPS {
            self.tell(Setpoint::default());
            std::thread::sleep(BETWEEN_STOPS);
        }
        tracing::info!("told the car to stop");
    }
}

impl Service for Adapter {
    fn poll(&mut self) -> Result<bool> {
        let mut any = self.take_request()?;
        while let Some(command) = self.commands.receive()? {
            any = true;
            if let Some(setpoint) = self.car.obey(command.header(), command.items(), now_ns()) {
                self.tell(setpoint);
            }
        }
        let now_ns = now_ns();
        if now_ns >= self.car.due_ns() {
            self.step()?;
            any = true;
        } else if now_ns >= self.look_ns {
            self.look(now_ns);
        }
        if now_ns >= self.notices.due_ns {
            self.tell_what_is_missing(now_ns)?;
        }
        Ok(any)
    }

    fn status(&self) -> Counters {
        let (batch, tick) = self.car.progress();
        let anomalies = self.car.anomalies();
        let at_start = if self.car.is_at_start(now_ns()) { Status::AT_START } else { 0 };
        Counters {
            batch,
            tick,
            dropped: anomalies.dropped,
            rejected: anomalies.rejected,
            late: anomalies.late,
            capacity: 1,
            pacing: Status::REAL_TIME | at_start,
        }
    }

    fn due_ns(&self) -> u64 {
        self.car.due_ns()
    }
}

/// What a restarted process finds about the drive under way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BatchFile {
    /// In hexadecimal digits, as everywhere, because TOML has no numbers that large.
    run: String,
    batch: u64,
    attempt: u32,
    alignment: Alignment,
}

impl BatchFile {
    fn read(path: &PathBuf) -> Option<Begun> {
        let text = std::fs::read_to_string(path).ok()?;
        let Self { run, batch, attempt, alignment } = toml::from_str(&text).ok()?;
        let run = u64::from_str_radix(&run, 16).ok()?;
        Some(Begun { attempt: Attempt { run, batch, attempt, reserved: 0 }, alignment })
    }

    fn write(path: &PathBuf, begun: Begun) -> Result<()> {
        let Begun { attempt: Attempt { run, batch, attempt, .. }, alignment } = begun;
        let run = format!("{run:016x}");
        let text = toml::to_string(&Self { run, batch, attempt, alignment })?;
        // By rename, so that there is never half a file.
        let new = path.with_extension("new");
        std::fs::write(&new, text)?;
        Ok(std::fs::rename(&new, path)?)
    }
}
