//! The lateral loop of any law: the law is linearised numerically, by driving it, and joined to the exact steering and car.
//!
//! The car drives straight on along a straight path, where the law's speed command is the car's speed: that gives the lead
//! of the reference. Then, for a single tick, the law sees the car a little beside the path, or turned, or turning. How its
//! steering answers, tick by tick, is all that there is to know of it for small offsets: filter, compensation and whatever
//! else it remembers are in it. With these answers as C_y, C_θ, C_r, and the exact answers G of the car to the command, the
//! open loop is L(z) = −(C_y·G_y + C_θ·G_θ + C_r·G_r).

use std::f64::consts::PI;

use config::{Advance, Parameters, PathConfig, Piece, RunConfig};
use controller::clock::Phase;
use controller::{DriveController, Seen};
use nalgebra::Complex;
use tracking::Pose;

use crate::Car;
use crate::lateral::{Wheels, least_delay_s};

/// How far the car is put beside the path (m), turned (rad) or set turning (rad/s): the mean of both sides is exact to the
/// third order.
const SMALL: f64 = 1e-5;
/// The law has forgotten that once its steering moves by less than this share of its largest answer.
const FORGOTTEN: f64 = 1e-9;
/// How long that must last, and how long it may take.
const QUIET_TICKS: usize = 200;
const LONGEST_TICKS: usize = 8_000;

/// The lateral loop of a law, a set of its parameters and a car, at one speed.
#[derive(Debug, Clone)]
pub struct LawLoop {
    tick_s: f64,
    lead_m: f64,
    wheels: Wheels,
    /// How the steering command answers to an offset, a heading and a yaw rate of a single tick.
    answers: [Vec<f64>; 3],
}

impl LawLoop {
    /// The loop of a configuration's law and vehicle.
    ///
    /// # Errors
    /// If the law has no steady state, or does not forget: why.
    pub fn new(config: &RunConfig, set: &Parameters, speed_mps: f64) -> Result<Self, String> {
        Self::on_plant(config, config, set, speed_mps)
    }

    /// The same with the vehicle of another configuration, of which the law knows nothing.
    ///
    /// # Errors
    /// As of [`LawLoop::new`].
    pub fn on_plant(
        config: &RunConfig,
        plant: &RunConfig,
        set: &Parameters,
        speed_mps: f64,
    ) -> Result<Self, String> {
        let probe = Probe::new(config, set, speed_mps);
        let lead_m = match config.reference.advance {
            Advance::Time => probe.steady_lead_m()?,
            // The reference keeps its distance, whatever the law.
            Advance::Projection => 0.0,
        };
        let answers = [
            probe.answer(lead_m, |seen, by| seen.measured.y_m += by)?,
            probe.answer(lead_m, |seen, by| seen.measured.yaw_rad += by)?,
            probe.answer(lead_m, |seen, by| seen.yaw_rate_radps += by)?,
        ];
        let car = Car::new(plant);
        let wheels = Wheels::new(&car, speed_mps);
        Ok(Self { tick_s: car.tick_s, lead_m, wheels, answers })
    }

    /// How far the reference runs ahead of the car; 0 where it follows the car.
    pub fn lead_m(&self) -> f64 {
        self.lead_m
    }

    /// The open loop at a point r·e^(iα) on or outside the unit circle.
    fn open_loop(&self, radius: f64, angle: f64) -> Complex<f64> {
        let turned = |ticks: f64| {
            let length = if radius == 1.0 { 1.0 } else { libm::pow(radius, ticks) };
            Complex::new(length * libm::cos(ticks * angle), length * libm::sin(ticks * angle))
        };
        let [offset, heading, yaw_rate] = self.wheels.answer(turned);
        let back = turned(-1.0);
        let sum = |answer: &[f64]| {
            answer.iter().rev().fold(Complex::new(0.0, 0.0), |sum, it| sum * back + *it)
        };
        let [by_offset, by_heading, by_yaw_rate] = [0, 1, 2].map(|of| sum(&self.answers[of]));
        -(by_offset * offset + by_heading * heading + by_yaw_rate * yaw_rate)
    }

    /// Whether small offsets die out: 1 + L has no zero outside the unit circle, as it does not wind round 0 there.
    ///
    /// The car integrates twice, with poles at 1; so the path runs a little outside of the circle. A loop that grows by
    /// less than 1e-6 of itself in a tick passes for stable.
    pub fn is_stable(&self) -> bool {
        const RADIUS: f64 = 1.0 + 1e-6;
        const LEAST_ANGLE: f64 = 1e-8;
        const POINTS: usize = 1_500;
        let at = |angle: f64| self.open_loop(RADIUS, angle) + 1.0;
        let ratio = libm::pow(PI / LEAST_ANGLE, 1.0 / POINTS as f64);
        let mut wound = 0.0;
        let (mut from, mut value) = (0.0, at(0.0));
        let mut to = LEAST_ANGLE;
        for point in 0..=POINTS {
            let end = if point == POINTS { PI } else { to };
            let next = at(end);
            wound += turned_between(&at, (from, value), (end, next), 12);
            (from, value) = (end, next);
            to *= ratio;
        }
        // Half of the circle; the other half mirrors it.
        libm::round(wound / PI) == 0.0
    }

    /// The additional dead time Δ, see [`LateralLoop::additional_dead_time_s`](crate::LateralLoop::additional_dead_time_s).
    /// The law does not know of it.
    pub fn additional_dead_time_s(&self) -> f64 {
        if !self.is_stable() {
            return 0.0;
        }
        least_delay_s(self.tick_s, |frequency_radps| {
            self.open_loop(1.0, frequency_radps * self.tick_s)
        })
    }
}

/// By how much a curve turns round 0 between two of its points, which are halved until the angle is small.
fn turned_between(
    at: &impl Fn(f64) -> Complex<f64>,
    (from, start): (f64, Complex<f64>),
    (to, end): (f64, Complex<f64>),
    halvings: u32,
) -> f64 {
    let quotient = end * start.conj();
    let angle = libm::atan2(quotient.im, quotient.re);
    if angle.abs() < 0.8 || halvings == 0 {
        return angle;
    }
    let middle = 0.5 * (from + to);
    let value = at(middle);
    turned_between(at, (from, start), (middle, value), halvings - 1)
        + turned_between(at, (middle, value), (to, end), halvings - 1)
}

/// Drives a law straight on.
pub(crate) struct Probe {
    drive: DriveController,
    set: Parameters,
    speed_mps: f64,
    tick_s: f64,
}

impl Probe {
    pub(crate) fn new(config: &RunConfig, set: &Parameters, speed_mps: f64) -> Self {
        let mut straight = config.clone();
        let tick_s = config.drive.tick_s;
        straight.drive.loop_time_s = (LONGEST_TICKS as f64 + 1e4) * tick_s;
        let start_m = Self::start_m(speed_mps);
        let length_m = start_m + 2.0 * straight.drive.loop_time_s * speed_mps + 100.0;
        let mut zones = config.path.zones.clone();
        zones.truncate(1);
        straight.path = PathConfig {
            name: String::new(),
            widths_m: Vec::new(),
            start: config::PoseConfig { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0 },
            pieces: vec![Piece::Straight { length_m }],
            points: Vec::new(),
            speeds_mps: Vec::new(),
            laps: 1,
            zones,
        };
        straight.reference.speed_mps = speed_mps;
        // At its speed from the beginning.
        straight.reference.ramp_s = 0.0;
        straight.drive.start_speed_mps = 0.0;
        Self { drive: DriveController::new(&straight), set: *set, speed_mps, tick_s }
    }

    /// Where the car is when it is looked at first: so far that no law looks back to the start of the path.
    fn start_m(speed_mps: f64) -> f64 {
        Self::LARGEST_LEAD_S * speed_mps + 100.0
    }

    /// How long the law drives on before it is looked at.
    pub(crate) const SETTLING_TICKS: u64 = 200;

    /// Leads beyond this time are not looked for.
    const LARGEST_LEAD_S: f64 = 100.0;

    /// The tick of the reference's clock, and what the law sees then.
    pub(crate) fn seen(&self, lead_m: f64, tick: u64) -> (Phase, Seen) {
        let per_tick_m = self.speed_mps * self.tick_s;
        let begin = libm::round(Self::start_m(self.speed_mps) / per_tick_m);
        let ticks = begin + tick as f64;
        let measured = Pose { x_m: ticks * per_tick_m - lead_m, ..Pose::default() };
        let (speed_mps, yaw_rate_radps) = (self.speed_mps, 0.0);
        let seen = Seen { measured, speed_mps, yaw_rate_radps, truth: None, collision: false };
        (Phase { ticks, waited_ticks: 0.0 }, seen)
    }

    /// The law, with the car at a steady distance behind the reference for a while; and its speed command.
    pub(crate) fn settled(&self, lead_m: f64) -> (DriveController, f64) {
        let mut drive = self.drive.clone();
        drive.reset(self.set, u64::MAX);
        let (phase, seen) = self.seen(lead_m, 0);
        drive.join(0.0, phase, seen.measured, 0.0, None);
        let mut commanded_mps = 0.0;
        for tick in 0..Self::SETTLING_TICKS {
            let (phase, seen) = self.seen(lead_m, tick);
            commanded_mps = drive.tick(phase, seen).command.speed_mps;
        }
        (drive, commanded_mps)
    }

    /// The lead at which the law asks for the speed that the car has.
    fn steady_lead_m(&self) -> Result<f64, String> {
        let lacking = |lead_m: f64| self.speed_mps - self.settled(lead_m).1;
        if lacking(0.0).abs() < 1e-9 * self.speed_mps {
            return Ok(0.0);
        }
        let (mut low, mut high) = (-self.speed_mps, Self::LARGEST_LEAD_S * self.speed_mps);
        if !(lacking(low) > 0.0 && lacking(high) < 0.0) {
            let problem = "at no distance behind its reference does the law ask for this speed";
            return Err(format!("no Δ: {problem}"));
        }
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if lacking(middle) > 0.0 { low = middle } else { high = middle }
        }
        Ok(0.5 * (low + high))
    }

    /// How the steering answers when, for one tick, the law sees the car otherwise than it is, per unit of that.
    fn answer(&self, lead_m: f64, change: impl Fn(&mut Seen, f64)) -> Result<Vec<f64>, String> {
        let (settled, _) = self.settled(lead_m);
        let mut sides = [(settled.clone(), SMALL), (settled, -SMALL)];
        let mut answer: Vec<f64> = Vec::new();
        let (mut largest, mut quiet) = (0.0_f64, 0);
        for tick in 0..LONGEST_TICKS {
            let [left, right] = sides.each_mut().map(|(drive, by)| {
                let (phase, mut seen) = self.seen(lead_m, Self::SETTLING_TICKS + tick as u64);
                if tick == 0 {
                    change(&mut seen, *by);
                }
                drive.tick(phase, seen).command.steering_rad
            });
            let by = (left - right) / (2.0 * SMALL);
            answer.push(by);
            largest = largest.max(by.abs());
            quiet = if by.abs() <= FORGOTTEN * largest { quiet + 1 } else { 0 };
            if quiet == QUIET_TICKS {
                answer.truncate(answer.len() - QUIET_TICKS);
                return Ok(answer);
            }
        }
        Err("no Δ: by itself, without the car, the law's steering does not come to rest".to_owned())
    }
}
