//! What is to be said of gains on a path at a speed: margins, regions, joints, and why there is no certificate.

use config::{Advance, NamedParameters, Parameters, RunConfig, VehicleModel};
use serde::{Deserialize, Serialize};
use tracking::Path;

use crate::margin::{additional_dead_time_on, is_exact};
use crate::region::start;
use crate::simulated::Start;
use crate::simulated_law::SimulatedLaw;
use crate::{
    Car, Equilibrium, Gains, Intervals, Joint, LateralLoop, LawLoop, Piece, Region, Simulated,
    joints,
};

/// Paths with more joints than this are lines through points, whose curvature changes at each: no joint of them is a
/// switch that a car settles behind.
const MOST_JOINTS: usize = 40;

/// Seed of the starts of simulated regions: the same ones, whenever they are asked for.
const SEED: u64 = 28;

/// Under which condition a certificate holds.
pub const CLAIM: &str = "V ≤ 1 is never left, and V falls at every tick, on one segment of constant curvature, \
     as long as speed and lead stay within their intervals and the heading within ± 0.35 rad of where it settles: for \
     the kinematic car without noise, dead time and lag. On arcs the car settles where speed and lead are those of the \
     equilibrium. It says nothing of other cars, of noise, or of the moment at which one segment passes into the next.";

/// What a path is driven with.
#[derive(Debug, Clone)]
pub struct Subject<'a> {
    config: &'a RunConfig,
    /// The configuration of the vehicle that is really there, of which the law knows nothing.
    plant: &'a RunConfig,
    car: Car,
    /// For each manoeuvre that is due, its name and gains.
    sets: Vec<(String, Parameters)>,
    /// For each zone, where it begins and its gains.
    zones: Vec<(f64, Gains)>,
    pieces: Vec<Piece>,
}

/// An extent of states: offset and heading, both ways.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Extent {
    /// Offset from where the loop settles.
    pub offset_m: f64,
    /// Heading from where it settles.
    pub heading_rad: f64,
}

/// A set of gains at a speed, on a straight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetAtSpeed {
    /// The manoeuvre that the gains are for.
    pub maneuver: String,
    /// The parameters of the law.
    pub gains: NamedParameters,
    /// How far the reference runs ahead; `None` if the law has no steady state.
    pub lead_m: Option<f64>,
    /// The spectral radius of a tick; `None` for a law whose loop is not written down.
    pub spectral_radius: Option<f64>,
    /// Whether small offsets die out; `None` if nothing is known.
    pub stable: Option<bool>,
    /// The additional dead time Δ; `None` if it is without bound, or nothing is known.
    pub additional_dead_time_s: Option<f64>,
    /// Whether Δ is too small.
    pub fragile: bool,
    /// The certified region.
    pub certified: Option<Extent>,
    /// Why there is none.
    pub no_certificate: Option<String>,
    /// The region from which 300 of 300 simulated starts converge; no larger one than twice the start was tried.
    pub simulated: Option<Extent>,
}

/// A joint of the path at a speed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JointAtSpeed {
    /// Where it is.
    pub along_m: f64,
    /// Curvatures before and behind, 1/m.
    pub curvatures: [f64; 2],
    /// By how much the path turns there.
    pub kink_rad: f64,
    /// V of the state that the car is in when the reference passes; `None` if there is no region behind.
    pub value: Option<f64>,
    /// Up to which V all simulated starts converge.
    pub simulated_value: Option<f64>,
}

impl JointAtSpeed {
    /// Whether the joint lies outside of what is certain, and of what converges when simulated.
    pub fn is_outside(&self) -> bool {
        match (self.value, self.simulated_value) {
            (Some(value), Some(simulated)) => value > simulated.max(1.0),
            _ => false,
        }
    }
}

/// A region with the gains and the manoeuvre that it is for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certified {
    /// The manoeuvre that the gains are for.
    pub maneuver: String,
    /// The gains.
    pub gains: Gains,
    /// The region.
    pub region: Region,
}

/// All that is said of a path at a speed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AtSpeed {
    /// The speed of the reference.
    pub speed_mps: f64,
    /// The sets.
    pub sets: Vec<SetAtSpeed>,
    /// The joints of the path.
    pub joints: Vec<JointAtSpeed>,
    /// The largest share of the steering's rate that the path asks for; 1: the limit.
    pub steering_rate_share: Option<f64>,
    /// The regions on straights and on the arcs of the path.
    #[serde(skip)]
    pub regions: Vec<Certified>,
}

impl<'a> Subject<'a> {
    /// The subject of a configuration with sets for the manoeuvres that are due, or with one for all.
    ///
    /// # Errors
    /// If nothing can be said of the law or of the gains: why.
    pub fn new(config: &'a RunConfig, sets: &[Parameters]) -> Result<Self, String> {
        Self::on_plant(config, config, sets)
    }

    /// The same with the vehicle of another configuration, of which what drives it knows nothing.
    ///
    /// # Errors
    /// As of [`Subject::new`].
    pub fn on_plant(
        config: &'a RunConfig,
        plant: &'a RunConfig,
        sets: &[Parameters],
    ) -> Result<Self, String> {
        let due = config.maneuvers_due();
        let is_exact = is_exact(config);
        if let Some(still) = sets.iter().map(Gains::new).find(|it| is_exact && it.kv <= 0.0) {
            return Err(format!("the gains have kv = {}: such a car does not drive", still.kv));
        }
        let by_zone = if sets.len() == 1 { sets.to_vec() } else { config.sets_by_zone(sets) };
        let sets: Vec<(String, Parameters)> = match *sets {
            [one] => vec![(config.maneuver.clone(), one)],
            _ => due.iter().map(|it| (*it).to_owned()).zip(sets.iter().copied()).collect(),
        };
        let zones = &config.path.zones;
        let zones = zones.iter().map(|it| it.from_m).zip(by_zone.iter().map(Gains::new)).collect();
        let mut subject =
            Self { config, plant, car: Car::new(plant), sets, zones, pieces: pieces(config) };
        if let [(_, one)] = subject.sets[..] {
            subject.zones = vec![(0.0, Gains::new(&one))];
        }
        Ok(subject)
    }

    /// The car.
    pub fn car(&self) -> &Car {
        &self.car
    }

    /// Why no region can be certified for this car, if so.
    pub fn uncertain(&self) -> Option<String> {
        let vehicle = &self.plant.vehicle;
        let says = |what: &str| Some(format!("no certificate: {what}"));
        let law = &self.config.law.name;
        if law != "paper" {
            return Some(format!(
                "no certificate for the law {law}: the loop is written down for the paper's law alone; Δ is that of the law \
                 as it drives"
            ));
        }
        if !is_exact(self.config) {
            return says(
                "the law compensates dead time (controller.compensate_dead_time), which makes another loop of it; Δ is that \
                 of the law as it drives",
            );
        }
        if self.config.reference.advance == Advance::Projection {
            return says("the reference follows the car (reference.advance)");
        }
        if vehicle.model == VehicleModel::Dynamic {
            return says("the tyres of this car slip (vehicle.model), the certified one's do not");
        }
        if vehicle.rear_slip_s2pm != 0.0 {
            return says(
                "the rear tyres of this car slip (vehicle.rear_slip_s2pm), the certified one's do not; see Δ and the simulated \
                 region",
            );
        }
        if vehicle.yaw_lag_s2pm != 0.0 || vehicle.understeer_s2pm != 0.0 {
            return says(
                "this car turns less or later at speed (vehicle.understeer_s2pm, vehicle.yaw_lag_s2pm), the certified one does \
                 not; see Δ and the simulated region",
            );
        }
        if vehicle.steering_delay_s > 0.0 || vehicle.steering_lag_s > 0.0 {
            return says("the steering has dead time or lag; see Δ and the simulated region");
        }
        let is_exact = vehicle.steering_gain == 1.0
            && vehicle.steering_offset_rad == 0.0
            && vehicle.steering_dead_band_rad == 0.0;
        (!is_exact)
            .then_some("no certificate: the steering has a gain, an offset or a dead band".into())
    }

    /// How many joints the path has that are too many to be looked at; 0 if they are not.
    pub fn passed_over(&self) -> usize {
        let joints = self.pieces.len().saturating_sub(1);
        if joints > MOST_JOINTS { joints } else { 0 }
    }

    /// For each zone, where it begins and its gains.
    pub(crate) fn zones(&self) -> &[(f64, Gains)] {
        &self.zones
    }

    /// The curvature behind a place of the path.
    pub(crate) fn curvature_at(&self, along_m: f64) -> f64 {
        let mut ends_m = 0.0;
        let holds = |piece: &&Piece| {
            ends_m += piece.length_m;
            along_m < ends_m
        };
        self.pieces.iter().find(holds).or(self.pieces.last()).map_or(0.0, |it| it.curvature)
    }

    fn gains_at(&self, along_m: f64) -> Gains {
        let behind = self.zones.iter().rev().find(|(from_m, _)| *from_m <= along_m);
        behind.unwrap_or(&self.zones[0]).1
    }

    /// What is said of its sets at a speed, on a straight.
    pub fn sets_at(&self, speed_mps: f64) -> Vec<SetAtSpeed> {
        let mut regions = Vec::new();
        let of = |(maneuver, set): &(String, Parameters)| {
            self.set_at(maneuver, set, speed_mps, &mut regions)
        };
        self.sets.iter().map(of).collect()
    }

    /// The additional dead time Δ of each set at a speed: 0 where the loop is unstable, infinite where there is no bound, NaN
    /// where nothing is known.
    pub fn additional_dead_times_s(&self, speed_mps: f64) -> Vec<f64> {
        let of = |(_, set): &(String, Parameters)| {
            additional_dead_time_on(self.config, self.plant, set, speed_mps).unwrap_or(f64::NAN)
        };
        self.sets.iter().map(of).collect()
    }

    /// Random starts on a straight at a speed, for each set, and whether the loop converges from them when it is simulated:
    /// in a rectangle twice as large as the simulated region, and no larger than is tried. None of a set that is unstable.
    pub fn starts_at(&self, speed_mps: f64) -> Vec<Vec<Start>> {
        let of = |((_, set), known): (&(String, Parameters), SetAtSpeed)| {
            let (Some(true), Some(lead_m)) = (known.stable, known.lead_m) else {
                return Vec::new();
            };
            let full = self.extent(1.0).offset_m;
            let size = known.simulated.map_or(0.1, |it| 2.0 * it.offset_m / full).min(2.0);
            if is_exact(self.config) {
                let at = Equilibrium::straight(speed_mps, lead_m);
                Simulated::new(&self.car, &Gains::new(set), &at).starts(size, SEED)
            } else {
                SimulatedLaw::new(self.config, self.plant, set, speed_mps, lead_m)
                    .starts(size, SEED)
            }
        };
        self.sets.iter().zip(self.sets_at(speed_mps)).map(of).collect()
    }

    /// All that is said of it at a speed.
    pub fn at(&self, speed_mps: f64) -> AtSpeed {
        let mut regions = Vec::new();
        let sets = self
            .sets
            .iter()
            .map(|(maneuver, set)| self.set_at(maneuver, set, speed_mps, &mut regions));
        let sets: Vec<SetAtSpeed> = sets.collect();
        let may_drive = sets.iter().all(|it| it.stable == Some(true)) && self.uncertain().is_none();
        let (mut seen, mut share) = (Vec::new(), None);
        if may_drive && self.passed_over() == 0 {
            let way = joints(&self.car, &self.pieces, speed_mps, |along_m| self.gains_at(along_m));
            share = way.steering_rate_share;
            let look = |joint: &Joint| self.joint_at(joint, speed_mps, &mut regions);
            seen = way.joints.iter().map(look).collect();
        }
        AtSpeed { speed_mps, sets, joints: seen, steering_rate_share: share, regions }
    }

    fn set_at(
        &self,
        maneuver: &str,
        set: &Parameters,
        speed_mps: f64,
        regions: &mut Vec<Certified>,
    ) -> SetAtSpeed {
        if !is_exact(self.config) {
            return self.driven_at(maneuver, set, speed_mps);
        }
        let gains = &Gains::new(set);
        let lead_m = match self.config.reference.advance {
            Advance::Time => speed_mps / gains.kv,
            Advance::Projection => self.config.reference.lookahead_m,
        };
        let lateral = LateralLoop::new(&self.car, gains, speed_mps, lead_m);
        let spectral_radius = lateral.spectral_radius();
        let stable = spectral_radius < 1.0;
        let margin_s = if stable { lateral.additional_dead_time_s() } else { 0.0 };
        let mut no_certificate = self.uncertain();
        let (mut certified, mut simulated) = (None, None);
        let at = Equilibrium::straight(speed_mps, lead_m);
        if !stable {
            no_certificate = Some("no certificate: the loop is unstable".to_owned());
        } else {
            let mut simulation = Simulated::new(&self.car, gains, &at);
            if no_certificate.is_none() {
                match self.region(maneuver, gains, &at, regions) {
                    Some(region) => {
                        certified = Some(self.extent(region.extent));
                        simulation = simulation.within(&region);
                    }
                    None => {
                        no_certificate = Some(
                            "no certificate: no ellipsoid was found in which V falls everywhere"
                                .to_owned(),
                        );
                    }
                }
            }
            simulated = simulation.extent(SEED).map(|it| self.extent(it));
        }
        SetAtSpeed {
            maneuver: maneuver.to_owned(),
            gains: self.config.law.named(set),
            lead_m: Some(lead_m),
            spectral_radius: Some(spectral_radius),
            stable: Some(stable),
            additional_dead_time_s: margin_s.is_finite().then_some(margin_s),
            fragile: margin_s < self.config.over.fragile_below_s,
            certified,
            no_certificate,
            simulated,
        }
    }

    /// What the law as it drives says of a set, where its loop is not written down.
    fn driven_at(&self, maneuver: &str, set: &Parameters, speed_mps: f64) -> SetAtSpeed {
        let known = LawLoop::on_plant(self.config, self.plant, set, speed_mps);
        let stable = known.as_ref().ok().map(LawLoop::is_stable);
        let margin_s = known.as_ref().ok().map(LawLoop::additional_dead_time_s);
        let lead_m = known.as_ref().ok().map(LawLoop::lead_m);
        let simulated = lead_m.filter(|_| stable == Some(true)).and_then(|lead_m| {
            let simulation = SimulatedLaw::new(self.config, self.plant, set, speed_mps, lead_m);
            simulation.extent(SEED).map(|it| self.extent(it))
        });
        let no_certificate = match (known, stable) {
            (Err(why), _) => Some(why),
            (_, Some(false)) => Some("no certificate: the loop is unstable".to_owned()),
            _ => self.uncertain(),
        };
        SetAtSpeed {
            maneuver: maneuver.to_owned(),
            gains: self.config.law.named(set),
            lead_m,
            spectral_radius: None,
            stable,
            additional_dead_time_s: margin_s.filter(|it| it.is_finite()),
            fragile: margin_s.is_some_and(|it| it < self.config.over.fragile_below_s),
            certified: None,
            no_certificate,
            simulated,
        }
    }

    fn joint_at(
        &self,
        joint: &Joint,
        speed_mps: f64,
        regions: &mut Vec<Certified>,
    ) -> JointAtSpeed {
        let gains = &joint.gains;
        let is_it = |set: &Parameters| Gains::new(set) == *gains;
        let name = self.sets.iter().find(|(_, it)| is_it(it)).map_or("", |(name, _)| name);
        let found = Equilibrium::new(&self.car, gains, speed_mps, joint.curvatures[1])
            .and_then(|at| Some((at, self.region(name, gains, &at, regions)?)));
        let (value, simulated_value) = match &found {
            None => (None, None),
            Some((at, region)) => {
                let simulation = Simulated::new(&self.car, gains, at).within(region);
                let value = region.value(&joint.deviation(at));
                (Some(value), Some(simulation.level(region, SEED)))
            }
        };
        let Joint { along_m, curvatures, kink_rad, .. } = *joint;
        JointAtSpeed { along_m, curvatures, kink_rad, value, simulated_value }
    }

    /// The region around an equilibrium, searched only once.
    fn region(
        &self,
        maneuver: &str,
        gains: &Gains,
        at: &Equilibrium,
        known: &mut Vec<Certified>,
    ) -> Option<Region> {
        let same = |it: &&Certified| it.gains == *gains && it.region.equilibrium == *at;
        if let Some(known) = known.iter().find(same) {
            return Some(known.region.clone());
        }
        let region = Region::find(&self.car, gains, at, Intervals::default())?;
        let maneuver = maneuver.to_owned();
        known.push(Certified { maneuver, gains: *gains, region: region.clone() });
        Some(region)
    }

    fn extent(&self, share: f64) -> Extent {
        let [offset_m, heading_rad] = start(&self.car);
        Extent { offset_m: share * offset_m, heading_rad: share * heading_rad }
    }
}

/// The pieces of a path between its joints.
fn pieces(config: &RunConfig) -> Vec<Piece> {
    let path = Path::new(&config.path);
    let ends: Vec<f64> = path.joints_m().collect();
    let piece = |ends: &[f64]| Piece {
        length_m: ends[1] - ends[0],
        curvature: path.curvature(0.5 * (ends[0] + ends[1])),
        kink_rad: match ends[0] {
            0.0 => 0.0,
            at => path.at(at).yaw_rad - path.at(at - 1e-6).yaw_rad,
        },
    };
    ends.windows(2).map(piece).collect()
}
