//! Processes whose messages differ in layout do not connect, however deep the difference lies.

use ipc_types::layout::ZeroCopySend;
use ipc_types::{Message, TickHeader, Topic};
use runtime::Bus;
use runtime::run::RunNames;

ipc_types::message!(
    /// A pose, with two fields swapped.
    #[name = "pathtune.WirePose#aec754c4"]
    pub struct WirePose {
        /// y in the map frame.
        pub y_m: f64,
        /// x in the map frame.
        pub x_m: f64,
        /// Yaw in the map frame.
        pub yaw_rad: f64,
    }
);

ipc_types::message!(
    /// The vehicle's message, made of such poses.
    #[name = "pathtune.Odometry#15d47905"]
    pub struct Odometry {
        /// Pose as measured.
        pub measured: WirePose,
        /// Pose in truth.
        pub truth: WirePose,
        /// Forward speed.
        pub speed_mps: f64,
        /// Yaw rate.
        pub yaw_rate_radps: f64,
        /// Steering angle.
        pub steering_rad: f64,
        /// Bits.
        pub status: u32,
        /// Explicit padding; 0.
        pub reserved: u32,
    }
);

impl Message for Odometry {
    type Header = TickHeader;
    const TOPIC: Topic = ipc_types::Odometry::TOPIC;
}

#[test]
fn swapped_fields_inside_a_field_keep_two_processes_apart() {
    let (theirs, ours) = (Odometry::FIELDS, ipc_types::Odometry::FIELDS);
    let plain = |fields: &[ipc_types::layout::Field]| {
        fields.iter().map(|it| (it.name, it.kind.name, it.offset)).collect::<Vec<_>>()
    };
    assert_eq!(plain(theirs), plain(ours));
    assert_eq!(size_of::<Odometry>(), size_of::<ipc_types::Odometry>());
    assert_ne!(Odometry::TYPE_NAME, ipc_types::Odometry::TYPE_NAME);

    let names = RunNames::create().unwrap();
    let bus = Bus::create(&names, 1).unwrap();
    let other = Bus::attach(&names, 1).unwrap();
    let _vehicle = bus.outlet::<ipc_types::Odometry>().unwrap();
    let refused = [other.inlet::<Odometry>().err(), other.outlet::<Odometry>().err()];
    for refused in refused {
        let refused = refused.expect("refused").to_string();
        assert!(refused.contains("IncompatibleTypes"), "{refused}");
    }
    assert!(other.inlet::<ipc_types::Odometry>().is_ok());
    drop((_vehicle, bus, other));
    names.remove();
}
