//! From drives to an envelope: the first drives give each channel's scale, other ones the threshold.

use config::{ChannelScale, ENVELOPE_CHANNELS};

use super::evidence::Look;
use super::rank::Guarantee;
use super::score::{KNOT, at, deviation, is_by_time, is_calibrated};

/// Blocks to each side over which the standard deviation of a channel that depends on time is pooled: few drives would
/// tell little of a single block.
const POOLED: usize = 5;
/// No standard deviation is smaller: a channel of drives that are all alike must not trip on rounding.
const LEAST_SD: f64 = 1e-6;
/// A deviation below one standard deviation is none, whatever the calibrated drives had.
const LEAST_LIMIT: f64 = 1.0;
/// The limit of a channel that too few drives show: their drives were too short for its window, and nothing is known of
/// longer ones.
const NEVER: f64 = 1e12;
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

    /// Whether the drive was long enough for a channel.
    fn shows(&self, channel: usize) -> bool {
        match is_by_time(channel) {
            true => self.by_time[channel].iter().any(|value| !value.is_nan()),
            false => self.others[channel].count > 0.0,
        }
    }

    /// The largest deviation of a channel.
    fn deviation(&self, channel: usize, mean: &[f64], sd: &[f64]) -> f64 {
        if is_by_time(channel) {
            let ages = self.by_time[channel].iter().enumerate();
            return ages
                .filter(|(age, value)| !value.is_nan() && is_calibrated(mean, *age))
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
        let shown = drives.iter().filter(|it| it.shows(channel)).count();
        let limit = match 2 * shown < drives.len() {
            true => NEVER,
            false => largest[place.clamp(1, largest.len()) - 1].max(LEAST_LIMIT),
        };
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive whose lateral residual over 1 s reaches this, and whose quality is that.
    fn trace(lateral_m: f64, quality: f64) -> DriveTrace {
        let mut trace = DriveTrace::default();
        for (age, side) in [1.0, -1.0, 0.0].into_iter().cycle().take(30).enumerate() {
            let mut values = [0.0; ENVELOPE_CHANNELS];
            (values[0], values[5]) = (quality, side * lateral_m);
            trace.add(&Look { age: Some(age), values });
        }
        trace
    }

    #[test]
    fn the_threshold_is_that_of_drives_that_made_no_scale() {
        let scaling: Vec<DriveTrace> =
            (0..20).map(|it| trace(1.0 + 0.01 * f64::from(it), 0.9)).collect();
        let others: Vec<DriveTrace> =
            (0..10).map(|it| trace(2.0 + 0.1 * f64::from(it), 0.9)).collect();
        let found = Calibration::new(&scaling, &others).unwrap();
        let own: Vec<f64> = others.iter().map(|it| it.score(&found.channels)).collect();
        assert_eq!(found.scores, own);
        assert_eq!((found.threshold, found.guarantee.above), (own[9], 0));
        // Twice as far as those of the scales.
        assert!(found.threshold > 2.0, "{}", found.threshold);
        let of_the_scales: Vec<f64> = scaling.iter().map(|it| it.score(&found.channels)).collect();
        assert!(of_the_scales.iter().all(|it| *it <= 1.0), "{of_the_scales:?}");
    }

    #[test]
    fn too_few_drives_and_channels_that_they_do_not_show_are_no_alarm() {
        let one = [trace(1.0, 0.9)];
        assert_eq!(Calibration::new(&one, &one), None);
        assert_eq!(Calibration::new(&[one.clone(), one.clone()].concat(), &[]), None);
        // Drives that were too short for the window of 10 s say nothing of it.
        let short = || {
            let mut trace = DriveTrace::default();
            let mut values = [0.0; ENVELOPE_CHANNELS];
            values[7] = f64::NAN;
            trace.add(&Look { age: Some(0), values });
            trace
        };
        let found = Calibration::new(&[short(), short(), short()], &[short()]).unwrap();
        assert_eq!(found.channels[7].limit, NEVER);
        assert_eq!(found.channels[8].limit, LEAST_LIMIT);
        assert!(found.threshold > 0.0);
    }
}
