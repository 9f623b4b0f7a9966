//! Drives over networks that have multicast, as those of a laboratory do: there, DDS discovers itself as well.

use crate::support::Sandbox;
use crate::support::dds::{Peer, Speaks, python, python_with_ros};
use crate::support::netns::{Host, hosts};

/// Drives a car of one host from another one, or from the same: so often as the environment asks for.
fn check_starts(speaks: Speaks, pick: impl Fn(&[Host; 2]) -> [&Host; 2]) {
    let python = match speaks {
        Speaks::Cyclone => python(),
        Speaks::Fast => python_with_ros(),
    };
    let (Some(python), Some(both)) = (python, hosts()) else { return };
    let starts =
        std::env::var("PATHTUNE_DDS_STARTS").map_or(1, |text| text.parse::<usize>().unwrap());
    let [car_s, ours] = pick(&both);
    let message = match speaks {
        Speaks::Cyclone => "stamped",
        Speaks::Fast => "twist",
    };
    for start in 0..starts {
        let sandbox = Sandbox::new();
        let car = Peer::on(car_s, &sandbox, &python, speaks);
        let message = format!("vehicle.ros2.drive_message='{message}'");
        let args = [
            ["drive", "lane_change"],
            ["--adapter", "ros2-vehicle"],
            ["--vehicle", "ackermann"],
            ["--set", &message],
            ["--set", "drive.loop_time_s=4"],
            ["--out", "out"],
        ];
        let output = ours.command(&sandbox, &args.concat()).output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "start {start}, {speaks:?}: {told}");
        assert!(car.last("x_m") > 1.0, "start {start}, {speaks:?}: {told}");
        drop(car);
        sandbox.assert_clean();
    }
    println!("{starts} of {starts} starts drove a car that speaks {speaks:?}");
}

#[test]
fn a_car_of_another_host_is_driven() {
    check_starts(Speaks::Cyclone, |[there, here]| [there, here]);
}

#[test]
fn a_car_on_the_same_interface_is_driven() {
    check_starts(Speaks::Cyclone, |[here, _]| [here, here]);
}

#[test]
fn a_ros_2_node_of_another_host_is_driven() {
    check_starts(Speaks::Fast, |[there, here]| [there, here]);
}

#[test]
fn a_ros_2_node_on_the_same_interface_is_driven() {
    check_starts(Speaks::Fast, |[here, _]| [here, here]);
}
