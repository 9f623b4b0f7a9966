//! Paths as people have them: each case is one that a real file led to.

mod support;

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::fs;

use support::Sandbox;

const GAINS: [&str; 2] = ["--gains", "3,21,21,0.7"];

/// A straight, a quarter turn to the left and a straight again, with a point every `step_m`.
fn bend(straight_m: f64, radius_m: f64, step_m: f64) -> Vec<[f64; 2]> {
    let arc_m = radius_m * FRAC_PI_2;
    (0..)
        .map(|index| step_m * f64::from(index))
        .take_while(|along_m| *along_m <= 2.0 * straight_m + arc_m)
        .map(|along_m| {
            let in_turn_m = (along_m - straight_m).clamp(0.0, arc_m);
            let beyond_m = (along_m - straight_m - arc_m).max(0.0);
            let angle = in_turn_m / radius_m;
            let x_m = along_m.min(straight_m) + radius_m * angle.sin();
            [x_m, radius_m * (1.0 - angle.cos()) + beyond_m]
        })
        .collect()
}

/// A file with this header, and a row for each point.
fn table(header: &str, points: &[[f64; 2]], row: impl Fn(usize, [f64; 2]) -> String) -> String {
    let rows = points.iter().enumerate().map(|(index, point)| row(index, *point) + "\n");
    std::iter::once(format!("{header}\n")).chain(rows).collect()
}

/// Drives a file; the columns of the recorded drive, and what was told.
struct Driven {
    rows: Vec<BTreeMap<String, f64>>,
    told: String,
}

impl Driven {
    fn column(&self, name: &str) -> impl Iterator<Item = f64> + Clone {
        self.rows.iter().map(move |row| row[name]).collect::<Vec<_>>().into_iter()
    }

    fn last(&self, name: &str) -> f64 {
        self.rows[self.rows.len() - 1][name]
    }

    /// The greatest distance of the true place from a line.
    fn off_m(&self, line: &[[f64; 2]]) -> f64 {
        let from_piece_m = |x_m: f64, y_m: f64, from: [f64; 2], to: [f64; 2]| {
            let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
            let share = ((x_m - from[0]) * dx + (y_m - from[1]) * dy) / (dx * dx + dy * dy);
            let share = share.clamp(0.0, 1.0);
            (x_m - from[0] - share * dx).hypot(y_m - from[1] - share * dy)
        };
        let places = self.column("x_m").zip(self.column("y_m")).step_by(10);
        places
            .map(|(x_m, y_m)| {
                line.windows(2)
                    .map(|pair| from_piece_m(x_m, y_m, pair[0], pair[1]))
                    .fold(f64::INFINITY, f64::min)
            })
            .fold(0.0, f64::max)
    }
}

fn drive(sandbox: &Sandbox, text: &str, args: &[&str]) -> Driven {
    fs::write(sandbox.path("p.csv"), text).unwrap();
    let all = [&["drive", "-q", "--path", "p.csv", "--out", "out"], &GAINS[..], args].concat();
    let output = sandbox.run(&all);
    assert!(output.status.success(), "{args:?}: {}", sandbox.story("out", &output));
    let rows = rows_of(sandbox);
    fs::remove_dir_all(sandbox.path("out")).unwrap();
    Driven { rows, told: String::from_utf8_lossy(&output.stderr).into_owned() }
}

/// The rows of the drive in `out`.
fn rows_of(sandbox: &Sandbox) -> Vec<BTreeMap<String, f64>> {
    let mut reader = csv::Reader::from_path(sandbox.path("out/drives/drive.csv")).unwrap();
    let rows = reader.deserialize().map(|row| {
        let row: BTreeMap<String, String> = row.unwrap();
        row.into_iter().filter_map(|(key, value)| Some((key, value.parse().ok()?))).collect()
    });
    rows.collect()
}

/// What is said of a file that is refused.
fn refused(sandbox: &Sandbox, text: &str, args: &[&str]) -> String {
    fs::write(sandbox.path("p.csv"), text).unwrap();
    let all = [&["drive", "-q", "--path", "p.csv", "--out", "out"], &GAINS[..], args].concat();
    let output = sandbox.run(&all);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(64), "{args:?}: {told}");
    assert_eq!(told.trim_end().lines().count(), 1, "{told}");
    told
}

#[track_caller]
fn has(told: &str, parts: &[&str]) {
    for part in parts {
        assert!(told.contains(part), "{told:?} lacks {part:?}");
    }
}

#[test]
fn header_of_other_tools() {
    let sandbox = Sandbox::new();
    let line = bend(26.0, 8.0, 0.5);
    let autoware = table("x,y,z,yaw,velocity,change_flag", &line, |_, [x, y]| {
        format!("{x:.4},{y:.4},0,0,3.0,0")
    });
    let told = refused(&sandbox, &autoware, &[]);
    has(&told, &["p.csv:1", "velocity", "unit", "--columns x=1,y=2,v_mps=5", "v_kmh=5"]);
    let driven = drive(&sandbox, &autoware, &["--columns", "x=1,y=2,v=5"]);
    assert!(driven.off_m(&line) < 1.0 && driven.column("speed_mps").fold(0.0, f64::max) > 2.5);
    let savetxt = table("# x_m y_m", &line, |_, [x, y]| format!("{x:.18e} {y:.18e}"));
    let driven = drive(&sandbox, &savetxt, &[]);
    assert!(driven.off_m(&line) < 1.0 && driven.told.is_empty(), "{}", driven.told);
    sandbox.assert_clean();
}

#[test]
fn projection_ignores_v_mps() {
    let sandbox = Sandbox::new();
    let line = bend(26.0, 8.0, 0.5);
    let text = table("x_m,y_m,v_mps", &line, |_, [x, y]| format!("{x:.6},{y:.6},2.0"));
    let driven = drive(&sandbox, &text, &["--set", "reference.advance=projection"]);
    // The car's own speed loop overshoots on the way from rest, as it does with any other speed; then it keeps it.
    let settled = driven.column("speed_mps").skip(driven.rows.len() / 2).fold(0.0, f64::max);
    let fastest_mps = driven.column("speed_mps").fold(0.0, f64::max);
    assert!((1.5..2.2).contains(&settled) && fastest_mps < 2.6, "{settled} {fastest_mps}");
    assert!(driven.off_m(&line) < 1.0);
    sandbox.assert_clean();
}

#[test]
fn recorded_standing_at_the_start() {
    let sandbox = Sandbox::new();
    let stood = |x: f64| std::iter::repeat_n([x, 0.0], 30);
    let moved = (0..=20).map(|index| [0.5 * f64::from(index), 0.0]);
    // Midway, too.
    let points: Vec<[f64; 2]> = stood(0.0)
        .chain(moved.clone().take(11))
        .chain(stood(5.0))
        .chain(moved.skip(11))
        .chain(stood(10.0))
        .collect();
    let driven = drive(&sandbox, &table("x_m,y_m", &points, |_, [x, y]| format!("{x},{y}")), &[]);
    has(&driven.told, &["90 points repeat the point before"]);
    assert!((driven.last("x_m") - 10.0).abs() < 0.5);
    sandbox.assert_clean();
}

#[test]
fn recorded_with_rtk_noise() {
    let sandbox = Sandbox::new();
    let line = bend(26.0, 8.0, 0.1);
    let noisy = |sd_m: f64| {
        let mut seed = 11_u64;
        let mut next = || {
            let mut sum = -6.0;
            for _ in 0..12 {
                seed = seed
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                sum += (seed >> 11) as f64 / (1_u64 << 53) as f64;
            }
            sd_m * sum
        };
        let points: Vec<[f64; 2]> = line.iter().map(|[x, y]| [x + next(), y + next()]).collect();
        table("x_m,y_m", &points, |_, [x, y]| format!("{x:.6},{y:.6}"))
    };
    let clean = table("x_m,y_m", &line, |_, [x, y]| format!("{x:.6},{y:.6}"));
    let usual_m = drive(&sandbox, &clean, &[]).off_m(&line);
    for (sd_m, args) in
        [(0.008, &[][..]), (0.05, &["--smooth", "0.2"]), (0.2, &["--smooth", "0.2"])]
    {
        let driven = drive(&sandbox, &noisy(sd_m), args);
        has(&driven.told, &["smoothed", "m from the points at the mean", "m at most"]);
        let off_m = driven.off_m(&line);
        assert!(off_m < usual_m + 0.05 + sd_m, "{sd_m}: {off_m} against {usual_m}");
    }
    // More than localisation can mean is not smoothed unasked.
    has(&refused(&sandbox, &noisy(0.2), &[]), &["p.csv:", "radius", "noise", "--smooth"]);
    has(
        &refused(&sandbox, &noisy(0.2), &["--smooth", "0.05"]),
        &["p.csv", "--smooth allows 0.05", "--smooth 0.2"],
    );
    sandbox.assert_clean();
}

#[test]
fn speed_too_fast_for_the_bend() {
    let sandbox = Sandbox::new();
    let line = bend(20.0, 6.0, 0.5);
    let guarded = ["--vehicle", "tesla_model_3_guarded"];
    let fast = table("x_m,y_m,v_mps", &line, |_, [x, y]| format!("{x:.6},{y:.6},8.5"));
    let told = refused(&sandbox, &fast, &guarded);
    has(&told, &["p.csv:4", "8.50 m/s", "radius", "limit is 3.0", "--speed-profile"]);
    let driven = drive(&sandbox, &fast, &[&guarded[..], &["--speed-profile"]].concat());
    has(&driven.told, &["speed profile: ", "lowered on", "2.7 m/s² sideways"]);
    assert!(driven.off_m(&line) < 1.0, "{}", driven.off_m(&line));
    let lateral = driven.column("speed_mps").zip(driven.column("yaw_rate_radps"));
    let most_mps2 = lateral.map(|(speed, rate)| (speed * rate).abs()).fold(0.0, f64::max);
    assert!(most_mps2 < 3.3, "{most_mps2}");
    // The same for the one speed of all points.
    let plain = table("x_m,y_m", &line, |_, [x, y]| format!("{x:.6},{y:.6}"));
    let set = [&guarded[..], &["--set", "reference.speed_mps=8.5"]].concat();
    has(&refused(&sandbox, &plain, &set), &["p.csv:4", "reference.speed_mps", "--speed-profile"]);
    sandbox.assert_clean();
}

#[test]
fn speed_zero_at_both_ends() {
    let sandbox = Sandbox::new();
    let line = bend(26.0, 8.0, 0.5);
    let last = line.len() - 1;
    let text = table("x_m,y_m,v_mps", &line, |index, [x, y]| {
        let near = index.min(last - index) as f64;
        format!("{x:.6},{y:.6},{:.3}", if near == 0.0 { 0.0 } else { (0.3 + 0.1 * near).min(2.0) })
    });
    let driven = drive(&sandbox, &text, &[]);
    has(&driven.told, &["the speed is 0 at its start", "at its end, where the drive is over"]);
    let [x_m, y_m] = line[last];
    let gap_m = (driven.last("x_m") - x_m).hypot(driven.last("y_m") - y_m);
    assert!(gap_m < 0.3 && driven.last("speed_mps") < 0.4, "{gap_m} {}", driven.last("speed_mps"));
    assert!(driven.column("speed_mps").fold(0.0, f64::max) > 1.8);
    sandbox.assert_clean();
}

#[test]
fn track_longer_than_an_hour() {
    let sandbox = Sandbox::new();
    let points: Vec<[f64; 2]> = (0..1150)
        .map(|index| {
            let angle = std::f64::consts::TAU * f64::from(index) / 1150.0;
            [900.0 * angle.cos(), 900.0 * angle.sin()]
        })
        .collect();
    let text = table("x_m,y_m", &points, |_, [x, y]| format!("{x:.3},{y:.3}"));
    let told = refused(&sandbox, &text, &[]);
    has(
        &told,
        &["p.csv", "takes 37", "reference.speed_mps = 1.5", "v_mps", "--set reference.speed_mps"],
    );
    assert!(!told.contains("loop_time_s"), "{told}");
    sandbox.assert_clean();
}

#[test]
fn utm_coordinates() {
    let sandbox = Sandbox::new();
    let line = bend(26.0, 8.0, 0.5);
    let text = table("x_m,y_m", &line, |_, [x, y]| {
        format!("{:.6},{:.6}", x + 482_301.25, y + 4_419_876.5)
    });
    let driven = drive(&sandbox, &text, &[]);
    has(&driven.told, &["from the first point on, 482301.25, 4419876.5", "--crs web-mercator"]);
    assert!(driven.off_m(&line) < 1.0);
    sandbox.assert_clean();
}

#[test]
fn waypoints_without_header() {
    let sandbox = Sandbox::new();
    let line = bend(5.0, 1.5, 0.2);
    let car = ["--vehicle", "f1tenth"];
    let text: String = line.iter().map(|[x, y]| format!("{x:.6},{y:.6},1.0\n")).collect();
    let driven = drive(&sandbox, &text, &car);
    has(&driven.told, &["columns 1, 2 taken as x_m, y_m", "column 3 is not read"]);
    let driven = drive(&sandbox, &text, &[&car[..], &["--columns", "x=1,y=2,v=3"]].concat());
    let fastest_mps = driven.column("speed_mps").fold(0.0, f64::max);
    assert!((0.9..1.3).contains(&fastest_mps) && driven.off_m(&line) < 0.3, "{fastest_mps}");
    sandbox.assert_clean();
}

#[test]
fn the_road_s_edges_are_kept() {
    let sandbox = Sandbox::new();
    let line = bend(26.0, 8.0, 0.5);
    let text = table("# x_m,y_m,w_tr_right_m,w_tr_left_m", &line, |_, [x, y]| {
        format!("{x:.6},{y:.6},2.5,1.5")
    });
    fs::write(sandbox.path("p.csv"), text).unwrap();
    let output =
        sandbox.run(&[&["drive", "-q", "--path", "p.csv", "--out", "out"], &GAINS[..]].concat());
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    has(&told, &["edges are 1.50 to 2.50 m away"]);
    has(&sandbox.text("out/config.toml"), &["widths_m = [[1.5, 2.5]"]);
    sandbox.assert_clean();
}

/// A road of 10 cm and less is narrower than the car drives exactly.
#[test]
fn the_body_may_not_pass_the_road_s_edges() {
    let sandbox = Sandbox::new();
    let line = bend(26.0, 8.0, 0.5);
    let text = table("# x_m,y_m,w_tr_right_m,w_tr_left_m", &line, |_, [x, y]| {
        format!("{x:.6},{y:.6},0.05,0.05")
    });
    fs::write(sandbox.path("p.csv"), text).unwrap();
    let output =
        sandbox.run(&[&["drive", "-q", "--path", "p.csv", "--out", "out"], &GAINS[..]].concat());
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    has(&String::from_utf8_lossy(&output.stdout), &["stopped the vehicle", "an edge of the road"]);
    has(&sandbox.text("out/result.json"), &["\"road_edge\""]);
    sandbox.assert_clean();
}

/// The car is braked so early that no part of it leaves the area.
#[test]
fn the_vehicle_stays_in_its_area() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("p.csv"), "x_m,y_m,v_mps\n0,0,4\n100,0,4\n").unwrap();
    let drive = |area: &str, out: &str| {
        let area = format!("drive.area_m={area}");
        let args = ["drive", "-q", "--path", "p.csv", "--out", out, "--set", &area];
        sandbox.run(&[&args[..], &GAINS[..]].concat())
    };
    let output = drive("[-5.0, 40.0, -5.0, 5.0]", "out");
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    has(&String::from_utf8_lossy(&output.stdout), &["it would leave the area"]);
    let config = config::Layers::maneuver("lane_change").unwrap().resolve().unwrap();
    let ahead_m = config.vehicle.body_front_m - config.vehicle.tracked_point_m;
    let farthest_m =
        rows_of(&sandbox).iter().fold(0.0, |most: f64, row| most.max(row["x_m"] + ahead_m));
    assert!((35.0..40.0).contains(&farthest_m), "{farthest_m}");
    for (area, why) in [
        ("[5.0, 40.0, -5.0, 5.0]", "does not hold the start"),
        ("[-5.0, -6.0, -5.0, 5.0]", "the least below the largest"),
        ("[-5.0, nan, -5.0, 5.0]", "the least below the largest"),
    ] {
        let output = drive(area, "no");
        assert_eq!(output.status.code(), Some(64), "{output:?}");
        has(&String::from_utf8_lossy(&output.stderr), &["drive.area_m", why]);
    }
    sandbox.assert_clean();
}

#[test]
fn what_is_no_path_is_named() {
    let sandbox = Sandbox::new();
    for (text, what) in
        [("\u{89}", "no columns"), ("{\"x\": [1]}", "looks like JSON"), ("<kml>", "looks like KML")]
    {
        has(&refused(&sandbox, text, &[]), &["p.csv:1", what]);
    }
    let told = refused(&sandbox, "0,0\n9,0\n", &["--path-topic", "/plan"]);
    has(&told, &["--path-topic with --path p.csv", "only a bag"]);
    fs::write(sandbox.path("bag.mcap"), b"\x89MCAP0\r\n").unwrap();
    let args = ["drive", "--path", "bag.mcap", "--columns", "x=1,y=2"];
    let output = sandbox.run(&[&args[..], &GAINS].concat());
    assert_eq!(output.status.code(), Some(64));
    has(
        &String::from_utf8_lossy(&output.stderr),
        &["--columns with --path bag.mcap", "no columns"],
    );
    sandbox.assert_clean();
}

#[test]
fn what_a_vehicle_s_file_leaves_out_is_told_once_and_is_no_progress() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("mine.toml"), "name = \"mine\"\nwheelbase_m = 2.0\n").unwrap();
    let driven = drive(&sandbox, "0,0\n30,0\n", &["--vehicle", "mine.toml"]);
    assert_eq!(driven.told.matches("the values of another car").count(), 1, "{}", driven.told);
    sandbox.assert_clean();
}
