use super::*;
use config::Layers;
use proptest::prelude::*;

fn path(pieces: &str) -> Path {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    layers.set(&format!("path.pieces={pieces}")).unwrap();
    Path::new(&layers.resolve().unwrap().path)
}

#[test]
fn places_on_many_turns_are_told_apart_by_where_the_vehicle_was() {
    let path = path("[{kind='arc',radius_m=18.0,angle_deg=3600.0}]");
    let turn_m = 36.0 * std::f64::consts::PI;
    assert!((path.length_m() - 10.0 * turn_m).abs() < 1e-9);
    for along_m in [0.0, 1.0, turn_m - 0.5, turn_m, 2.25 * turn_m, 9.9 * turn_m] {
        let at = path.at(along_m);
        for near_m in [along_m - 2.0, along_m + 2.0] {
            let found = path.project(at.x_m, at.y_m, near_m, 3.0);
            assert!((found.along_m - along_m).abs() < 1e-6, "{along_m}: {found:?}");
            assert!(found.offset_m.abs() < 1e-9, "{along_m}: {found:?}");
        }
    }
}

const MIXED: &str = "[{kind='straight',length_m=4.0},{kind='arc',radius_m=18.0,angle_deg=200.0},\
    {kind='diagonal',length_m=6.0,offset_m=3.5},{kind='arc',radius_m=7.0,angle_deg=-90.0}]";

#[test]
fn a_diagonal_keeps_the_heading_behind_it() {
    let path = path(
        "[{kind='straight',length_m=1.0},{kind='diagonal',length_m=5.5,offset_m=-3.5},\
         {kind='straight',length_m=2.0}]",
    );
    let end = path.end();
    assert!((end.x_m - 8.5).abs() < 1e-12 && (end.y_m + 3.5).abs() < 1e-12);
    assert_eq!(end.yaw_rad, 0.0);
    assert!(path.at(2.0).yaw_rad < -0.5);
}

#[test]
fn a_cosine_is_a_cosine() {
    use std::f64::consts::PI;
    for (length_m, offset_m) in [(18.0, -3.5), (2.0, 0.5), (5000.0, 100.0)] {
        let cosine = format!("{{kind='cosine',length_m={length_m:?},offset_m={offset_m:?}}}");
        let path = path(&format!(
            "[{{kind='straight',length_m=8.0}},{cosine},{{kind='straight',length_m=4.0}}]"
        ));
        let end = path.end();
        assert!((end.x_m - 12.0 - length_m).abs() < 1e-9 && (end.y_m - offset_m).abs() < 1e-9);
        assert_eq!(end.yaw_rad, 0.0);
        for step in 0..=1000 {
            let pose = path.at(8.0 + (path.length_m() - 12.0) * f64::from(step) / 1000.0);
            let phase = PI * (pose.x_m - 8.0) / length_m;
            let y_m = 0.5 * offset_m * (1.0 - libm::cos(phase));
            let slope = 0.5 * PI * offset_m / length_m * libm::sin(phase);
            assert!((pose.y_m - y_m).abs() < 1e-4 * length_m, "{length_m}: {pose:?} {y_m}");
            assert!((pose.yaw_rad - libm::atan(slope)).abs() < 1e-3, "{length_m}: {pose:?}");
        }
    }
}

#[test]
fn an_arc_ends_where_geometry_says() {
    let end = path("[{kind='arc',radius_m=7.0,angle_deg=90.0}]").end();
    assert!((end.x_m - 7.0).abs() < 1e-12 && (end.y_m - 7.0).abs() < 1e-12);
}

fn through(points: &[[f64; 2]]) -> Path {
    let mut path = Layers::maneuver("lane_change").unwrap().resolve().unwrap().path;
    (path.pieces, path.points) = (Vec::new(), points.to_vec());
    Path::new(&path)
}

/// The path of a file with these points, as a run drives it.
fn from_file(points: &[[f64; 2]]) -> (config::RunConfig, Path) {
    let rows: Vec<_> = points.iter().map(|[x_m, y_m]| format!("{x_m},{y_m}\n")).collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("p.csv");
    std::fs::write(&file, format!("x_m,y_m\n{}", rows.concat())).unwrap();
    let mut layers = Layers::own_path();
    layers.add_path(&file).unwrap();
    let config = layers.resolve().unwrap();
    let path = Path::new(&config.path);
    (config, path)
}

/// Points of a circle around the origin, counter-clockwise.
fn circle(radius_m: f64, count: usize, turns: f64) -> Vec<[f64; 2]> {
    let point = |index: usize| {
        let angle = std::f64::consts::TAU * turns * index as f64 / count as f64;
        [radius_m * libm::cos(angle), radius_m * libm::sin(angle)]
    };
    (0..=count).map(|index| point(if turns == 1.0 { index % count } else { index })).collect()
}

#[test]
fn a_circle_of_coarse_points_is_a_circle() {
    for (radius_m, count, turns) in
        [(6.0, 8, 1.0), (6.0, 8, 0.8), (12.0, 20, 1.0), (50.0, 24, 2.5), (500.0, 90, 1.0)]
    {
        let (config, path) = from_file(&circle(radius_m, count, turns));
        let start = config.path.start;
        assert!((path.at(0.0).yaw_rad - start.yaw_rad).abs() < 1e-4);
        let steps = 4000;
        for step in 0..steps {
            let along_m = path.length_m() * f64::from(step) / f64::from(steps);
            let pose = path.at(along_m);
            let off_m = libm::hypot(pose.x_m, pose.y_m) - radius_m;
            assert!(off_m.abs() < 1e-2, "R {radius_m}, {count} points: {off_m} m");
            let across = libm::atan2(pose.y_m, pose.x_m) + std::f64::consts::FRAC_PI_2;
            assert!(wrap_angle(pose.yaw_rad - across).abs() < 2e-3);
            let beside = path.project(0.9 * pose.x_m, 0.9 * pose.y_m, along_m, 3.0);
            assert!((beside.offset_m - (0.1 * radius_m)).abs() < 1e-2);
        }
        for segment in path.segments.iter() {
            let apart = segment.curvature * radius_m - 1.0;
            assert!(apart.abs() < 1e-2, "R {radius_m}, {count} points: curvature {apart}");
        }
        // Unwrapped: a lap is a whole turn.
        let turned = path.end().yaw_rad - path.at(0.0).yaw_rad;
        assert!((turned - turns * std::f64::consts::TAU).abs() < 1e-3);
    }
}

#[test]
fn arcs_meet_the_points_also_where_they_are_uneven() {
    let points = [[0.0, 0.0], [1.0, 0.0], [1.5, 0.2], [3.5, 1.5], [3.6, 1.7], [3.6, -4.0]];
    let path = through(&points);
    assert_eq!(path.joints_m().count(), points.len());
    for ([x_m, y_m], along_m) in points.into_iter().zip(path.joints_m()) {
        for pose in [path.at(along_m), path.at(along_m - 1e-9)] {
            assert!(libm::hypot(pose.x_m - x_m, pose.y_m - y_m) < 1e-8);
        }
    }
    let straight = through(&[[1.0, 1.0], [1.0, 3.0]]);
    assert_eq!((straight.length_m(), straight.end().y_m), (2.0, 3.0));
}

#[test]
fn a_projection_visits_the_window_alone() {
    let points: Vec<_> = (0..100_000).map(|index| [0.25 * f64::from(index), 0.0]).collect();
    let path = through(&points);
    let started = std::time::Instant::now();
    for index in 0..20_000 {
        let x_m = 1.2 * f64::from(index);
        let point = path.project(x_m, 0.5, x_m + 1.0, 3.0);
        assert!((point.along_m - x_m).abs() < 1e-6 && point.offset_m == 0.5);
    }
    // Visiting all segments each time would be 2 billion visits.
    assert!(started.elapsed().as_secs() < 5);
}

proptest! {
    #[test]
    fn a_path_passes_through_every_given_point(
        steps in prop::collection::vec((0.4..2.0f64, -0.1..0.1f64), 8..60),
    ) {
        let (mut at, mut heading, mut bend, mut last_m) = ([5.0, 5.0], 0.5, 0.0f64, 0.0);
        let mut points = vec![at];
        for (step_m, change) in steps {
            bend = (bend + 0.3 * change * step_m).clamp(-0.1, 0.1);
            heading += bend * 0.5 * (last_m + step_m);
            last_m = step_m;
            at = [at[0] + step_m * libm::cos(heading), at[1] + step_m * libm::sin(heading)];
            points.push(at);
        }
        // Not from a file: points that turn to and fro like these may be taken for noise, and smoothed.
        let path = through(&points);
        let mut near_m = 0.0;
        for [x_m, y_m] in points {
            let point = path.project(x_m, y_m, near_m, 3.0);
            prop_assert!(point.offset_m.abs() < 1e-2, "{}", point.offset_m);
            let (dx, dy) = (x_m - point.pose.x_m, y_m - point.pose.y_m);
            prop_assert!(libm::hypot(dx, dy) < 1e-2);
            near_m = point.along_m;
        }
    }

    #[test]
    fn a_follower_finds_the_nearest_point_that_a_projection_finds(
        steps in prop::collection::vec((0.0..0.4f64, -1.0..1.0f64), 1..200),
    ) {
        for path in [path(MIXED), path("[{kind='straight',length_m=4.0},{kind='arc',radius_m=18.0,angle_deg=-350.0}]")] {
            let (mut follower, mut along_m) = (PathFollower::default(), 0.0);
            for (step_m, offset_m) in &steps {
                along_m = f64::min(along_m + step_m, path.length_m());
                let pose = path.at(along_m);
                let x_m = pose.x_m - offset_m * libm::sin(pose.yaw_rad);
                let y_m = pose.y_m + offset_m * libm::cos(pose.yaw_rad);
                let found = path.project(x_m, y_m, along_m, 3.0);
                let wanted_m = libm::hypot(x_m - found.pose.x_m, y_m - found.pose.y_m);
                let apart_m = follower.distance_m(&path, x_m, y_m);
                prop_assert!((apart_m - wanted_m).abs() < 1e-7, "{apart_m} {wanted_m} at {along_m}");
                let here = path.at(follower.along_m(&path, x_m, y_m));
                let there_m = libm::hypot(x_m - here.x_m, y_m - here.y_m);
                prop_assert!((there_m - apart_m).abs() < 1e-7);
            }
        }
    }

    #[test]
    fn what_a_projection_does_not_look_at_closely_is_farther_away(
        along in 0.0..100.0f64, x_m in -30.0..60.0f64, y_m in -40.0..40.0f64, window_m in 0.1..60.0f64,
    ) {
        // Many places on many turns: as far from a circle's middle as anywhere.
        let round = through(&circle(10.0, 63, 1.6));
        for path in [path(MIXED), path("[{kind='cosine',length_m=60.0,offset_m=9.0}]"), round] {
            let found = path.project(x_m, y_m, along, window_m);
            let (low, high) = (along - window_m, along + window_m);
            let mut wanted: Option<(f64, f64)> = None;
            for segment in &*path.segments {
                let (from, to) = (segment.from_m, segment.from_m + segment.length_m);
                if to < low || from > high {
                    continue;
                }
                let along_m = (from + segment.nearest(x_m, y_m)).clamp(low.max(from), high.min(to));
                let pose = segment.at(along_m - from);
                let apart = (x_m - pose.x_m).powi(2) + (y_m - pose.y_m).powi(2);
                if wanted.is_none_or(|(least, _)| apart < least) {
                    wanted = Some((apart, along_m));
                }
            }
            let beyond_its_end = (0.0, path.length_m());
            prop_assert_eq!(found.along_m, wanted.unwrap_or(beyond_its_end).1);
        }
    }

    #[test]
    fn the_path_has_no_gaps(along in 0.0..80.0f64) {
        let path = path(MIXED);
        let (a, b) = (path.at(along), path.at(along + 1e-6));
        prop_assert!(libm::hypot(a.x_m - b.x_m, a.y_m - b.y_m) < 2e-6);
    }

    #[test]
    fn a_point_beside_the_path_projects_to_where_it_came_from(
        along in 0.5..80.0f64, offset in -1.0..1.0f64, off in -2.0..2.0f64,
    ) {
        let path = path(MIXED);
        let pose = path.at(along);
        let x = pose.x_m - offset * libm::sin(pose.yaw_rad);
        let y = pose.y_m + offset * libm::cos(pose.yaw_rad);
        let point = path.project(x, y, along + off, 3.0);
        // At a kink another point may lie nearer, never farther.
        let apart = libm::hypot(x - point.pose.x_m, y - point.pose.y_m);
        prop_assert!(apart <= offset.abs() + 1e-9);
        prop_assert!((point.along_m - (along + off)).abs() <= 3.0 + 1e-9);
    }
}
