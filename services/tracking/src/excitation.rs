//! What to drive so that a car's values show: standing, steering steps, a sine that gets quicker, and speed steps.

/// How long it takes.
pub const EXCITATION_S: f64 = 47.0;

/// The command at a time since the beginning: steering angle (rad) and speed (m/s).
///
/// With A = `steering_rad`, v = `speed_mps` and all angles around `turn_rad`: 1 s standing; 3 s straight on at v; steering
/// steps of A, −A, A/2 and −A/2, 2.5 s each; a sine of 0.48 A from 0.1 Hz to 1.5 Hz, 12 s; then speeds of 1.75 v and v for
/// 4 s each, 2 v for 10 s and 0.6 v for 3 s, at 1.75 v with a sine of 0.72 A that takes 3 s, and at 2 v with one that takes
/// 8 s. After that v.
pub fn excitation(time_s: f64, steering_rad: f64, speed_mps: f64, turn_rad: f64) -> (f64, f64) {
    let (steering, speed) = match time_s {
        ..1.0 => return (0.0, 0.0),
        ..4.0 => (0.0, 1.0),
        ..14.0 => {
            let steps = [1.0, -1.0, 0.5, -0.5];
            (steps[(((time_s - 4.0) / 2.5) as usize).min(3)], 1.0)
        }
        ..26.0 => {
            // The frequency rises evenly.
            let since_s = time_s - 14.0;
            let turns = 0.1 * since_s + 0.5 * (1.4 / 12.0) * since_s * since_s;
            (0.48 * libm::sin(std::f64::consts::TAU * turns), 1.0)
        }
        _ => {
            // Fast bends tell how the tyres slip: long ones the most, in which the car turns far.
            let bend = |begin_s: f64, takes_s: f64| {
                0.72 * libm::sin(std::f64::consts::TAU * (time_s - begin_s) / takes_s)
            };
            let steering = match time_s {
                27.0..30.0 => bend(27.0, 3.0),
                35.25..43.25 => bend(35.25, 8.0),
                _ => 0.0,
            };
            let speed = match time_s {
                ..30.0 => 1.75,
                34.0..44.0 => 2.0,
                44.0..EXCITATION_S => 0.6,
                _ => 1.0,
            };
            (steering, speed)
        }
    };
    (turn_rad + steering_rad * steering, speed_mps * speed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_stands_first_and_keeps_its_amplitudes() {
        assert_eq!(excitation(0.99, 0.25, 2.0, 0.2), (0.0, 0.0));
        assert_eq!(excitation(5.0, 0.25, 2.0, 0.0), (0.25, 2.0));
        assert_eq!(excitation(7.0, 0.25, 2.0, 0.2), (0.2 - 0.25, 2.0));
        assert_eq!(excitation(34.5, 0.25, 2.0, 0.0), (0.0, 4.0));
        assert_eq!(excitation(1e9, 0.25, 2.0, 0.0), (0.0, 2.0));
        for tick in 1400..2600 {
            let (steering_rad, speed_mps) = excitation(f64::from(tick) * 0.01, 0.25, 2.0, 0.0);
            assert!(steering_rad.abs() <= 0.12 && speed_mps == 2.0);
        }
    }
}
