//! An envelope from simulated drives: with noise, and with vehicles that differ as a car may differ from its file.
//!
//! An envelope of drives that are all alike promises nothing for a car that is a little different: its false alarms are
//! then near one half. So each drive draws what may vary.

use config::{Envelope, MadeFor, NamedParameters, Parameters, Promise, RunConfig};
use rollout::Rollout;
use supervisor::Movement;
use supervisor::envelope::{Calibration, DriveTrace, Evidence};
use tracking::{DriveRecord, EndReason};

use crate::rng::{Stream, drive_seed};

/// The stream of what varies, away from those of learners.
const STREAM: u64 = 0x0065_6e76_656c_6f70;
/// The number under which seeds of noise are drawn, likewise.
const LEARNER: u32 = u32::MAX - 28;
/// A drive that was farther from the path than this is no example of a good one; for a car of this wheelbase, and less for
/// a smaller one.
const FAR_M: f64 = 1.0;
const FULL_SIZE_M: f64 = 2.875;
/// What is said of what varies.
const VARIED: &str =
    "simulated with noise × 0.7 to 1.4, wheelbase ± 5 %, steering rate ± 10 %, pedal lag ± 10 %";

/// How far from the path a drive may be that is to be an example of a good one.
pub fn far_m(config: &RunConfig) -> f64 {
    FAR_M * (config.vehicle.wheelbase_m / FULL_SIZE_M).min(1.0)
}

/// What differs from drive to drive, beside the noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spread {
    /// What a car may differ in from its file.
    Varied,
    /// Nothing: each drive is one of the very same vehicle.
    Nothing,
}

/// The vehicle and the noise seed of a drive.
pub fn varied(config: &RunConfig, seed: u64, number: u32, spread: Spread) -> (RunConfig, u64) {
    let noise_seed = drive_seed(seed ^ STREAM, LEARNER, number);
    if spread == Spread::Nothing {
        return (config.clone(), noise_seed);
    }
    let mut stream = Stream::new(seed ^ STREAM, u64::from(number));
    let mut between = |least: f64, most: f64| least + (most - least) * stream.uniform();
    let mut plant = config.clone();
    let noise = between(0.7, 1.4);
    plant.noise.position_sd_m *= noise;
    plant.noise.heading_half_width_rad *= noise;
    let length = between(0.95, 1.05);
    let vehicle = &mut plant.vehicle;
    vehicle.wheelbase_m *= length;
    vehicle.front_axle_to_cg_m *= length;
    vehicle.steering_rate_radps *= between(0.9, 1.1);
    vehicle.pedal_lag_s *= between(0.9, 1.1);
    (plant, noise_seed)
}

/// A drive as the envelope sees it.
#[derive(Debug, Clone)]
pub struct Traced {
    /// What is kept of it.
    pub trace: DriveTrace,
    /// Its record.
    pub record: DriveRecord,
}

impl Traced {
    /// Drives, and looks on.
    pub fn drive<P: rollout::Plant>(
        rollout: &mut Rollout<P>,
        config: &RunConfig,
        by_zone: &[Parameters],
        seed: u64,
    ) -> Self {
        let mut evidence = Evidence::new(config);
        let mut trace = DriveTrace::default();
        let record = rollout.drive_scheduled(by_zone, Some(seed), |tick, it| {
            let seen = it.observation;
            let movement = Movement {
                pose: seen.measured,
                speed_mps: seen.speed_mps,
                yaw_rate_radps: seen.yaw_rate_radps,
            };
            evidence.see(tick, movement, true);
            evidence.follow(it.decision.reference_along_m);
            if it.decision.ended.is_none()
                && let Some(look) = evidence.tell(it.passed.steering_rad)
            {
                trace.add(&look);
            }
        });
        Self { trace, record }
    }

    /// Whether it is an example of a good drive.
    pub fn is_good(&self, config: &RunConfig) -> bool {
        let ended_well = matches!(self.record.reason, EndReason::Time | EndReason::Goal);
        ended_well && self.record.path_max_m <= far_m(config)
    }
}

/// What was calibrated, and from how many drives.
///
/// # Errors
/// If too few drives are good ones.
pub fn envelope_of(
    config: &RunConfig,
    sets: &[Parameters],
    traces: Vec<DriveTrace>,
    left_out: u64,
    varied: String,
) -> Result<Envelope, String> {
    let (scaling, others) = traces.split_at(traces.len() / 2);
    let Some(found) = Calibration::new(scaling, others) else {
        let (good, all) = (traces.len(), traces.len() as u64 + left_out);
        if left_out == 0 {
            return Err(format!("{good} drives are too few: at least 4 are needed"));
        }
        return Err(format!(
            "{good} of {all} drives stayed within {:.2} m of the path to their end, and at least 4 must: take steadier gains, \
             or see whether the noise (noise.position_sd_m = {}) is that of this car",
            far_m(config),
            config.noise.position_sd_m
        ));
    };
    let gains: Vec<NamedParameters> = sets.iter().map(|set| config.law.named(set)).collect();
    Ok(Envelope {
        made_for: MadeFor::of(config, gains),
        promise: Promise {
            alpha: found.guarantee.alpha,
            delta: found.guarantee.delta,
            scaled_on: scaling.len() as u64,
            threshold_on: others.len() as u64,
            above: found.guarantee.above,
            left_out,
            varied,
        },
        threshold: found.threshold,
        channels: found.channels,
        scores: found.scores,
    })
}

/// Calibrates on simulated drives with these sets: one, or one for each manoeuvre that is due. Tells `each` how many drives
/// have been made.
///
/// # Errors
/// If too few drives are good ones.
pub fn calibrate(
    config: &RunConfig,
    sets: &[Parameters],
    drives: u32,
    spread: Spread,
    mut each: impl FnMut(u32),
) -> Result<Envelope, String> {
    let by_zone = config.sets_by_zone(sets);
    let by_zone = if sets.len() == 1 { sets } else { &by_zone };
    let mut traces = Vec::new();
    let mut left_out = 0;
    for number in 0..drives {
        each(number);
        let (plant, seed) = varied(config, config.run.seed, number, spread);
        let mut rollout = Rollout::on_plant(config, &plant);
        let traced = Traced::drive(&mut rollout, config, by_zone, seed);
        match traced.is_good(config) {
            true => traces.push(traced.trace),
            false => left_out += 1,
        }
    }
    each(drives);
    let spread = if spread == Spread::Varied { VARIED } else { "simulated with the same vehicle" };
    envelope_of(config, sets, traces, left_out, spread.to_owned())
}
