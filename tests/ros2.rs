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
mod with {
    use std::fs;
    use std::path::{Path, PathBuf};
    use std::process::Child;
    use std::time::{Duration, Instant};

    use config::{Layers, RunConfig};
    use ipc_types::{
        Attempt, BatchHeader, Command, DriveRequest, Odometry, Status, TickHeader, WirePose, has,
    };
    use runtime::clock::now_ns;
    use runtime::run::{RunNames, segments_of};
    use runtime::{Attachment, Bus, Inlet, Outlet, Wait};
    use rustix::process::Signal;

    use serde_json::Value;

    use super::support::dds::{Peer, own_domain, python};
    use super::support::onlooker::{Onlooker, ROUNDABOUT};
    use super::support::{Sandbox, signal};

    /// The rest of the ring.
    struct Ring {
        attachment: Attachment,
        requests: Outlet<DriveRequest>,
        commands: Outlet<Command>,
        odometry: Inlet<Odometry>,
        status: Inlet<Status>,
        bus: Bus,
        adapter: Child,
        log: PathBuf,
        newest_status: Status,
        batch: u64,
        /// Everything that the vehicle has published.
        heard: Vec<(TickHeader, Odometry)>,
        // The last to go.
        leftovers: Option<Leftovers>,
    }

    /// Removes what a failed test leaves.
    struct Leftovers(RunNames);

    impl Drop for Leftovers {
        fn drop(&mut self) {
            self.0.remove();
        }
    }

    impl Ring {
        /// Creates a run and starts the adapter in it.
        fn start(sandbox: &Sandbox, domain: u32, vehicle: &str, settings: &[&str]) -> Self {
            let mut layers = Layers::maneuver("lane_change").unwrap();
            layers.set_vehicle("--vehicle", vehicle).unwrap();
            layers.set(&format!("vehicle.ros2.domain_id={domain}")).unwrap();
            layers.set("vehicle.ros2.network='127.0.0.1'").unwrap();
            for setting in settings {
                layers.set(setting).unwrap();
            }
            let config: RunConfig = layers.resolve().unwrap();
            let run = now_ns() << 8 | u64::from(domain);
            let root = sandbox.path("r").join("pathtune").join(format!("{run:016x}"));
            fs::create_dir_all(&root).unwrap();
            let folder = sandbox.path("out");
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join("config.toml"), toml::to_string(&config).unwrap()).unwrap();
            let attachment = Attachment {
                names: RunNames { run, root },
                folder,
                max_len: 1,
                incarnation: 1,
                core: None,
                wait: Wait::default(),
                fifo: None,
                parent: std::process::id() as i32,
                chaos: None,
            };
            let bus = Bus::create(&attachment.names, 1).unwrap();
            let log = sandbox.path("adapter.log");
            let adapter = Self::spawn(sandbox, &attachment, &log);
            Self {
                leftovers: Some(Leftovers(attachment.names.clone())),
                requests: bus.outlet().unwrap(),
                commands: bus.outlet().unwrap(),
                odometry: bus.observe().unwrap(),
                status: bus.observe().unwrap(),
                attachment,
                bus,
                adapter,
                log,
                newest_status: Status::default(),
                batch: 0,
                heard: Vec::new(),
            }
        }

        fn spawn(sandbox: &Sandbox, attachment: &Attachment, log: &Path) -> Child {
            let log = fs::OpenOptions::new().create(true).append(true).open(log).unwrap();
            sandbox
                .command(&["service", "ros2-vehicle"])
                .envs(attachment.to_env())
                .stdout(log.try_clone().unwrap())
                .stderr(log)
                .spawn()
                .unwrap()
        }

        /// Kills the adapter and starts it again, as the orchestrator does.
        fn kill_and_restart(&mut self, sandbox: &Sandbox) {
            self.adapter.kill().unwrap();
            self.adapter.wait().unwrap();
            // What it had still published is of the time before the kill.
            self.turn(&mut |_| None);
            self.bus.clean_dead_nodes();
            self.attachment.incarnation += 1;
            self.newest_status = Status::default();
            self.adapter = Self::spawn(sandbox, &self.attachment, &self.log);
        }

        fn told(&self) -> String {
            fs::read_to_string(&self.log).unwrap_or_default()
        }

        /// Takes what has come; answers each odometry with what `answer` makes of it.
        fn turn(&mut self, answer: &mut dyn FnMut(&Odometry) -> Option<Command>) {
            self.bus.look_for_readers();
            while let Some(status) = self.status.receive().unwrap() {
                self.newest_status = status.items()[0];
            }
            while let Some(received) = self.odometry.receive().unwrap() {
                let (mut header, odometry) = (received.header(), received.items()[0]);
                self.heard.push((header, odometry));
                if let Some(command) = answer(&odometry) {
                    header.supervisor_sent_ns = now_ns();
                    self.commands.send(header, 1, |_| command).unwrap();
                }
            }
            std::thread::sleep(Duration::from_micros(500));
        }

        fn drive(
            &mut self,
            time: Duration,
            mut answer: impl FnMut(&Odometry) -> Option<Command>,
        ) -> Vec<(TickHeader, Odometry)> {
            let (from, until) = (self.heard.len(), Instant::now() + time);
            while Instant::now() < until {
                self.turn(&mut answer);
            }
            self.heard[from..].to_vec()
        }

        fn wait_for(&mut self, what: &str, within: Duration, mut is_so: impl FnMut(&Self) -> bool) {
            let until = Instant::now() + within;
            while !is_so(self) {
                assert!(Instant::now() < until, "waited in vain for {what}: {}", self.told());
                let ended = self.adapter.try_wait().unwrap();
                assert!(ended.is_none(), "ended while waiting for {what}: {}", self.told());
                self.turn(&mut |_| None);
            }
        }

        fn is_at_start(&self) -> bool {
            self.newest_status.state == Status::READY
                && has(self.newest_status.pacing, Status::REAL_TIME)
                && has(self.newest_status.pacing, Status::AT_START)
        }

        fn request(&mut self) {
            self.batch += 1;
            let (run, batch) = (self.attachment.names.run, self.batch);
            let attempt = Attempt { run, batch, attempt: 1, reserved: 0 };
            let header = BatchHeader { attempt, sent_ns: now_ns(), ..BatchHeader::default() };
            let request = DriveRequest { flags: DriveRequest::REAL_TIME, ..Default::default() };
            self.requests.send(header, 1, |_| request).unwrap();
        }

        /// Asks the adapter to stop; waits for a good end.
        fn stop(mut self) -> String {
            signal(self.adapter.id() as i32, Signal::INT);
            let until = Instant::now() + Duration::from_secs(5);
            let status = loop {
                if let Some(status) = self.adapter.try_wait().unwrap() {
                    break status;
                }
                assert!(Instant::now() < until, "does not stop: {}", self.told());
                std::thread::sleep(Duration::from_millis(5));
            };
            assert!(status.success(), "{status}: {}", self.told());
            let told = self.told();
            // Behind the adapter and us nothing is left, but for what the run's end removes.
            let leftovers = self.leftovers.take();
            let run = self.attachment.names.run;
            drop(self);
            let mut left = segments_of(run);
            left.retain(|name| !name.ends_with(".global_mgmt"));
            assert_eq!(left, Vec::<String>::new());
            drop(leftovers);
            assert_eq!(segments_of(run), Vec::<String>::new());
            told
        }
    }

    impl Drop for Ring {
        fn drop(&mut self) {
            let _ = self.adapter.kill();
            let _ = self.adapter.wait();
        }
    }

    /// Follows the line y = `y_m`.
    fn follow(y_m: f64, speed_mps: f64) -> impl Fn(&Odometry) -> Option<Command> {
        move |seen| {
            let WirePose { y_m: at_m, yaw_rad, .. } = seen.measured;
            let steering_rad = (0.5 * (y_m - at_m) - 1.2 * yaw_rad).clamp(-0.4, 0.4);
            Some(Command { speed_mps, steering_rad, ..Command::default() })
        }
    }

    fn silent_for_the_rest(
        rest: &[(TickHeader, Odometry)],
        own: &[(TickHeader, Odometry)],
    ) -> bool {
        rest.iter().all(|(header, _)| header.tick < own[0].0.tick)
    }

    fn ticks(heard: &[(TickHeader, Odometry)]) -> Vec<u64> {
        heard.iter().map(|(header, _)| header.tick).collect()
    }

    #[test]
    fn a_car_that_nobody_here_wrote_is_driven_stopped_and_left_standing() {
        let Some(python) = python() else { return };
        let (sandbox, domain) = (Sandbox::new(), own_domain());
        // It stands anywhere: where it stands the path begins. Its odometry is that of a point 1 m ahead.
        let args = ["--start", "12,-3,2.5", "--point", "1.0"];
        let car = Peer::start(&sandbox, &python, domain, &args);
        let settings = ["vehicle.ros2.odometry_point_m=1.0", "vehicle.ros2.odometry_frame='odom'"];
        let mut ring = Ring::start(&sandbox, domain, "ackermann", &settings);
        ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
        assert_eq!(ring.newest_status.capacity, 1);
        assert!(ring.heard.is_empty());

        ring.request();
        let driven = ring.drive(Duration::from_secs(5), follow(-1.0, 1.5));
        let (first, last) = (driven.first().unwrap(), driven.last().unwrap());
        assert_eq!((first.0.tick, first.1.status, first.0.applied_ns), (0, 0, 0));
        let WirePose { x_m, y_m, yaw_rad } = first.1.measured;
        assert!(x_m.abs() < 1e-9 && y_m.abs() < 1e-9 && yaw_rad.abs() < 1e-9, "{first:?}");
        assert!(ticks(&driven).is_sorted_by(|a, b| a < b));
        let rate_hz = driven.len() as f64 / 5.0;
        println!("odometry at {rate_hz} Hz");
        // Of 100, on whatever machine.
        assert!(rate_hz > 50.0, "{rate_hz} Hz");
        let at = last.1.measured;
        assert!(at.x_m > 3.0 && (at.y_m + 1.0).abs() < 0.2, "{at:?}");
        assert!((last.1.speed_mps - 1.5).abs() < 0.2 && last.1.status == 0, "{last:?}");
        assert!(last.0.applied_ns > last.0.odometry_sent_ns - 100_000_000);
        // As the car itself has it, in its own frame: the tracked point lies 0.7 m ahead of its rear axle.
        let map = |line: &Value| {
            let of = |key: &str| line[key].as_f64().unwrap();
            let yaw_rad = of("yaw_rad");
            let x_m = of("x_m") + 0.7 * yaw_rad.cos() - 12.0 - 0.7 * 2.5f64.cos();
            let y_m = of("y_m") + 0.7 * yaw_rad.sin() + 3.0 - 0.7 * 2.5f64.sin();
            let (sin, cos) = 2.5f64.sin_cos();
            (cos * x_m + sin * y_m, cos * y_m - sin * x_m)
        };
        let line = car
            .log()
            .into_iter()
            .rev()
            .find(|line| line["t_ns"].as_u64().unwrap() <= last.0.odometry_sent_ns);
        let (x_m, y_m) = map(&line.unwrap());
        assert!((x_m - at.x_m).hypot(y_m - at.y_m) < 0.1, "({x_m}, {y_m}), measured {at:?}");

        // Nobody answers any more: it stops by itself, wheels straight, and says so.
        let before = car.last("speed_mps");
        let silent = ring.drive(Duration::from_secs(2), |_| None);
        let (own, rest): (Vec<_>, Vec<_>) =
            silent.into_iter().partition(|(_, seen)| has(seen.status, Odometry::OWN_STOP));
        // A command is held for 0.1 s: at most 10 ticks, and some that were on their way.
        assert!(before > 1.2 && rest.len() < 30, "{before} m/s, {}", rest.len());
        assert!(silent_for_the_rest(&rest, &own), "own stop ends by itself");
        assert!(own.len() > 50, "{}", own.len());
        assert!(car.last("speed_mps") < 0.3 && car.last("told_mps") == 0.0);
        assert_eq!(car.last("told_rad"), 0.0);
        // Somebody does again.
        let again = ring.drive(Duration::from_secs(2), follow(-1.0, 1.0));
        assert_eq!(again.last().unwrap().1.status, 0);
        assert!(car.last("speed_mps") > 0.7);
        // The end of the drive; the next one begins where the car has come to rest.
        let ended = ring.drive(Duration::from_secs(3), |_| {
            Some(Command { speed_mps: 1.0, flags: Command::ENDED, ..Command::default() })
        });
        assert_eq!(ended.last().unwrap().1.status, Odometry::ENDED);
        assert!(car.last("speed_mps").abs() < 0.05);
        ring.wait_for("the car at rest", Duration::from_secs(5), Ring::is_at_start);
        ring.request();
        let next = ring.drive(Duration::from_secs(2), follow(0.0, 1.0));
        // What was on its way when the request went out is of the drive before.
        let (header, first) = next.iter().find(|(header, _)| header.attempt.batch == 2).unwrap();
        assert_eq!((header.tick, first.measured.x_m), (0, 0.0));

        // It ends on the way: the car is told to stop.
        assert!(car.last("told_mps") == 1.0);
        let heard = car.last("heard");
        let told = ring.stop();
        assert!(told.contains("told the car to stop"), "{told}");
        std::thread::sleep(Duration::from_millis(200));
        assert_eq!((car.last("told_mps"), car.last("told_rad")), (0.0, 0.0));
        assert!(car.last("heard") - heard >= 3.0);
        sandbox.assert_clean();
    }

    #[test]
    fn a_killed_adapter_joins_the_drive_again() {
        let Some(python) = python() else { return };
        let (sandbox, domain) = (Sandbox::new(), own_domain());
        let car = Peer::start(&sandbox, &python, domain, &["--start", "0,0,-1.0"]);
        let mut ring = Ring::start(&sandbox, domain, "ackermann", &[]);
        ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
        ring.request();
        let driven = ring.drive(Duration::from_secs(2), follow(0.0, 1.0));
        assert!(!driven.is_empty());
        let killed = Instant::now();
        ring.kill_and_restart(&sandbox);
        let heard = ring.heard.len();
        let before = ring.heard[heard - 1];
        ring.wait_for("odometry", Duration::from_secs(5), |ring| ring.heard.len() > heard);
        println!("odometry again {:?} behind the kill", killed.elapsed());
        let first = ring.heard[heard];
        assert_eq!((first.0.attempt.batch, first.0.attempt.attempt), (1, 1));
        assert!(first.0.tick > before.0.tick, "{first:?}, before {before:?}");
        let ticks_away = (first.0.odometry_sent_ns - before.0.odometry_sent_ns) / 10_000_000;
        assert!((first.0.tick - before.0.tick).abs_diff(ticks_away) < 10, "{ticks_away}");
        // It goes on where the car is, not at the start again.
        let away_m = 0.01 * ticks_away as f64;
        let ahead_m = first.1.measured.x_m - before.1.measured.x_m;
        assert!(ahead_m > 0.0 && ahead_m < 1.5 * away_m + 0.2, "{ahead_m} m in {away_m} s");
        assert!(first.1.measured.y_m.abs() < 0.2, "{first:?}");
        // Nobody has answered yet.
        assert!(has(first.1.status, Odometry::OWN_STOP));
        let again = ring.drive(Duration::from_secs(2), follow(0.0, 1.0));
        assert_eq!(again.last().unwrap().1.status, 0);
        assert!(car.last("speed_mps") > 0.8);
        let told = ring.stop();
        assert!(told.contains("joined=true"), "{told}");
        sandbox.assert_clean();
    }

    #[test]
    fn what_is_missing_is_said_within_five_seconds_of_a_process_that_lives() {
        let Some(python) = python() else { return };
        for (with_car, part) in [
            (false, "no odometry on /odom; publishers seen: 0"),
            (true, "no odometry on /odom; publishers seen: 1, best effort; ours asks for reliable"),
        ] {
            let (sandbox, domain) = (Sandbox::new(), own_domain());
            let car = with_car.then(|| Peer::start(&sandbox, &python, domain, &[]));
            if let Some(car) = &car {
                car.wait_until_it_lives();
            }
            let started = Instant::now();
            let settings = ["vehicle.ros2.odometry_reliability='reliable'"];
            let mut ring = Ring::start(&sandbox, domain, "ackermann", &settings);
            ring.wait_for("readiness", Duration::from_secs(5), |ring| {
                ring.newest_status.state == Status::READY
            });
            let ready = started.elapsed();
            // A sign of life every 100 ms, and a request that has to wait.
            ring.request();
            let mut beats = 0;
            let until = started + Duration::from_millis(5000).max(ready + Duration::from_secs(3));
            while Instant::now() < until {
                while ring.status.receive().unwrap().is_some() {
                    beats += 1;
                }
                std::thread::sleep(Duration::from_millis(5));
                ring.bus.look_for_readers();
            }
            let told = ring.told();
            assert!(told.contains(part), "{told}");
            assert!(told.contains("waits for odometry"), "{told}");
            assert_eq!(told.contains("nobody receives /drive"), !with_car, "{told}");
            assert!(beats >= 15, "{beats} beats, ready after {ready:?}");
            assert!(ring.heard.is_empty() && !ring.is_at_start());
            ring.stop();
            sandbox.assert_clean();
        }
    }

    #[test]
    fn a_car_that_somebody_drives_already_is_left_to_them() {
        let Some(python) = python() else { return };
        let (sandbox, domain) = (Sandbox::new(), own_domain());
        let driver = Peer::start(&sandbox, &python, domain, &["--driver"]);
        driver.wait_until_it_lives();
        let mut ring = Ring::start(&sandbox, domain, "ackermann", &[]);
        let status = ring.adapter.wait().unwrap();
        let told = ring.told();
        assert_eq!(status.code(), Some(64), "{told}");
        assert_eq!(told.lines().count(), 1, "{told}");
        assert!(told.contains("publishes on /drive already"), "{told}");
        drop(ring);
        sandbox.assert_clean();
    }

    #[test]
    fn the_user_is_told_what_is_missing_and_what_is_in_the_way() {
        let Some(python) = python() else { return };
        let (sandbox, domain) = (Sandbox::new(), own_domain());
        let domain_is = format!("vehicle.ros2.domain_id={domain}");
        let more = ["--set", &domain_is, "--set", "vehicle.ros2.network='127.0.0.1'"];
        let args = ["lane_change", "--adapter", "ros2-vehicle", "--vehicle", "ackermann"];
        let args = [&args[..], &more].concat();
        // Nobody there: it waits, and says for what.
        let drive = sandbox.start("drive", "waits", &args);
        std::thread::sleep(Duration::from_secs(6));
        drive.interrupt();
        let told = String::from_utf8_lossy(&drive.finish().stderr).into_owned();
        assert!(told.contains("ros2-vehicle: no odometry on /odom; publishers seen: 0"), "{told}");
        assert_eq!(told.matches("the drive waits for odometry").count(), 1, "{told}");
        // Somebody drives the car: one line, and no second try.
        let driver = Peer::start(&sandbox, &python, domain, &["--driver"]);
        driver.wait_until_it_lives();
        let output = sandbox.run(&[&["drive"], &args[..], &["--out", "refused"]].concat());
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(64), "{told}");
        assert!(
            told.contains("ros2-vehicle: ") && told.contains("publishes on /drive already"),
            "{told}"
        );
        assert!(!told.contains("restarted"), "{told}");
        drop(driver);
        sandbox.assert_clean();
    }

    #[test]
    fn carla_s_topics_messages_frames_and_collisions_are_understood() {
        let Some(python) = python() else { return };
        let (sandbox, domain) = (Sandbox::new(), own_domain());
        let args = [
            ["--odometry", "/carla/ego_vehicle/odometry"],
            ["--drive", "/carla/ego_vehicle/ackermann_cmd"],
            ["--collision", "/carla/ego_vehicle/collision"],
            ["--collides-after", "0.5"],
            ["--frame", "map"],
            ["--point", "1.44"],
            ["--start=-0.5,-0.1,0.05", "--bare"],
            // Not CARLA's: its own node turns the sign. Here the key must.
            ["--sign=-1", "--bare"],
        ];
        let args = args.concat();
        let car = Peer::start(&sandbox, &python, domain, &args);
        let settings = ["vehicle.ros2.steering_sign=-1", "vehicle.ros2.align='map'"];
        let mut ring = Ring::start(&sandbox, domain, "carla", &settings);
        ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
        ring.request();
        let driven = ring.drive(Duration::from_secs(4), follow(0.5, 1.0));
        // In the map's frame the pose is the car's own: 0.7 m ahead of its rear axle.
        let first = driven[0].1.measured;
        assert!((first.x_m - 0.2).abs() < 0.01 && (first.y_m + 0.065).abs() < 0.01, "{first:?}");
        assert!((driven.last().unwrap().1.measured.y_m - 0.5).abs() < 0.25);
        assert!(car.log().iter().any(|line| line["told_rad"].as_f64().unwrap() < -0.1));
        let collided: Vec<bool> =
            driven.iter().map(|(_, seen)| has(seen.status, Odometry::COLLISION)).collect();
        assert!(!collided[0] && *collided.last().unwrap() && collided.is_sorted());
        let told = ring.stop();
        assert!(told.contains("collision"), "{told}");
        sandbox.assert_clean();
    }

    /// The whole pipeline behind the adapter, and in front of it a car that nobody here wrote.
    fn drive_whole(maneuver: &str, seconds: u32) {
        let Some(python) = python() else { return };
        let (sandbox, domain) = (Sandbox::new(), own_domain());
        let time = format!("drive.loop_time_s={seconds}");
        let simulated =
            ["drive", maneuver, "--vehicle", "tesla_model_3_guarded", "--set", &time, "--set"];
        let simulated =
            sandbox.json("simulated", &[&simulated[..], &["vehicle.gear_engaged=true"]].concat());
        let car = Peer::start(&sandbox, &python, domain, &["--start", "0,0,0.3"]);
        let set = format!("vehicle.ros2.domain_id={domain}");
        let args = ["drive", maneuver, "--adapter", "ros2-vehicle", "--vehicle", "ackermann"];
        let more = ["--set", &set, "--set", "vehicle.ros2.network=\"127.0.0.1\"", "--set", &time];
        // Discovery over loopback may take longer than a car in a laboratory would.
        let driven = sandbox.json("driven", &[&args[..], &more].concat());
        let off = |result: &Value| result["max_cross_track_m"].as_f64().unwrap();
        println!(
            "{maneuver}: at most {:.3} m off the path by the multi-body car over DDS, {:.3} m by our simulator; mse {} and {}; it drove {:.1} m",
            off(&driven),
            off(&simulated),
            driven["mse_m2"],
            simulated["mse_m2"],
            car.last("x_m").hypot(car.last("y_m")),
        );
        assert_ne!(driven["reason"], "collision");
        assert_eq!(driven["true_poses"], false);
        // It went along the path, within the lane and the one beside it.
        assert!(off(&driven) < 1.75, "{driven}");
        assert!(car.last("x_m").hypot(car.last("y_m")) > 2.0, "it did not go");
        sandbox.assert_clean();
    }

    #[test]
    fn the_pipeline_drives_it_through_a_lane_change() {
        drive_whole("lane_change", 8);
    }

    #[test]
    fn the_pipeline_drives_it_through_a_roundabout() {
        drive_whole("roundabout", 20);
    }

    #[test]
    fn adapters_killed_again_and_again_are_always_ready_again() {
        let Some(python) = python() else { return };
        let kills: usize =
            std::env::var("PATHTUNE_ADAPTER_KILLS").map_or(10, |text| text.parse().unwrap());
        let (sandbox, domain) = (Sandbox::new(), own_domain());
        let car = Peer::start(&sandbox, &python, domain, &[]);
        let set = format!("vehicle.ros2.domain_id={domain}");
        let adapter = ["--adapter", "ros2-vehicle", "--vehicle", "ackermann"];
        let network = ["--set", &set, "--set", "vehicle.ros2.network=\"127.0.0.1\""];
        let mut drive =
            sandbox.start("drive", "out", &[ROUNDABOUT, &adapter[..], &network[..]].concat());
        drive.wait_for("the run", || sandbox.has_living_run());
        let mut onlooker = Onlooker::new(&sandbox.living_run());
        onlooker.until_it_drives();
        let (mut times_ms, mut stops) = (Vec::new(), 0);
        for kill in 0..kills {
            onlooker.look_for(Duration::from_millis(300));
            onlooker.until_it_drives();
            let pid = sandbox.service("ros2-vehicle").unwrap();
            // Every third one freezes, which is found out by its silence.
            let fault = if kill % 3 == 2 { Signal::STOP } else { Signal::KILL };
            times_ms.push(onlooker.strike("ros2-vehicle", pid, fault).0);
            // Another one drives.
            onlooker.look_until("another adapter", |_| {
                sandbox.service("ros2-vehicle").is_some_and(|now| now != pid)
            });
            stops += usize::from(onlooker.until_it_drives());
        }
        times_ms.sort_by(f64::total_cmp);
        println!(
            "{kills} adapters killed or frozen: safe command p50 {:.1} ms, max {:.1} ms; {stops} stops; {:.1} m driven",
            times_ms[kills / 2],
            times_ms[kills - 1],
            car.last("x_m").hypot(car.last("y_m")),
        );
        // One publisher, as DDS and as the topic see it: a second one would have been told.
        let told = sandbox.text("out/logs/ros2-vehicle.log");
        assert!(!told.contains("publishes on"), "{told}");
        drop(onlooker);
        drive.interrupt();
        drive.finish();
        sandbox.assert_clean();
    }
}
