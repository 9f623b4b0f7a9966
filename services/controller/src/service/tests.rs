use super::*;
use config::Layers;
use runtime::run::RunNames;

#[test]
fn odometry_that_overtakes_its_request_is_held_counts_as_news_and_is_answered() {
    let names = RunNames::create().unwrap();
    let bus = Bus::create(&names, 1).unwrap();
    let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
    let ticks = config.ticks();
    let mut controller = Controller::new(&bus, config, names.run, now_ns()).unwrap();
    let (odometry, requests) = (bus.outlet::<Odometry>().unwrap(), bus.outlet().unwrap());
    let answers = bus.observe::<RawCommand>().unwrap();

    let attempt = Attempt { run: names.run, batch: 1, attempt: 1, reserved: 0 };
    let tick = TickHeader { attempt, ..TickHeader::default() };
    odometry.send(tick, 1, |_| Odometry::default()).unwrap();
    // Counts as progress although there is nothing to do: the request may have come meanwhile, and its wake-up is
    // over.
    assert!(controller.poll().unwrap());
    assert!(!controller.poll().unwrap());
    let request = BatchHeader { attempt, ..BatchHeader::default() };
    requests.send(request, 1, |_| DriveRequest { ticks, ..DriveRequest::default() }).unwrap();
    assert!(controller.poll().unwrap() && answers.receive().unwrap().is_none());
    assert!(controller.poll().unwrap());
    assert_eq!(answers.receive().unwrap().unwrap().header().attempt.batch, 1);
    assert!(!controller.poll().unwrap());
    drop((controller, odometry, requests, answers, bus));
    names.remove();
}

#[test]
fn parameters_that_cannot_be_driven_are_not() {
    let names = RunNames::create().unwrap();
    let bus = Bus::create(&names, 1).unwrap();
    let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
    let mut controller = Controller::new(&bus, config, names.run, now_ns()).unwrap();
    let requests = bus.outlet().unwrap();
    let attempt = Attempt { run: names.run, batch: 1, attempt: 1, reserved: 0 };
    let header = BatchHeader { attempt, ..BatchHeader::default() };
    for (ki, is_driven) in [(f64::NAN, false), (1.5, false), (0.5, true)] {
        let parameters = Parameters::of(&[1.0, 1.0, 1.0, ki]).0;
        let request = DriveRequest { parameters, ticks: 1, ..DriveRequest::default() };
        requests.send(header, 1, |_| request).unwrap();
        assert!(controller.poll().unwrap());
        assert_eq!(controller.driving.is_some(), is_driven, "{ki}");
    }
    assert_eq!(controller.counters.rejected, 2);
    drop((controller, requests, bus));
    names.remove();
}

#[test]
fn a_report_and_an_error_tell_the_distance_from_the_path() {
    let names = RunNames::create().unwrap();
    let bus = Bus::create(&names, 1).unwrap();
    let mut layers = Layers::maneuver("lane_change").unwrap();
    layers.set("path.pieces=[{kind='straight',length_m=8.0}]").unwrap();
    let config = layers.resolve().unwrap();
    let mut controller = Controller::new(&bus, config, names.run, now_ns()).unwrap();
    let (odometry, requests) = (bus.outlet().unwrap(), bus.outlet().unwrap());
    let reports = bus.observe::<DriveReport>().unwrap();
    let errors = bus.observe::<TrackingError>().unwrap();
    let attempt = Attempt { run: names.run, batch: 1, attempt: 1, reserved: 0 };
    let header = BatchHeader { attempt, ..BatchHeader::default() };
    requests.send(header, 1, |_| DriveRequest { ticks: 1, ..DriveRequest::default() }).unwrap();
    assert!(controller.poll().unwrap());
    let tick = TickHeader { attempt, ..TickHeader::default() };
    let beside = Odometry {
        measured: WirePose { x_m: 1.0, y_m: -0.5, yaw_rad: 0.0 },
        speed_mps: 2.0,
        yaw_rate_radps: -0.25,
        ..Odometry::default()
    };
    odometry.send(tick, 1, |_| beside).unwrap();
    assert!(controller.poll().unwrap());
    let error = errors.receive().unwrap().unwrap().items()[0];
    assert_eq!((error.along_track_m, error.path_distance_m), (-1.0, 0.5));
    let report = reports.receive().unwrap().unwrap().items()[0];
    assert_eq!((report.ticks, report.path_max_m, report.path_mean_m), (1, 0.5, 0.5));
    assert_eq!(report.lateral_acceleration_max_mps2, 0.5);
    assert!(report.progress > 0.0 && report.progress < 1.0);
    drop((controller, odometry, requests, reports, errors, bus));
    names.remove();
}

#[test]
fn a_controller_that_joins_a_drive_resumes_the_state_of_the_law_that_was_kept() {
    for kept_rad in [None, Some(0.25)] {
        let names = RunNames::create().unwrap();
        let bus = Bus::create(&names, 1).unwrap();
        let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        let ticks = config.ticks();
        let mut controller = Controller::new(&bus, config, names.run, now_ns()).unwrap();
        let (odometry, requests) = (bus.outlet().unwrap(), bus.outlet().unwrap());
        let (kept_law_states, safety) = (bus.outlet().unwrap(), bus.outlet().unwrap());
        let answers = bus.observe::<RawCommand>().unwrap();
        let states = bus.observe::<LawState>().unwrap();

        let attempt = Attempt { run: names.run, batch: 1, attempt: 1, reserved: 0 };
        // It was requested before this controller started.
        let header = BatchHeader { attempt, sent_ns: 1, ..BatchHeader::default() };
        // The filter alone: each tick halves its angle.
        let request = DriveRequest {
            parameters: Parameters::of(&[0.0, 0.0, 0.0, 0.5]).0,
            ticks,
            flags: DriveRequest::REAL_TIME,
            ..DriveRequest::default()
        };
        requests.send(header, 1, |_| request).unwrap();
        assert!(controller.poll().unwrap());
        if let Some(rad) = kept_rad {
            let mut kept = KeptLawState { tick: 6, count: 1, ..KeptLawState::default() };
            kept.numbers[0] = rad;
            kept_law_states.send(header, 1, |_| kept).unwrap();
        }
        let stands = Safety {
            tick: 6,
            steering_rad: 0.125,
            phase_ticks: 6.0,
            clock_rate: 1.0,
            has_reference: 1,
            ..Safety::default()
        };
        safety.send(header, 1, |_| stands).unwrap();
        let tick = TickHeader { attempt, tick: 8, ..TickHeader::default() };
        odometry.send(tick, 1, |_| Odometry::default()).unwrap();
        assert!(controller.poll().unwrap());
        let answer = answers.receive().unwrap().unwrap().items()[0];
        let steering_rad = 0.5 * kept_rad.unwrap_or(stands.steering_rad);
        assert_eq!((answer.steering_rad, answer.phase_ticks), (steering_rad, 8.0));
        let state = states.receive().unwrap().unwrap().items()[0];
        assert_eq!((state.tick, state.slot, state.count), (8, 0, 1));
        assert_eq!(state.numbers[0], steering_rad);
        drop((controller, odometry, requests, kept_law_states, safety, answers, states, bus));
        names.remove();
    }
}
