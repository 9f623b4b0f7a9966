//! The envelope of one vehicle, tick by tick: what its channels show, and when they trip.

use config::{
    ChannelScale, ENVELOPE_CHANNELS, Envelope as File, Layers, MadeFor, Promise, RunConfig,
};
use supervisor::envelope::{Envelope, Evidence, Look};
use supervisor::{Channel, Movement, Watch};
use tracking::Pose;

const TICK_S: f64 = 0.01;
const SPEED_MPS: f64 = 2.0;

/// The paper's car on a long straight path, with the gear engaged.
fn config() -> RunConfig {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    for set in [
        "path.pieces=[{kind='straight',length_m=2000.0}]",
        "path.start={x_m=0.0,y_m=0.0,yaw_rad=0.0}",
        "vehicle.gear_engaged=true",
    ] {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

/// The movement of a tick of a car that drives straight on, this far beside the path.
fn straight(tick: u64, y_m: f64) -> Movement {
    let pose = Pose { x_m: SPEED_MPS * TICK_S * tick as f64, y_m, yaw_rad: 0.0 };
    Movement { pose, speed_mps: SPEED_MPS, yaw_rate_radps: 0.0 }
}

/// What these ticks show, with the reference 1 m ahead.
fn looks(
    evidence: &mut Evidence,
    ticks: impl IntoIterator<Item = u64>,
    movement: impl Fn(u64) -> Movement,
) -> Vec<Look> {
    let one = |tick: u64| {
        let seen = movement(tick);
        evidence.see(tick, seen, true);
        evidence.follow(seen.pose.x_m + 1.0);
        evidence.tell(0.0)
    };
    ticks.into_iter().filter_map(one).collect()
}

/// From which look on a channel shows anything.
fn first(looks: &[Look], channel: usize) -> Option<usize> {
    looks.iter().position(|it| !it.values[channel].is_nan())
}

#[test]
fn windows_fill_from_the_moment_that_the_car_rolls() {
    let mut evidence = Evidence::new(&config());
    let stands = Movement { speed_mps: 0.0, ..straight(0, 0.0) };
    assert_eq!(looks(&mut evidence, 0..50, |_| stands), []);
    // Odometry that was missing while it stood is no gap in its drive.
    let mut late = evidence.clone();
    assert_eq!(looks(&mut late, 100..1150, |tick| straight(tick, 0.2)).len(), 105);
    let looks = looks(&mut evidence, 50..1100, |tick| straight(tick, 0.2));
    assert_eq!(looks.len(), 105);
    assert_eq!((looks[0].age, looks[104].age), (Some(0), Some(104)));
    // Quality after 1 s, the lateral error after 3 s, residuals once the window has a start, noise after 1 s.
    let firsts: Vec<usize> = (0..13).filter_map(|channel| first(&looks, channel)).collect();
    assert_eq!(firsts, [9, 29, 10, 30, 100, 10, 30, 100, 10, 30, 100, 9, 9]);
    // 0.2 m to the left: the path is 0.2 m to the right, as the paper's error has it.
    let last = looks[104].values;
    assert!((last[0] - 1.0 / 1.2).abs() < 1e-9 && (last[1] + 0.2).abs() < 1e-9, "{last:?}");
    assert!(last[2..].iter().all(|it| it.abs() < 1e-9), "{last:?}");
}

#[test]
fn a_car_that_is_carried_to_the_side_or_turned_shows_in_its_own_channel() {
    let drifts = |tick: u64| straight(tick, 0.1 * TICK_S * tick as f64);
    let all = looks(&mut Evidence::new(&config()), 0..1100, drifts);
    let last = all.last().unwrap().values;
    for (channel, wanted_m) in [(5, 0.1), (6, 0.3), (7, 1.0)] {
        assert!((last[channel] - wanted_m).abs() < 1e-6, "{channel}: {last:?}");
    }
    assert!(last[2..5].iter().chain(&last[8..11]).all(|it| it.abs() < 1e-9), "{last:?}");

    // It says that it drives 2 m/s, and comes 1 m/s far, with wheels that are told to stay straight.
    let slow = |tick: u64| {
        let mut seen = straight(tick, 0.0);
        seen.pose.x_m *= 0.5;
        seen.pose.yaw_rad = 0.01 * TICK_S * tick as f64;
        seen
    };
    let last = looks(&mut Evidence::new(&config()), 0..1100, slow).last().unwrap().values;
    assert!((last[2] + 1.0).abs() < 1e-2 && (last[8] - 0.01).abs() < 1e-9, "{last:?}");
}

#[test]
fn noise_is_what_the_second_differences_show() {
    // To and fro by 5 cm and 0.1 rad: second differences of 0.2 m and 0.4 rad.
    let shakes = |tick: u64| {
        let side = if tick.is_multiple_of(2) { 1.0 } else { -1.0 };
        let mut seen = straight(tick, 0.05 * side);
        // Across the seam of angles, too.
        seen.pose.yaw_rad = tracking::wrap_angle(3.1 + 0.1 * side);
        seen
    };
    let last = looks(&mut Evidence::new(&config()), 0..200, shakes).last().unwrap().values;
    assert!((last[11] - 0.04).abs() < 1e-9 && (last[12] - 0.16).abs() < 1e-9, "{last:?}");
    // Odometry of every other tick has no differences from tick to tick.
    let halves =
        looks(&mut Evidence::new(&config()), (0..400).step_by(2), |tick| straight(tick, 0.0));
    assert!(halves.len() > 30 && halves.iter().all(|it| it.values[11].is_nan()));
    assert!(halves.last().unwrap().values[2].abs() < 1e-9, "{:?}", halves.last());
}

#[test]
fn what_was_not_seen_for_long_starts_the_windows_afresh_and_a_moment_does_not() {
    let mut evidence = Evidence::new(&config());
    let there = |tick: u64| straight(tick, 0.0);
    assert_eq!(looks(&mut evidence, 0..200, there).last().unwrap().age, Some(19));
    // 15 ticks are reckoned with the speed that the car had.
    let after = looks(&mut evidence, 215..330, there);
    assert!(after.iter().all(|it| it.values[2].abs() < 1e-9), "{after:?}");
    // A second without odometry: the age goes on, as the drive does.
    let age = after.last().unwrap().age.unwrap();
    let elsewhere = |tick: u64| straight(tick, 5.0);
    let after = looks(&mut evidence, 430..600, elsewhere);
    assert_eq!(after[0].age, Some(age + 1 + 10));
    assert_eq!(first(&after, 2), Some(10));
    assert!(after.last().unwrap().values[5].abs() < 1e-9, "no jump is held against it");

    // Lost: how long it has been under way is no longer known. Twice is once.
    evidence.lose();
    evidence.lose();
    let after = looks(&mut evidence, 900..1100, elsewhere);
    assert!(after.iter().all(|it| it.age.is_none()));
    assert_eq!(first(&after, 2), Some(10));
    // Nothing tells where the reference is.
    let mut blind = Evidence::new(&config());
    let looks: Vec<Look> = (0..200)
        .filter_map(|tick| {
            blind.see(tick, there(tick), true);
            blind.tell(0.0)
        })
        .collect();
    assert!(looks.last().unwrap().values[..2].iter().all(|it| it.is_nan()));
}

#[test]
fn a_car_that_stops_on_its_own_is_reckoned_with_its_wheels_straight() {
    let mut evidence = Evidence::new(&config());
    let residual = |obeys: bool, evidence: &mut Evidence| {
        let mut last = None;
        for tick in 0..400 {
            evidence.see(tick, straight(tick, 0.0), obeys);
            last = evidence.tell(0.2).or(last);
        }
        last.unwrap().values[8]
    };
    assert!(residual(false, &mut evidence).abs() < 1e-9);
    // One that is to steer and does not turn less than reckoned: 2 m/s · tan 0.2 / 2.875 m for a second.
    let turned_rad = SPEED_MPS * libm::tan(0.2) / 2.875;
    let missing_rad = residual(true, &mut Evidence::new(&config()));
    assert!((missing_rad + turned_rad).abs() < 1e-3, "{missing_rad} {turned_rad}");
}

/// An envelope of such scales: mean and standard deviation of each channel, over `knots` half seconds for quality and
/// lateral error.
fn file(knots: usize, limit: f64) -> File {
    let scale = |(index, (kind, over_s)): (usize, (&str, f64))| {
        let numbers = if index < 2 { knots } else { 1 };
        let mean = if index == 0 { 0.9 } else { 0.0 };
        let (mean, sd) = (vec![mean; numbers], vec![0.1; numbers]);
        ChannelScale { kind: kind.to_owned(), over_s, limit, mean, sd }
    };
    File {
        made_for: MadeFor::of(&config(), Vec::new()),
        promise: Promise {
            alpha: 0.01,
            delta: 0.01,
            scaled_on: 500,
            threshold_on: 500,
            above: 0,
            left_out: 0,
            varied: String::new(),
        },
        threshold: 1.0,
        channels: File::CHANNELS.into_iter().enumerate().map(scale).collect(),
        scores: Vec::new(),
    }
}

fn held_to(file: File) -> RunConfig {
    RunConfig { envelope: Some(Box::new(file)), ..config() }
}

/// Drives these ticks in an envelope.
fn drive(envelope: &mut Envelope, ticks: std::ops::Range<u64>, movement: impl Fn(u64) -> Movement) {
    for tick in ticks {
        let seen = movement(tick);
        envelope.see(tick, seen, true);
        envelope.follow(seen.pose.x_m + 1.0);
        envelope.tell(0.0);
    }
}

#[test]
fn the_first_channel_beyond_the_threshold_trips_and_the_largest_makes_the_score() {
    // Drifting from 2 s on: by 0.5 m/s, 2 standard deviations and a half of the mean over 1 s make the alarm.
    let drifts = |tick: u64| straight(tick, 0.5 * TICK_S * tick.saturating_sub(200) as f64);
    let mut envelope = Envelope::new(&held_to(file(20, 2.5))).unwrap();
    drive(&mut envelope, 0..200, drifts);
    assert_eq!(envelope.alarm(), None);
    assert!(envelope.score().0 < 1.0, "{:?}", envelope.score());
    assert!((envelope.quality() - 1.0).abs() < 1e-9);
    assert_eq!(envelope.calibrated_quality(), Some((0.9, 0.1)));
    drive(&mut envelope, 200..400, drifts);
    let alarm = envelope.alarm().unwrap();
    assert_eq!(alarm.channel, Channel::Lateral);
    // The window's mean has come 0.25 m to the side half a second after the drift began.
    assert!((250..270).contains(&alarm.tick) && alarm.tick % 10 == 9, "{alarm:?}");
    let (score, worst) = envelope.score();
    assert!(score > 1.5 && worst == 6, "over 3 s it is largest: {score} {worst}");
    // Lost, the alarm is forgotten, and the score stays.
    envelope.lose();
    assert_eq!((envelope.alarm(), envelope.score()), (None, (score, worst)));
    assert_eq!(Channel::ALL.map(|it| it.reason().count_ones()), [1; 6]);
}

#[test]
fn of_what_no_calibrated_drive_was_as_old_as_nothing_is_known() {
    // Beside the path by 2 m: far beyond the lateral error, and the quality, as long as drives are known.
    let beside = |tick: u64| straight(tick, 2.0);
    let mut envelope = Envelope::new(&held_to(file(20, 3.0))).unwrap();
    drive(&mut envelope, 0..200, beside);
    assert_eq!(envelope.alarm().map(|it| it.channel), Some(Channel::Quality));
    // Known for one second.
    let mut envelope = Envelope::new(&held_to(file(2, 3.0))).unwrap();
    let jumps = |tick: u64| straight(tick, if tick < 100 { 0.0 } else { 2.0 });
    drive(&mut envelope, 0..100, jumps);
    assert_eq!(envelope.calibrated_quality(), Some((0.9, 0.1)));
    drive(&mut envelope, 100..1000, jumps);
    assert_eq!(envelope.calibrated_quality(), None);
    let channel = envelope.alarm().map(|it| it.channel);
    assert_eq!(channel, Some(Channel::Lateral), "the jump itself, in the residual");
    // Nor is anything known of how old a drive is that was lost.
    let mut envelope = Envelope::new(&held_to(file(100, 3.0))).unwrap();
    envelope.lose();
    drive(&mut envelope, 0..1000, beside);
    assert_eq!((envelope.alarm(), envelope.calibrated_quality()), (None, None));
}

#[test]
fn what_is_better_than_calibrated_drives_is_no_deviation() {
    // Quality 1 where 0.5 was usual, and no noise where some was.
    let mut file = file(20, 1.0);
    file.channels[0].mean = vec![0.5; 20];
    file.channels[11].mean = vec![5.0];
    file.channels[12].mean = vec![5.0];
    let mut envelope = Envelope::new(&held_to(file)).unwrap();
    drive(&mut envelope, 0..500, |tick| straight(tick, 0.0));
    assert!(envelope.score().0 < 1e-6, "{:?}", envelope.score());
    assert_eq!(ENVELOPE_CHANNELS, 13);
}

#[test]
fn an_envelope_that_only_judges_stops_nobody() {
    assert!(Envelope::new(&config()).is_none());
    let held = held_to(file(20, 1.0));
    assert!(Envelope::at_work(&held).is_some());
    let judged = RunConfig { envelope_only_judges: true, ..held.clone() };
    assert!(Envelope::at_work(&judged).is_none() && Envelope::new(&judged).is_some());
    // In the watch, too.
    let alarm = |config: &RunConfig| {
        let mut watch = Watch::new(config);
        let raw = supervisor::RawCommand { speed_mps: 2.0, yaw_rate_radps: 0.0, steering_rad: 0.0 };
        for tick in 0..300 {
            watch.see(tick, straight(tick, 2.0), true);
            watch.follow(SPEED_MPS * TICK_S * tick as f64 + 1.0);
            watch.command(TICK_S, 0, Some(raw));
        }
        watch.alarm().map(|it| it.channel)
    };
    assert_eq!((alarm(&held), alarm(&judged)), (Some(Channel::Quality), None));
}
