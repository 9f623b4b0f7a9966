//! The regions of attraction: their sizes, and how they see a car at the joints of a path.

use certificate::{Car, Equilibrium, Gains, Intervals, Joint, Piece, Region, Simulated, joints};
use config::{Layers, RunConfig};
use tracking::Path;

const LANE: Gains = Gains { kv: 3.0, kl: 21.0, ks: 21.0, ki: 0.7 };
const ROUNDABOUT: Gains = Gains { kv: 3.4, kl: 21.0, ks: 1.0, ki: 0.84 };

fn circuit() -> RunConfig {
    Layers::maneuver("circuit").unwrap().resolve().unwrap()
}

fn find(gains: &Gains, speed_mps: f64, curvature: f64) -> Region {
    let car = Car::new(&circuit());
    let at = Equilibrium::new(&car, gains, speed_mps, curvature).unwrap();
    Region::find(&car, gains, &at, Intervals::default()).unwrap()
}

#[test]
fn the_sizes_of_the_paper_s_sets() {
    for (gains, radius_m, speed_mps, wanted) in [
        (LANE, f64::INFINITY, 1.45, 0.4272),
        (LANE, f64::INFINITY, 4.0, 0.1797),
        (ROUNDABOUT, f64::INFINITY, 1.45, 0.2057),
        (ROUNDABOUT, f64::INFINITY, 4.0, 0.0747),
        (ROUNDABOUT, 18.0, 1.45, 0.1667),
        (ROUNDABOUT, 18.0, 4.0, 0.0712),
        (ROUNDABOUT, 12.0, 1.45, 0.1410),
        (ROUNDABOUT, 12.0, 4.0, 0.0689),
        (LANE, 12.0, 1.45, 0.2557),
        (LANE, 12.0, 4.0, 0.1584),
        (LANE, 7.0, 1.45, 0.1414),
        (LANE, 7.0, 4.0, 0.1108),
    ] {
        let got = find(&gains, speed_mps, 1.0 / radius_m).extent;
        println!("{gains:?} R{radius_m} {speed_mps}: {got:.5} wanted {wanted}");
        assert!((got / wanted - 1.0).abs() < 0.005, "R{radius_m} {speed_mps}: {got}");
    }
}

/// The joints of the circuit, driven with the paper's pair of sets.
fn driven(config: &RunConfig, speed_mps: f64) -> Vec<Joint> {
    let path = Path::new(&config.path);
    let ends: Vec<f64> = path.joints_m().collect();
    let pieces: Vec<Piece> = ends
        .windows(2)
        .map(|ends| Piece {
            length_m: ends[1] - ends[0],
            curvature: path.curvature(0.5 * (ends[0] + ends[1])),
            kink_rad: path.at(ends[0]).yaw_rad - path.at(ends[0] - 1e-6).yaw_rad,
        })
        .collect();
    let [_, from, to] = [0, 1, 2].map(|zone| config.path.zones[zone].from_m);
    joints(&Car::new(config), &pieces, speed_mps, |along_m| {
        if (from..to).contains(&along_m) { ROUNDABOUT } else { LANE }
    })
    .joints
}

#[test]
fn how_the_regions_see_the_joints_of_the_circuit() {
    let config = circuit();
    let car = Car::new(&config);
    for (speed_mps, wanted) in
        [(1.45, [1.10, 1.59, 2.99, 0.21, 8.7]), (4.0, [2.8, 6.9, 7.8, 2.2, 14.5])]
    {
        // The first two are kinks, the last one leads out of the sharp turn.
        let met = driven(&config, speed_mps);
        assert_eq!(met.len(), 8);
        for (joint, wanted) in met[2..7].iter().zip(wanted) {
            let at = Equilibrium::new(&car, &joint.gains, speed_mps, joint.curvatures[1]).unwrap();
            let region = Region::find(&car, &joint.gains, &at, Intervals::default()).unwrap();
            let value = region.value(&joint.deviation(&at));
            println!("{speed_mps} m/s, {:.1} m: V {value:.3}, wanted {wanted}", joint.along_m);
            assert!((value / wanted - 1.0).abs() < 0.05, "{value} {wanted}");
        }
        // A straight's region is no alarm where the car has long settled.
        assert!(met[6].gains == LANE && met[2].gains == ROUNDABOUT);
    }
}

#[test]
fn the_simulated_region_is_larger_than_the_certain_one() {
    let car = Car::new(&circuit());
    for (gains, speed_mps) in [(LANE, 1.45), (ROUNDABOUT, 4.0)] {
        let region = find(&gains, speed_mps, 0.0);
        let simulated = Simulated::new(&car, &gains, &region.equilibrium);
        let level = simulated.clone().within(&region).level(&region, 7);
        let extent = simulated.extent(7).unwrap();
        println!("{speed_mps} m/s: V up to {level:.2}, extent {extent:.2}");
        assert!(level > 1.0 && extent > region.extent);
    }
    // A car whose steering is late comes back from less, and from nowhere once it is unstable.
    let at = Equilibrium::new(&car, &ROUNDABOUT, 3.0, 0.0).unwrap();
    let late = |delay_s: f64| {
        let car = Car { steering_delay_s: delay_s, ..car };
        Simulated::new(&car, &ROUNDABOUT, &at).extent(7)
    };
    let extents = [late(0.0), late(0.2), late(0.4)];
    println!("{extents:?}");
    assert!(extents[0] > extents[1] && extents[1].is_some() && extents[2].is_none());
}
