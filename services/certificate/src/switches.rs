//! Regions of the gains that change along a path, each on the curve that the car is led along when it comes to the zone: in them
//! a change of gains is certain to be held.

use config::{Parameters, RunConfig, ZoneRegion};

use crate::{Equilibrium, Gains, Intervals, Region, Subject};

/// The regions of a path's zones with these sets, one for each manoeuvre that is due, at the speed of its reference. A zone
/// whose gains have no certified region there has none.
///
/// # Errors
/// If nothing can be certified of this car or law: why.
pub fn zone_regions(config: &RunConfig, sets: &[Parameters]) -> Result<Vec<ZoneRegion>, String> {
    let subject = Subject::new(config, sets)?;
    if let Some(why) = subject.uncertain() {
        return Err(why);
    }
    let speed_mps = config.reference.speed_mps;
    let zones = subject.zones();
    let region = |(zone, (from_m, gains)): (usize, &(f64, Gains))| {
        // The state is seen from the reference, which by then is farther, behind the joint at which a zone may begin.
        let (_, before) = &zones[zone.saturating_sub(1)];
        let curvature = subject.curvature_at(from_m + speed_mps / before.kv);
        let at = Equilibrium::new(subject.car(), gains, speed_mps, curvature)?;
        let Region { p, .. } = Region::find(subject.car(), gains, &at, Intervals::default())?;
        let at = [at.offset_m, at.heading_rad, at.steering_rad, at.steering_rad];
        Some(ZoneRegion { zone, at, p })
    };
    Ok(zones.iter().enumerate().filter_map(region).collect())
}
