//! What was identified, in words.

use std::path::Path;

use identification::{Identification, Row};

/// The table: key, before, after, interval, verdict.
pub(super) fn rows(found: &Identification) -> Vec<[String; 5]> {
    let mut rows = Vec::new();
    for row in &found.rows {
        rows.push(cells(row));
        if row.key == "steering_lag_s" {
            rows.push(cells(&found.delay_and_lag));
        }
    }
    rows
}

fn cells(row: &Row) -> [String; 5] {
    let interval = match row.interval {
        Some([low, high]) => format!("{} … {}", number(low), number(high)),
        None => "–".to_owned(),
    };
    let verdict = match (&row.why, row.only_with) {
        (Some(why), _) => format!("no: {why}"),
        (None, Some(other)) => format!("yes, together with {other}"),
        (None, None) if row.roughly => "roughly; the file's value fits worse".to_owned(),
        (None, None) => "yes".to_owned(),
    };
    [row.key.to_owned(), number(row.before), number(row.after), interval, verdict]
}

/// A number with four digits that count.
fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let before_point = value.abs().log10().floor() as i32 + 1;
    let digits = (4 - before_point).clamp(0, 6) as usize;
    format!("{value:.digits$}")
}

/// What is said below the table.
pub(super) fn notes(
    found: &Identification,
    refusal: Option<&str>,
    write: bool,
    file: &Path,
) -> Vec<String> {
    let mut notes: Vec<String> = found
        .predictions
        .iter()
        .map(|it| {
            let [low, high] = it.ratio;
            format!(
                "predicted over {} s, where no fit has seen the drive: off by {:.3} m with the file's values, {:.3} m with the \
                 new ones ({:.0} to {:.0} %, {} predictions)",
                it.over_s,
                it.before_m,
                it.after_m,
                100.0 * low,
                100.0 * high,
                it.windows
            )
        })
        .collect();
    let noise = found.noise;
    notes.push(format!(
        "noise of the odometry: position {:.4} m, heading ± {:.4} rad; --write puts it into [noise], which drives with --noise \
         use",
        noise.position_sd_m, noise.heading_half_width_rad
    ));
    notes.extend(found.drive_next.iter().map(|next| format!("not identified: drive {next}")));
    if !write {
        notes.push(match refusal {
            None if !file.is_file() => format!(
                "these values can be written into a file of your own: put base = \"{}\" into one, and name that with --vehicle",
                file.display()
            ),
            None => format!("--write puts these values into {}", file.display()),
            Some(why) => format!("--write would be refused: {why}"),
        });
    }
    notes
}
