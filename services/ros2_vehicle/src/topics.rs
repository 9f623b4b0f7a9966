//! Readers and writers of ROS topics on a DDS participant, and the node that ROS 2 shows for them.
//!
//! Which reader and writer belongs to which node, ROS 2 learns from the topic `ros_discovery_info`: each participant
//! publishes all of its nodes there, anew whenever one of them changes.

use config::Ros2Reliability;
use rustdds::no_key::{DataWriterCdr, SimpleDataReaderCdr};
use rustdds::policy::{Deadline, Durability, History, Lifespan, Liveliness, Reliability};
use rustdds::{
    DomainParticipant, Duration, GUID, Publisher, QosPolicies, QosPolicyBuilder, RTPSEntity,
    Subscriber, Timestamp, Topic, TopicKind,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::Refused;
use crate::commands::Commands;
use crate::missing::{dds_topic, dds_type};

const NODE: &str = "pathtune_vehicle";
/// Where ROS 2 looks for nodes, and the type of what is there.
const GRAPH_TOPIC: &str = "ros_discovery_info";
const GRAPH_TYPE: (&str, &str) = ("rmw_dds_common", "ParticipantEntitiesInfo");
/// How many commands are kept for a reader that missed one: older ones would be out of date.
const DRIVE_DEPTH: i32 = 10;

/// `rmw_dds_common/Gid`, as it is from ROS 2 Iron on.
type Gid = [u8; 16];

/// `rmw_dds_common/ParticipantEntitiesInfo`.
#[derive(Debug, Clone, Serialize)]
struct Nodes {
    participant: Gid,
    nodes: Vec<Node>,
}

/// `rmw_dds_common/NodeEntitiesInfo`.
#[derive(Debug, Clone, Serialize)]
struct Node {
    namespace: &'static str,
    name: &'static str,
    readers: Vec<Gid>,
    writers: Vec<Gid>,
}

/// The topics of our node.
pub(crate) struct Topics {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    graph: DataWriterCdr<Nodes>,
    node: Node,
}

/// An error of DDS as one of ours.
pub(crate) fn refused(what: &str) -> impl Fn(&dyn std::fmt::Debug) -> Refused {
    move |why| Refused(format!("ROS 2: {what}: {why:?}"))
}

/// As ROS 2 has it by default: nothing ever expires.
fn qos(reliability: Ros2Reliability, durability: Durability, depth: i32) -> QosPolicies {
    let reliability = match reliability {
        Ros2Reliability::BestEffort => Reliability::BestEffort,
        // A subscriber that does not read must not hold up the car.
        Ros2Reliability::Reliable => Reliability::Reliable { max_blocking_time: Duration::ZERO },
    };
    QosPolicyBuilder::new()
        .reliability(reliability)
        .durability(durability)
        .history(History::KeepLast { depth })
        .liveliness(Liveliness::Automatic { lease_duration: Duration::INFINITE })
        .deadline(Deadline(Duration::INFINITE))
        .lifespan(Lifespan { duration: Duration::INFINITE })
        .build()
}

impl Topics {
    /// A node without topics.
    pub(crate) fn new(participant: &DomainParticipant) -> Result<Self, Refused> {
        let fail = refused("cannot join the network");
        let none = QosPolicies::qos_none();
        let publisher = participant.create_publisher(&none).map_err(|why| fail(&why))?;
        let subscriber = participant.create_subscriber(&none).map_err(|why| fail(&why))?;
        let kept = qos(Ros2Reliability::Reliable, Durability::TransientLocal, 1);
        let graph = topic(participant, GRAPH_TOPIC, GRAPH_TYPE, &kept)
            .and_then(|topic| publisher.create_datawriter_no_key(&topic, None))
            .map_err(|why| fail(&why))?;
        let node = Node { namespace: "/", name: NODE, readers: vec![], writers: vec![gid(&graph)] };
        Ok(Self { participant: participant.clone(), publisher, subscriber, graph, node })
    }

    /// A reader of the newest message.
    pub(crate) fn reader<M: DeserializeOwned + 'static>(
        &mut self,
        name: &str,
        of: (&str, &str),
        reliability: Ros2Reliability,
    ) -> Result<SimpleDataReaderCdr<M>, Refused> {
        let qos = qos(reliability, Durability::Volatile, 1);
        let reader: SimpleDataReaderCdr<M> = topic(&self.participant, &dds_topic(name), of, &qos)
            .and_then(|topic| self.subscriber.create_simple_datareader_no_key(&topic, None))
            .map_err(|why| refused(name)(&why))?;
        self.node.readers.push(gid(&reader));
        Ok(reader)
    }

    /// A writer of commands.
    pub(crate) fn writer<M: Serialize + Send + Sync + 'static>(
        &mut self,
        name: &str,
        of: (&str, &str),
        reliability: Ros2Reliability,
    ) -> Result<Commands<M>, Refused> {
        let qos = qos(reliability, Durability::Volatile, DRIVE_DEPTH);
        let writer: DataWriterCdr<M> = topic(&self.participant, &dds_topic(name), of, &qos)
            .and_then(|topic| self.publisher.create_datawriter_no_key(&topic, None))
            .map_err(|why| refused(name)(&why))?;
        self.node.writers.push(gid(&writer));
        Ok(Commands::new(writer))
    }

    /// Tells ROS 2 of the node and all of its topics.
    pub(crate) fn announce(&self) {
        self.tell(vec![self.node.clone()]);
    }

    fn tell(&self, nodes: Vec<Node>) {
        let participant = self.participant.guid().to_bytes();
        // Only those who look at the graph of nodes would miss it.
        if let Err(why) = self.graph.write(Nodes { participant, nodes }, Some(Timestamp::now())) {
            tracing::warn!("ROS 2 is not told of this node: {why}");
        }
    }
}

impl Drop for Topics {
    fn drop(&mut self) {
        self.tell(Vec::new());
    }
}

fn topic(
    participant: &DomainParticipant,
    name: &str,
    of: (&str, &str),
    qos: &QosPolicies,
) -> rustdds::dds::CreateResult<Topic> {
    participant.create_topic(name.to_owned(), dds_type(of), qos, TopicKind::NoKey)
}

fn gid(of: &impl RTPSEntity) -> Gid {
    let guid: GUID = of.guid();
    guid.to_bytes()
}
