//! Parses a path's file: rows of points that a user measured, drew or computed.
//!
//! Two forms are understood. In both, columns are found by name, in any order; other columns are ignored:
//!
//! - comma-separated values, whose header names `x_m,y_m` and optionally `v_mps`;
//! - the raceline form of TUM and F1TENTH: `;` between the fields, the header in a comment such as
//!   `# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2`. Its heading and curvature are not read: their
//!   conventions differ from tool to tool, and they follow from the points.
//!
//! Lines that begin with `#` are comments. Each mistake is reported in one line that names the file and its line.

use crate::ConfigError;

/// The shortest path that is worth a drive.
const SHORTEST_M: f64 = 1.0;
/// The longest path: a drive's time is limited to an hour.
const LONGEST_M: f64 = 1e5;
/// Points nearer to each other than this are the same: far below the precision of a file's decimals.
const SAME_POINT_M: f64 = 1e-6;
/// A step is a gap if it is this many times the median step, …
const GAP_FACTOR: f64 = 10.0;
/// … and longer than this: dense points may be uneven although none is missing.
const GAP_M: f64 = 1.0;
/// The largest coordinate, as of any configuration.
const FARTHEST_M: f64 = 1e6;
/// The highest speed, as that of `reference.speed_mps`.
const FASTEST_MPS: f64 = 50.0;

/// The content of a path's file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PathFile {
    /// The points: at least 2, and no two neighbours the same. The last point of a closed path is its first.
    pub(crate) points: Vec<[f64; 2]>,
    /// The speed at each point; empty if the file has no such column.
    pub(crate) speeds_mps: Vec<f64>,
    /// The line of each point.
    pub(crate) lines: Vec<usize>,
}

/// Where the columns are.
#[derive(Debug, Clone, PartialEq)]
struct Header {
    delimiter: char,
    x: usize,
    y: usize,
    v: Option<usize>,
    names: Vec<String>,
}

/// Parses the bytes of the file that `origin` names.
///
/// # Errors
/// At the first mistake, with its line and what to do about it.
pub(crate) fn parse(origin: &str, bytes: &[u8]) -> Result<PathFile, ConfigError> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = bytes[..error.valid_up_to()].iter().filter(|byte| **byte == b'\n').count() + 1;
        mistake(origin, line, "is not UTF-8 text; save the file as UTF-8")
    })?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    if text.trim().is_empty() {
        return Err(mistake(
            origin,
            1,
            "is empty; write a header x_m,y_m[,v_mps], and one point per line",
        ));
    }
    let (header, header_line, body) = find_header(origin, text)?;
    let rows = rows(origin, &header, body)?;
    let file = match rows.points.len() {
        0 => return Err(mistake(origin, header_line, "no points follow; write one per line")),
        1 => {
            let problem = "is the only point; a path needs at least 2";
            return Err(mistake(origin, rows.lines[0], problem));
        }
        _ => rows,
    };
    check_steps(origin, file)
}

fn mistake(origin: &str, line: usize, problem: impl Into<String>) -> ConfigError {
    ConfigError::new(format!("{origin}:{line}"), "", problem)
}

/// The user's own words in an error: in quotes, on one line, no longer than a line.
fn quoted(text: &str) -> String {
    const LONGEST: usize = 60;
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{:?}…", &text[..end]),
        None => format!("{text:?}"),
    }
}

/// Lines with their numbers, without blank ones and comments.
type Body<'a> = Vec<(usize, &'a str)>;

/// The header, its line, and the rows after it.
fn find_header<'a>(origin: &str, text: &'a str) -> Result<(Header, usize, Body<'a>), ConfigError> {
    let mut in_comment = None;
    let mut body = Body::new();
    for (line, content) in text.lines().enumerate().map(|(index, line)| (index + 1, line.trim())) {
        match content.strip_prefix('#') {
            // Only above the points: a header below the first of them would belong to other points.
            Some(comment) if in_comment.is_none() && body.is_empty() => {
                in_comment = [';', ',']
                    .into_iter()
                    .find_map(|delimiter| read_header(origin, line, comment, delimiter).transpose())
                    .transpose()?
                    .map(|header| (header, line));
            }
            Some(_) => {}
            None if content.is_empty() => {}
            None => body.push((line, content)),
        }
    }
    let Some(&(line, first)) = body.first() else {
        let (problem, line) = match in_comment {
            Some((_, line)) => ("no points follow; write one per line", line),
            None => {
                ("holds only comments; write a header x_m,y_m[,v_mps], and one point per line", 1)
            }
        };
        return Err(mistake(origin, line, problem));
    };
    // A header without the comment sign takes precedence over one in a comment.
    for delimiter in [',', ';'] {
        if let Some(header) = read_header(origin, line, first, delimiter)? {
            body.remove(0);
            return Ok((header, line, body));
        }
    }
    if let Some((header, line)) = in_comment {
        return Ok((header, line, body));
    }
    Err(mistake(origin, line, no_header(first)))
}

/// The header in a line, if it names x_m and y_m with this delimiter.
fn read_header(
    origin: &str,
    line: usize,
    content: &str,
    delimiter: char,
) -> Result<Option<Header>, ConfigError> {
    let names: Vec<_> = fields(content, delimiter).map(str::to_owned).collect();
    let column = |wanted: &str| names.iter().position(|name| name == wanted);
    let (Some(x), Some(y)) = (column("x_m"), column("y_m")) else { return Ok(None) };
    let v = column("v_mps").or_else(|| column("vx_mps"));
    for index in [Some(x), Some(y), v].into_iter().flatten() {
        if names.iter().skip(index + 1).any(|name| *name == names[index]) {
            let problem = format!("names column {} twice; rename one of them", names[index]);
            return Err(mistake(origin, line, problem));
        }
    }
    Ok(Some(Header { delimiter, x, y, v, names }))
}

/// The fields of a line, without the quotes that some programs put around each.
fn fields(content: &str, delimiter: char) -> impl Iterator<Item = &str> {
    content.split(delimiter).map(|field| field.trim().trim_matches('"').trim())
}

/// What is wrong with a first line that is not a header.
fn no_header(first: &str) -> String {
    let holds = |names: &[&str], wanted: &str| names.contains(&wanted);
    for (delimiter, called) in [('\t', "tabs"), ('|', "'|'"), (' ', "spaces")] {
        let names: Vec<_> = fields(first, delimiter).collect();
        if holds(&names, "x_m") && holds(&names, "y_m") {
            return format!(
                "has {called} between its columns; separate them by commas, as in x_m,y_m"
            );
        }
    }
    let delimiter = if first.contains(';') { ';' } else { ',' };
    let names: Vec<_> = fields(first, delimiter).collect();
    if names.iter().all(|name| name.parse::<f64>().is_ok()) {
        return "is a row of numbers without a header above it; name the columns in the first line, \
                as in x_m,y_m"
            .to_owned();
    }
    let missing = match (holds(&names, "x_m"), holds(&names, "y_m")) {
        (true, _) => "no column y_m",
        (_, true) => "no column x_m",
        _ => "no columns x_m and y_m",
    };
    format!("has {missing}; found {}; write a header x_m,y_m[,v_mps]", quoted(&names.join(", ")))
}

/// Reads the rows below the header.
fn rows(origin: &str, header: &Header, body: Body<'_>) -> Result<PathFile, ConfigError> {
    let text: String = body.iter().flat_map(|(_, content)| [content, "\n"]).collect();
    // Every record is one line, so that the n-th record is the body's n-th line: quotes and line breaks have no meaning
    // here.
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(header.delimiter as u8)
        .has_headers(false)
        .flexible(true)
        .quoting(false)
        .terminator(csv::Terminator::Any(b'\n'))
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let mut file = PathFile { points: Vec::new(), speeds_mps: Vec::new(), lines: Vec::new() };
    for (record, (line, _)) in reader.records().zip(&body) {
        let record = record.map_err(|error| mistake(origin, *line, error.to_string()))?;
        if record.len() != header.names.len() {
            let problem = format!(
                "has {} fields, but the header names {} ({}); separate them by {:?}",
                record.len(),
                header.names.len(),
                quoted(&header.names.join(", ")),
                header.delimiter
            );
            return Err(mistake(origin, *line, problem));
        }
        let number = |column: usize, low: f64, high: f64| {
            let name = &header.names[column];
            let field = record[column].trim_matches('"').trim();
            let wrong = |problem: String| mistake(origin, *line, format!("{name} {problem}"));
            if field.is_empty() {
                return Err(wrong("is empty; write a number".to_owned()));
            }
            let Ok(value) = field.parse::<f64>() else {
                let comma = field.replace(',', ".").parse::<f64>().is_ok();
                let hint =
                    if comma { "write the decimals after a point" } else { "write a number" };
                return Err(wrong(format!("is {}, which is not a number; {hint}", quoted(field))));
            };
            if !(low..=high).contains(&value) {
                let value = quoted(field);
                return Err(wrong(format!("is {value}, but must be a number in [{low}, {high}]")));
            }
            Ok(value)
        };
        let point = [
            number(header.x, -FARTHEST_M, FARTHEST_M)?,
            number(header.y, -FARTHEST_M, FARTHEST_M)?,
        ];
        if let Some(column) = header.v {
            let speed_mps = number(column, f64::NEG_INFINITY, f64::INFINITY)?;
            if speed_mps <= 0.0 || speed_mps > FASTEST_MPS {
                let name = &header.names[column];
                let problem = format!(
                    "{name} is {}, but must lie in (0, {FASTEST_MPS}]; the vehicle drives only forwards, \
                     and has its own ramp from rest (reference.ramp_s)",
                    quoted(&record[column])
                );
                return Err(mistake(origin, *line, problem));
            }
            file.speeds_mps.push(speed_mps);
        }
        file.points.push(point);
        file.lines.push(*line);
    }
    Ok(file)
}

/// Checks the steps from point to point, and closes a path whose ends are the same up to rounding.
fn check_steps(origin: &str, mut file: PathFile) -> Result<PathFile, ConfigError> {
    let apart_m = |a: [f64; 2], b: [f64; 2]| libm::hypot(b[0] - a[0], b[1] - a[1]);
    let steps: Vec<_> = file.points.windows(2).map(|pair| apart_m(pair[0], pair[1])).collect();
    let lines = &file.lines;
    if let Some(index) = steps.iter().position(|step_m| *step_m <= SAME_POINT_M) {
        let problem = format!("repeats the point of line {}; remove one of them", lines[index]);
        return Err(mistake(origin, lines[index + 1], problem));
    }
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let median_m = sorted[(sorted.len() - 1) / 2];
    let gap = steps.iter().position(|step_m| *step_m > (GAP_FACTOR * median_m).max(GAP_M));
    if let Some(index) = gap {
        let problem = format!(
            "lies {:.2} m after the point of line {}, but the usual step is {median_m:.2} m; fill the gap \
             with points",
            steps[index], lines[index]
        );
        return Err(mistake(origin, lines[index + 1], problem));
    }
    let length_m: f64 = steps.iter().sum();
    let last = file.points.len() - 1;
    if !(SHORTEST_M..=LONGEST_M).contains(&length_m) {
        let problem = format!(
            "ends a path of {length_m:.2} m, but a path must be {SHORTEST_M} m to {} km long; x_m and y_m are in metres",
            LONGEST_M / 1000.0
        );
        return Err(mistake(origin, lines[last], problem));
    }
    let gap_m = apart_m(file.points[0], file.points[last]);
    if gap_m <= SAME_POINT_M {
        file.points[last] = file.points[0];
    } else if is_one_step_open(&file.points, gap_m, median_m) {
        // Racelines leave out the last point, because it is the first one.
        file.points.push(file.points[0]);
        file.lines.push(file.lines[last]);
        if let Some(&speed_mps) = file.speeds_mps.first() {
            file.speeds_mps.push(speed_mps);
        }
    }
    Ok(file)
}

/// Whether only the last step of a lap is missing: the end lies no farther from the start than two points lie apart, and
/// the step from there to the start leads on in the direction of its neighbours.
fn is_one_step_open(points: &[[f64; 2]], gap_m: f64, median_m: f64) -> bool {
    /// By how much the missing step may be longer than the others.
    const UNEVEN: f64 = 1.5;
    let count = points.len();
    let step = |from: [f64; 2], to: [f64; 2]| (to[0] - from[0], to[1] - from[1]);
    let missing = step(points[count - 1], points[0]);
    let (before, behind) = (step(points[count - 2], points[count - 1]), step(points[0], points[1]));
    let leads_on = |(x_m, y_m): (f64, f64)| x_m * missing.0 + y_m * missing.1 > 0.0;
    gap_m <= UNEVEN * median_m && leads_on(before) && leads_on(behind)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn message(text: &str) -> String {
        parse("p.csv", text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn every_mistake_names_its_line_and_the_way_out() {
        let check = |text: &str, parts: &[&str]| {
            let message = message(text);
            for part in parts {
                assert!(message.contains(part), "{text:?}: {message:?} lacks {part:?}");
            }
            assert!(!message.contains('\n') && message.len() < 300, "{message:?}");
        };
        check("", &["p.csv:1:", "empty", "x_m,y_m"]);
        check("\u{feff} \r\n\n", &["p.csv:1:", "empty"]);
        check("# hello\n", &["only comments", "x_m,y_m"]);
        check("x_m,y_m\n", &["p.csv:1:", "no points"]);
        check("# x_m;y_m\n\n# end\n", &["p.csv:1:", "no points"]);
        check("1,2\n3,4", &["p.csv:1:", "without a header", "x_m,y_m"]);
        check("# a comment\n\n1;2\n3;4", &["p.csv:3:", "without a header"]);
        check("x,y\n1,2", &["p.csv:1:", "no columns x_m and y_m", "\"x, y\""]);
        check("x_m,z_m\n1,2", &["no column y_m", "\"x_m, z_m\""]);
        check("s;y_m\n1;2", &["no column x_m", "\"s, y_m\""]);
        check("x_m,y_m,x_m\n1,2,3", &["p.csv:1:", "x_m twice"]);
        check("x_m\ty_m\n1\t2", &["p.csv:1:", "tabs", "commas"]);
        check("x_m | y_m\n1|2", &["'|'", "commas"]);
        check("x_m  y_m v_mps\n1 2", &["spaces", "commas"]);
        check("x_m,y_m\n1,2\n3,4,5\n", &["p.csv:3:", "3 fields", "names 2", "x_m, y_m"]);
        check("x_m;y_m\n1;2\n3,4\n", &["p.csv:3:", "1 fields", "';'"]);
        check("x_m,y_m\n1,2\n\n# c\n3,left\n", &["p.csv:5:", "y_m is \"left\"", "not a number"]);
        check("x_m;y_m\n1;2\n2,5;4\n", &["p.csv:3:", "x_m is \"2,5\"", "point"]);
        check("x_m,y_m\n1,\n", &["p.csv:2:", "y_m is empty"]);
        check("x_m,y_m\n1,nan\n", &["p.csv:2:", "y_m is \"nan\"", "number"]);
        check("x_m,y_m\n-inf,1\n", &["p.csv:2:", "x_m is \"-inf\""]);
        check("x_m,y_m\n1,2e6\n", &["p.csv:2:", "y_m is \"2e6\"", "1000000"]);
        check("x_m,y_m,v_mps\n1,2,nan\n", &["p.csv:2:", "v_mps is \"nan\""]);
        check("x_m,y_m,v_mps\n1,2,inf\n", &["p.csv:2:", "v_mps is \"inf\""]);
        check("x_m,y_m,v_mps\n1,2,0\n", &["p.csv:2:", "v_mps is \"0\"", "(0, 50]"]);
        check("# x_m;y_m;vx_mps\n1;2;-3\n", &["p.csv:2:", "vx_mps is \"-3\"", "(0, 50]"]);
        check("x_m,y_m\n1,2\n", &["p.csv:2:", "only point"]);
        check("x_m,y_m\n1,2\n1.0,2\n", &["p.csv:3:", "line 2", "repeats the point"]);
        check(
            "x_m,y_m\n0,0\n1,0\n2,0\n22,0\n23,0\n",
            &["p.csv:5:", "20.00 m", "line 4", "usual step is 1.00 m"],
        );
        check("x_m,y_m\n0,0\n0.1,0\n0.9,0\n", &["p.csv:4:", "0.90 m", "1 m to 100 km"]);
        check("x_m,y_m\n0,0\n90000,0\n90000,90000\n", &["p.csv:4:", "180000.00 m"]);
        check(&format!("{}\n1", "é".repeat(500)), &["no columns", "…"]);
        let latin = parse("p.csv", b"x_m,y_m\n1,2\n\xe9").unwrap_err().to_string();
        assert!(latin.contains("p.csv:3:") && latin.contains("UTF-8"), "{latin}");
    }

    #[test]
    fn both_forms_are_read_with_their_columns_by_name() {
        let check = |text: &str, points: &[[f64; 2]], speeds: &[f64], lines: &[usize]| {
            let file = parse("p.csv", text.as_bytes()).unwrap_or_else(|error| panic!("{error}"));
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
        let closed = parse("p.csv", b"x_m,y_m\n1,0\n5,0\n5,5\n1,1e-9\n").unwrap();
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
            for bytes in [any.as_bytes(), &bytes, like.as_bytes()] {
                match parse("p.csv", bytes) {
                    Ok(file) => {
                        prop_assert!(file.points.len() >= 2);
                        prop_assert_eq!(file.points.len(), file.lines.len());
                    }
                    Err(error) => {
                        let message = error.to_string();
                        prop_assert!(message.starts_with("p.csv:"));
                        prop_assert_eq!(message.lines().count(), 1);
                    }
                }
            }
        }
    }
}
