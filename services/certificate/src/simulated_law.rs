//! From where the loop of any law converges when it is simulated: the law itself drives the kinematic car of
//! [`Simulated`](crate::Simulated) along a straight path, at a steady speed.

use config::{Parameters, RunConfig};
use controller::DriveController;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::Car;
use crate::law::Probe;
use crate::region::start;
use crate::simulated::{STARTS, Start, starts};

/// The sizes that are tried: from a fiftieth of the start to twice of it, in steps of this ratio.
const GROWTH: f64 = 1.25;
const EXTENTS: [f64; 2] = [0.02, 2.0];
/// How long a start may take to converge.
const LONGEST_S: f64 = 60.0;

/// A law's loop on a straight path, to be simulated from many starts.
pub(crate) struct SimulatedLaw {
    car: Car,
    probe: Probe,
    lead_m: f64,
    settled: DriveController,
}

impl SimulatedLaw {
    /// The loop of a configuration's law at a speed, with the lead that its reference has there.
    pub(crate) fn new(
        config: &RunConfig,
        plant: &RunConfig,
        set: &Parameters,
        speed_mps: f64,
        lead_m: f64,
    ) -> Self {
        let probe = Probe::new(config, set, speed_mps);
        let settled = probe.settled(lead_m).0;
        Self { car: Car::new(plant), probe, lead_m, settled }
    }

    /// The multiple of [`START`](crate::START) from whose edge all starts converge: the largest that is found by halving
    /// the sizes. `None` if not even a fiftieth of it does.
    pub(crate) fn extent(&self, seed: u64) -> Option<f64> {
        let [offset_m, heading_rad] = start(&self.car);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let shares: Vec<[f64; 2]> = (0..STARTS)
            .map(|index| {
                let [a, b] = [rng.random_range(-1.0..=1.0), rng.random_range(-1.0..=1.0)];
                match index % 4 {
                    0 => [1.0, b],
                    1 => [a, 1.0],
                    2 => [-1.0, b],
                    _ => [a, -1.0],
                }
            })
            .collect();
        let size = |step: u32| EXTENTS[0] * libm::pow(GROWTH, f64::from(step));
        let all = |step: u32| {
            let size = size(step);
            shares.iter().all(|[a, b]| self.converges(size * a * offset_m, size * b * heading_rad))
        };
        if !all(0) {
            return None;
        }
        // Converges from `low`, not from `high`, or not tried.
        let most = libm::floor(libm::log(EXTENTS[1] / EXTENTS[0]) / libm::log(GROWTH)) as u32;
        let (mut low, mut high) = (0, most + 1);
        while high - low > 1 {
            let middle = u32::midpoint(low, high);
            if all(middle) { low = middle } else { high = middle }
        }
        Some(size(low))
    }

    /// Random starts in a rectangle of this multiple of [`START`](crate::START), and which of them converge.
    pub(crate) fn starts(&self, size: f64, seed: u64) -> Vec<Start> {
        starts(&self.car, size, seed, |[y, heading]| self.converges(y, heading))
    }

    /// Whether the loop comes back from an offset and a heading, with the steering straight.
    fn converges(&self, mut offset_m: f64, mut heading_rad: f64) -> bool {
        let car = &self.car;
        let (h, limit) = (car.tick_s, car.steering_limit_rad);
        let reach = car.steering_rate_radps * h;
        let share = match car.steering_lag_s {
            0.0 => 1.0,
            lag_s => -libm::expm1(-h / lag_s),
        };
        let delay = libm::ceil(car.steering_delay_s / h - 1e-6) as usize;
        let mut line = vec![0.0; delay + 1];
        let mut wheels = 0.0_f64;
        let mut turning = car.turning();
        let mut drive = self.settled.clone();
        let mut near_for = 0;
        for tick in 0..(LONGEST_S / h) as u64 {
            let (phase, mut seen) = self.probe.seen(self.lead_m, Probe::SETTLING_TICKS + tick);
            seen.measured.y_m = offset_m;
            seen.measured.yaw_rad = heading_rad;
            seen.yaw_rate_radps = turning.yaw_rate_radps();
            let command = drive.tick(phase, seen).command.steering_rad;
            line[tick as usize % (delay + 1)] = command;
            // The oldest, which the next tick overwrites.
            let acting =
                (car.steering_gain * line[(tick as usize + 1) % (delay + 1)]).clamp(-limit, limit);
            wheels += (share * (acting - wheels)).clamp(-reach, reach);
            let turned = turning.turn(wheels, seen.speed_mps, h);
            let middle = heading_rad + 0.5 * turned;
            let p = car.tracked_m(seen.speed_mps);
            offset_m += h * seen.speed_mps * libm::sin(middle)
                + p * (libm::sin(heading_rad + turned) - libm::sin(heading_rad));
            heading_rad += turned;
            let is_near = offset_m.abs() < 0.02 * car.wheelbase_m
                && heading_rad.abs() < 0.02
                && wheels.abs() < 0.02;
            near_for = if is_near { near_for + 1 } else { 0 };
            if near_for == 100 {
                return true;
            }
            if offset_m.is_nan() || offset_m.abs() > 1e3 * car.wheelbase_m {
                return false;
            }
        }
        false
    }
}
