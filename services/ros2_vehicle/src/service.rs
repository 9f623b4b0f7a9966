//! The process: the vehicle role in real time, between the run's shared memory and the ROS 2 network.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use config::{RunConfig, Vehicle};
use ipc_types::{Attempt, Command, DriveRequest, Odometry, Status, WakeRole};
use runtime::clock::now_ns;
use runtime::{Attachment, Bus, Counters, Inlet, Outlet, Service, join, serve};

use crate::Refused;
use crate::arrivals::{Arrivals, NotUsed};
use crate::begun::BatchFile;
use crate::car::{Begun, Car};
use crate::frames::Reader;
use crate::hearing::Hearing;
use crate::missing::{driven_by_others, joined_by_others, odometry_not_used, one_does_not_answer};
use crate::ros::Ros;
use crate::stop::Setpoint;
use crate::waits::Around;

/// How many commands to stop the car gets when the process ends; next, the time between them.
const STOPS: u32 = 5;
const BETWEEN_STOPS: Duration = Duration::from_millis(20);
/// Longest time between two looks at the network.
const LOOK_NS: u64 = 5_000_000;
/// After how long something missing is reported for the first time; next, the time until it is reported again.
const FIRST_TOLD_NS: u64 = 2_000_000_000;
const TOLD_AGAIN_NS: u64 = 10_000_000_000;
/// Time between looks at which peers there are.
const LOOK_AROUND_NS: u64 = 100_000_000;
/// Odometry that has not come for so long is missing.
const ODOMETRY_GONE_NS: u64 = 500_000_000;
/// Longest time for which a process that ends waits until the car hears it.
const HEARD_AGAIN: Duration = Duration::from_secs(1);

pub(crate) fn run() -> Result<()> {
    let (attachment, bus, config) = join()?;
    // Before this process is moved to the ring's core, so that the network's threads stay on the other cores.
    let is_first = attachment.incarnation == 1;
    // After a crash the car must not be left alone for longer than necessary; its previous driver was this adapter.
    let ros = Ros::join(&config.vehicle, is_first)?;
    attachment.take_place();
    let mut adapter = Adapter::new(&attachment, &bus, &config, ros)?;
    serve(&attachment, &bus, WakeRole::Vehicle, &mut adapter)
}

struct Adapter {
    requests: Inlet<DriveRequest>,
    commands: Inlet<Command>,
    odometry: Outlet<Odometry>,
    ros: Ros,
    vehicle: Vehicle,
    reader: Reader,
    arrivals: Arrivals,
    car: Car,
    around: Around,
    hearing: Hearing,
    batch_file: PathBuf,
    /// A drive that an earlier incarnation of this process had begun.
    begun_before: Option<Begun>,
    look_ns: u64,
    notices: Notices,
}

/// What has been reported, so that it is not reported all the time.
struct Notices {
    due_ns: u64,
    /// When to report next that odometry, or a reader of the commands, is missing, or what the drive waits for.
    odometry_ns: u64,
    hearers_ns: u64,
    start_ns: u64,
    has_odometry: bool,
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
            vehicle: config.vehicle.clone(),
            reader: Reader::new(&config.vehicle, config.path.start),
            arrivals: Arrivals::default(),
            car: Car::new(config, attachment.names.run),
            around: Around::default(),
            hearing: Hearing::default(),
            batch_file,
            begun_before,
            look_ns: 0,
            notices: Notices {
                due_ns: now_ns,
                odometry_ns: now_ns + FIRST_TOLD_NS,
                hearers_ns: now_ns + FIRST_TOLD_NS,
                start_ns: 0,
                has_odometry: false,
                failures: 0,
            },
        })
    }

    /// Takes what the network has brought.
    fn look(&mut self, now_ns: u64) {
        self.look_ns = now_ns + LOOK_NS;
        loop {
            let read = match self.ros.next_odometry() {
                Ok(None) => break,
                Ok(Some((odometry, sent))) => {
                    self.reader.read(&odometry, sent).map_err(NotUsed::from)
                }
                Err(why) => Err(NotUsed::Unreadable(why)),
            };
            let not_used = match read {
                Ok(reading) => self.car.see(reading, now_ns),
                Err(why) => {
                    self.car.reject();
                    // If it goes on like this, that is told as odometry that is missing.
                    if self.notices.has_odometry {
                        self.notices.say_failure("odometry that is not used", &why.to_string());
                    }
                    Some(why)
                }
            };
            self.arrivals.note(not_used, now_ns);
        }
        if self.ros.has_collided() {
            tracing::warn!("the car reports a collision");
            self.car.collide();
        }
    }

    /// Joins the network anew if DDS has ended, as it does when this process is stopped and continued.
    ///
    /// # Errors
    /// If the network cannot be joined; the process that is started next may have more luck.
    fn mend(&mut self) -> Result<()> {
        if self.ros.is_alive() {
            return Ok(());
        }
        self.rejoin()?;
        tracing::warn!(
            "this process was stopped for a moment, which ended its link to the car; it has joined the network again"
        );
        Ok(())
    }

    /// Joins the network anew.
    ///
    /// # Errors
    /// If it cannot be joined.
    fn rejoin(&mut self) -> Result<()> {
        let joined = Ros::rejoin(&self.vehicle, &self.ros)?;
        let ended = std::mem::replace(&mut self.ros, joined);
        // This takes down what has not ended yet, and may wait for what no longer answers.
        std::thread::spawn(move || drop(ended));
        // Nobody hears us until we are discovered.
        self.around = Around::default();
        self.hearing.ask_again();
        self.car.look_around(self.around);
        self.notices.due_ns = 0;
        Ok(())
    }

    /// Looks whether the commands arrive.
    ///
    /// # Errors
    /// If they do not, and the network cannot be joined anew.
    fn listen(&mut self, now_ns: u64) -> Result<()> {
        let was_silent = self.hearing.is_silent();
        let (answer, is_told) = (self.ros.answer(), self.car.is_told(now_ns));
        self.hearing.look(answer, is_told, now_ns);
        if self.around.is_answered != self.hearing.is_answered() {
            self.around.is_answered = self.hearing.is_answered();
            self.car.look_around(self.around);
        }
        if !self.hearing.is_silent() {
            return Ok(());
        }
        let topic = self.ros.drive_topic();
        let answerers = self.ros.answerers();
        if answerers > 1 {
            // One that only listens must not stop the car.
            if !was_silent {
                tracing::warn!("{}", one_does_not_answer(topic, answerers));
            }
            return Ok(());
        }
        if self.hearing.is_lost() && self.car.lose() {
            tracing::warn!(
                "no command on {topic} has been acknowledged for a second: should the car hear us again, it is \
                 stopped; this drive does not go on"
            );
        }
        if answerers == 1 && self.hearing.rejoins(now_ns) {
            tracing::warn!(
                "no command on {topic} has been acknowledged for 0.3 s; joining the network anew"
            );
            self.rejoin()?;
        }
        Ok(())
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
            self.hearing.begin();
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

    /// Looks who is on the topic of the commands.
    ///
    /// # Errors
    /// If another program drives the car, and this one has not yet.
    fn look_around(&mut self, now_ns: u64) -> Result<()> {
        let mut around = self.ros.around();
        around.is_answered = self.hearing.is_answered();
        around.is_heard &= !self.hearing.is_silent() || self.ros.answerers() > 1;
        if around.other_drivers > self.around.other_drivers {
            let (topic, others) = (self.ros.drive_topic(), around.other_drivers);
            // Discovery may take longer than a start may. Once the car is on the road, it is too late to leave it to
            // another driver.
            if !self.car.has_driven() && self.begun_before.is_none() {
                return Err(Refused(driven_by_others(topic, others)).into());
            }
            tracing::warn!("{}", joined_by_others(topic, others));
        }
        if around.is_heard && !self.around.is_heard {
            self.notices.hearers_ns = 0;
            tracing::info!("commands are received");
        }
        self.around = around;
        self.car.look_around(around);
        if !around.is_heard && now_ns >= self.notices.hearers_ns {
            self.notices.hearers_ns = now_ns + TOLD_AGAIN_NS;
            if let Some(why) = self.ros.nobody_hears() {
                tracing::warn!("{why}");
            }
        }
        Ok(())
    }

    /// Says what is missing.
    fn tell_what_is_missing(&mut self, now_ns: u64) {
        let age_ns = self.car.odometry_age_ns(now_ns);
        if age_ns.is_some_and(|age_ns| age_ns < ODOMETRY_GONE_NS) {
            if !self.notices.has_odometry {
                let from = if self.car.knows_ages() { "its stamp" } else { "its arrival" };
                tracing::info!("odometry arrives; its age counts from {from}");
            }
            self.notices.has_odometry = true;
            // If it stops, report that at once.
            self.notices.odometry_ns = 0;
        } else if now_ns >= self.notices.odometry_ns {
            self.notices.has_odometry = false;
            self.notices.odometry_ns = now_ns + TOLD_AGAIN_NS;
            let why = match self.arrivals.not_used(now_ns) {
                Some((rate_hz, why)) => odometry_not_used(self.ros.odometry_topic(), rate_hz, why),
                None => self.ros.no_odometry(),
            };
            match age_ns {
                None => tracing::warn!("{why}"),
                Some(age_ns) => {
                    tracing::warn!(
                        "{why}; the last that was used is {:.1} s old",
                        age_ns as f64 * 1e-9
                    )
                }
            }
        }
        if self.car.is_awaited() && now_ns >= self.notices.start_ns {
            self.notices.start_ns = now_ns + FIRST_TOLD_NS;
            if let Some(waits) = self.car.start_waits(now_ns) {
                tracing::warn!("{waits}");
            }
        }
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
        // A link that a pause just before has ended shows that only a moment later: then the car is told again.
        for _ in 0..2 {
            if let Err(why) = self.mend() {
                tracing::warn!("the car could not be told to stop: {why:#}");
                return;
            }
            let until = Instant::now() + HEARD_AGAIN;
            while !self.ros.around().is_heard && Instant::now() < until {
                std::thread::sleep(BETWEEN_STOPS);
            }
            for _ in 0..STOPS {
                self.tell(Setpoint::default());
                std::thread::sleep(BETWEEN_STOPS);
            }
            if self.ros.is_alive() {
                break;
            }
        }
        tracing::info!(
            "told the car to stop; commands were acknowledged after {:.3} s at most",
            self.hearing.longest_ns() as f64 * 1e-9
        );
    }
}

impl Service for Adapter {
    fn poll(&mut self) -> Result<bool> {
        // Before anything is said of the car: what DDS took in before it ended may be old.
        let now = now_ns();
        if now >= self.look_ns {
            self.mend()?;
            self.listen(now)?;
        }
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
            // A car that does not hear us yet may do so at any time.
            let wait_ns = if self.around.is_heard { LOOK_AROUND_NS } else { LOOK_NS };
            self.notices.due_ns = now_ns + wait_ns;
            self.look_around(now_ns)?;
            self.tell_what_is_missing(now_ns);
        }
        Ok(any)
    }

    fn status(&self) -> Counters {
        let (batch, tick) = self.car.progress();
        let anomalies = self.car.anomalies();
        let at_start = if self.car.waits(now_ns()).is_none() { Status::AT_START } else { 0 };
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
