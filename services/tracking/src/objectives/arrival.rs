//! How much drives miss that do not arrive, so that a tuner sees which of them come nearer to arriving.

use crate::DriveRecord;

/// The least that is missed: never quite the bound itself, even beside the goal.
const LEAST: f64 = 1e-6;
/// The part of the credit that a drive gets for being near the path, wherever it ends: drives that stand at the start are
/// told apart, too.
const FOR_NEARNESS: f64 = 0.1;

/// What a drive missed that did not arrive, from just above 0 to 1:
///
///   1 − (0.1 + 0.9·p) / (1 + e/s)
///
/// with the share p of the path at which it ended, its mean distance e from the path, and a scale s in m. After a stop or a
/// collision each tick that was cut off counts with the last distance, so that e is the smaller the longer a drive stayed
/// on the path, and the nearer to it it ended. Progress counts the less the farther off a drive was: one that leaves the
/// path at once may end beside its last point.
pub(super) fn missed(drive: &DriveRecord, scale_m: f64) -> f64 {
    let come = FOR_NEARNESS + (1.0 - FOR_NEARNESS) * drive.progress;
    (1.0 - come / (1.0 + drive.path_mean_m / scale_m)).max(LEAST)
}

/// What several drives with the same parameters missed together, from just above 0 to 1; 0 if all arrive: first how many
/// of them do not arrive, and between equals the mean of what these missed.
pub(super) fn missed_together(drives: &[DriveRecord], scale_m: f64) -> f64 {
    let each: Vec<f64> =
        drives.iter().filter(|it| !it.arrived()).map(|it| missed(it, scale_m)).collect();
    if each.is_empty() {
        return 0.0;
    }
    let count = each.len() as f64;
    (count - 1.0 + each.iter().sum::<f64>() / count) / drives.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Covered, DriveRecorder, EndReason, TickMeasures};

    /// A drive of 1,000 ticks that leaves the path at a share of it, at 1 cm a tick, and that the gate stops `end_m` from
    /// the path, or nobody.
    fn leaving(at: f64, end_m: Option<f64>) -> DriveRecord {
        let mut recorder = DriveRecorder::new(0.01);
        let mut path_distance_m = 0.02;
        for tick in 0..1000 {
            if f64::from(tick) >= 1000.0 * at {
                path_distance_m += 0.01;
            }
            recorder.add(TickMeasures { path_distance_m, ..TickMeasures::default() });
            if end_m.is_some_and(|it| path_distance_m > it) {
                break;
            }
        }
        let reason = end_m.map_or(EndReason::Time, |_| EndReason::Stopped);
        // A drive that nobody stops ends beside the last point of the path.
        let at_end = if end_m.is_some() { at } else { 1.0 };
        recorder.finish(reason, 1000, 0.01, Covered { at_end, in_time: at_end }, 0)
    }

    fn rising(drives: &[DriveRecord]) {
        let values: Vec<f64> = drives.iter().map(|it| missed(it, 2.0)).collect();
        assert!(values.is_sorted_by(|a, b| a < b), "{values:?}");
        assert!(values.iter().all(|it| (LEAST..=1.0).contains(it)), "{values:?}");
    }

    #[test]
    fn the_longer_a_drive_stays_on_the_path_and_the_nearer_it_ends_the_less_it_misses() {
        rising(&[0.9, 0.6, 0.3, 0.0].map(|at| leaving(at, Some(3.0))));
        rising(&[0.9, 0.6, 0.3, 0.0].map(|at| leaving(at, None)));
        rising(&[1.0, 2.0, 4.0].map(|end_m| leaving(0.5, Some(end_m))));
        // Whatever its projection says, one that leaves at once has not come as far as one that leaves midway.
        rising(&[leaving(0.5, Some(3.0)), leaving(0.0, None)]);
        // One that ends beside its goal has nearly arrived.
        let beside = DriveRecord { progress: 1.0, path_mean_m: 0.05, ..DriveRecord::default() };
        rising(&[DriveRecord { path_mean_m: 0.0, ..beside }, beside, leaving(0.9, Some(1.0))]);
        assert!(missed(&DriveRecord { path_mean_m: f64::MAX, ..beside }, 2.0) <= 1.0);
    }

    #[test]
    fn over_several_drives_first_counts_how_many_arrive_then_how_far_the_others_came() {
        let arrived = DriveRecord { reason: EndReason::Goal, ..DriveRecord::default() };
        let [near, far] = [0.9, 0.1].map(|at| leaving(at, Some(3.0)));
        let of = |drives: &[DriveRecord]| missed_together(drives, 2.0);
        let values = [
            of(&[arrived; 3]),
            of(&[arrived, near, arrived]),
            of(&[arrived, far, arrived]),
            of(&[arrived, near, near]),
            of(&[near, arrived, far]),
            of(&[near, near, near]),
            of(&[near, near, far]),
            of(&[far, far, far]),
        ];
        assert!(values.is_sorted_by(|a, b| a < b), "{values:?}");
        assert_eq!((values[0], of(&[far]) == missed(&far, 2.0)), (0.0, true));
        assert!(values[7] <= 1.0);
    }
}
