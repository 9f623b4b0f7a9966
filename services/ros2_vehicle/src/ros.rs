//! The car's topics on the ROS 2 network.

use std::fmt::Display;
use std::net::{IpAddr, UdpSocket};
use std::time::{Duration, Instant};

use anyhow::Result;
use config::{CollisionMessage, DriveMessage, Ros2, Ros2Reliability, Vehicle};
use ros2_client::dds::rustdds::dds::qos::policy;
use ros2_client::dds::rustdds::{
    DomainParticipant, DomainParticipantBuilder, GUID, RTPSEntity, Topic,
};
use ros2_client::qos::{History, QosProfile, Reliability, WhenFull};
use ros2_client::{
    Context, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, Subscription,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::Refused;
use crate::messages::{
    AckermannDrive, AckermannDriveStamped, Bool, CarlaCollisionEvent, Header, ODOMETRY, Odometry,
    Time, Twist, collision_type, drive_type, to_drive, to_twist,
};
use crate::missing::{Ours, Peer};
use crate::stop::Setpoint;
use crate::threads::Threads;
use crate::waits::Around;

/// How many commands are kept for a reader that missed one: older ones would be out of date.
const DRIVE_DEPTH: usize = 10;
/// How long a publisher of the drive topic may take to be discovered.
const DISCOVERY: Duration = Duration::from_secs(2);

/// The car on the network.
pub(crate) struct Ros {
    settings: Ros2,
    wheelbase_m: f64,
    participant: DomainParticipant,
    threads: Threads,
    odometry: Subscription<Odometry>,
    collision: Option<Collision>,
    drive: Drive,
    // The other fields depend on these.
    _node: Node,
    _context: Context,
}

enum Drive {
    Stamped(Publisher<AckermannDriveStamped>),
    Bare(Publisher<AckermannDrive>),
    Twist(Publisher<Twist>),
}

enum Collision {
    CarlaEvent(Subscription<CarlaCollisionEvent>),
    Bool(Subscription<Bool>),
}

fn refused(what: &str) -> impl Fn(&dyn Display) -> Refused {
    move |why| Refused(format!("ROS 2: {what}: {why}"))
}

fn reader(reliability: Ros2Reliability) -> QosProfile {
    let newest = QosProfile::subscription_default();
    match reliability {
        Ros2Reliability::BestEffort => newest.reliability_best_effort(),
        Ros2Reliability::Reliable => newest.reliability_reliable(WhenFull::Fail),
    }
}

fn writer(reliability: Ros2Reliability) -> QosProfile {
    QosProfile {
        reliability: match reliability {
            Ros2Reliability::BestEffort => Reliability::BestEffort,
            // A subscriber that does not read must not hold up the car.
            Ros2Reliability::Reliable => Reliability::Reliable { when_full: WhenFull::Fail },
        },
        history: History::KeepLast { depth: DRIVE_DEPTH },
        ..QosProfile::publisher_default()
    }
}

struct Maker {
    node: Node,
}

impl Maker {
    fn topic(&mut self, name: &str, of: (&str, &str), qos: &QosProfile) -> Result<Topic, Refused> {
        let fail = refused(name);
        let parsed = Name::parse(name).map_err(|why| fail(&format!("{why:?}")))?;
        self.node
            .create_topic(&parsed, MessageTypeName::new(of.0, of.1), qos)
            .map_err(|why| fail(&format!("{why:?}")))
    }

    fn reader<M: DeserializeOwned + 'static>(
        &mut self,
        name: &str,
        of: (&str, &str),
        reliability: Ros2Reliability,
    ) -> Result<Subscription<M>, Refused> {
        let qos = reader(reliability);
        let topic = self.topic(name, of, &qos)?;
        self.node
            .create_subscription(&topic, Some(qos))
            .map_err(|why| refused(name)(&format!("{why:?}")))
    }

    fn writer<M: Serialize>(
        &mut self,
        name: &str,
        of: (&str, &str),
        reliability: Ros2Reliability,
    ) -> Result<Publisher<M>, Refused> {
        let qos = writer(reliability);
        let topic = self.topic(name, of, &qos)?;
        self.node
            .create_publisher(&topic, Some(qos))
            .map_err(|why| refused(name)(&format!("{why:?}")))
    }
}

impl Ros {
    /// Joins the network. With `alone`, refuses to do so if there is another driver of the car.
    pub(crate) fn join(vehicle: &Vehicle, alone: bool) -> Result<Self, Refused> {
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
            .map_err(|why| fail(&format!("its threads cannot be watched: {why}")))?;
        let participant = participant.map_err(|why| fail(&format!("{why:?}")))?;
        let context = Context::from_domain_participant(participant.clone())
            .map_err(|why| fail(&format!("{why:?}")))?;
        if alone {
            let until = Instant::now() + DISCOVERY;
            while Instant::now() < until {
                let others = writers(&participant, &settings.drive_topic).len();
                if others > 0 {
                    return Err(Refused(crate::missing::driven_by_others(
                        &settings.drive_topic,
                        others,
                    )));
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        let name = NodeName::new("/", "pathtune_vehicle").expect("a valid node name");
        // The node needs no parameters, and the log is our own.
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let node = context.new_node(name, options).map_err(|why| fail(&format!("{why:?}")))?;
        let mut make = Maker { node };
        let odometry =
            make.reader(&settings.odometry_topic, ODOMETRY, settings.odometry_reliability)?;
        let of = drive_type(settings.drive_message);
        let (topic, reliability) = (&settings.drive_topic, settings.drive_reliability);
        let drive = match settings.drive_message {
            DriveMessage::Stamped => Drive::Stamped(make.writer(topic, of, reliability)?),
            DriveMessage::Bare => Drive::Bare(make.writer(topic, of, reliability)?),
            DriveMessage::Twist => Drive::Twist(make.writer(topic, of, reliability)?),
        };
        let of = collision_type(settings.collision_message);
        let (topic, reliability) = (&settings.collision_topic, settings.collision_reliability);
        let collision = match settings.collision_message {
            _ if topic.is_empty() => None,
            CollisionMessage::CarlaEvent => {
                Some(Collision::CarlaEvent(make.reader(topic, of, reliability)?))
            }
            CollisionMessage::Bool => Some(Collision::Bool(make.reader(topic, of, reliability)?)),
        };
        let settings = settings.clone();
        Ok(Self {
            settings,
            wheelbase_m: vehicle.wheelbase_m,
            participant,
            threads,
            odometry,
            collision,
            drive,
            _node: make.node,
            _context: context,
        })
    }

    /// Whether messages still come and go. Nothing but [`Ros::join`] brings back what has ended.
    pub(crate) fn is_alive(&self) -> bool {
        self.threads.all_live()
    }

    /// The next odometry that has come, and when it was sent by its sender's clock; an error if it cannot be parsed.
    pub(crate) fn next_odometry(&self) -> Result<Option<(Odometry, Time)>, String> {
        let taken = self.odometry.take().map_err(|why| why.to_string())?;
        Ok(taken.map(|(odometry, info)| {
            let sent_ns = info.source_timestamp().map(|time| time.to_nanos());
            (odometry, sent_ns.map_or_else(wall_clock, to_time))
        }))
    }

    /// Whether a collision was reported since the last look.
    pub(crate) fn has_collided(&self) -> bool {
        let mut any = false;
        match &self.collision {
            None => {}
            Some(Collision::CarlaEvent(reader)) => {
                while let Ok(Some(_)) = reader.take() {
                    any = true;
                }
            }
            Some(Collision::Bool(reader)) => {
                while let Ok(Some((told, _))) = reader.take() {
                    any |= told.data;
                }
            }
        }
        any
    }

    /// Sends a command to the car.
    pub(crate) fn tell(&self, setpoint: Setpoint) -> Result<(), String> {
        let sign = self.settings.steering_sign;
        let drive = to_drive(setpoint, sign);
        match &self.drive {
            Drive::Bare(writer) => writer.publish(drive).map_err(|why| why.to_string()),
            Drive::Twist(writer) => {
                let twist = to_twist(setpoint, sign, self.wheelbase_m);
                writer.publish(twist).map_err(|why| why.to_string())
            }
            Drive::Stamped(writer) => {
                let header =
                    Header { stamp: wall_clock(), frame_id: self.settings.drive_frame.clone() };
                let message = AckermannDriveStamped { header, drive };
                writer.publish(message).map_err(|why| why.to_string())
            }
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
            other_drivers: writers(&self.participant, &self.settings.drive_topic).len(),
        }
    }

    /// The message about odometry that does not come.
    pub(crate) fn no_odometry(&self) -> String {
        let topic = &self.settings.odometry_topic;
        let reliability = self.settings.odometry_reliability;
        let ours = Ours { topic, of_type: ODOMETRY, reliability };
        let publishers = writers(&self.participant, topic);
        crate::missing::no_odometry(ours, &publishers, self.settings.domain_id)
    }

    /// The message about commands that nobody receives, if so.
    pub(crate) fn nobody_hears(&self) -> Option<String> {
        let topic = &self.settings.drive_topic;
        let of_type = drive_type(self.settings.drive_message);
        let ours = Ours { topic, of_type, reliability: self.settings.drive_reliability };
        let subscribers: Vec<Peer> = self
            .participant
            .discovered_readers()
            .iter()
            .map(|reader| &reader.subscription_topic_data)
            .filter(|data| *data.topic_name() == dds_topic(topic))
            .map(|data| Peer {
                type_name: data.type_name().clone(),
                reliability: reliability(data.qos().reliability(), Ros2Reliability::BestEffort),
            })
            .collect();
        crate::missing::nobody_hears(ours, &subscribers)
    }
}

/// Publishers of a topic that are not ours. By multicast, a participant discovers itself as well.
fn writers(participant: &DomainParticipant, topic: &str) -> Vec<Peer> {
    let GUID { prefix: ours, .. } = participant.guid();
    participant
        .discovered_writers()
        .iter()
        .map(|writer| &writer.publication_topic_data)
        .filter(|data| data.key.prefix != ours && *data.topic_name() == dds_topic(topic))
        .map(|data| Peer {
            type_name: data.type_name.clone(),
            reliability: reliability(data.reliability, Ros2Reliability::Reliable),
        })
        .collect()
}

/// The name of a ROS topic in DDS.
fn dds_topic(name: &str) -> String {
    format!("rt{name}")
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

fn to_time(ns: i64) -> Time {
    let second_ns = 1_000_000_000;
    Time { sec: ns.div_euclid(second_ns) as i32, nanosec: ns.rem_euclid(second_ns) as u32 }
}
