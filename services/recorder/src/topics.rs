//! The topics of a run in a recording: bytes, and the tables that say what they mean.

use anyhow::Result;
use ipc_types::layout::{Bytes, Layout, Number, numbers};
use ipc_types::{Attempt, BatchHeader, Message, TickHeader, for_each_topic};
use runtime::{Bus, Inlet};
use serde_json::{Value, json};

use crate::raw;

/// Where in a run a message belongs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Place {
    /// The attempt that it belongs to.
    pub attempt: Attempt,
    /// The tick, for topics that are sent once a tick.
    pub tick: Option<u64>,
    /// When it was sent.
    pub sent_ns: u64,
}

/// A header that says where its message belongs.
pub(crate) trait Placed {
    fn place(&self, topic: &str) -> Place;
}

impl Placed for TickHeader {
    fn place(&self, topic: &str) -> Place {
        // Each hop adds its own stamp to what it copies.
        let sent_ns = match topic {
            "odometry" => self.odometry_sent_ns,
            "command" => self.supervisor_sent_ns,
            _ => self.controller_sent_ns,
        };
        Place { attempt: self.attempt, tick: Some(self.tick), sent_ns }
    }
}

impl Placed for BatchHeader {
    fn place(&self, _topic: &str) -> Place {
        Place { attempt: self.attempt, tick: None, sent_ns: self.sent_ns }
    }
}

/// A topic in a recording.
#[derive(Debug, Clone)]
pub struct TopicInfo {
    /// Its name on the bus; `/pathtune/NAME` is its channel.
    pub name: &'static str,
    /// The element's name on the wire, with the hash of its layout.
    pub element: &'static str,
    /// The header's.
    pub header: &'static str,
    /// Whether it is sent once a tick.
    pub is_per_tick: bool,
    /// Bytes of a header.
    pub header_bytes: usize,
    /// Bytes of an element.
    pub element_bytes: usize,
    /// The tables of their fields, as JSON.
    pub layout: String,
}

impl TopicInfo {
    fn of<M: Message>() -> Self {
        let (header_bytes, element_bytes) = (size_of::<M::Header>(), size_of::<M>());
        let layout = json!({
            "byte_order": "little",
            "header": table::<M::Header>(header_bytes),
            "element": table::<M>(element_bytes),
        });
        Self {
            name: M::TOPIC.name,
            element: M::TYPE_NAME,
            header: M::Header::TYPE_NAME,
            is_per_tick: M::Header::TYPE_NAME == TickHeader::TYPE_NAME,
            header_bytes,
            element_bytes,
            layout: layout.to_string(),
        }
    }

    /// The channel of the topic's bytes.
    pub fn channel(&self) -> String {
        format!("/pathtune/{}", self.name)
    }
}

fn table<T: Layout>(bytes: usize) -> Value {
    json!({ "type": T::TYPE_NAME, "bytes": bytes, "fields": fields::<T>() })
}

/// A message's numbers with their offsets in the whole message. A message inside a message is flattened, its names
/// after a dot, and so is an array, with an index after its name.
fn fields<T: Layout>() -> Vec<Value> {
    let tell = |Number { name, kind, offset, bytes }| json!({ "name": name, "kind": kind, "offset": offset, "bytes": bytes });
    numbers(T::FIELDS).into_iter().map(tell).collect()
}

/// All topics, in the order of their table.
pub fn topics() -> Vec<TopicInfo> {
    let mut all = Vec::new();
    macro_rules! add {
        ($message:ty) => {
            all.push(TopicInfo::of::<$message>());
        };
    }
    for_each_topic!(add);
    all
}

/// Number of a topic in the table.
///
/// # Panics
/// If there is no topic of this name.
pub(crate) fn index_of(name: &str) -> usize {
    topics().iter().position(|topic| topic.name == name).expect("a topic of the table")
}

/// A digest that is the same for two recordings if and only if their layouts are the same.
pub fn layout_digest() -> String {
    // How messages are wrapped counts, too.
    let mut names = vec![raw::SCHEMA];
    names.extend(topics().iter().flat_map(|topic| [topic.header, topic.element]));
    // FNV-1a, 64 bits: it only has to distinguish versions of one program, not resist attacks.
    let hash = names.join(";").bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    format!("{hash:016x}")
}

/// A message that was received.
#[derive(Debug)]
pub(crate) struct Sample {
    pub(crate) topic: usize,
    pub(crate) place: Place,
    /// Header and elements, as in memory.
    pub(crate) bytes: Vec<u8>,
}

/// The inlet of one topic.
pub(crate) trait Tap {
    fn topic(&self) -> usize;
    fn take(&self) -> Result<Option<Sample>>;
}

struct Port<M: Message> {
    topic: usize,
    inlet: Inlet<M>,
}

impl<M: Message> Tap for Port<M>
where
    M::Header: Placed,
{
    fn topic(&self) -> usize {
        self.topic
    }

    fn take(&self) -> Result<Option<Sample>> {
        let Some(message) = self.inlet.receive()? else { return Ok(None) };
        let (header, items) = (message.header(), message.items());
        let mut bytes = Vec::with_capacity(size_of::<M::Header>() + size_of_val(items));
        header.put(&mut bytes);
        for item in items {
            item.put(&mut bytes);
        }
        Ok(Some(Sample { topic: self.topic, place: header.place(M::TOPIC.name), bytes }))
    }
}

/// The inlets of all topics of a run. Requests come first, because they say to what everything else belongs.
pub(crate) fn tap_all(bus: &Bus) -> Result<Vec<Box<dyn Tap>>> {
    let mut taps: Vec<Box<dyn Tap>> = Vec::new();
    macro_rules! tap {
        ($message:ty) => {
            taps.push(Box::new(Port::<$message> { topic: taps.len(), inlet: bus.observe()? }));
        };
    }
    for_each_topic!(tap);
    let requests = index_of("drive_request");
    taps.sort_by_key(|tap| (tap.topic() != requests, tap.topic()));
    Ok(taps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::Odometry;

    #[test]
    fn a_table_tells_every_byte() {
        for topic in topics() {
            let layout: Value = serde_json::from_str(&topic.layout).unwrap();
            for (part, bytes) in [("header", topic.header_bytes), ("element", topic.element_bytes)]
            {
                let fields = layout[part]["fields"].as_array().unwrap();
                let told: u64 = fields.iter().map(|field| field["bytes"].as_u64().unwrap()).sum();
                assert_eq!(told as usize, bytes, "{} {part}", topic.name);
            }
        }
    }

    #[test]
    fn bytes_are_those_of_the_table() {
        let odometry = Odometry { speed_mps: 1.5, status: 7, ..Odometry::default() };
        let mut bytes = Vec::new();
        odometry.put(&mut bytes);
        assert_eq!(bytes.len(), size_of::<Odometry>());
        let topic = &topics()[index_of("odometry")];
        let layout: Value = serde_json::from_str(&topic.layout).unwrap();
        let fields = layout["element"]["fields"].as_array().unwrap();
        let offset = |name: &str| {
            let field = fields.iter().find(|field| field["name"] == name).unwrap();
            field["offset"].as_u64().unwrap() as usize
        };
        let at = offset("speed_mps");
        assert_eq!(bytes[at..at + 8], 1.5f64.to_le_bytes());
        assert_eq!(offset("truth.yaw_rad"), 40);
        assert_eq!(Odometry::take(&mut &bytes[..]), Some(odometry));
        assert_eq!(Odometry::take(&mut &bytes[1..]), None);
    }
}
