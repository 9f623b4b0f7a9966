//! Noise of the odometry.

use config::Noise;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tracking::Pose;

/// A stream of noisy poses; starts anew with each drive.
#[derive(Debug, Clone)]
pub(crate) struct PoseNoise {
    settings: Noise,
    // ChaCha's stream is the same in every version and on every host.
    rng: ChaCha8Rng,
}

impl PoseNoise {
    pub(crate) fn new(settings: Noise, seed: u64) -> Self {
        Self { settings, rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// The pose as the sensor sees it now. Each call draws new noise.
    pub(crate) fn disturb(&mut self, pose: Pose) -> Pose {
        // Box–Muller on libm instead of a library's table, whose values may change with the library's version.
        let radius = (-2.0 * libm::log(1.0 - self.uniform())).sqrt() * self.settings.position_sd_m;
        let angle = std::f64::consts::TAU * self.uniform();
        // The sum of two uniform variables is triangular.
        let heading =
            self.settings.heading_half_width_rad * (self.uniform() + self.uniform() - 1.0);
        Pose {
            x_m: pose.x_m + radius * libm::cos(angle),
            y_m: pose.y_m + radius * libm::sin(angle),
            yaw_rad: pose.yaw_rad + heading,
        }
    }

    /// Uniform in [0, 1), 53 bits.
    fn uniform(&mut self) -> f64 {
        (self.rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_has_the_moments_that_the_paper_names() {
        let settings = Noise { enabled: true, position_sd_m: 0.1, heading_half_width_rad: 0.088 };
        let mut noise = PoseNoise::new(settings, 1);
        let count = 100_000;
        let (mut sum, mut squares, mut turned, mut largest) = (0.0, 0.0, 0.0, 0.0f64);
        for _ in 0..count {
            let pose = noise.disturb(Pose::default());
            sum += pose.x_m + pose.y_m;
            squares += pose.x_m * pose.x_m + pose.y_m * pose.y_m;
            turned += pose.yaw_rad * pose.yaw_rad;
            largest = largest.max(pose.yaw_rad.abs());
        }
        let count = f64::from(count);
        assert!((sum / count).abs() < 2e-3);
        assert!(((squares / count / 2.0).sqrt() - 0.1).abs() < 1e-3);
        // A triangular distribution on ± a has the variance a²/6.
        assert!(((turned / count).sqrt() - 0.088 / 6.0f64.sqrt()).abs() < 1e-3);
        assert!(largest < 0.088);
    }
}
