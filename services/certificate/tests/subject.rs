//! What is said of gains on a path: each figure from the loop, the region and the joints that it is of.

use certificate::{
    Car, Equilibrium, Gains, Intervals, LateralLoop, Region, Subject, additional_dead_time_s,
    check, zone_regions,
};
use config::{Layers, Parameters, RunConfig};

fn config(maneuver: &str, sets: &[&str]) -> RunConfig {
    let mut layers = Layers::maneuver(maneuver).unwrap();
    sets.iter().for_each(|set| layers.set(set).unwrap());
    layers.resolve().unwrap()
}

/// The paper's sets of the circuit: lane change and roundabout.
fn pair() -> [Parameters; 2] {
    [[3.0, 21.0, 21.0, 0.7], [3.4, 21.0, 1.0, 0.84]].map(|it| Parameters::of(&it))
}

#[test]
fn the_lead_of_the_reference_is_part_of_the_margin() {
    let [lane, roundabout] = pair();
    let plain = config("circuit", &[]);
    for set in [lane, roundabout] {
        let gains = Gains::new(&set);
        let known = LateralLoop::steady(&Car::new(&plain), &gains, 3.0).additional_dead_time_s();
        assert_eq!(additional_dead_time_s(&plain, &set, 3.0), Ok(known));
        // A reference that follows the car keeps its distance at every speed.
        let follows = config("circuit", &["reference.advance='projection'"]);
        let lead_m = follows.reference.lookahead_m;
        let known = LateralLoop::new(&Car::new(&follows), &gains, 3.0, lead_m);
        let told = additional_dead_time_s(&follows, &set, 3.0).unwrap();
        assert_eq!(told, known.additional_dead_time_s());
        let subject = Subject::new(&follows, &[set]).unwrap();
        assert_eq!(subject.sets_at(3.0)[0].lead_m, Some(lead_m));
        assert_eq!(subject.additional_dead_times_s(3.0), [told]);
        assert!(subject.uncertain().unwrap().contains("reference.advance"));
    }
    let why = |set: &[f64; 4], speed_mps: f64| {
        additional_dead_time_s(&plain, &Parameters::of(set), speed_mps).unwrap_err()
    };
    assert!(why(&[3.0, 21.0, 21.0, 0.7], 0.0).contains("does not drive"));
    assert!(why(&[0.0, 21.0, 21.0, 0.7], 1.0).contains("kv = 0"));
    assert!(Subject::new(&plain, &[Parameters::of(&[0.0, 1.0, 1.0, 0.7])]).is_err());
    // Of other laws, the law says it.
    let stanley = config("lane_change", &["law_preset=stanley"]);
    assert!(additional_dead_time_s(&stanley, &stanley.law.defaults(), 1.5).unwrap() > 0.2);
}

#[test]
fn each_joint_of_the_path_is_seen_by_the_region_of_the_curve_behind_it() {
    let config = config("circuit", &[]);
    let car = Car::new(&config);
    let subject = Subject::new(&config, &pair()).unwrap();
    assert_eq!((subject.uncertain(), subject.passed_over()), (None, 0));
    let said = subject.at(4.0);
    let margins: Vec<f64> =
        said.sets.iter().map(|it| 1000.0 * it.additional_dead_time_s.unwrap()).collect();
    assert!((margins[0] - 421.0).abs() < 1.0 && (margins[1] - 244.0).abs() < 1.0, "{margins:?}");
    assert_eq!(said.sets.iter().map(|it| it.fragile).collect::<Vec<_>>(), [false, false]);
    for (set, wanted) in said.sets.iter().zip([0.1797, 0.0747]) {
        let offset_m = set.certified.unwrap().offset_m;
        assert!((offset_m / wanted - 1.0).abs() < 0.005, "{offset_m}");
        assert!(set.simulated.unwrap().offset_m > offset_m);
        assert!(set.stable == Some(true) && set.spectral_radius.unwrap() < 1.0);
    }
    // The table's joints: into R12, R18, R12, a straight, and R7.
    let values: Vec<f64> = said.joints.iter().map(|it| it.value.unwrap()).collect();
    for (value, wanted) in values[2..7].iter().zip([2.8, 6.9, 7.8, 2.2, 14.5]) {
        assert!((value / wanted - 1.0).abs() < 0.05, "{values:?}");
    }
    let outside: Vec<bool> = said.joints.iter().map(|it| it.is_outside()).collect();
    assert_eq!(outside, [false, false, false, true, true, false, false, false]);
    assert_eq!(said.steering_rate_share, Some(1.0));
    // One region for each set and curvature that is met, and each of them holds by itself.
    let mut met: Vec<(f64, String)> = Vec::new();
    for it in &said.regions {
        assert_eq!(check(&car, &it.gains, &it.region), Ok(()));
        met.push((it.region.equilibrium.curvature, it.maneuver.clone()));
    }
    met.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let radius = |it: &(f64, String)| if it.0 == 0.0 { 0.0 } else { (1.0 / it.0).round() };
    let met: Vec<(f64, &str)> = met.iter().map(|it| (radius(it), it.1.as_str())).collect();
    let (lane, round) = ("lane_change", "roundabout");
    assert_eq!(met, [(-12.0, round), (0.0, lane), (0.0, round), (18.0, round), (7.0, lane)]);
}

#[test]
fn the_region_of_a_zone_is_that_of_its_gains_on_the_curve_of_the_reference() {
    let config = config("circuit", &["reference.speed_mps=1.45"]);
    let car = Car::new(&config);
    let found = zone_regions(&config, &pair()).unwrap();
    assert_eq!(found.iter().map(|it| it.zone).collect::<Vec<_>>(), [0, 1, 2]);
    let [lane, roundabout] = pair().map(|it| Gains::new(&it));
    for (zone, gains) in found.iter().zip([lane, roundabout, lane]) {
        // The last zone begins a hair before the arc ends; the reference is on the straight by then.
        let at = Equilibrium::new(&car, &gains, 1.45, 0.0).unwrap();
        let region = Region::find(&car, &gains, &at, Intervals::default()).unwrap();
        assert_eq!((zone.p, zone.at), (region.p, [0.0; 4]), "{}", zone.zone);
    }
    let late = self::config("circuit", &["vehicle.steering_lag_s=0.1"]);
    assert!(zone_regions(&late, &pair()).unwrap_err().contains("dead time or lag"));
}

#[test]
fn why_there_is_no_certificate_is_told() {
    let told = |sets: &[&str]| {
        let config = config("lane_change", sets);
        let set = match config.law.name.as_str() {
            "paper" => pair()[0],
            _ => config.law.defaults(),
        };
        let at = Subject::new(&config, &[set]).unwrap().at(1.5);
        assert!(at.sets[0].certified.is_none() && at.joints.is_empty() && at.regions.is_empty());
        at.sets[0].no_certificate.clone().unwrap()
    };
    for (sets, word) in [
        (&["law_preset=stanley"][..], "the law stanley"),
        (&["vehicle.model=dynamic"], "the tyres"),
        (&["vehicle.steering_delay_s=0.1"], "dead time or lag"),
        (
            &["vehicle.steering_delay_s=0.1", "controller.compensate_dead_time=true"],
            "compensates dead time",
        ),
        (&["vehicle.steering_gain=0.9"], "a gain, an offset or a dead band"),
        (&["vehicle.steering_offset_rad=0.01"], "a gain, an offset or a dead band"),
        (&["vehicle.steering_dead_band_rad=0.01"], "a gain, an offset or a dead band"),
    ] {
        let why = told(sets);
        assert!(why.contains(word), "{sets:?}: {why}");
    }
    // An unstable loop has none either, no region, and no start comes back.
    let config = config("roundabout", &["vehicle.steering_delay_s=0.3"]);
    let subject = Subject::new(&config, &[Parameters::of(&[5.8, 11.0, 11.0, 0.98])]).unwrap();
    let set = &subject.sets_at(3.0)[0];
    assert_eq!((set.stable, set.additional_dead_time_s), (Some(false), Some(0.0)));
    assert!(set.fragile && set.simulated.is_none() && subject.starts_at(3.0)[0].is_empty());
    assert!(set.no_certificate.as_ref().unwrap().contains("unstable"));
}

#[test]
fn starts_are_drawn_where_some_come_back_and_some_do_not() {
    let config = config("roundabout", &[]);
    let subject = Subject::new(&config, &[pair()[1]]).unwrap();
    let known = subject.sets_at(4.0)[0].simulated.unwrap();
    let starts = &subject.starts_at(4.0)[0];
    assert_eq!(starts.len(), 300);
    let inside = |offset_m: f64, heading_rad: f64| {
        offset_m.abs() <= known.offset_m && heading_rad.abs() <= known.heading_rad
    };
    let within: Vec<_> = starts.iter().filter(|it| inside(it.offset_m, it.heading_rad)).collect();
    assert!(within.len() > 40 && within.iter().all(|it| it.converges));
    assert!(starts.iter().any(|it| !it.converges));
    assert!(starts.iter().all(|it| it.offset_m.abs() <= 2.0 * known.offset_m + 1e-9));
}
