//! What to say when something is missing on the ROS side. DDS itself says nothing: peers whose settings do not match
//! are not connected.

use config::Ros2Reliability;

use crate::arrivals::NotUsed;

/// A peer at the other end of a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Peer {
    /// The name of its type, as written in DDS.
    pub type_name: String,
    /// The reliability that it offers or asks for.
    pub reliability: Ros2Reliability,
}

/// A topic as we see it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ours<'a> {
    /// Its name.
    pub topic: &'a str,
    /// Package and name of its type.
    pub of_type: (&'static str, &'static str),
    /// The reliability that we ask for or offer.
    pub reliability: Ros2Reliability,
}

/// The name of a ROS topic in DDS.
pub fn dds_topic(name: &str) -> String {
    format!("rt{name}")
}

/// The type's name, as written in DDS.
pub fn dds_type((package, name): (&str, &str)) -> String {
    format!("{package}::msg::dds_::{name}_")
}

fn name(reliability: Ros2Reliability) -> &'static str {
    match reliability {
        Ros2Reliability::BestEffort => "best effort",
        Ros2Reliability::Reliable => "reliable",
    }
}

/// Each of the peers in a word or two, and why it does not match, if so.
fn describe(ours: Ours, peers: &[Peer], fits: impl Fn(&Peer) -> bool, verb: &str) -> String {
    let mut text = peers.len().to_string();
    let mut why = String::new();
    for peer in peers {
        text += &format!(", {}", name(peer.reliability));
        if peer.type_name != dds_type(ours.of_type) {
            text += &format!(" of the type {}", peer.type_name);
            let (package, name) = ours.of_type;
            why = format!("; ours is {package}/{name}");
        } else if !fits(peer) {
            why = format!("; ours {verb} {}", name(ours.reliability));
        }
    }
    text + &why
}

/// The message about odometry that does not come.
pub fn no_odometry(ours: Ours, publishers: &[Peer], domain_id: u16) -> String {
    let topic = ours.topic;
    if publishers.is_empty() {
        return format!(
            "no odometry on {topic}; publishers seen: 0 in domain {domain_id}; check that the car is running, and \
             vehicle.ros2.odometry_topic, .domain_id and .network"
        );
    }
    let fits = |peer: &Peer| {
        ours.reliability == Ros2Reliability::BestEffort
            || peer.reliability == Ros2Reliability::Reliable
    };
    format!(
        "no odometry on {topic}; publishers seen: {}",
        describe(ours, publishers, fits, "asks for")
    )
}

/// The message about odometry that comes and is not used.
pub fn odometry_not_used(topic: &str, rate_hz: f64, why: &NotUsed) -> String {
    format!("odometry on {topic} comes at {rate_hz:.0} Hz, but {why}")
}

/// The message about commands that nobody receives; `None` if they are received.
pub fn nobody_hears(ours: Ours, subscribers: &[Peer]) -> Option<String> {
    let fits = |peer: &Peer| {
        ours.reliability == Ros2Reliability::Reliable
            || peer.reliability == Ros2Reliability::BestEffort
    };
    let expected = dds_type(ours.of_type);
    if subscribers.iter().any(|peer| fits(peer) && peer.type_name == expected) {
        return None;
    }
    let what = describe(ours, subscribers, fits, "offers");
    Some(format!("nobody receives {}; subscribers seen: {what}", ours.topic))
}

/// The message about one of several subscribers that does not acknowledge commands.
pub fn one_does_not_answer(topic: &str, subscribers: usize) -> String {
    format!(
        "one of the {subscribers} subscribers of {topic} has acknowledged no command for 0.3 s; if that is the car, it does \
         not hear them"
    )
}

/// The message if another program drives the car before we do.
pub fn driven_by_others(topic: &str, others: usize) -> String {
    let who = who_publishes(others);
    format!("{who} on {topic} already; stop that first: a car obeys only one driver")
}

/// The message if another program begins to drive the car while we do.
pub fn joined_by_others(topic: &str, others: usize) -> String {
    let who = who_publishes(others);
    format!(
        "{who} on {topic}, too: the car is being stopped, and this drive does not go on; stop that, then start another"
    )
}

fn who_publishes(others: usize) -> &'static str {
    if others == 1 { "somebody else publishes" } else { "others publish" }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Ros2Reliability::{BestEffort, Reliable};

    const ODOMETRY: (&str, &str) = crate::messages::ODOMETRY;

    fn peer(reliability: Ros2Reliability) -> Peer {
        Peer { type_name: dds_type(ODOMETRY), reliability }
    }

    #[test]
    fn what_is_missing_is_told_in_a_line() {
        let ours = |reliability| Ours { topic: "/odom", of_type: ODOMETRY, reliability };
        let told = no_odometry(ours(Reliable), &[peer(BestEffort)], 0);
        assert_eq!(
            told,
            "no odometry on /odom; publishers seen: 1, best effort; ours asks for reliable"
        );
        let told = no_odometry(ours(BestEffort), &[peer(BestEffort), peer(Reliable)], 0);
        assert_eq!(told, "no odometry on /odom; publishers seen: 2, best effort, reliable");
        assert!(no_odometry(ours(BestEffort), &[], 7).contains("publishers seen: 0 in domain 7"));
        let other = Peer { type_name: "x::Y".to_owned(), reliability: Reliable };
        let told = no_odometry(ours(BestEffort), &[other], 0);
        assert!(
            told.ends_with("1, reliable of the type x::Y; ours is nav_msgs/Odometry"),
            "{told}"
        );
    }

    #[test]
    fn odometry_that_is_not_used_is_told_with_its_rate() {
        let old = NotUsed::Old { age_s: 5.02, limit_s: 0.1 };
        assert_eq!(
            odometry_not_used("/odom", 49.7, &old),
            "odometry on /odom comes at 50 Hz, but it was measured 5.0 s before it was sent, by its stamp; \
             vehicle.ros2.odometry_age_limit_s allows 0.1 s"
        );
    }

    #[test]
    fn whoever_hears_the_commands_is_enough() {
        let ours = |reliability| Ours { topic: "/drive", of_type: ODOMETRY, reliability };
        assert_eq!(nobody_hears(ours(Reliable), &[peer(BestEffort)]), None);
        assert_eq!(nobody_hears(ours(Reliable), &[peer(Reliable)]), None);
        assert_eq!(nobody_hears(ours(BestEffort), &[peer(Reliable), peer(BestEffort)]), None);
        let told = nobody_hears(ours(BestEffort), &[peer(Reliable)]).unwrap();
        assert_eq!(
            told,
            "nobody receives /drive; subscribers seen: 1, reliable; ours offers best effort"
        );
        let told = nobody_hears(ours(Reliable), &[]).unwrap();
        assert_eq!(told, "nobody receives /drive; subscribers seen: 0");
    }
}
