//! A weighted sum of the other objectives and of how fast the wheels are turned, each divided by its scale.

use config::RunConfig;

use super::Measure;
use super::distance::Distance;
use super::mse::Mse;
use super::path::Path;
use super::path_max::PathMax;
use crate::DriveRecord;

/// Σ weight · value / scale. A scale of 0 stands for the least value in the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Weighted {
    distance: Distance,
    /// Distance, mse, path, path_max, steering_travel.
    weights: [f64; PARTS],
    scales: [f64; PARTS],
}

/// Number of terms.
const PARTS: usize = 5;
/// Bounds the mean rate of the steering angle, rad/s: no car's wheels turn faster all the time.
const MOST_TRAVEL_RADPS: f64 = 2.0;
/// Replaces a best value of 0, so that nothing is divided by 0.
const LEAST_SCALE: f64 = 1e-9;

impl Weighted {
    fn parts(&self, drive: &DriveRecord) -> [f64; PARTS] {
        let travel = drive.steering_travel_radps;
        [self.distance.of(drive), Mse.of(drive), Path.of(drive), PathMax.of(drive), travel]
    }

    fn sum(&self, parts: [f64; PARTS]) -> f64 {
        let weighed = parts.iter().zip(self.weights).zip(self.scales);
        // An objective without a weight needs no scale.
        weighed
            .filter(|((_, weight), _)| *weight > 0.0)
            .map(|((part, weight), scale)| weight * part / scale)
            .sum()
    }
}

impl Measure for Weighted {
    fn new(config: &RunConfig) -> Self {
        let settings = &config.objective.settings;
        let names = ["distance", "mse", "path", "path_max", "steering_travel"];
        let of = |kind: &str| names.map(|name| settings.number(&format!("{name}_{kind}")).max(0.0));
        Self { distance: Distance::new(config), weights: of("weight"), scales: of("scale") }
    }

    fn of(&self, drive: &DriveRecord) -> f64 {
        self.sum(self.parts(drive))
    }

    fn of_bound(&self, apart_m: f64) -> f64 {
        let distance = self.distance.of_bound(apart_m);
        let mse = Mse.of_bound(apart_m);
        let (path, path_max) = (Path.of_bound(apart_m), PathMax.of_bound(apart_m));
        self.sum([distance, mse, path, path_max, MOST_TRAVEL_RADPS])
    }

    fn needs_bests(&self) -> bool {
        self.weights.iter().zip(self.scales).any(|(weight, scale)| *weight > 0.0 && scale == 0.0)
    }

    fn take_bests(&mut self, drives: &[DriveRecord]) {
        let mut best = [f64::INFINITY; PARTS];
        for drive in drives {
            for (best, part) in best.iter_mut().zip(self.parts(drive)) {
                *best = best.min(part);
            }
        }
        for (scale, best) in self.scales.iter_mut().zip(best) {
            if *scale == 0.0 {
                *scale = best.max(LEAST_SCALE);
            }
        }
    }
}
