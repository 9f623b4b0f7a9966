//! What rosbag2's storage plugin adds to an MCAP file, and looks for when it reads one.
//!
//! The plugin takes types, counts and times from the file's summary. From the record `rosbag2` it takes the version, which
//! decides how it reads the quality of service of the channels. In version 8 the policies are numbers, which every
//! version of the plugin understands; without such a record the newer ones expect words, which the older ones do not
//! understand.

use std::collections::BTreeMap;

/// Name of the record.
pub(crate) const RECORD: &str = "rosbag2";
/// The key of a channel's metadata under which its quality of service stands.
pub(crate) const QOS: &str = "offered_qos_profiles";

/// The record's entries: metadata of version 8 without what the plugin takes from the summary.
pub(crate) fn metadata() -> BTreeMap<String, String> {
    let text = "version: 8\n\
                storage_identifier: mcap\n\
                duration:\n  nanoseconds: 0\n\
                starting_time:\n  nanoseconds_since_epoch: 0\n\
                message_count: 0\n\
                topics_with_message_count: []\n\
                compression_format: \"\"\n\
                compression_mode: \"\"\n\
                relative_file_paths: []\n\
                files: []\n\
                custom_data: {}\n\
                ros_distro: \"\"\n";
    BTreeMap::from([("serialized_metadata".to_owned(), text.to_owned())])
}

/// The quality of service with which a topic is played: reliable, and kept for late subscribers if it is `latched`.
pub(crate) fn qos(latched: bool) -> String {
    // Numbers of `rmw_qos_profile_t`: keep last 1, reliable 1, transient local 1, volatile 2, automatic 1.
    let (depth, durability) = if latched { (1, 1) } else { (10, 2) };
    let forever = "\n    sec: 9223372036\n    nsec: 854775807";
    format!(
        "- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: {durability}\n  deadline:{forever}\n  \
         lifespan:{forever}\n  liveliness: 1\n  liveliness_lease_duration:{forever}\n  \
         avoid_ros_namespace_conventions: false"
    )
}
