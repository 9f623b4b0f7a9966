//! A drive in real time: which odometry is published when, and which commands the car gets meanwhile.
//!
//! Pure: the time is an argument.

use config::{Align, RunConfig};
use ipc_types::{Attempt, BatchHeader, Command, DriveRequest, Odometry, TickHeader, WirePose, has};
use tracking::{Pose, wrap_angle};

use crate::arrivals::NotUsed;
use crate::frames::{Alignment, Reading};
use crate::stop::{Setpoint, Setpoints};
use crate::waits::{Around, Offset, Waits};

/// The car, between its odometry and our commands.
#[derive(Debug, Clone, PartialEq)]
pub struct Car {
    run: u64,
    tick_ns: u64,
    start: Pose,
    align: Align,
    start_distance_m: f64,
    start_heading_rad: f64,
    standstill_mps: f64,
    odometry_age_ns: u64,
    command_age_ns: u64,
    setpoints: Setpoints,
    around: Around,
    /// What was read last, and when it was measured, as far as that is known.
    newest: Option<(Reading, u64)>,
    /// More than one message was used: a stamp that stands would do for one.
    is_followed: bool,
    drive: Option<Drive>,
    /// The last command to the car, and when it was sent.
    told: Option<(Setpoint, u64)>,
    due_ns: u64,
    anomalies: Anomalies,
}

/// Counts of what was not as it should be.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Anomalies {
    /// Requests and commands that did not match.
    pub dropped: u64,
    /// Odometry and commands that were not finite.
    pub rejected: u64,
    /// Commands that came too late, and ticks whose odometry came too late.
    pub late: u64,
    /// Ticks whose odometry was too old to be published; part of `late`.
    pub stale: u64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Drive {
    attempt: Attempt,
    start: Pose,
    /// When tick 0 was, and the tick that is due; `None` while the car is not at the start.
    clock: Option<(u64, u64)>,
    alignment: Alignment,
    held: Option<Held>,
    applied_ns: u64,
    ended: bool,
    collided: bool,
    own_stop: bool,
    /// Another driver has been there, who may have moved the car, or the car did not hear us: this drive does not go on.
    given_up: bool,
}

/// The newest command.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Held {
    tick: u64,
    sent_ns: u64,
    setpoint: Setpoint,
}

/// How a drive began: what a restarted process must know to go on with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Begun {
    /// The attempt.
    pub attempt: Attempt,
    /// How the odometry's frame lies in the map.
    pub alignment: Alignment,
}

/// What to do now.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Step {
    /// Odometry to publish.
    pub odometry: Option<(TickHeader, Odometry)>,
    /// The command to send to the car.
    pub setpoint: Option<Setpoint>,
    /// The drive begins with this step.
    pub begun: Option<Begun>,
}

impl Car {
    /// A car of which nothing is known yet.
    pub fn new(config: &RunConfig, run: u64) -> Self {
        let vehicle = &config.vehicle;
        let ns = |s: f64| (s * 1e9).round() as u64;
        Self {
            run,
            tick_ns: ns(config.drive.tick_s),
            start: config.path.start.into(),
            align: vehicle.ros2.align,
            start_distance_m: vehicle.ros2.start_distance_m,
            start_heading_rad: vehicle.ros2.start_heading_rad,
            standstill_mps: vehicle.safety.standstill_mps,
            odometry_age_ns: ns(vehicle.ros2.odometry_age_limit_s),
            command_age_ns: ns(vehicle.safety.command_age_limit_s),
            setpoints: Setpoints::new(vehicle),
            around: Around::default(),
            newest: None,
            is_followed: false,
            drive: None,
            told: None,
            due_ns: u64::MAX,
            anomalies: Anomalies::default(),
        }
    }

    /// Takes odometry that has just come. Returns why it is not used, if so.
    pub fn see(&mut self, reading: Reading, now_ns: u64) -> Option<NotUsed> {
        // Repeating an old message does not make it newer.
        let is_repeated = reading.stamp != Default::default()
            && self.newest.is_some_and(|(last, _)| last.stamp == reading.stamp);
        if is_repeated {
            return Some(NotUsed::StampStands(reading.stamp));
        }
        let age_ns = reading.age_ns.unwrap_or(0);
        if age_ns > self.odometry_age_ns {
            let [age_s, limit_s] = [age_ns, self.odometry_age_ns].map(|ns| ns as f64 * 1e-9);
            return Some(NotUsed::Old { age_s, limit_s });
        }
        self.is_followed = self.newest.is_some();
        self.newest = Some((reading, now_ns.saturating_sub(age_ns)));
        None
    }

    /// Notes who is on the topic of the commands now.
    pub fn look_around(&mut self, around: Around) {
        self.around = around;
        if let Some(drive) = &mut self.drive {
            drive.given_up |= around.other_drivers > 0 && drive.clock.is_some();
        }
    }

    /// The car no longer hears us: should it do so again, it is brought to a stop. Returns whether a drive was under way.
    pub fn lose(&mut self) -> bool {
        let drive = self.drive.as_mut().filter(|drive| drive.clock.is_some() && !drive.given_up);
        drive.map(|drive| drive.given_up = true).is_some()
    }

    /// Whether the car was sent a command lately.
    pub fn is_told(&self, now_ns: u64) -> bool {
        self.told.is_some_and(|(_, at_ns)| now_ns.saturating_sub(at_ns) < 10 * self.tick_ns)
    }

    /// Counts odometry that cannot be used.
    pub fn reject(&mut self) {
        self.anomalies.rejected += 1;
    }

    /// Notes a collision.
    pub fn collide(&mut self) {
        if let Some(drive) = &mut self.drive {
            drive.collided |= drive.clock.is_some();
        }
    }

    /// How old the newest odometry is; `None` before the first.
    pub fn odometry_age_ns(&self, now_ns: u64) -> Option<u64> {
        self.newest.map(|(_, at_ns)| now_ns.saturating_sub(at_ns))
    }

    /// Whether the newest odometry tells its age by its stamp.
    pub fn knows_ages(&self) -> bool {
        self.newest.is_some_and(|(reading, _)| reading.age_ns.is_some())
    }

    fn fresh(&self, now_ns: u64) -> Option<Reading> {
        let (reading, at_ns) = self.newest?;
        (now_ns.saturating_sub(at_ns) <= self.odometry_age_ns).then_some(reading)
    }

    /// How far the car is from the start, if that is known now.
    pub fn offset(&self, now_ns: u64) -> Option<Offset> {
        let reading = self.fresh(now_ns)?;
        if self.align == Align::Start {
            return Some(Offset::default());
        }
        let start = self.drive.map_or(self.start, |drive| drive.start);
        Some(Offset {
            distance_m: (reading.pose.position() - start.position()).norm(),
            heading_rad: wrap_angle(reading.pose.yaw_rad - start.yaw_rad).abs(),
        })
    }

    /// What a drive would have to wait for; `None` if the car stands at the start of the path, and obeys us alone.
    pub fn waits(&self, now_ns: u64) -> Option<Waits> {
        let (Some(reading), Some(off)) = (self.fresh(now_ns), self.offset(now_ns)) else {
            return Some(Waits::Odometry);
        };
        if !self.is_followed {
            return Some(Waits::Odometry);
        }
        if !self.around.is_heard {
            return Some(Waits::Subscriber);
        }
        if self.around.other_drivers > 0 {
            return Some(Waits::OtherDriver);
        }
        if reading.speed_mps.abs() > self.standstill_mps {
            return Some(Waits::Standstill { speed_mps: reading.speed_mps });
        }
        let is_there =
            off.distance_m <= self.start_distance_m && off.heading_rad <= self.start_heading_rad;
        (!is_there).then_some(Waits::Start(off))
    }

    /// What a drive that was requested waits for.
    pub fn start_waits(&self, now_ns: u64) -> Option<Waits> {
        self.waits(now_ns).or((!self.around.is_answered).then_some(Waits::Answer))
    }

    /// Whether a request waits for the car to be at the start.
    pub fn is_awaited(&self) -> bool {
        self.drive.is_some_and(|drive| drive.clock.is_none())
    }

    /// Batch and next tick of the drive.
    pub fn progress(&self) -> (u64, u64) {
        self.drive
            .map_or((0, 0), |drive| (drive.attempt.batch, drive.clock.map_or(0, |(_, next)| next)))
    }

    /// Counts of what was not as it should be.
    pub fn anomalies(&self) -> Anomalies {
        self.anomalies
    }

    /// When [`Car::step`] has something to do; `u64::MAX` for never.
    pub fn due_ns(&self) -> u64 {
        self.due_ns
    }

    /// Whether the car has been sent a command.
    pub fn has_driven(&self) -> bool {
        self.told.is_some()
    }

    /// Takes a request for a drive, which ends any drive under way. Returns whether it is one for us.
    pub fn request(&mut self, header: BatchHeader, requests: &[DriveRequest], now_ns: u64) -> bool {
        let [request] = requests else {
            self.anomalies.dropped += 1;
            return false;
        };
        if !header.attempt.is_of(self.run) {
            self.anomalies.dropped += 1;
            return false;
        }
        let WirePose { x_m, y_m, yaw_rad } = request.start;
        self.drive = Some(Drive {
            attempt: header.attempt,
            start: Pose { x_m, y_m, yaw_rad },
            clock: None,
            alignment: Alignment::default(),
            held: None,
            applied_ns: 0,
            ended: false,
            collided: false,
            own_stop: false,
            given_up: false,
        });
        self.due_ns = now_ns;
        true
    }

    /// Goes on with the drive of the request that was just taken: this process was restarted during it.
    pub fn rejoin(&mut self, begun: Begun, requested_ns: u64, now_ns: u64) {
        let Some(drive) = &mut self.drive else { return };
        if drive.attempt == begun.attempt {
            drive.alignment = begun.alignment;
            let tick = now_ns.saturating_sub(requested_ns) / self.tick_ns;
            drive.clock = Some((requested_ns, tick));
        }
    }

    /// Takes a command. Returns what the car must be told at once, if anything.
    pub fn obey(
        &mut self,
        header: TickHeader,
        commands: &[Command],
        now_ns: u64,
    ) -> Option<Setpoint> {
        let matching = self.drive.as_mut().filter(|drive| {
            header.attempt == drive.attempt
                && drive.clock.is_some()
                && drive.held.is_none_or(|held| header.tick >= held.tick)
        });
        let (Some(drive), [command]) = (matching, commands) else {
            self.anomalies.dropped += 1;
            return None;
        };
        // Late or not, a drive that has ended does not go on: it is only brought to a stop.
        let ends = has(command.flags, Command::ENDED);
        drive.ended |= ends;
        if drive.ended && !ends {
            return None;
        }
        if now_ns.saturating_sub(header.supervisor_sent_ns) > self.command_age_ns {
            self.anomalies.late += 1;
            return None;
        }
        let setpoint = self.setpoints.of(command).unwrap_or_else(|| {
            self.anomalies.rejected += 1;
            Setpoint::default()
        });
        drive.held = Some(Held { tick: header.tick, sent_ns: header.supervisor_sent_ns, setpoint });
        if drive.given_up {
            return None;
        }
        // What nobody has received has not been applied.
        if self.around.is_heard {
            drive.applied_ns = now_ns;
        }
        drive.own_stop = false;
        self.told = Some((setpoint, now_ns));
        Some(setpoint)
    }

    /// Does what is due.
    pub fn step(&mut self, now_ns: u64) -> Step {
        let mut step = Step::default();
        if now_ns < self.due_ns {
            return step;
        }
        let fresh = self.fresh(now_ns);
        let waits = self.start_waits(now_ns);
        let Some(mut drive) = self.drive else {
            self.due_ns = u64::MAX;
            return step;
        };
        if let (None, None, Some(reading)) = (drive.clock, waits, fresh) {
            drive.alignment = Alignment::new(self.align, reading.pose, drive.start);
            drive.clock = Some((now_ns, 0));
            let Drive { attempt, alignment, .. } = drive;
            step.begun = Some(Begun { attempt, alignment });
        }
        match drive.clock {
            None => {
                // The car still rolls, or has to be brought to the start: its earlier commands no longer count. One that
                // stands at the start is told to stay, to see whether it hears that.
                if self.told.is_some() || waits == Some(Waits::Answer) {
                    step.setpoint = Some(self.stop(fresh, now_ns));
                }
                self.due_ns = now_ns + self.tick_ns;
            }
            Some((since_ns, _)) => {
                let tick = now_ns.saturating_sub(since_ns) / self.tick_ns;
                let setpoint = self.setpoint(&mut drive, since_ns, fresh, now_ns);
                step.setpoint = Some(setpoint);
                match fresh {
                    None => {
                        self.anomalies.stale += 1;
                        self.anomalies.late += 1;
                    }
                    Some(reading) => {
                        step.odometry =
                            Some(self.odometry(&drive, tick, reading, setpoint, now_ns));
                    }
                }
                drive.clock = Some((since_ns, tick + 1));
                self.due_ns = since_ns + (tick + 1) * self.tick_ns;
            }
        }
        if let Some(setpoint) = step.setpoint {
            self.told = Some((setpoint, now_ns));
        }
        self.drive = Some(drive);
        step
    }

    /// The command to the car at a tick.
    fn setpoint(
        &self,
        drive: &mut Drive,
        since_ns: u64,
        fresh: Option<Reading>,
        now_ns: u64,
    ) -> Setpoint {
        drive.own_stop = false;
        let is_young = |sent_ns: u64| now_ns.saturating_sub(sent_ns) <= self.command_age_ns;
        match drive.held {
            Some(held) if is_young(held.sent_ns) && !drive.given_up => held.setpoint,
            // There cannot be an answer yet.
            None if is_young(since_ns) => Setpoint::default(),
            _ => {
                drive.own_stop = !drive.ended;
                self.stop(fresh, now_ns)
            }
        }
    }

    /// The next setpoint of the car's own stop.
    fn stop(&self, fresh: Option<Reading>, now_ns: u64) -> Setpoint {
        match self.told {
            Some((told, at_ns)) => {
                let since_s = now_ns.saturating_sub(at_ns) as f64 * 1e-9;
                self.setpoints.stop(told.speed_mps, since_s)
            }
            // After a restart, the earlier command is unknown, but the car reports its speed.
            None => self.setpoints.stop(fresh.map_or(0.0, |it| it.speed_mps), 0.0),
        }
    }

    fn odometry(
        &self,
        drive: &Drive,
        tick: u64,
        reading: Reading,
        setpoint: Setpoint,
        now_ns: u64,
    ) -> (TickHeader, Odometry) {
        let Pose { x_m, y_m, yaw_rad } = drive.alignment.to_map(reading.pose);
        let status = [
            (drive.collided, Odometry::COLLISION),
            (drive.ended, Odometry::ENDED),
            (drive.own_stop && self.around.is_heard, Odometry::OWN_STOP),
        ];
        let odometry = Odometry {
            measured: WirePose { x_m, y_m, yaw_rad },
            truth: WirePose::default(),
            speed_mps: reading.speed_mps,
            yaw_rate_radps: reading.yaw_rate_radps,
            // The message does not contain the steering angle: the commanded one is used.
            steering_rad: setpoint.steering_rad,
            status: status.iter().filter(|(is, _)| *is).fold(0, |bits, (_, bit)| bits | bit),
            reserved: 0,
        };
        let header = TickHeader {
            attempt: drive.attempt,
            tick,
            applied_ns: drive.applied_ns,
            odometry_sent_ns: now_ns,
            ..TickHeader::default()
        };
        (header, odometry)
    }
}

#[cfg(test)]
#[path = "car_tests.rs"]
mod tests;
