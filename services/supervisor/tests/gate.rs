//! The gate from outside: nothing out of limits passes, whatever comes.

use config::{Layers, RunConfig};
use supervisor::{Change, Gate, Passed, RawCommand};

const TICK_S: f64 = 0.01;

fn config(sets: &[String]) -> RunConfig {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    for set in sets {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

/// A gate whose limits all bind.
fn strict(sets: &[&str]) -> Gate {
    let all = [
        "vehicle.safety.acceleration_limit_mps2=2.0",
        "vehicle.safety.deceleration_limit_mps2=4.0",
        "vehicle.safety.jerk_limit_mps3=100.0",
        "vehicle.safety.reverse_limit_mps=1.0",
        "vehicle.safety.steering_rate_limit_radps=0.5",
        "vehicle.safety.lateral_acceleration_limit_mps2=3.0",
    ];
    let sets: Vec<String> = all.iter().chain(sets).map(|set| (*set).to_owned()).collect();
    Gate::new(&config(&sets))
}

/// A gate of the paper's car: speed and steering angle alone are bounded.
fn paper() -> Gate {
    Gate::new(&config(&[]))
}

fn raw(speed_mps: f64, steering_rad: f64) -> RawCommand {
    RawCommand { speed_mps, yaw_rate_radps: 0.25, steering_rad }
}

fn near(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-12
}

#[test]
fn within_its_limits_a_command_passes_bit_for_bit() {
    let mut gate = paper();
    for (speed_mps, steering_rad) in [(9.0, -0.5), (-300.0, 0.0), (0.1 + 0.2, 0.5235987755982988)] {
        let passed = gate.pass(TICK_S, 9.0, raw(speed_mps, steering_rad));
        assert_eq!((passed.speed_mps, passed.steering_rad), (speed_mps, steering_rad));
        assert_eq!(passed.yaw_rate_radps, speed_mps * libm::tan(steering_rad) / 2.875);
        assert_eq!(passed.change, Change::default());
        assert!(!passed.change.is_any());
        assert_eq!((gate.speed_mps(), gate.steering_rad()), (speed_mps, steering_rad));
    }
}

#[test]
fn speed_and_angle_are_brought_to_their_limits() {
    let mut gate = paper();
    let passed = gate.pass(TICK_S, 9.0, raw(9.1, 0.6));
    assert_eq!((passed.speed_mps, passed.steering_rad), (9.0, 0.5235987755982988));
    let expected = Change { speed_limited: true, steering_limited: true, ..Change::default() };
    assert_eq!(passed.change, expected);
    assert!(passed.change.is_any());
    // What the governor allows binds, too.
    let passed = gate.pass(TICK_S, 3.0, raw(8.0, -0.6));
    assert_eq!((passed.speed_mps, passed.steering_rad), (3.0, -0.5235987755982988));
    assert_eq!(passed.change, expected);
    let mut gate = strict(&[
        "vehicle.safety.jerk_limit_mps3=inf",
        "vehicle.safety.deceleration_limit_mps2=inf",
    ]);
    let passed = gate.pass(TICK_S, 9.0, raw(-1.5, 0.0));
    assert_eq!((passed.speed_mps, passed.change.speed_limited), (-1.0, true));
}

#[test]
fn what_is_not_finite_slows_the_vehicle_down() {
    let numbers = [
        RawCommand { speed_mps: f64::NAN, ..raw(1.0, 0.1) },
        RawCommand { yaw_rate_radps: f64::INFINITY, ..raw(1.0, 0.1) },
        RawCommand { steering_rad: f64::NEG_INFINITY, ..raw(1.0, 0.1) },
    ];
    for it in numbers {
        assert!(!it.is_finite());
        let mut gate = paper();
        gate.pass(TICK_S, 9.0, raw(1.0, 0.1));
        let passed = gate.pass(TICK_S, 9.0, it);
        assert!(passed.change.rejected && !passed.change.speed_limited);
        // The stop's deceleration, the steering held.
        assert!(near(passed.speed_mps, 1.0 - 2.0 * TICK_S), "{}", passed.speed_mps);
        assert_eq!(passed.steering_rad, 0.1);
        assert_eq!(passed.yaw_rate_radps, passed.speed_mps * libm::tan(0.1) / 2.875);
    }
    assert!(raw(1.0, 0.1).is_finite());
}

#[test]
fn the_speed_changes_no_faster_than_acceleration_and_deceleration_allow() {
    let mut gate = strict(&["vehicle.safety.jerk_limit_mps3=inf"]);
    let passed = gate.pass(TICK_S, 9.0, raw(5.0, 0.0));
    assert!(near(passed.speed_mps, 0.02), "{}", passed.speed_mps);
    assert_eq!(passed.change, Change { acceleration_limited: true, ..Change::default() });
    let passed = gate.pass(2.0 * TICK_S, 9.0, raw(5.0, 0.0));
    assert!(near(passed.speed_mps, 0.06), "{}", passed.speed_mps);
    let passed = gate.pass(TICK_S, 9.0, raw(-0.5, 0.0));
    assert!(near(passed.speed_mps, 0.02), "{}", passed.speed_mps);
    // Reached: nothing is changed any more.
    let passed = gate.pass(TICK_S, 9.0, raw(0.03, 0.0));
    assert_eq!((passed.speed_mps, passed.change), (0.03, Change::default()));
}

#[test]
fn the_acceleration_changes_no_faster_than_the_jerk_allows() {
    let mut gate = strict(&[]);
    let mut last = (0.0, 0.0);
    let mut top_mps = 0.0f64;
    for tick in 0..400 {
        let passed = gate.pass(TICK_S, 9.0, raw(3.0, 0.0));
        let acceleration = (passed.speed_mps - last.0) / TICK_S;
        assert!(
            (acceleration - last.1).abs() <= 1.0 + 1e-9,
            "tick {tick}: {acceleration} {last:?}"
        );
        assert!(acceleration <= 2.0 + 1e-9);
        last = (passed.speed_mps, acceleration);
        top_mps = top_mps.max(passed.speed_mps);
        // 1, 2, then on at 2 m/s².
        match tick {
            0 => assert!(near(passed.speed_mps, 0.01)),
            1 => assert!(near(passed.speed_mps, 0.03)),
            2 => assert!(near(passed.speed_mps, 0.05)),
            _ => {}
        }
    }
    // It comes there without going beyond.
    assert!((last.0 - 3.0).abs() < 1e-6 && top_mps <= 3.0 + 1e-9, "{last:?} {top_mps}");
    let slowest = (0..400).map(|_| gate.pass(TICK_S, 9.0, raw(1.0, 0.0)).speed_mps);
    let slowest = slowest.fold(f64::INFINITY, f64::min);
    assert!((slowest - 1.0).abs() < 1e-6, "{slowest}");
}

#[test]
fn the_approach_takes_the_acceleration_that_can_just_be_taken_back() {
    // a·dt + a²/2j = 0.03 with dt = 0.1 and j = 10 is a = −1 + √1.6.
    let mut gate = strict(&["vehicle.safety.jerk_limit_mps3=10.0"]);
    let passed = gate.pass(0.1, 9.0, raw(0.03, 0.0));
    assert!(near(passed.speed_mps, 0.1 * (1.6f64.sqrt() - 1.0)), "{}", passed.speed_mps);
    assert!(passed.change.acceleration_limited);
}

#[test]
fn the_steering_angle_changes_no_faster_than_its_rate() {
    let mut gate = strict(&[]);
    let passed = gate.pass(TICK_S, 9.0, raw(0.0, 0.3));
    assert!(near(passed.steering_rad, 0.005), "{}", passed.steering_rad);
    assert_eq!(passed.change, Change { steering_rate_limited: true, ..Change::default() });
    let passed = gate.pass(2.0 * TICK_S, 9.0, raw(0.0, -0.3));
    assert!(near(passed.steering_rad, -0.005), "{}", passed.steering_rad);
    let passed = gate.pass(TICK_S, 9.0, raw(0.0, -0.006));
    assert_eq!((passed.steering_rad, passed.change), (-0.006, Change::default()));
}

#[test]
fn lateral_acceleration_bounds_the_angle_of_a_fast_car_and_the_speed_of_a_turning_one() {
    let free = [
        "vehicle.safety.steering_rate_limit_radps=inf",
        "vehicle.safety.jerk_limit_mps3=inf",
        "vehicle.safety.acceleration_limit_mps2=inf",
        "vehicle.safety.deceleration_limit_mps2=inf",
        "vehicle.safety.reverse_limit_mps=inf",
    ];
    let bound_rad = (3.0f64 * 2.875 / 36.0).atan();
    let bound_mps = (3.0f64 * 2.875 / 0.4f64.tan()).sqrt();
    for side in [1.0, -1.0] {
        let mut gate = strict(&free);
        let passed = gate.pass(TICK_S, 9.0, raw(6.0, 0.5 * side));
        assert_eq!(passed.speed_mps, 6.0);
        assert!(near(passed.steering_rad, bound_rad * side), "{}", passed.steering_rad);
        assert_eq!(passed.change, Change { lateral_limited: true, ..Change::default() });

        let mut gate = strict(&free);
        gate.pass(TICK_S, 9.0, raw(0.0, 0.4 * side));
        let passed = gate.pass(TICK_S, 9.0, raw(6.0, 0.4 * side));
        assert!(near(passed.speed_mps, bound_mps), "{}", passed.speed_mps);
        assert!(near(passed.steering_rad, 0.4 * side), "{}", passed.steering_rad);
        assert_eq!(passed.change, Change { lateral_limited: true, ..Change::default() });
        // Backwards alike.
        let passed = gate.pass(TICK_S, 9.0, raw(-6.0, 0.4 * side));
        assert!(near(passed.speed_mps, -bound_mps), "{}", passed.speed_mps);
        let passed = gate.pass(TICK_S, 9.0, raw(1.0, 0.4 * side));
        assert_eq!(passed.change, Change::default());
    }
}

#[test]
fn the_angle_is_one_that_the_coming_speed_allows() {
    // At 2 m/s² and a jerk of 10 m/s³ the speed goes on by 0.2 m/s once it is to be held.
    let free =
        ["vehicle.safety.steering_rate_limit_radps=inf", "vehicle.safety.jerk_limit_mps3=10.0"];
    let mut gate = strict(&free);
    let mut passed = gate.pass(TICK_S, 9.0, raw(9.0, 0.0));
    for _ in 0..1000 {
        if passed.speed_mps >= 5.0 {
            break;
        }
        passed = gate.pass(TICK_S, 9.0, raw(9.0, 0.0));
    }
    let passed = gate.pass(TICK_S, 9.0, raw(9.0, 0.5));
    let coming_mps = passed.speed_mps + 0.2;
    let bound_rad = (3.0 * 2.875 / (coming_mps * coming_mps)).atan();
    assert!((passed.steering_rad - bound_rad).abs() < 1e-9, "{}", passed.steering_rad);
    // Slowing down the speed is already its highest.
    let mut gate = strict(&free);
    gate.resume(5.0, 0.0);
    for _ in 0..20 {
        gate.pass(TICK_S, 9.0, raw(0.0, 0.0));
    }
    let passed = gate.pass(TICK_S, 9.0, raw(0.0, 0.5));
    let bound_rad = (3.0 * 2.875 / (passed.speed_mps * passed.speed_mps)).atan();
    assert!((passed.steering_rad - bound_rad).abs() < 1e-9, "{}", passed.steering_rad);
}

#[test]
fn a_stop_is_straight_on_and_gentle() {
    let mut gate = strict(&["vehicle.safety.jerk_limit_mps3=inf"]);
    gate.resume(1.0, 0.1);
    assert_eq!((gate.speed_mps(), gate.steering_rad()), (1.0, 0.1));
    let passed = gate.stop(TICK_S);
    assert!(near(passed.speed_mps, 0.98), "{}", passed.speed_mps);
    assert!(near(passed.steering_rad, 0.095), "{}", passed.steering_rad);
    let held = gate.slow_down(TICK_S);
    assert!(near(held.speed_mps, 0.96) && held.steering_rad == passed.steering_rad);
    for _ in 0..100 {
        gate.stop(TICK_S);
    }
    assert_eq!((gate.speed_mps(), gate.steering_rad()), (0.0, 0.0));
    // From backwards, too.
    gate.resume(-0.5, 0.0);
    assert!(near(gate.stop(TICK_S).speed_mps, -0.48));
    gate.reset();
    assert_eq!((gate.speed_mps(), gate.steering_rad()), (0.0, 0.0));
}

#[test]
fn a_full_brake_is_bounded_by_the_limits_alone_and_steers_as_wanted() {
    let mut gate = strict(&["vehicle.safety.jerk_limit_mps3=inf"]);
    gate.resume(1.0, 0.1);
    let passed = gate.brake(TICK_S, -1.0, 0.2, 1.0);
    assert!(near(passed.speed_mps, 0.96), "{}", passed.speed_mps);
    assert!(near(passed.steering_rad, 0.105), "{}", passed.steering_rad);
    assert!(near(gate.brake(TICK_S, -1.0, f64::NAN, 1.0).steering_rad, 0.105));
    for _ in 0..100 {
        gate.brake(TICK_S, -3.0, 0.2, 1.0);
    }
    assert_eq!((gate.speed_mps(), gate.steering_rad()), (-1.0, 0.2));
    // It never speeds up.
    gate.resume(0.02, 0.0);
    assert_eq!(gate.brake(TICK_S, 5.0, 0.0, 0.0).speed_mps, 0.0);
    assert_eq!(paper().brake(TICK_S, -1.0, 0.0, 0.0).speed_mps, -1.0);
}

#[test]
fn a_full_brake_may_have_a_limit_of_its_own() {
    let mut gate = strict(&["vehicle.safety.full_brake_mps2=inf"]);
    gate.resume(3.0, 0.1);
    // At once, but steered within the limits: 3 m/s² at the 6 m/s that the vehicle still drives are less than 0.25 rad.
    let passed = gate.brake(TICK_S, -1.0, 0.3, 6.0);
    assert_eq!(passed.speed_mps, -1.0);
    assert!(near(passed.steering_rad, 0.105), "{}", passed.steering_rad);
    for _ in 0..100 {
        gate.brake(TICK_S, -1.0, 0.3, 6.0);
    }
    let most_rad = libm::atan(3.0 * 2.875 / 36.0);
    assert!(near(gate.steering_rad(), most_rad), "{}", gate.steering_rad());
    // A vehicle whose speed is not known is not turned farther.
    let passed = gate.brake(TICK_S, -1.0, 0.3, f64::NAN);
    assert!(near(passed.steering_rad, most_rad) && passed.change.lateral_limited, "{passed:?}");
    let held = gate.steering_rad();
    assert!(!gate.brake(TICK_S, -1.0, held, f64::NAN).change.lateral_limited);
    // Afterwards all limits hold as before: 100 m/s³ and 2 m/s².
    let passed = gate.pass(TICK_S, 9.0, raw(3.0, 0.0));
    assert!(near(passed.speed_mps, -0.99), "{}", passed.speed_mps);
    let mut gate = strict(&["vehicle.safety.full_brake_mps2=8.0"]);
    gate.resume(3.0, 0.0);
    assert!(near(gate.brake(TICK_S, -1.0, 0.0, 3.0).speed_mps, 2.92));
    // Other stops keep to the limits.
    gate.resume(3.0, 0.0);
    assert!(gate.stop(TICK_S).speed_mps > 2.97);
}

#[test]
fn it_goes_on_from_what_was_measured_within_its_limits() {
    let mut gate = strict(&[]);
    gate.resume(f64::NAN, f64::INFINITY);
    assert_eq!((gate.speed_mps(), gate.steering_rad()), (0.0, 0.0));
    gate.resume(20.0, 0.0);
    assert_eq!(gate.speed_mps(), 9.0);
    gate.resume(-20.0, -2.0);
    assert_eq!((gate.speed_mps(), gate.steering_rad()), (-1.0, -0.5235987755982988));
    gate.resume(20.0, 2.0);
    let most_mps = (3.0 * 2.875 / 0.5235987755982988f64.tan()).sqrt();
    assert!(near(gate.speed_mps(), most_mps));
    // The acceleration is not what it was before.
    for _ in 0..5 {
        gate.pass(TICK_S, 9.0, raw(0.0, 0.0));
    }
    gate.resume(1.0, 0.0);
    let passed = gate.pass(TICK_S, 9.0, raw(1.0, 0.0));
    assert_eq!((passed.speed_mps, passed.change), (1.0, Change::default()));
}

#[test]
fn a_time_that_is_none_counts_as_the_shortest_or_the_longest() {
    let step = |dt_s: f64| {
        let mut gate = strict(&["vehicle.safety.jerk_limit_mps3=inf"]);
        gate.pass(dt_s, 9.0, raw(9.0, 0.0)).speed_mps
    };
    for dt_s in [0.0, -1.0, f64::NAN, 1e-6, 1e-7] {
        assert!((step(dt_s) - 2e-6).abs() < 1e-15, "{dt_s}: {}", step(dt_s));
    }
    for dt_s in [1.0, 2.0, f64::INFINITY] {
        assert!(near(step(dt_s), 2.0), "{dt_s}: {}", step(dt_s));
    }
}

/// Numbers that are the same in every run.
struct Stream(u64);

impl Stream {
    fn bits(&mut self) -> u64 {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A number as somebody hostile, broken or reasonable would send it.
    fn number(&mut self, scale: f64) -> f64 {
        match self.bits() % 16 {
            0 => f64::from_bits(self.bits()),
            1 => f64::NAN,
            2 => [f64::INFINITY, f64::NEG_INFINITY][self.bits() as usize % 2],
            3 => [f64::MAX, f64::MIN, f64::MIN_POSITIVE, 5e-324, -0.0][self.bits() as usize % 5],
            4 => scale * [1.0, -1.0][self.bits() as usize % 2],
            5 => self.within(-1e6, 1e6),
            _ => self.within(-1.5 * scale, 1.5 * scale),
        }
    }
}

#[test]
fn left_and_right_are_the_same_to_the_last_bit() {
    for seed in 0..200 {
        let (_, mut left) = draw(&mut Stream(seed));
        let mut right = left;
        let mut stream = Stream(seed.wrapping_mul(77));
        for _ in 0..200 {
            let dt_s = stream.within(0.001, 0.02);
            let (wanted_mps, wanted_rad) = (stream.within(-10.0, 40.0), stream.within(-1.5, 1.5));
            let mut other = right.pass(dt_s, 40.0, raw(wanted_mps, -wanted_rad));
            other.steering_rad = -other.steering_rad;
            other.yaw_rate_radps = -other.yaw_rate_radps;
            assert_eq!(left.pass(dt_s, 40.0, raw(wanted_mps, wanted_rad)), other, "{seed}");
        }
    }
}

/// Limits as they were drawn; the gate is made of the same numbers.
struct Drawn {
    speed: f64,
    reverse: f64,
    acceleration: f64,
    deceleration: f64,
    jerk: f64,
    steering: f64,
    rate: f64,
    lateral: f64,
    wheelbase: f64,
}

fn draw(stream: &mut Stream) -> (Drawn, Gate) {
    let or_off = |stream: &mut Stream, low: f64, high: f64| {
        if stream.bits().is_multiple_of(4) { f64::INFINITY } else { stream.within(low, high) }
    };
    let drawn = Drawn {
        speed: stream.within(0.5, 40.0),
        reverse: or_off(stream, 0.0, 5.0),
        acceleration: or_off(stream, 0.2, 8.0),
        deceleration: or_off(stream, 0.2, 10.0),
        jerk: or_off(stream, 0.5, 200.0),
        steering: stream.within(0.05, 1.2),
        rate: or_off(stream, 0.05, 3.0),
        lateral: or_off(stream, 0.2, 8.0),
        wheelbase: stream.within(0.3, 6.0),
    };
    let mut config = config(&[]);
    config.supervisor.speed_limit_mps = drawn.speed;
    config.controller.steering_limit_rad = drawn.steering;
    config.vehicle.wheelbase_m = drawn.wheelbase;
    let safety = &mut config.vehicle.safety;
    safety.reverse_limit_mps = drawn.reverse;
    safety.acceleration_limit_mps2 = drawn.acceleration;
    safety.deceleration_limit_mps2 = drawn.deceleration;
    safety.jerk_limit_mps3 = drawn.jerk;
    safety.steering_rate_limit_radps = drawn.rate;
    safety.lateral_acceleration_limit_mps2 = drawn.lateral;
    safety.stop_deceleration_mps2 = stream.within(0.1, 10.0);
    let gate = Gate::new(&config);
    (drawn, gate)
}

#[test]
fn of_ten_million_commands_none_out_of_limits_passes() {
    const SEQUENCES: usize = 5_000;
    const COMMANDS: usize = 2_000;
    let mut stream = Stream(20_261_122);
    for sequence in 0..SEQUENCES {
        let (limits, mut gate) = draw(&mut stream);
        let mut last = (0.0, 0.0, 0.0);
        for command in 0..COMMANDS {
            let given_s = match stream.bits() % 8 {
                0 => stream.number(0.02),
                1 => stream.within(0.0, 0.02),
                _ => TICK_S,
            };
            let dt_s = if given_s > 1e-6 { given_s.min(1.0) } else { 1e-6 };
            let passed = match stream.bits() % 64 {
                0 => gate.stop(given_s),
                1 => gate.slow_down(given_s),
                3..=5 => {
                    let wanted_mps = stream.number(limits.speed);
                    gate.brake(given_s, wanted_mps, stream.number(limits.steering), 0.0)
                }
                2 => {
                    gate.resume(stream.number(limits.speed), stream.number(limits.steering));
                    last = (gate.speed_mps(), 0.0, gate.steering_rad());
                    gate.stop(given_s)
                }
                _ => {
                    let allowed = stream.within(0.0, limits.speed);
                    let raw = RawCommand {
                        speed_mps: stream.number(limits.speed),
                        yaw_rate_radps: stream.number(10.0),
                        steering_rad: stream.number(limits.steering),
                    };
                    gate.pass(given_s, allowed, raw)
                }
            };
            let problem = check(&limits, dt_s, last, &passed);
            assert!(
                problem.is_none(),
                "sequence {sequence}, command {command}: {problem:?}, dt {dt_s}: {last:?} then {passed:?}"
            );
            let acceleration = (passed.speed_mps - last.0) / dt_s;
            last = (passed.speed_mps, acceleration, passed.steering_rad);
        }
    }
}

/// The limit that a command breaks, behind a last one of this speed, acceleration and steering angle.
fn check(
    limits: &Drawn,
    dt_s: f64,
    last: (f64, f64, f64),
    passed: &Passed,
) -> Option<&'static str> {
    let Passed { speed_mps: v, steering_rad: angle, yaw_rate_radps, .. } = *passed;
    // Differences of rounded numbers, divided by a short time.
    let grain = 1e-14 * (1.0 + v.abs() + last.0.abs()) / dt_s;
    let acceleration = (v - last.0) / dt_s;
    let tests = [
        ("finite", v.is_finite() && angle.is_finite() && yaw_rate_radps.is_finite()),
        ("speed", v <= limits.speed && v >= -limits.reverse.min(1000.0)),
        ("steering angle", angle.abs() <= limits.steering),
        ("acceleration", acceleration <= limits.acceleration + grain),
        ("deceleration", acceleration >= -limits.deceleration - grain),
        ("jerk", (acceleration - last.1).abs() <= limits.jerk * dt_s + 4.0 * grain),
        ("steering rate", (angle - last.2).abs() <= limits.rate * dt_s + 1e-12),
        ("yaw rate", yaw_rate_radps == v * libm::tan(angle) / limits.wheelbase),
        (
            "lateral acceleration",
            v * v * angle.abs().tan() / limits.wheelbase <= limits.lateral * (1.0 + 1e-9) + 1e-9,
        ),
    ];
    tests.into_iter().find(|(_, holds)| !holds).map(|(name, _)| name)
}
