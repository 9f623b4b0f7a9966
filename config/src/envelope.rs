//! The envelope of a drive: what calibrated drives looked like, and from where on a drive counts as another kind of
//! drive. Written by `pathtune calibrate`, read by `pathtune drive`.

use serde::{Deserialize, Serialize};

use crate::{NamedParameters, RunConfig};

/// How many channels a drive is looked at by.
pub const ENVELOPE_CHANNELS: usize = 13;

/// An envelope, as its file has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Envelope {
    /// What it was calibrated for.
    pub made_for: MadeFor,
    /// What it promises, and on how many drives that rests.
    pub promise: Promise,
    /// A drive whose score is above this is out of the envelope.
    pub threshold: f64,
    /// The channels, in the order of [`Envelope::CHANNELS`].
    pub channels: Vec<ChannelScale>,
    /// The scores of the drives that set the threshold, ascending: later drives are compared with them.
    pub scores: Vec<f64>,
}

/// What an envelope was calibrated for: another drive is none of its business.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MadeFor {
    /// The manoeuvre, or the path's name.
    pub maneuver: String,
    /// The vehicle's name.
    pub vehicle: String,
    /// The law.
    pub law: String,
    /// Its parameters: one set, or one for each manoeuvre that is due.
    pub gains: Vec<NamedParameters>,
    /// One tick.
    pub tick_s: f64,
    /// A hash of the path and of how its reference advances.
    pub path: String,
}

/// What an envelope promises: for drives like those calibrated on, the probability that more than a share `alpha` of them
/// raises a false alarm is at most `delta`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Promise {
    /// The share of false alarms.
    pub alpha: f64,
    /// The probability that the share is larger after all.
    pub delta: f64,
    /// Drives from which the scales of the channels were taken.
    pub scaled_on: u64,
    /// Other drives, which set the threshold.
    pub threshold_on: u64,
    /// How many of those have a score above the threshold.
    pub above: u64,
    /// Drives that went too far from the path, or ended early, and were left out.
    pub left_out: u64,
    /// Where the drives come from, and what differed between them.
    pub varied: String,
}

/// How one channel is scaled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelScale {
    /// Its kind.
    pub kind: String,
    /// Over how long it looks.
    pub over_s: f64,
    /// The largest deviation of a calibrated drive in standard deviations: its quantile 1 − 0.01/13 over the drives. Beyond
    /// reach for a channel that too few of them were long enough for.
    pub limit: f64,
    /// Mean, every half second since take-off; a single number where time does not matter.
    pub mean: Vec<f64>,
    /// Standard deviation, likewise.
    pub sd: Vec<f64>,
}

impl Envelope {
    /// The channels: kind, and over how many seconds it looks.
    pub const CHANNELS: [(&str, f64); ENVELOPE_CHANNELS] = [
        ("quality", 1.0),
        ("lateral_error", 3.0),
        ("along", 1.0),
        ("along", 3.0),
        ("along", 10.0),
        ("lateral", 1.0),
        ("lateral", 3.0),
        ("lateral", 10.0),
        ("yaw", 1.0),
        ("yaw", 3.0),
        ("yaw", 10.0),
        ("noise", 1.0),
        ("heading_noise", 1.0),
    ];

    /// Reads the text of an envelope's file.
    ///
    /// # Errors
    /// If it is none; the message names the key.
    pub fn parse(text: &str) -> Result<Self, String> {
        let envelope: Self = toml::from_str(text).map_err(|error| error.message().to_owned())?;
        envelope.check()?;
        Ok(envelope)
    }

    /// Checks what the types do not.
    ///
    /// # Errors
    /// With the key and what is wrong with it.
    pub fn check(&self) -> Result<(), String> {
        let positive = |key: &str, number: f64| match number.is_finite() && number > 0.0 {
            true => Ok(()),
            false => Err(format!("{key}: {number} is not a number above 0")),
        };
        positive("threshold", self.threshold)?;
        let [alpha, delta] = [self.promise.alpha, self.promise.delta];
        for (key, number) in [("promise.alpha", alpha), ("promise.delta", delta)] {
            if !(number > 0.0 && number < 1.0) {
                return Err(format!("{key}: {number} is not a share between 0 and 1"));
            }
        }
        let named = self.channels.iter().map(|it| (it.kind.as_str(), it.over_s));
        if !named.eq(Self::CHANNELS) {
            return Err(format!(
                "channels: they are not the {ENVELOPE_CHANNELS} of this version; calibrate again"
            ));
        }
        for (index, it) in self.channels.iter().enumerate() {
            let key = |name: &str| format!("channels[{index}].{name}");
            positive(&key("limit"), it.limit)?;
            if it.mean.is_empty() || it.mean.len() != it.sd.len() {
                let (means, sds) = (it.mean.len(), it.sd.len());
                return Err(format!("{}: {means} means, {sds} standard deviations", key("mean")));
            }
            if let Some(mean) = it.mean.iter().find(|mean| !mean.is_finite()) {
                return Err(format!("{}: {mean} is not a number", key("mean")));
            }
            it.sd.iter().try_for_each(|sd| positive(&key("sd"), *sd))?;
        }
        let is_score = |score: &f64| score.is_finite() && *score >= 0.0;
        if !self.scores.iter().all(is_score) || !self.scores.is_sorted() {
            return Err("scores: they are not ascending numbers of at least 0".to_owned());
        }
        Ok(())
    }
}

impl MadeFor {
    /// What a drive of this configuration and these gains is.
    pub fn of(config: &RunConfig, gains: Vec<NamedParameters>) -> Self {
        Self {
            maneuver: config.maneuver.clone(),
            vehicle: config.vehicle.name.clone(),
            law: config.law.name.clone(),
            gains,
            tick_s: config.drive.tick_s,
            path: path_hash(config),
        }
    }

    /// The first thing in which another drive differs, with what it is here and there.
    pub fn difference(&self, other: &Self) -> Option<(&'static str, String, String)> {
        let shown = |it: &Self| {
            [
                ("maneuver", it.maneuver.clone()),
                ("vehicle", it.vehicle.clone()),
                ("law", it.law.clone()),
                ("gains", it.gains.iter().map(in_order).collect::<Vec<_>>().join(" / ")),
                ("tick_s", it.tick_s.to_string()),
                ("path", it.path.clone()),
            ]
        };
        let pairs = shown(self).into_iter().zip(shown(other));
        pairs.into_iter().find(|(a, b)| a.1 != b.1).map(|(a, b)| (a.0, a.1, b.1))
    }
}

/// Parameters by their names: in a file their order has no meaning.
fn in_order(named: &NamedParameters) -> String {
    let mut named = named.clone();
    named.0.sort_by(|a, b| a.0.cmp(&b.0));
    named.to_string()
}

/// FNV-1a over path and reference, as a configuration's file has them.
fn path_hash(config: &RunConfig) -> String {
    let text = |it: Result<String, toml::ser::Error>| it.expect("a configuration can be written");
    // A file may be renamed.
    let path = crate::PathConfig { name: String::new(), ..config.path.clone() };
    let texts = [text(toml::to_string(&path)), text(toml::to_string(&config.reference))];
    let hash = texts
        .iter()
        .flat_map(|text| text.bytes())
        .fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
    format!("{hash:016x}")
}
