//! A drive as comma-separated values with named columns.

use std::io::{BufRead as _, BufReader};
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use identification::{Command, Drive, Odometry, Point};

use super::{MOST_SAMPLES, Read, fill_gaps};

/// Columns with the names that they may have, and whether a file must have them.
const COLUMNS: [(&[&str], bool); 8] = [
    (&["t_s", "time_s"], true),
    (&["x_m"], true),
    (&["y_m"], true),
    (&["yaw_rad"], true),
    (&["speed_mps", "v_mps"], true),
    (&["command_steering_rad", "cmd_steering_rad"], true),
    (&["command_speed_mps", "cmd_speed_mps"], true),
    (&["yaw_rate_radps"], false),
];

/// Reads a file. A row holds odometry, a command, or both; empty fields tell nothing.
pub(crate) fn read(file: &Path) -> Result<Read> {
    parse(config::BoundedLines::new(config::open_regular(file)?))
}

fn parse(text: impl std::io::Read) -> Result<Read> {
    let mut text = BufReader::new(text);
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .delimiter(delimiter(text.fill_buf()?))
        .from_reader(text);
    let header = reader.headers().context("is neither an MCAP file nor CSV text")?.clone();
    let mut places = [None; 8];
    for (place, (names, is_needed)) in places.iter_mut().zip(COLUMNS) {
        *place = header.iter().position(|it| names.contains(&it));
        ensure!(
            place.is_some() || !is_needed,
            "has no column {}; its first line must name the columns, and names {}",
            names[0],
            beginning(&header.iter().collect::<Vec<_>>().join(","))
        );
    }
    let mut drive = Drive::default();
    for record in reader.records() {
        let record = record.context("is no table")?;
        let line = record.position().map_or(0, csv::Position::line);
        let field = |index: usize| -> Result<Option<f64>> {
            let Some(text) = places[index].and_then(|at| record.get(at)) else { return Ok(None) };
            if text.is_empty() || text.eq_ignore_ascii_case("nan") {
                return Ok(None);
            }
            let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
            let name = COLUMNS[index].0[0];
            number
                .with_context(|| {
                    format!("line {line}: {name} is {:?}, which is no number", beginning(text))
                })
                .map(Some)
        };
        let time_s = field(0)?.with_context(|| format!("line {line}: t_s is empty"))?;
        let last_s =
            [drive.odometry.last().map(|it| it.time_s), drive.commands.last().map(|it| it.time_s)];
        if last_s.into_iter().flatten().any(|last_s| time_s < last_s) {
            bail!("line {line}: t_s goes backwards; sort the rows by their time of arrival");
        }
        let told = [field(1)?, field(2)?, field(3)?, field(4)?];
        if let [Some(x_m), Some(y_m), Some(yaw_rad), Some(speed_mps)] = told {
            let yaw_rate_radps = field(7)?.unwrap_or(f64::NAN);
            let is_new = drive.odometry.last().is_none_or(|it| it.time_s < time_s);
            if is_new {
                drive.odometry.push(Odometry {
                    time_s,
                    x_m,
                    y_m,
                    yaw_rad,
                    speed_mps,
                    yaw_rate_radps,
                });
            }
        } else if told.iter().any(Option::is_some) {
            bail!(
                "line {line}: of x_m, y_m, yaw_rad and speed_mps, some are empty; give all or none"
            );
        }
        match (field(5)?, field(6)?) {
            (Some(steering_rad), Some(speed_mps)) => {
                drive.commands.push(Command { time_s, steering_rad, speed_mps });
            }
            (None, None) => {}
            _ => {
                bail!("line {line}: command_steering_rad and command_speed_mps: give both or none")
            }
        }
        ensure!(
            drive.odometry.len().max(drive.commands.len()) <= MOST_SAMPLES,
            "has more than {MOST_SAMPLES} rows; cut it"
        );
    }
    ensure!(!drive.odometry.is_empty() && !drive.commands.is_empty(), "holds no drive");
    // A gap in a yaw rate that is measured otherwise: without it, the heading's would be taken for all of the drive.
    fill_gaps(&mut drive.odometry);
    drive.late_commands_s = apart_s(&drive).unwrap_or_default();
    let caveats = sampled_commands(drive.late_commands_s).into_iter().collect();
    Ok(Read { drives: vec![drive], point: Point::Tracked, caveats, ..Read::default() })
}

/// What separates the names of the columns: a semicolon or a tab, if the first line has one, or else a comma.
fn delimiter(beginning: &[u8]) -> u8 {
    let lines = beginning.split(|byte| *byte == b'\n');
    let header = lines.into_iter().find(|it| !it.starts_with(b"#")).unwrap_or_default();
    [b';', b'\t'].into_iter().find(|it| header.contains(it)).unwrap_or(b',')
}

/// How far apart commands are that are noted in the rows of the odometry, if that is far: most were given before they were
/// noted.
fn apart_s(drive: &Drive) -> Option<f64> {
    const FAR_S: f64 = 0.015;
    let same = drive.odometry.len() == drive.commands.len()
        && drive.odometry.iter().zip(&drive.commands).all(|(a, b)| a.time_s == b.time_s);
    let (first, last) = (drive.commands.first()?, drive.commands.last()?);
    let apart_s = (last.time_s - first.time_s) / (drive.commands.len().max(2) - 1) as f64;
    (same && apart_s > FAR_S).then_some(apart_s)
}

/// What to know of commands that are noted so much late at most.
fn sampled_commands(late_s: f64) -> Option<String> {
    (late_s > 0.0).then(|| {
        format!(
            "commands stand in the rows of the odometry, {:.0} ms apart: if they were not given at these times but noted with \
             the next row, dead times come out up to {:.0} ms too short ({:.0} ms on average), for which their intervals \
             allow; give commands rows of their own, or log at 100 Hz",
            1e3 * late_s,
            1e3 * late_s,
            0.5e3 * late_s
        )
    })
}

/// What a message shows of a text of any length.
fn beginning(text: &str) -> String {
    match text.char_indices().nth(200) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name_and_rows_may_hold_a_part() {
        let text = "cmd_speed_mps,t_s,x_m,y_m,yaw_rad,v_mps,cmd_steering_rad,other\n\
                    2, 0.0, 1, 2, 0.1, 1.5, 0.2, x\n\
                    ,0.01,1,2,0.1,1.5,,\n\
                    3,0.015,,,,,0.1,\n";
        let read = parse(text.as_bytes()).unwrap();
        let drive = &read.drives[0];
        assert_eq!((drive.odometry.len(), drive.commands.len()), (2, 2));
        assert!(drive.odometry[0].yaw_rate_radps.is_nan());
        for other in [";", "\t"] {
            let others = format!("# Of Monday, May 4.\n{}", text.replace(',', other));
            assert_eq!(parse(others.as_bytes()).unwrap().drives[0].commands, drive.commands);
        }
        assert_eq!(drive.commands[1], Command { time_s: 0.015, steering_rad: 0.1, speed_mps: 3.0 });
    }

    #[test]
    fn commands_that_were_sampled_with_slow_odometry_are_told() {
        let rows = |apart_s: f64, own: bool| {
            let mut text = "t_s,x_m,y_m,yaw_rad,v_mps,cmd_steering_rad,cmd_speed_mps\n".to_owned();
            for row in 0..50 {
                let time_s = apart_s * f64::from(row);
                text += &match own {
                    true => format!("{time_s},0,0,0,1,,\n{},,,,,0.1,1\n", time_s + 0.001),
                    false => format!("{time_s},0,0,0,1,0.1,1\n"),
                };
            }
            let read = parse(text.as_bytes()).unwrap();
            assert_eq!(read.drives[0].late_commands_s > 0.0, !read.caveats.is_empty());
            read.caveats
        };
        assert!(rows(0.05, false)[0].contains("up to 50 ms too short (25 ms on average)"));
        assert!(rows(0.05, true).is_empty() && rows(0.01, false).is_empty());
    }

    #[test]
    fn mistakes_name_line_and_column() {
        let header = "t_s,x_m,y_m,yaw_rad,speed_mps,command_steering_rad,command_speed_mps\n";
        let check = |rows: &str, parts: &[&str]| {
            let why = format!("{:#}", parse(rows.as_bytes()).unwrap_err());
            for part in parts {
                assert!(why.contains(part), "{why:?} lacks {part:?}");
            }
        };
        check("t_s,x_m\n", &["no column y_m", "t_s,x_m"]);
        check(&format!("{header}0,1,2,3,4,5,six\n"), &["line 2", "command_speed_mps", "six"]);
        check(&format!("{header}1,1,2,3,4,5,6\n0,1,2,3,4,5,6\n"), &["line 3", "backwards"]);
        check(&format!("{header}1,1,,3,4,5,6\n"), &["line 2", "all or none"]);
        check(&format!("{header}1,1,2,3,4,5,\n"), &["line 2", "give both"]);
        check(header, &["holds no drive"]);
        check(&format!("{header}0,1,2\n"), &["no table"]);
    }
}
