//! From drives to an envelope: the first drives give each channel's scale, other ones the threshold.

use config::{ChannelScale, ENVELOPE_CHANNELS};

use super::evidence::Look;
use super::rank::Guarantee;
use super::score::{KNOT, at, deviation, is_by_time};

/// Blocks to each side over which the standard deviation of a channel that depends on time is pooled: few drives would
/// tell little of a single block.
const POOLED: usize = 5;
/// No standard deviation is smaller: a channel of drives that are all alike must not trip on rounding.
const LEAST_SD: f64 = 1e-6;
/// A deviation below one standard deviation is none, whatever the calibrated drives had.
const LEAST_LIMIT: f64 = 1.0;
/// Together, the limits of all channels are exceeded by this share of the drives.
const EXCEEDED: f64 = 0.01;

/// What is kept of a drive to calibrate with.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DriveTrace {
    /// Quality and lateral error, block by block since take-off.
    by_time: [Vec<f64>; 2],
    /// Of the other channels: how many, their sum, their squares' sum, the least and the largest.
    others: [Summary; ENVELOPE_CHANNELS],
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Summary {
    count: f64,
    sum: f64,
    squares: f64,
    least: f64,
    most: f64,
}

impl Default for Summary {
    fn default() -> Self {
        Self { count: 0.0, sum: 0.0, squares: 0.0, least: f64::INFINITY, most: f64::NEG_INFINITY }
    }
}

impl DriveTrace {
    /// Takes what the channels show at the end of the next block.
    pub fn add(&mut self, look: &Look) {
        for (channel, value) in look.values.into_iter().enumerate() {
            if is_by_time(channel) {
                self.by_time[channel].push(value);
            } else if !value.is_nan() {
                let it = &mut self.others[channel];
                it.count += 1.0;
                it.sum += value;
                it.squares += value * value;
                it.least = it.least.min(value);
                it.most = it.most.max(value);
            }
        }
    }

    /// The largest deviation of a channel.
    fn deviation(&self, channel: usize, mean: &[f64], sd: &[f64]) -> f64 {
        if is_by_time(channel) {
            let ages = self.by_time[channel].iter().enumerate();
            return ages
                .filter(|(_, value)| !value.is_nan())
                .map(|(age, value)| deviation(channel, *value, at(mean, age), at(sd, age)))
                .fold(0.0, f64::max);
        }
        let it = &self.others[channel];
        if it.count == 0.0 {
            return 0.0;
        }
        // The largest deviation is that of the least or the largest number.
        let of = |value| deviation(channel, value, mean[0], sd[0]);
        of(it.least).max(of(it.most))
    }

    /// The drive's score: what [`Envelope::score`](super::Envelope::score) says at its end.
    pub fn score(&self, channels: &[ChannelScale]) -> f64 {
        let share = |(channel, it): (usize, &ChannelScale)| {
            self.deviation(channel, &it.mean, &it.sd) / it.limit
        };
        channels.iter().enumerate().map(share).fold(0.0, f64::max)
    }
}

/// What a calibration comes to.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The scale of each channel.
    pub channels: Vec<ChannelScale>,
    /// The scores of the drives that set the threshold, ascending.
    pub scores: Vec<f64>,
    /// What they promise.
    pub guarantee: Guarantee,
    /// The threshold.
    pub threshold: f64,
}

impl Calibration {
    /// Scales from some drives, and the threshold from others: drives that made the scales have scores that are too small.
    /// `None` without two drives for the scales, and one for the threshold.
    pub fn new(scaling: &[DriveTrace], others: &[DriveTrace]) -> Option<Self> {
        let guarantee = Guarantee::of(others.len() as u64)?;
        if scaling.len() < 2 {
            return None;
        }
        let channels = scales(scaling);
        let mut scores: Vec<f64> = others.iter().map(|it| it.score(&channels)).collect();
        scores.sort_by(f64::total_cmp);
        // A threshold of 0 would make an alarm of nothing.
        let threshold = guarantee.threshold(&scores).max(f64::MIN_POSITIVE);
        Some(Self { channels, scores, guarantee, threshold })
    }
}

/// The scale of each channel.
fn scales(drives: &[DriveTrace]) -> Vec<ChannelScale> {
    let scale = |(channel, (kind, over_s)): (usize, (&str, f64))| {
        let (mean, sd) =
            if is_by_time(channel) { by_time(drives, channel) } else { overall(drives, channel) };
        let mut largest: Vec<f64> =
            drives.iter().map(|it| it.deviation(channel, &mean, &sd)).collect();
        largest.sort_by(f64::total_cmp);
        let share = 1.0 - EXCEEDED / ENVELOPE_CHANNELS as f64;
        let place = (share * largest.len() as f64).ceil() as usize;
        let limit = largest[place.clamp(1, largest.len()) - 1].max(LEAST_LIMIT);
        ChannelScale { kind: kind.to_owned(), over_s, limit, mean, sd }
    };
    config::Envelope::CHANNELS.into_iter().enumerate().map(scale).collect()
}

/// Mean and standard deviation of a channel for which time does not matter.
fn overall(drives: &[DriveTrace], channel: usize) -> (Vec<f64>, Vec<f64>) {
    let of = |number: fn(&Summary) -> f64| -> f64 {
        drives.iter().map(|it| number(&it.others[channel])).sum()
    };
    let count = of(|it| it.count).max(1.0);
    let mean = of(|it| it.sum) / count;
    let variance = of(|it| it.squares) / count - mean * mean;
    (vec![mean], vec![variance.max(0.0).sqrt().max(LEAST_SD)])
}

/// Mean and standard deviation every half second since take-off, as long as half of the drives last.
fn by_time(drives: &[DriveTrace], channel: usize) -> (Vec<f64>, Vec<f64>) {
    let blocks = drives.iter().map(|it| it.by_time[channel].len()).max().unwrap_or(0);
    // Of each block: how many drives have it, their mean, and the sum of their squared differences from it.
    let of_block = |age: usize| {
        let values = || {
            drives
                .iter()
                .filter_map(|it| it.by_time[channel].get(age).copied())
                .filter(|value| !value.is_nan())
        };
        let count = values().count() as f64;
        let mean = values().sum::<f64>() / count;
        (count, mean, values().map(|value| (value - mean) * (value - mean)).sum::<f64>())
    };
    let moments: Vec<(f64, f64, f64)> = (0..blocks).map(of_block).collect();
    let enough = (drives.len() as f64 / 2.0).max(2.0);
    let known = |age: usize| moments.get(age).is_some_and(|it| it.0 >= enough);
    let Some(first) = (0..blocks).find(|age| known(*age)) else { return (vec![0.0], vec![1.0]) };
    let last = (first..blocks).take_while(|age| known(*age)).last().unwrap_or(first);
    let (mut means, mut sds) = (Vec::new(), Vec::new());
    for age in (0..=last).step_by(KNOT) {
        // Before the first full window there is nothing to compare.
        let age = age.max(first);
        let near = &moments[age.saturating_sub(POOLED).max(first)..=(age + POOLED).min(last)];
        let free: f64 = near.iter().map(|it| it.0 - 1.0).sum();
        let squares: f64 = near.iter().map(|it| it.2).sum();
        means.push(moments[age].1);
        sds.push((squares / free).sqrt().max(LEAST_SD));
    }
    (means, sds)
}
