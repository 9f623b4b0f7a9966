//! What to drive so that every key shows: some 46 s of standing, steering steps, a chirp and speed steps.

/// How long it takes.
pub const EXCITATION_S: f64 = 46.0;

/// The command at a time since the beginning: steering angle (rad) and speed (m/s).
///
/// 1 s standing; 3 s straight on at 2 m/s; steering steps of ± 0.25 and ± 0.125 rad; a chirp of ± 0.12 rad from 0.1 to
/// 1.5 Hz; then speeds of 3.5, 2, 4, 1.2 and 2 m/s. `scale` multiplies angles and `speed_scale` speeds.
pub fn excitation(time_s: f64, scale: f64, speed_scale: f64) -> (f64, f64) {
    let (steering_rad, speed_mps) = match time_s {
        ..1.0 => (0.0, 0.0),
        ..4.0 => (0.0, 2.0),
        ..14.0 => {
            let steps = [0.25, -0.25, 0.125, -0.125];
            (steps[(((time_s - 4.0) / 2.5) as usize).min(3)], 2.0)
        }
        ..26.0 => {
            // The frequency rises from 0.1 Hz to 1.5 Hz within 12 s.
            let since_s = time_s - 14.0;
            let turns = 0.1 * since_s + 0.5 * (1.4 / 12.0) * since_s * since_s;
            (0.12 * libm::sin(std::f64::consts::TAU * turns), 2.0)
        }
        _ => {
            let speeds = [3.5, 2.0, 4.0, 1.2, 2.0];
            (0.0, speeds[(((time_s - 26.0) / 4.0) as usize).min(4)])
        }
    };
    (scale * steering_rad, speed_scale * speed_mps)
}
