//! Tables and their mistakes.

use super::*;
use proptest::prelude::*;

fn read(text: &str) -> Result<PathFile, ConfigError> {
    parse("p.csv", text.as_bytes(), &PathOptions::default())
}

fn message(text: &str) -> String {
    read(text).unwrap_err().to_string()
}

#[test]
fn every_mistake_names_its_line_and_the_way_out() {
    let check = |text: &str, parts: &[&str]| {
        let message = message(text);
        for part in parts {
            assert!(message.contains(part), "{text:?}: {message:?} lacks {part:?}");
        }
        assert!(!message.contains('\n') && message.len() < 330, "{message:?}");
    };
    check("", &["p.csv:1:", "empty", "x_m,y_m"]);
    check("\u{feff} \r\n\n", &["p.csv:1:", "empty"]);
    check("# hello\n", &["only comments", "x_m,y_m"]);
    check("x_m,y_m\n", &["p.csv:1:", "no points"]);
    check("# x_m;y_m\n\n# end\n", &["p.csv:1:", "no points"]);
    check("a,b\n1,2", &["p.csv:1:", "no columns x_m and y_m", "\"a, b\"", "--columns"]);
    check("1\n2\n3", &["p.csv:1:", "one column"]);
    check("x_m,y_m,v_mps\n0,0,1\n1,0,\n", &["p.csv:3:", "v_mps is empty"]);
    check("x,y,speed\n0,0,2\n1,0,2\n", &["p.csv:1:", "speed without a unit", "v_mps=3", "v_kmh=3"]);
    check("x,y,v\nm,m,km/h\n0,0,1\n", &["p.csv:2:", "units", "into those", "leave this line out"]);
    check("x\ty\n[m]\t[m]\n0\t0\n", &["p.csv:2:", "units"]);
    check("x_yd,y_yd\n0,0\n1,0\n", &["p.csv:1:", "in yd", "--columns"]);
    check("lat,lon,speed\n48,11,2\n48,11.01,2\n", &["p.csv:1:", "lat=1,lon=2,v_mps=3"]);
    check("x,pos_x,ref_x,y\n", &["p.csv:1:", "no points"]);
    check("pos_x,ref_x,y\n0,0,0\n1,1,0\n", &["p.csv:1:", "pos_x, ref_x", "--columns"]);
    check("x_m,z_m\n1,2", &["no column y_m", "\"x_m, z_m\""]);
    check("s;y_m\n1;2", &["no column x_m", "\"s, y_m\""]);
    check("x_m,y_m,x_m\n1,2,3", &["p.csv:1:", "x_m twice"]);
    check("x_m  y_m v_mps\n1 2", &["p.csv:2:", "2 fields", "spaces"]);
    check("x_m,y_m\n1,2\n3,4,5\n", &["p.csv:3:", "3 fields", "names 2", "x_m, y_m"]);
    check("x_m;y_m\n1;2\n3,4\n", &["p.csv:3:", "1 fields", "';'"]);
    check("x_m,y_m\n1,2\n\n# c\n3,left\n", &["p.csv:5:", "y_m is \"left\"", "not a number"]);
    check("x_m;y_m\n1.5;2\n2,5;4\n", &["p.csv:3:", "x_m is \"2,5\"", "point"]);
    check("x_m,y_m\n1,\n", &["p.csv:2:", "y_m is empty"]);
    check("x_m,y_m\n1,nan\n", &["p.csv:2:", "y_m is \"nan\"", "number"]);
    check("x_m,y_m\n-inf,1\n", &["p.csv:2:", "x_m is \"-inf\""]);
    check("x_m,y_m\n1,2e9\n", &["p.csv:2:", "y_m is \"2e9\"", "1000000000"]);
    check("x_m,y_m,v_mps\n1,2,nan\n", &["p.csv:2:", "v_mps is \"nan\""]);
    check("x_m,y_m,v_mps\n1,2,inf\n", &["p.csv:2:", "v_mps is \"inf\""]);
    check("x_m,y_m,v_mps\n1,2,60\n", &["p.csv:2:", "v_mps is \"60\"", "[0, 50]", "v_kmh=3"]);
    check("# x_m;y_m;vx_mps\n1;2;-3\n", &["p.csv:2:", "vx_mps is \"-3\"", "[0, 50]", "forwards"]);
    check("x_m,y_m\n1,2\n", &["p.csv:2:", "only point"]);
    check("x_m,y_m\n1,2\n1.0,2\n", &["p.csv:3:", "0.00 m", "1 m to"]);
    check(
        "x_m,y_m\n0,0\n1,0\n2,0\n22,0\n23,0\n",
        &["p.csv:5:", "20.00 m", "line 4", "usual step is 1.00 m"],
    );
    // A point that does not belong to the path, midway and at both ends.
    let away = ["leave it out", "40.01 m", "usual step is 1.00 m"];
    let all = |line| [&[line], &away[..]].concat();
    check("x_m,y_m\n0,0\n1,0\n2,40\n3,0\n4,0\n", &all("p.csv:4:"));
    check("x_m,y_m\n0,40\n1,0\n2,0\n3,0\n4,0\n", &all("p.csv:2:"));
    check("x_m,y_m\n0,0\n1,0\n2,0\n3,0\n4,40\n", &all("p.csv:6:"));
    // Before the first fix.
    check(
        "lat,lon\n0,0\n0,0\n48.1,11.5\n48.1001,11.5\n48.1002,11.5\n48.1003,11.5\n",
        &["p.csv:2:", "leave it out"],
    );
    check("1,2,0\n2,2.5,0\n3,3,0\n4,3.5,0\n", &["rises evenly", "x=2,y=3"]);
    check("x_m,y_m\n0,0\n0.1,0\n0.9,0\n", &["p.csv:4:", "0.90 m", "1 m to 100 km"]);
    check("x_m,y_m\n0,0\n90000,0\n90000,90000\n", &["p.csv:4:", "180000.00 m"]);
    check(&format!("{}\n1", "é".repeat(500)), &["no columns", "…"]);
    check("\u{89}PNG", &["no columns"]);
    check("{\"a\": 1}", &["p.csv:1:", "looks like JSON"]);
    check("x_m,y_m\n48.1,11.5\n48.1001,11.5\n48.1002,11.5001\n", &["degrees", "--crs wgs84"]);
    check(
        "x,y\n1289000,6131000\n1289001,6131000\n",
        &["p.csv:2:", "web-Mercator", "--crs web-mercator"],
    );
    let latin =
        parse("p.csv", b"x_m,y_m\n1,2\n\xe9", &PathOptions::default()).unwrap_err().to_string();
    assert!(latin.contains("p.csv:3:") && latin.contains("UTF-8"), "{latin}");
}

#[test]
fn a_lap_that_goes_on_beyond_its_start_is_told_with_the_line_at_which_it_is_whole() {
    let point = |it: i32| {
        let angle = std::f64::consts::TAU * f64::from(it) / 60.0;
        format!("{:.4},{:.4}\n", 10.0 * libm::sin(angle), 10.0 - 10.0 * libm::cos(angle))
    };
    let text = |last| format!("x_m,y_m\n{}", (0..=last).map(point).collect::<String>());
    let notes = read(&text(65)).unwrap().notes.join("; ");
    assert!(notes.contains("again at line 62, and goes on"), "{notes}");
    for last in [60, 40] {
        assert!(!read(&text(last)).unwrap().notes.join("; ").contains("goes on"), "{last}");
    }
}

#[test]
fn a_lap_with_its_ends_almost_together_is_closed_at_one_point() {
    let lap = |end: &str| read(&format!("x_m,y_m\n0,0\n5,-1\n8,3\n4,8\n-2,6\n-4,2\n{end}\n"));
    for end in ["0.02,0.01", "-0.02,0.01", "0.002,0"] {
        let file = lap(end).unwrap();
        assert_eq!((file.points.len(), file.points[0]), (7, file.points[6]), "{end}");
        let told = file.notes.join("; ");
        assert!(told.contains("mm from its start: closed there"), "{told}");
    }
    assert_eq!(lap("-0.5,0.1").unwrap().points.len(), 8);
    // There and back is no lap.
    let back = read("x_m,y_m\n0,0\n5,0\n9,1\n9,2\n5,1\n0.02,0\n").unwrap();
    assert_ne!(back.points[0], back.points[5]);
}

#[test]
fn both_forms_are_read_with_their_columns_by_name() {
    let check = |text: &str, points: &[[f64; 2]], speeds: &[f64], lines: &[usize]| {
        let file = read(text).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((&*file.points, &*file.speeds_mps, &*file.lines), (points, speeds, lines));
    };
    let two = [[1.0, 2.0], [3.0, -4.5]];
    check("x_m,y_m\n1,2\n3,-4.5\n", &two, &[], &[2, 3]);
    check("\u{feff}x_m, y_m\r\n\r\n1, 2\r\n# c\r\n3, -4.5", &two, &[], &[3, 5]);
    check("# made by hand\ny_m,name,x_m\n2,a,1\n  # c\n-4.5,,3\n", &two, &[], &[3, 5]);
    check("\"x_m\",\"y_m\"\n\"1\",\"2\"\n\"3\",\"-4.5\"\n", &two, &[], &[2, 3]);
    check("v_mps,x_m,y_m\n1.5,1,2\n2,3,-45e-1\n", &two, &[1.5, 2.0], &[2, 3]);
    check("x_m;y_m;vx_mps\n1;2;1.5\n3;-4.5;2\n", &two, &[1.5, 2.0], &[2, 3]);
    check(
        "# 0d1f-uuid\n# 2ab\n# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2\n\
         0.0; 1.0; 2.0; 1.57; 0.0; 8.0; nan\n6.8; 3.0; -4.5; 1.5; 0.0; 7.5; 0.1\n",
        &two,
        &[8.0, 7.5],
        &[4, 5],
    );
    check("# x_m,y_m,w_tr_right_m\n1,2,1.1\n3,-4.5,1.1\n", &two, &[], &[2, 3]);
    check("# x_m; y_m\nx_m,y_m\n1,2\n3,-4.5\n", &two, &[], &[3, 4]);
    let closed = read("x_m,y_m\n1,0\n5,0\n5,5\n1,1e-9\n").unwrap();
    assert_eq!(closed.points[0], closed.points[3]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]
    #[test]
    fn no_text_makes_the_parser_panic_or_wordy(
        any in ".{0,200}",
        bytes in prop::collection::vec(any::<u8>(), 0..60),
        like in "(# ?)?(x_m|y_m|v_mps|s)([,;\t |](x_m|y_m|v_mps)){0,3}\r?\n([-0-9.einfa,;#\" \r\u{85}]{0,12}\n){0,6}",
    ) {
        let columns = [None, Some("x=x_m,y=y_m"), Some("x=2,y=1,v=3")];
        let files = [any.as_bytes(), &bytes, like.as_bytes()];
        for (bytes, columns) in files.into_iter().flat_map(|it| columns.map(|columns| (it, columns))) {
            let columns = columns.map(|it| it.parse().unwrap());
            match parse("p.csv", bytes, &PathOptions { columns, ..PathOptions::default() }) {
                Ok(file) => {
                    prop_assert!(file.points.len() >= 2);
                    prop_assert_eq!(file.points.len(), file.lines.len());
                }
                Err(error) => {
                    let message = error.to_string();
                    prop_assert!(message.starts_with("p.csv:"), "{message}");
                    prop_assert_eq!(message.lines().count(), 1);
                }
            }
        }
    }
}

/// What is read of a file, with options as of the command line.
fn read_as(text: &str, columns: Option<&str>, crs: Option<&str>) -> Result<PathFile, ConfigError> {
    let options = PathOptions {
        columns: columns.map(|it| it.parse().unwrap()),
        crs: crs.map(|it| it.parse().unwrap()),
        ..PathOptions::default()
    };
    parse("p.csv", text.as_bytes(), &options)
}

#[test]
fn tables_of_many_tools_are_read_and_told() {
    let two = [[1.0, 2.0], [3.0, -4.5]];
    let check = |text: &str, speeds: &[f64], told: &str| {
        let file = read(text).unwrap_or_else(|error| panic!("{text:?}: {error}"));
        assert_eq!((&file.points[..], &file.speeds_mps[..]), (&two[..], speeds), "{text:?}");
        let notes = file.notes.join("; ");
        assert!(notes.contains(told), "{text:?}: {notes:?} lacks {told:?}");
    };
    check("1,2\n3,-4.5\n", &[], "columns 1, 2 taken as x_m, y_m");
    check("1 2\n3 -4.5\n", &[], "columns 1, 2 taken as x_m, y_m");
    check("1\t2\n3\t-4.5\n", &[], "columns 1, 2");
    check("  1   2  \r\n\r\n  3   -4.5\r\n", &[], "columns 1, 2");
    check("1;2\n3;-4.5\n", &[], "columns 1, 2");
    check("1;2\n3;-4,5\n", &[], "decimals are taken to stand after a comma");
    check("1,0 2,0\n3,0 -4,5\n", &[], "after a comma");
    check("\"1,0\",\"2,0\"\n\"3,0\",\"-4,5\"\n", &[], "after a comma");
    check("name,x,y\n\"Oak St., 5\",1,2\n\"5\" pipe\",3,-4.5\n", &[], "x");
    check("(1, 2)\n(3, -4.5)\n", &[], "columns 1, 2");
    check("1.0,2.0;\n3.0,-4.5;\n", &[], "columns 1, 2");
    check("[1.0 2.0;\n3.0 -4.5];\n", &[], "columns 1, 2");
    check("1;2;\n3;-4,5;\n", &[], "after a comma");
    check("Lap #,x,y # of Monday\n1,1,2 # start\n1,3,-4.5\n", &[], "x_m from x");
    check(
        "1,2,0.5\n3,-4.5,0.5\n",
        &[],
        "column 3 is not read (a speed in m/s: --columns x=1,y=2,v=3)",
    );
    check(
        "1,2,1.1,1.2\n3,-4.5,1.1,1.2\n",
        &[],
        "columns 3…4 are not read (a speed in m/s: --columns x=1,y=2,v=…)",
    );
    check("1,2,0,0,0,0.6,0.8\n3,-4.5,0,0,0,0,1\n", &[], "quaternion in columns 4…7");
    check(
        "1700000000.1 1 2 0 0 0 0.6 0.8\n1700000000.2 3 -4.5 0 0 0 0 1\n",
        &[],
        "columns 2, 3 taken as x_m, y_m, after a time",
    );
    check("# x_m y_m\n1.0e0 2.0e0\n3.0e0 -4.5e0\n", &[], "");
    check("// drawn by hand\nx,y\n1,2\n3,-4.5\n", &[], "x_m from x in m");
    check("% x y\n1 2\n3 -4.5\n", &[], "x_m from x in m");
    check("x [cm],y [cm]\n100,200\n300,-450\n", &[], "x_m from x [cm] in cm");
    check("x_mm;y_mm\n1000;2000\n3000;-4500\n", &[], "in mm");
    check("time,x,y,theta,\n0,1,2,9,\n1,3,-4.5,9,\n", &[], "y_m from y in m");
    check(",x,y\n0,1,2\n1,3,-4.5\n", &[], "x_m from x in m");
    check("x,y,v\n1,2,1.5\n3,-4.5,2\n", &[1.5, 2.0], "v_mps from v in m/s");
    check("x,y,speed_kmh\n1,2,7.2\n3,-4.5,14.4\n", &[2.0, 4.0], "v_mps from speed_kmh in km/h");
    check(
        "x,y,z,qx,qy,qz,qw,velocity\n1,2,0,0,0,0,1,2\n3,-4.5,0,0,0,0,1,2\n",
        &[2.0, 2.0],
        "v_mps from velocity in m/s",
    );
    check("x,y,z,x,y,z,w\n1,2,0,0,0,0,1\n3,-4.5,0,0,0,0,1\n", &[], "x_m from x");
    check(
        "pose.position.x,pose.position.y,pose.orientation.x\n1,2,0\n3,-4.5,0\n",
        &[],
        "pose.position.x",
    );
    check("x,y\n1,2\nx,y\n3,-4.5\n", &[], "header is repeated 1 times");
    check("x,y\n1,2\n1,2\n1,2\n3,-4.5\n3,-4.5\n", &[], "3 points repeat the point before");
    check("recorded on Monday\nx,y\n1,2\n3,-4.5\n", &[], "x_m from x");
    check(
        "x_m,y_m,w_tr_right_m,w_tr_left_m\n1,2,1.5,1\n3,-4.5,1.5,1\n",
        &[],
        "the left edge from w_tr_left_m",
    );
    let feet = read("x_ft,y_ft\n0,0\n100,0\n").unwrap();
    assert!((feet.points[1][0] - 30.48).abs() < 1e-9, "{feet:?}");
    let old = "x,y\r1,2\r3,-4.5\r";
    check(old, &[], "x_m from x");
}

#[test]
fn a_raceline_beside_its_reference_line_is_the_one_that_is_driven() {
    // To the east, the normal points to the south.
    let header = "# x_ref_m; y_ref_m; width_right_m; width_left_m; x_normvec_m; y_normvec_m; alpha_m; s_racetraj_m; \
                  psi_racetraj_rad; kappa_racetraj_radpm; vx_racetraj_mps; ax_racetraj_mps2\n";
    let rows = "0; 0; 3; 4; 0; -1; 0.5; 0; 0; 0; 7; 0\n5; 0; 3; 4; 0; -1; -1; 5; 0; 0; 8; 0\n";
    let file = read(&format!("# id\n{header}{rows}")).unwrap();
    assert_eq!(file.points, [[0.0, -0.5], [5.0, 1.0]]);
    assert_eq!(file.widths_m, [[4.5, 2.5], [3.0, 4.0]]);
    assert_eq!(file.speeds_mps, [7.0, 8.0]);
    let notes = file.notes.join("; ");
    assert!(notes.contains("alpha_m beside that reference line, to the right"), "{notes}");
    // Without the normals the reference line is all there is.
    let file = read("x_ref_m,y_ref_m,alpha_m\n0,0,1\n5,0,1\n").unwrap();
    assert_eq!(file.points[1], [5.0, 0.0]);
}

#[test]
fn speeds_that_are_not_read_are_told() {
    let notes = |text: &str| read(text).unwrap().notes.join("; ");
    let told = notes("x_m,y_m,v_max,target_speed_a,variance,vy\n0,0,1,2,3,4\n5,0,1,2,3,4\n");
    assert_eq!(told, "not read: v_max, target_speed_a");
    assert_eq!(notes("x_m,y_m,v_mps,vy_mps\n0,0,1,0\n5,0,1,0\n"), "");
}

#[test]
fn a_car_that_stood_long_leaves_no_gap_behind_it() {
    let stood = (0..40)
        .map(|it| format!("{:.2},{:.2}\n", 0.15 * f64::from(it % 3), 0.1 * f64::from(it % 2)));
    let drove = (1..=30).map(|it| format!("{},0\n", 8 * it));
    let text: String = std::iter::once("x_m,y_m\n".to_owned()).chain(stood).chain(drove).collect();
    assert_eq!(read(&text).unwrap().points.len(), 70);
    let rows: String =
        (0..40).map(|it| format!("{},0\n", if it < 20 { it } else { it + 11 })).collect();
    assert!(message(&format!("x_m,y_m\n{rows}")).contains("12.00 m after the point of line 21"));
}

#[test]
fn comments_are_no_header_unless_they_name_the_rows_columns() {
    let check = |text: &str, points: &[[f64; 2]]| {
        let file = read(text).unwrap_or_else(|error| panic!("{text:?}: {error}"));
        assert_eq!(file.points, points, "{text:?}");
    };
    let two = [[1.0, 2.0], [3.0, -4.5]];
    check("# waypoints of the x y plane\n1,2\n3,-4.5\n", &two);
    check("# waypoints of the x y plane\n1 2\n3 -4.5\n", &two);
    check("# y x plane\n# v_mps,y_m,x_m\n# x and y follow\n5,2,1\n5,-4.5,3\n", &two);
    check("# Raceline, columns:\n# y_m; x_m\n2;1\n-4.5;3\n", &two);
    check("[1.0, 2.0]\n[3.0, -4.5]\n", &two);
    let uneven = message("# s_m; x_m; y_m\n1; 2\n3; -4.5\n");
    assert!(uneven.contains("the header names 3"), "{uneven}");
    let uneven = message("# x y\n0.1 1 2\n0.2 3 -4.5\n");
    assert!(uneven.contains("the header names 2"), "{uneven}");
}

#[test]
fn a_gpx_file_is_known_by_its_tags_in_any_encoding() {
    let gpx = |before: &[u8], name: &[u8]| {
        let points =
            b"<trkpt lat='48.0' lon='11.0'/><trkpt lat='48.0' lon='11.001'/></trkseg></trk></gpx>";
        let bytes =
            [before, b"<?xml version='1.0'?>\n<gpx><trk><name>", name, b"</name><trkseg>", points]
                .concat();
        parse("p.gpx", &bytes, &PathOptions::default())
    };
    assert_eq!(gpx(b"\xef\xbb\xbf", b"Oak").unwrap().points.len(), 2);
    let latin = gpx(b"", b"Stra\xdfe").unwrap_err().to_string();
    assert!(latin.contains("p.gpx:2:") && latin.contains("save the file as UTF-8"), "{latin}");
}

#[test]
fn a_speed_just_below_0_is_that_of_a_car_at_rest() {
    let file = read("x_m,y_m,v_mps\n0,0,-0.02\n1,0,1\n2,0,1\n3,0,-0.049\n").unwrap();
    assert_eq!(file.speeds_mps, [0.0, 1.0, 1.0, 0.0]);
    assert_eq!(file.notes, ["2 speeds between -0.05 and 0 m/s are taken as 0, a car at rest"]);
    let file = read("x_m,y_m,v_kmh\n0,0,-0.1\n1,0,1\n").unwrap();
    assert_eq!(file.speeds_mps[0], 0.0);
    assert!(message("x_m,y_m,v_mps\n0,0,-0.05\n1,0,1\n").contains("only forwards"));
}

#[test]
fn a_raceline_without_a_header_and_ambiguous_columns() {
    let rows = |first: &dyn Fn(f64) -> f64| -> String {
        (0..20)
            .map(f64::from)
            .map(|at| {
                format!("{};{at};{};0.1;0.0;{};0\n", first(at), 2.0 + 0.0 * at, 3.0 + 0.1 * at)
            })
            .collect()
    };
    let raceline = read(&rows(&|at| at)).unwrap();
    assert_eq!((raceline.points[3], raceline.speeds_mps[0]), ([3.0, 2.0], 3.0));
    assert!(raceline.notes[0].contains("length along columns 2, 3"), "{:?}", raceline.notes);
    let timed: String =
        (0..20).map(f64::from).map(|at| format!("{},{at},{}\n", 0.1 * at, 0.2 * at)).collect();
    let message = read(&timed).unwrap_err().to_string();
    assert!(message.contains("rises evenly") && message.contains("--columns x=2,y=3"), "{message}");
    let kitti = "1 0 0 5 0 1 0 0 0 0 1 3\n1 0 0 6 0 1 0 0 0 0 1 4\n";
    assert!(read(kitti).unwrap_err().to_string().contains("KITTI"));
}

#[test]
fn a_table_without_a_header_is_not_guessed_where_it_may_be_another() {
    let path = |text: &str| read(text).map(|file| file.points).map_err(|error| error.to_string());
    let asked = |text: &str, part: &str| {
        let message = path(text).unwrap_err();
        for part in [part, "--columns x=2,y=3 or x=1,y=2"] {
            assert!(message.contains(part), "{text:?}: {message:?} lacks {part:?}");
        }
    };
    // Straights at 45°, or the length along a straight.
    asked("0,0,2\n1,1,2\n2,2,2\n3,3,2\n", "may be x of a straight, or the length");
    asked("0,0,2\n1,1,2.2\n2.5,2.5,2.5\n3,3,2.6\n", "may be x of a straight, or the length");
    let bent = "0,0,2\n1,1,2\n2,2,2\n3,2,3\n4,2,4\n5,2,5\n";
    assert_eq!(path(bent).unwrap()[3], [2.0, 3.0]);
    // A clock with jitter.
    let jitter = "0.000,0,0\n0.101,0.15,0.01\n0.199,0.31,0.02\n0.304,0.46,0.04\n0.402,0.60,0.08\n";
    asked(jitter, "rises almost evenly");
    let widths = "0,0,1.1\n1,0.1,1.1\n1.9,0.3,1.1\n3.1,0.9,1.1\n";
    assert_eq!(path(widths).unwrap()[1], [1.0, 0.1]);
    // Speeds beside x and y do not come along as a vehicle does.
    let speeds = "0,0,2\n1,0.1,2.02\n1.9,0.3,2.05\n3.1,0.5,2.1\n";
    assert_eq!(path(speeds).unwrap()[1], [1.0, 0.1]);
    let back = "0,0,1\n1,0.1,2\n1.9,0.3,3\n1.5,1,3\n";
    assert_eq!(path(back).unwrap()[3], [1.5, 1.0]);
    // Words and gaps are no coordinates.
    for third in ["straight", "nan"] {
        let text = format!("1.0,2.0,{third}\n1.5,2.0,{third}\n2.0,2.1,{third}\n2.5,2.1,{third}\n");
        assert_eq!(path(&text).unwrap()[2], [2.0, 2.1], "{third}");
    }
    asked("0,1,2\n1,1.5,2\n2,2.5,oops\n3,3.5,2\n", "rises evenly");
    // As ros2 topic echo --csv writes odometry and poses.
    let odometry =
        |x: f64| format!("1700000000,123,odom,base_link,{x},2.0,0.0,0,0,0.1,0.99,0.1,0\n");
    let file = read(&[odometry(1.0), odometry(2.0), odometry(3.0)].concat()).unwrap();
    assert_eq!(file.points[1], [2.0, 2.0]);
    assert!(file.notes[0].contains("columns 5, 6 taken as x_m, y_m"), "{:?}", file.notes);
    let pose = |x: f64| format!("1700000000,123,map,{x},2.0,0.0,0,0,0.1,0.99\n");
    let file = read(&[pose(1.0), pose(2.0), pose(3.0)].concat()).unwrap();
    assert_eq!(file.points[1], [2.0, 2.0]);
}

#[test]
fn columns_are_those_that_the_user_names() {
    let file = read_as("0,1,2,9,5\n0,3,-4.5,9,6\n", Some("x=2,y=3,v=5"), None).unwrap();
    assert_eq!((file.points[1], file.speeds_mps[1]), ([3.0, -4.5], 6.0));
    let file =
        read_as("p q r\n100 200 36\n300 -450 72\n", Some("x_cm=p,y_cm=Q,v_kmh=3"), None).unwrap();
    assert_eq!((file.points[1], file.speeds_mps[1]), ([3.0, -4.5], 20.0));
    let wrong = |text: &str, columns: &str, part: &str| {
        let message = read_as(text, Some(columns), None).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    };
    // The header's units hold where --columns says none, and the advice that the program gives keeps them.
    let cm = "x_cm,y_cm,speed\n100,200,5\n300,-450,6\n";
    let advice = message(cm);
    assert!(advice.contains("--columns x_cm=1,y_cm=2,v_mps=3"), "{advice}");
    for columns in ["x=1,y=2,v=3", "x=x_cm,y=y_cm,v=speed", "x_cm=1,y_cm=2,v_mps=3"] {
        let file = read_as(cm, Some(columns), None).unwrap();
        assert_eq!((file.points[1], file.speeds_mps[1]), ([3.0, -4.5], 6.0), "{columns}");
        let told = "read x_m from x_cm in cm, y_m from y_cm in cm, v_mps from speed in m/s";
        assert_eq!(file.notes, [told]);
    }
    let file = read_as(cm, Some("x_m=1,y_m=2"), None).unwrap();
    assert_eq!(file.points[1], [300.0, -450.0]);
    let file =
        read_as("left (map);up_mm;v km/h\n1;2000;36\n3;-4500;72\n", Some("x=1,y=2,v=3"), None);
    let file = file.unwrap();
    assert_eq!((file.points[1], file.speeds_mps[1]), ([3.0, -4.5], 20.0));
    wrong("x_yd,y_yd\n1,2\n3,4\n", "x=1,y=2", "x_yd, in yd");
    wrong("1,2\n3,4\n", "x=1,y=3", "names column 3, but the row has 2");
    wrong("a,b\n3,4\n", "x=a,y=c", "has no column c");
    for (text, part) in [
        ("x=1", "both coordinates"),
        ("x=1,y=0", "counted from 1"),
        ("x=1,y=2,x=3", "twice"),
        ("x,y", "no assignment"),
        ("x_yd=1,y=2", "unit yd"),
        ("w=1,y=2", "none of x, y, v"),
    ] {
        let why = text.parse::<Columns>().unwrap_err();
        assert!(why.contains(part), "{text}: {why}");
    }
}

#[test]
fn names_between_tabs_may_hold_spaces_and_count_as_the_rows_do() {
    let check = |text: &str, columns: Option<&str>| {
        let file = read_as(text, columns, None).unwrap_or_else(|error| panic!("{text:?}: {error}"));
        assert_eq!(file.points, [[1.0, 2.0], [3.0, -4.5]], "{text:?}");
    };
    check("Time stamp\tX\tY\tZ\n0.0\t1\t2\t0\n0.1\t3\t-4.5\t0\n", Some("x=X,y=Y"));
    check("Time stamp\tX\tY\tZ\n0.0\t1\t2\t0\n0.1\t3\t-4.5\t0\n", Some("x=2,y=3"));
    check("Time stamp\tX\tY\tZ\n0.0\t1\t2\t0\n0.1\t3\t-4.5\t0\n", None);
    check("x [m]\ty [m]\n1\t2\n3\t-4.5\n", None);
    check("x [m]\ty [m]\n1,0\t2,0\n3,0\t-4,5\n", None);
    check("street\tx\ty\nOak St, 5\t1\t2\nElm St\t3\t-4.5\n", None);
    check("\tx\ty\n0\t1\t2\n1\t3\t-4.5\n", None);
    check("x\tnote\ty\tend\n1\ta b\t2\tc\n3\t\t-4.5\t\n", None);
    // Aligned by several tabs, and by tabs and spaces.
    check("x\t\ty\n1.0\t2\n3\t\t-4.5\n", None);
    check("\t1\t\t2\n\t3\t\t-4.5\n", Some("x=1,y=2"));
    check("x y\tv_mps\n1 2\t1\n3 -4.5\t1\n", None);
    check("x,\ty\n1,\t2\n3,\t-4.5\n", None);
    for (text, columns, parts) in [
        ("name,x,y\n1,2\n2,3\n", "x=x,y=y", ["p.csv:1:", "names 3", "rows have 2"]),
        ("time stamp x y\n1 2 3\n2 3 4\n", "x=x,y=y", ["p.csv:1:", "names 4", "rows have 3"]),
    ] {
        let message = read_as(text, Some(columns), None).unwrap_err().to_string();
        for part in parts.into_iter().chain(["by number"]) {
            assert!(message.contains(part), "{message:?} lacks {part:?}");
        }
    }
    // An empty field at the end is one of the row's.
    let file = read_as("x,y,note\n1,2,\n3,-4.5,a\n", Some("x=x,y=y"), None).unwrap();
    assert_eq!(file.points[1], [3.0, -4.5]);
}

#[test]
fn coordinates_of_the_earth_become_metres() {
    let utm =
        read("x_m,y_m\n482301.25,4419876.5\n482302.25,4419876.5\n482303.25,4419877\n").unwrap();
    assert_eq!(utm.points, [[0.0, 0.0], [1.0, 0.0], [2.0, 0.5]]);
    assert_eq!(utm.origin, [482_301.25, 4_419_876.5]);
    assert!(
        utm.notes[0].contains("from the first point on, 482301.25, 4419876.5"),
        "{:?}",
        utm.notes
    );
    // At 60° a unit of web-Mercator is half a metre.
    let y = 8_399_737.889_818_36;
    let text = format!("x,y\n1289000,{y}\n1289010,{y}\n1289020,{}\n", y + 4.0);
    let mercator = read_as(&text, None, Some("web-mercator")).unwrap();
    assert!(
        (mercator.points[1][0] - 5.0).abs() < 1e-6 && (mercator.points[2][1] - 2.0).abs() < 1e-6
    );
    assert!(mercator.notes.join(" ").contains("scaled by 0.5000"), "{:?}", mercator.notes);
    let metres = read_as(&text, None, Some("metres")).unwrap();
    assert_eq!(metres.points[1], [10.0, 0.0]);
    let named = read("# EPSG:3857\nx,y\n300000,6000000\n300010,6000000\n300020,6000000\n").unwrap();
    assert!(named.points[1][0] < 7.5, "{:?}", named.points);
    // UTM is the universal *transverse* Mercator.
    for (comment, first_m) in [
        ("UTM (Universal Transverse Mercator) zone 32N", 10.0),
        ("transverse-mercator", 10.0),
        ("WGS 84 / Pseudo-Mercator", 7.34),
    ] {
        let text = format!("# {comment}\nx,y\n500000,5300000\n500010,5300000\n500020,5300000\n");
        let along_m = read(&text).unwrap().points[1][0];
        assert!((along_m - first_m).abs() < 0.1, "{comment}: {along_m}");
    }
    let degrees = "latitude,longitude\n48.0,11.0\n48.0,11.001\n48.001,11.001\n";
    let there = read(degrees).unwrap();
    assert!((there.points[1][0] - 74.63).abs() < 0.01 && (there.points[2][1] - 111.2).abs() < 0.05);
    let bare = read_as("11.0 48.0\n11.001 48.0\n11.001 48.001\n", None, Some("wgs84")).unwrap();
    assert_eq!(bare.points, there.points);
    let gpx = "<?xml version='1.0'?><gpx><trk><trkseg><trkpt lat='48.0' lon='11.0'/><trkpt lat='48.0' lon='11.001'/>\
               <trkpt lat='48.001' lon='11.001'/></trkseg></trk></gpx>";
    assert_eq!(read(gpx).unwrap().points, there.points);
}
