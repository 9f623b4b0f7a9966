//! Drives over networks that have multicast, as those of a laboratory do: there, DDS discovers itself as well.

use crate::support::Sandbox;
use crate::support::dds::{Peer, Speaks, python, python_with_ros};
use crate::support::netns::{Host, hosts};

/// Drives a car of one host from another one, or from the same: so often as the environment asks for.
fn check_starts(speaks: Speaks, message: &str, pick: impl Fn(&[Host; 2]) -> [&Host; 2]) {
    let python = match speaks {
        Speaks::Cyclone => python(),
        Speaks::Fast => python_with_ros(),
    };
    let (Some(python), Some(both)) = (python, hosts()) else { return };
    let starts =
        std::env::var("PATHTUNE_DDS_STARTS").map_or(1, |text| text.parse::<usize>().unwrap());
    let [car_s, ours] = pick(&both);
    let is_stamped_twist = message == "twist_stamped";
    let (mut silence_ms, mut step_ms) = (0.0f64, 0.0f64);
    for start in 0..starts {
        let sandbox = Sandbox::new();
        let car = Peer::on(
            car_s,
            &sandbox,
            &python,
            speaks,
            if is_stamped_twist { &["--stamped"] } else { &[] },
        );
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
        let [silence, step] = car.longest_silence_ms();
        (silence_ms, step_ms) = (silence_ms.max(silence), step_ms.max(step));
        let shared = car.shared_files();
        assert_eq!(shared.is_empty(), speaks == Speaks::Cyclone, "{shared:?}");
        if speaks == Speaks::Fast && is_stamped_twist {
            // As a test that fails may leave it: it cannot clean up, and whoever started it does.
            car.freeze();
        }
        drop(car);
        let left: Vec<_> = shared.iter().filter(|path| path.exists()).collect();
        assert!(left.is_empty(), "{left:?}");
        sandbox.assert_clean();
    }
    println!(
        "{starts} of {starts} starts drove a car that speaks {speaks:?}; it went without commands for {silence_ms:.0} ms at \
         most, and its own longest step took {step_ms:.0} ms"
    );
}

#[test]
fn a_car_of_another_host_is_driven() {
    check_starts(Speaks::Cyclone, "stamped", |[there, here]| [there, here]);
}

#[test]
fn a_car_on_the_same_interface_is_driven() {
    check_starts(Speaks::Cyclone, "stamped", |[here, _]| [here, here]);
}

#[test]
fn a_ros_2_node_of_another_host_is_driven() {
    check_starts(Speaks::Fast, "twist_stamped", |[there, here]| [there, here]);
}

#[test]
fn a_ros_2_node_on_the_same_interface_is_driven() {
    check_starts(Speaks::Fast, "twist", |[here, _]| [here, here]);
}
