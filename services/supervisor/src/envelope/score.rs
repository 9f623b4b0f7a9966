//! The score of a drive, and the alarm when it exceeds the threshold.

use std::sync::Arc;

use config::{ENVELOPE_CHANNELS, RunConfig};

use super::evidence::{Evidence, Look};
use crate::{Channel, Movement};

/// Blocks between two values of a channel that depends on time.
pub(super) const KNOT: usize = 5;

/// The kinds of the channels, in the order of [`config::Envelope::CHANNELS`].
pub(super) const KINDS: [Channel; ENVELOPE_CHANNELS] = [
    Channel::Quality,
    Channel::LateralError,
    Channel::Along,
    Channel::Along,
    Channel::Along,
    Channel::Lateral,
    Channel::Lateral,
    Channel::Lateral,
    Channel::Yaw,
    Channel::Yaw,
    Channel::Yaw,
    Channel::Noise,
    Channel::Noise,
];

/// Whether mean and standard deviation of a channel depend on the time since take-off.
pub(super) fn is_by_time(channel: usize) -> bool {
    matches!(KINDS[channel], Channel::Quality | Channel::LateralError)
}

/// Deviation of a number in standard deviations, to the side that is bad: a quality may be high, noise low.
#[inline]
pub(super) fn deviation(channel: usize, value: f64, mean: f64, sd: f64) -> f64 {
    let by = (value - mean) / sd;
    match KINDS[channel] {
        Channel::Quality => (-by).max(0.0),
        Channel::Noise => by.max(0.0),
        _ => by.abs(),
    }
}

/// Whether enough calibrated drives were as old as this; of what comes later nothing is known.
#[inline]
pub(super) fn is_calibrated(numbers: &[f64], age: usize) -> bool {
    age < numbers.len() * KNOT
}

/// Mean or standard deviation at an age, between the numbers of every half second.
#[inline]
pub(super) fn at(numbers: &[f64], age: usize) -> f64 {
    let last = numbers.len() - 1;
    let place = (age / KNOT).min(last);
    let next = (place + 1).min(last);
    let share = (age % KNOT) as f64 / KNOT as f64;
    numbers[place] + share * (numbers[next] - numbers[place])
}

/// An alarm: the drive is out of the envelope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alarm {
    /// Its number in [`config::Envelope::CHANNELS`].
    pub index: usize,
    /// The kind of the channel that tripped.
    pub channel: Channel,
    /// The tick of the odometry with which it did.
    pub tick: u64,
}

/// The envelope of one vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Envelope {
    file: Arc<config::Envelope>,
    evidence: Evidence,
    tick: u64,
    score: f64,
    worst: usize,
    quality: f64,
    /// How old the drive was then, in blocks since take-off.
    age: Option<usize>,
    alarm: Option<Alarm>,
}

impl Envelope {
    /// Before a vehicle at rest; `None` if the configuration has no envelope.
    pub fn new(config: &RunConfig) -> Option<Self> {
        Some(Self {
            file: Arc::new(config.envelope.as_deref()?.clone()),
            evidence: Evidence::new(config),
            tick: 0,
            score: 0.0,
            worst: 0,
            quality: f64::NAN,
            age: None,
            alarm: None,
        })
    }

    /// The same for the supervisor, which stops what is out of its envelope; `None` if drives are only judged by it.
    pub fn at_work(config: &RunConfig) -> Option<Self> {
        if config.envelope_only_judges { None } else { Self::new(config) }
    }

    /// Nothing is known of how the vehicle came here. An alarm is forgotten; the score stays.
    pub fn lose(&mut self) {
        self.evidence.lose();
        self.alarm = None;
    }

    /// Takes odometry that is believed; see [`Evidence::see`].
    #[inline]
    pub fn see(&mut self, tick: u64, movement: Movement, obeys: bool) {
        self.tick = tick;
        self.evidence.see(tick, movement, obeys);
    }

    /// Where the reference is, along the path.
    #[inline]
    pub fn follow(&mut self, along_m: f64) {
        self.evidence.follow(along_m);
    }

    /// The steering angle that is commanded from here on.
    #[inline]
    pub fn tell(&mut self, steering_rad: f64) {
        if let Some(look) = self.evidence.tell(steering_rad) {
            self.judge(&look);
        }
    }

    fn judge(&mut self, look: &Look) {
        (self.quality, self.age) = (look.values[0], look.age);
        let mut worst = (0.0, self.worst);
        for (channel, scale) in self.file.channels.iter().enumerate() {
            let age = match look.age {
                _ if !is_by_time(channel) => 0,
                Some(age) if is_calibrated(&scale.mean, age) => age,
                _ => continue,
            };
            let (mean, sd) = (at(&scale.mean, age), at(&scale.sd, age));
            let share = deviation(channel, look.values[channel], mean, sd) / scale.limit;
            if share > worst.0 {
                worst = (share, channel);
            }
        }
        if worst.0 > self.score {
            (self.score, self.worst) = worst;
        }
        if worst.0 > self.file.threshold && self.alarm.is_none() {
            let (index, tick) = (worst.1, self.tick);
            self.alarm = Some(Alarm { index, channel: KINDS[index], tick });
        }
    }

    /// The drive's score so far, and the number of the channel that it comes from.
    pub fn score(&self) -> (f64, usize) {
        (self.score, self.worst)
    }

    /// The quality over the last second; NaN before the first.
    pub fn quality(&self) -> f64 {
        self.quality
    }

    /// Mean and standard deviation of the calibrated drives' quality, as long after take-off as that one; `None` if few of
    /// them lasted as long.
    pub fn calibrated_quality(&self) -> Option<(f64, f64)> {
        let scale = &self.file.channels[0];
        let age = self.age.filter(|age| is_calibrated(&scale.mean, *age))?;
        Some((at(&scale.mean, age), at(&scale.sd, age)))
    }

    /// The first alarm.
    pub fn alarm(&self) -> Option<Alarm> {
        self.alarm
    }
}
