//! The vehicle role filled by a ROS 2 car: one that nobody here wrote, heard and spoken to over DDS. The rest of the
//! ring is the test itself, on the run's shared memory.

mod support;

#[cfg(not(feature = "ros2"))]
mod without {
    use super::support::Sandbox;

    #[test]
    fn a_build_without_it_says_so_in_a_line() {
        let sandbox = Sandbox::new();
        let launch = "[[process]]\nrole = 'vehicle'\nservice = 'ros2-vehicle'\n\
            [[process]]\nrole = 'supervisor'\n[[process]]\nrole = 'controller'\n[[process]]\nrole = 'trainer'\n";
        std::fs::write(sandbox.path("my.toml"), launch).unwrap();
        for args in [
            vec!["service", "ros2-vehicle"],
            vec!["train", "lane_change", "--launch", "my.toml", "--out", "out"],
        ] {
            let output = sandbox.run(&args);
            assert_eq!(output.status.code(), Some(64), "{args:?}");
            let told = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(told.lines().count(), 1, "{told}");
            assert!(told.contains("--features ros2"), "{told}");
            assert!(!sandbox.path("out").exists());
        }
        sandbox.assert_clean();
    }
}

#[cfg(feature = "ros2")]
#[path = "ros2"]
mod with {
    mod drives;
    mod fault_table;
    mod faults;
    mod networks;
    mod own_car;
    mod ring;
    mod told;
}
