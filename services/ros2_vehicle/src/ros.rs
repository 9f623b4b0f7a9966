//! The car's topics on the ROS 2 network.

use std::net::{IpAddr, UdpSocket};
use std::time::{Duration, Instant};

use config::{CollisionMessage, DriveMessage, Ros2, Ros2Reliability, Vehicle};
use rustdds::no_key::SimpleDataReaderCdr;
use rustdds::{DomainParticipant, DomainParticipantBuilder, GUID, RTPSEntity, Timestamp, policy};

use crate::Refused;
use crate::commands::Commands;
use crate::hearing::Answer;
use crate::messages::{
    AckermannDrive, AckermannDriveStamped, Bool, CarlaCollisionEvent, Header, ODOMETRY, Odometry,
    Time, Twist, TwistStamped, collision_type, drive_type, to_drive, to_twist,
};
use crate::missing::{Ours, Peer, dds_topic};
use crate::stop::Setpoint;
use crate::threads::Threads;
use crate::topics::{Topics, refused};
use crate::waits::Around;

/// How long a publisher of the drive topic may take to be discovered.
const DISCOVERY: Duration = Duration::from_secs(2);

/// The car on the network.
pub(crate) struct Ros {
    settings: Ros2,
    wheelbase_m: f64,
    participant: DomainParticipant,
    /// Participants of this process that may not have ended yet.
    former: Vec<GUID>,
    threads: Threads,
    odometry: SimpleDataReaderCdr<Odometry>,
    collision: Option<Collision>,
    drive: Drive,
    // The others depend on it.
    _topics: Topics,
}

enum Drive {
    Stamped(Commands<AckermannDriveStamped>),
    Bare(Commands<AckermannDrive>),
    Twist(Commands<Twist>),
    TwistStamped(Commands<TwistStamped>),
}

enum Collision {
    CarlaEvent(SimpleDataReaderCdr<CarlaCollisionEvent>),
    Bool(SimpleDataReaderCdr<Bool>),
}

impl Ros {
    /// Joins the network. With `alone`, refuses to do so if there is another driver of the car.
    pub(crate) fn join(vehicle: &Vehicle, alone: bool) -> Result<Self, Refused> {
        Self::join_after(vehicle, alone, Vec::new())
    }

    /// Joins the network anew.
    pub(crate) fn rejoin(vehicle: &Vehicle, before: &Self) -> Result<Self, Refused> {
        let mut former = before.former.clone();
        former.push(before.participant.guid());
        Self::join_after(vehicle, false, former)
    }

    fn join_after(vehicle: &Vehicle, alone: bool, former: Vec<GUID>) -> Result<Self, Refused> {
        let settings = &vehicle.ros2;
        let mut builder = DomainParticipantBuilder::new(settings.domain_id);
        if let Ok(address) = settings.network.parse::<IpAddr>() {
            // DDS itself would take any, and then be heard by nobody.
            UdpSocket::bind((address, 0)).map_err(|_| {
                Refused(format!(
                    "vehicle.ros2.network is {address}, but no interface of this machine has that address; `ip address` \
                     lists them, and an empty network means all of them"
                ))
            })?;
            builder = builder.with_only_networks([address]);
        }
        let fail = refused("cannot join the network");
        let (participant, threads) = Threads::of(|| builder.build())
            .map_err(|why| fail(&format_args!("its threads cannot be watched: {why}")))?;
        let participant = participant.map_err(|why| fail(&why))?;
        if alone {
            let until = Instant::now() + DISCOVERY;
            while Instant::now() < until {
                let others = writers(&participant, &former, &settings.drive_topic).len();
                if others > 0 {
                    return Err(Refused(crate::missing::driven_by_others(
                        &settings.drive_topic,
                        others,
                    )));
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        let mut topics = Topics::new(&participant)?;
        let odometry =
            topics.reader(&settings.odometry_topic, ODOMETRY, settings.odometry_reliability)?;
        let of = drive_type(settings.drive_message);
        let (topic, reliability) = (&settings.drive_topic, settings.drive_reliability);
        let drive = match settings.drive_message {
            DriveMessage::Stamped => Drive::Stamped(topics.writer(topic, of, reliability)?),
            DriveMessage::Bare => Drive::Bare(topics.writer(topic, of, reliability)?),
            DriveMessage::Twist => Drive::Twist(topics.writer(topic, of, reliability)?),
            DriveMessage::TwistStamped => {
                Drive::TwistStamped(topics.writer(topic, of, reliability)?)
            }
        };
        let of = collision_type(settings.collision_message);
        let (topic, reliability) = (&settings.collision_topic, settings.collision_reliability);
        let collision = match settings.collision_message {
            _ if topic.is_empty() => None,
            CollisionMessage::CarlaEvent => {
                Some(Collision::CarlaEvent(topics.reader(topic, of, reliability)?))
            }
            CollisionMessage::Bool => {
                Some(Collision::Bool(topics.reader(topic, of, reliability)?))
            }
        };
        topics.announce();
        let settings = settings.clone();
        Ok(Self {
            settings,
            wheelbase_m: vehicle.wheelbase_m,
            participant,
            former,
            threads,
            odometry,
            collision,
            drive,
            _topics: topics,
        })
    }

    /// Whether messages still come and go. Nothing but [`Ros::join`] brings back what has ended.
    pub(crate) fn is_alive(&self) -> bool {
        self.threads.all_live()
    }

    /// The next odometry that has come, and when it was sent by its sender's clock; an error if it cannot be parsed.
    pub(crate) fn next_odometry(&self) -> Result<Option<(Odometry, Time)>, String> {
        self.odometry.drain_read_notifications();
        let taken = self.odometry.try_take_one().map_err(|why| why.to_string())?;
        Ok(taken.map(|sample| {
            let sent = sample.source_timestamp().and_then(to_time).unwrap_or_else(wall_clock);
            (sample.into_value(), sent)
        }))
    }

    /// Whether a collision was reported since the last look.
    pub(crate) fn has_collided(&self) -> bool {
        let mut any = false;
        match &self.collision {
            None => {}
            Some(Collision::CarlaEvent(reader)) => {
                reader.drain_read_notifications();
                while let Ok(Some(_)) = reader.try_take_one() {
                    any = true;
                }
            }
            Some(Collision::Bool(reader)) => {
                reader.drain_read_notifications();
                while let Ok(Some(told)) = reader.try_take_one() {
                    any |= told.into_value().data;
                }
            }
        }
        any
    }

    /// Sends a command to the car.
    pub(crate) fn tell(&mut self, setpoint: Setpoint) -> Result<(), String> {
        let sign = self.settings.steering_sign;
        let drive = to_drive(setpoint, sign);
        let header = || Header { stamp: wall_clock(), frame_id: self.settings.drive_frame.clone() };
        let twist = to_twist(setpoint, sign, self.wheelbase_m);
        match &mut self.drive {
            Drive::Bare(commands) => commands.send(drive),
            Drive::Twist(commands) => commands.send(twist),
            Drive::Stamped(commands) => {
                commands.send(AckermannDriveStamped { header: header(), drive })
            }
            Drive::TwistStamped(commands) => {
                commands.send(TwistStamped { header: header(), twist })
            }
        }
    }

    /// Whether what was sent has arrived.
    pub(crate) fn answer(&mut self) -> Answer {
        match &mut self.drive {
            Drive::Bare(commands) => commands.answer(),
            Drive::Twist(commands) => commands.answer(),
            Drive::Stamped(commands) => commands.answer(),
            Drive::TwistStamped(commands) => commands.answer(),
        }
    }

    /// The topic of the odometry.
    pub(crate) fn odometry_topic(&self) -> &str {
        &self.settings.odometry_topic
    }

    /// The topic of the commands.
    pub(crate) fn drive_topic(&self) -> &str {
        &self.settings.drive_topic
    }

    /// Who is on the topic of the commands.
    pub(crate) fn around(&self) -> Around {
        Around {
            is_heard: self.nobody_hears().is_none(),
            is_answered: false,
            other_drivers: self.writers(&self.settings.drive_topic).len(),
        }
    }

    /// How many receive the commands and acknowledge them.
    pub(crate) fn answerers(&self) -> usize {
        let is_one = |peer: &Peer| peer.reliability == Ros2Reliability::Reliable;
        self.readers().iter().filter(|peer| is_one(peer)).count()
    }

    /// The message about odometry that does not come.
    pub(crate) fn no_odometry(&self) -> String {
        let topic = &self.settings.odometry_topic;
        let reliability = self.settings.odometry_reliability;
        let ours = Ours { topic, of_type: ODOMETRY, reliability };
        let publishers = self.writers(topic);
        crate::missing::no_odometry(ours, &publishers, self.settings.domain_id)
    }

    /// The message about commands that nobody receives, if so.
    pub(crate) fn nobody_hears(&self) -> Option<String> {
        let topic = &self.settings.drive_topic;
        let of_type = drive_type(self.settings.drive_message);
        let ours = Ours { topic, of_type, reliability: self.settings.drive_reliability };
        crate::missing::nobody_hears(ours, &self.readers())
    }

    /// Publishers of a topic that are not ours.
    fn writers(&self, topic: &str) -> Vec<Peer> {
        writers(&self.participant, &self.former, topic)
    }

    /// Subscribers of the commands.
    fn readers(&self) -> Vec<Peer> {
        let topic = dds_topic(&self.settings.drive_topic);
        self.participant
            .discovered_readers()
            .iter()
            .map(|reader| &reader.subscription_topic_data)
            .filter(|data| *data.topic_name() == topic)
            .map(|data| Peer {
                type_name: data.type_name().clone(),
                reliability: reliability(data.qos().reliability(), Ros2Reliability::BestEffort),
            })
            .collect()
    }
}

/// Publishers of a topic that are not of this process. By multicast, a participant discovers itself as well.
fn writers(participant: &DomainParticipant, former: &[GUID], topic: &str) -> Vec<Peer> {
    let is_ours = |guid: GUID| {
        guid.prefix == participant.guid().prefix || former.iter().any(|it| it.prefix == guid.prefix)
    };
    let topic = dds_topic(topic);
    participant
        .discovered_writers()
        .iter()
        .map(|writer| &writer.publication_topic_data)
        .filter(|data| !is_ours(data.key) && *data.topic_name() == topic)
        .map(|data| Peer {
            type_name: data.type_name.clone(),
            reliability: reliability(data.reliability, Ros2Reliability::Reliable),
        })
        .collect()
}

/// The reliability that a peer announces. DDS lets it leave out what is the default: that of a writer is reliable, that
/// of a reader best effort.
fn reliability(policy: Option<policy::Reliability>, default: Ros2Reliability) -> Ros2Reliability {
    match policy {
        Some(policy::Reliability::Reliable { .. }) => Ros2Reliability::Reliable,
        Some(policy::Reliability::BestEffort) => Ros2Reliability::BestEffort,
        None => default,
    }
}

/// ROS stamps are those of the wall clock.
fn wall_clock() -> Time {
    let since = std::time::SystemTime::now()
        .duration_since(std::time::SystemTime::UNIX_EPOCH)
        .unwrap_or_default();
    Time { sec: since.as_secs() as i32, nanosec: since.subsec_nanos() }
}

/// What DDS counts in shares of 2⁻³² s.
fn to_time(sent: Timestamp) -> Option<Time> {
    let ticks = sent.to_ticks();
    let nanosec = ((ticks & u64::from(u32::MAX)) * 1_000_000_000) >> 32;
    let is_one = sent != Timestamp::INVALID && sent != Timestamp::INFINITE;
    is_one.then_some(Time { sec: (ticks >> 32) as i32, nanosec: nanosec as u32 })
}
