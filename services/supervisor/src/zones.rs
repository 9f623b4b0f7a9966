//! Which zone applies: the one that the vehicle is in, once the zone's gains are certain to hold the vehicle as it drives now.
//!
//! A change of gains is a switch between two loops. Where the region of attraction of the loop to come is certified, the
//! switch waits until the state lies in it: V ≤ 1. Until then the vehicle keeps the gains that it has. The state is a mean over
//! ten ticks, because the noise of a single pose would decide otherwise.

use config::{RunConfig, ZoneRegion};
use tracking::{Path, Pose, SteeringChain, ZoneTracker, wrap_angle};

/// Ticks of the mean.
const MEAN: usize = 10;

/// The zones of one vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Zones {
    tracker: ZoneTracker,
    /// Boxed, because most drives have none.
    switches: Option<Box<Switches>>,
}

#[derive(Debug, Clone, PartialEq)]
struct Switches {
    path: Path,
    regions: Vec<ZoneRegion>,
    /// The zone whose gains the vehicle drives with.
    zone: usize,
    is_refusing: bool,
    /// The last poses, each with the reference's, as a ring.
    seen: [(Pose, f64); MEAN],
    count: usize,
    /// The road wheels, as the vehicle's file says that they follow.
    steering: SteeringChain,
    wheels_rad: f64,
}

impl Zones {
    /// Before a vehicle at the start of its path.
    pub fn new(config: &RunConfig) -> Self {
        let switches = || Switches {
            path: Path::new(&config.path),
            regions: config.switch_regions.clone(),
            zone: 0,
            is_refusing: false,
            seen: [(Pose::default(), 0.0); MEAN],
            count: 0,
            steering: SteeringChain::new(&config.vehicle, config.drive.tick_s),
            wheels_rad: 0.0,
        };
        Self {
            tracker: ZoneTracker::new(config),
            switches: (!config.switch_regions.is_empty()).then(|| Box::new(switches())),
        }
    }

    /// Goes on from a place along the path: the next update gives the zone there.
    pub fn resume(&mut self, along_m: f64) {
        self.tracker.resume(along_m);
        // Whatever gains the vehicle has been given, they are those of a zone that was entered.
        self.switches = None;
    }

    /// The zone that applies, given the pose that is measured now, the reference's progress, and the angle that the law steers.
    #[inline]
    pub fn update(&mut self, measured: Pose, along_m: f64, law_rad: f64) -> usize {
        let zone = self.tracker.update(measured, along_m);
        match &mut self.switches {
            None => zone,
            Some(switches) => switches.update(zone, (measured, along_m), law_rad),
        }
    }

    /// The steering angle that is commanded from here on.
    #[inline]
    pub fn tell(&mut self, steering_rad: f64) {
        if let Some(it) = &mut self.switches {
            it.wheels_rad = it.steering.step(steering_rad);
        }
    }

    /// Whether the vehicle is in a zone whose gains it is not given yet.
    #[inline]
    pub fn is_refusing(&self) -> bool {
        self.switches.as_ref().is_some_and(|it| it.is_refusing)
    }
}

impl Switches {
    fn update(&mut self, zone: usize, seen: (Pose, f64), law_rad: f64) -> usize {
        self.seen[self.count % MEAN] = seen;
        self.count += 1;
        self.is_refusing = zone != self.zone && !self.holds(zone, law_rad);
        if !self.is_refusing {
            self.zone = zone;
        }
        self.zone
    }

    /// Whether the gains of a zone are certain to hold the vehicle; so they are taken to be where nothing is certified.
    fn holds(&self, zone: usize, law_rad: f64) -> bool {
        let Some(region) = self.regions.iter().find(|it| it.zone == zone) else { return true };
        let (mut offset_m, mut heading_rad) = (0.0, 0.0);
        let seen = &self.seen[..self.count.min(MEAN)];
        for (pose, along_m) in seen {
            let reference = self.path.at(*along_m);
            let (sin, cos) = (libm::sin(reference.yaw_rad), libm::cos(reference.yaw_rad));
            offset_m += cos * (pose.y_m - reference.y_m) - sin * (pose.x_m - reference.x_m);
            heading_rad += wrap_angle(pose.yaw_rad - reference.yaw_rad);
        }
        let of = seen.len() as f64;
        region.value(&[offset_m / of, heading_rad / of, law_rad, self.wheels_rad]) <= 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    fn config(regions: Vec<ZoneRegion>) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set("path.zones=[{name='a',from_m=0.0},{name='b',from_m=1.0}]").unwrap();
        layers.set("path.pieces=[{kind='straight',length_m=9.0}]").unwrap();
        let mut config = layers.resolve().unwrap();
        config.switch_regions = regions;
        config
    }

    /// Offsets up to 0.2 m, headings up to 0.1 rad, and angles up to 0.5 rad.
    fn region(zone: usize) -> ZoneRegion {
        let mut p = [[0.0; 4]; 4];
        for (place, most) in [0.2, 0.1, 0.5, 0.5].into_iter().enumerate() {
            p[place][place] = 1.0 / (most * most);
        }
        ZoneRegion { zone, at: [0.0; 4], p }
    }

    fn at(x_m: f64, y_m: f64) -> Pose {
        Pose { x_m, y_m, yaw_rad: 0.0 }
    }

    #[test]
    fn a_switch_waits_until_the_state_lies_in_the_region_of_the_gains_to_come() {
        let mut zones = Zones::new(&config(vec![region(1)]));
        // The mean of the last ten ticks decides.
        (0..20).for_each(|_| assert_eq!(zones.update(at(0.5, 0.3), 0.5, 0.0), 0));
        for (tick, waits) in [(0, true), (2, true), (3, false)] {
            let mut zones = zones.clone();
            (0..tick).for_each(|_| assert_eq!(zones.update(at(1.5, 0.0), 1.5, 0.0), 0));
            assert_eq!(zones.update(at(1.5, 0.0), 1.5, 0.0), usize::from(!waits), "{tick}");
            assert_eq!(zones.is_refusing(), waits);
        }
        // Back where no region is known, nothing is refused.
        (0..9).for_each(|_| {
            zones.update(at(1.5, 0.0), 1.5, 0.0);
        });
        assert_eq!(zones.update(at(0.1, 0.3), 0.1, 0.0), 0);
        assert!(!zones.is_refusing());
    }

    #[test]
    fn what_the_law_steers_and_where_the_wheels_are_count_too() {
        let fresh = Zones::new(&config(vec![region(1)]));
        assert_eq!(fresh.clone().update(at(1.5, 0.0), 1.5, 0.51), 0);
        assert_eq!(fresh.clone().update(at(1.5, 0.0), 1.5, 0.49), 1);
        let mut turned = fresh.clone();
        (0..300).for_each(|_| turned.tell(0.55));
        assert_eq!(turned.update(at(1.5, 0.0), 1.5, 0.0), 0);
        // A supervisor that joins a drive does not know with which gains it is driven.
        turned.resume(1.5);
        assert_eq!(turned.update(at(1.5, 0.0), 1.5, 0.0), 1);
        // Without regions it is the tracker alone.
        let mut off = Zones::new(&config(Vec::new()));
        assert_eq!((off.update(at(1.5, 3.0), 1.5, 0.5), off.is_refusing()), (1, false));
    }
}
