//! `pathtune calibrate`: an envelope from simulated or recorded drives, its file, and what it promises.

pub(crate) mod journal;
mod recorded;

use std::fs::OpenOptions;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};

use config::Envelope;
use orchestrator::cli::{CalibrateArgs, CertifyArgs};
use orchestrator::commands::{Certifiable, certifiable};
use orchestrator::words::{Failure, print_line, print_table};
use serde_json::json;
use trainer::calibration::{self, Spread};

/// Drives between two lines of progress.
const TELL_EVERY: u32 = 200;

/// Calibrates.
pub(crate) fn calibrate(args: &CalibrateArgs) -> Result<(), Failure> {
    let of = CertifyArgs {
        what: args.what.clone(),
        gains: args.gains.clone(),
        from: Vec::new(),
        speeds: Vec::new(),
        path: args.path.clone(),
        reading: args.reading.clone(),
        vehicle: args.vehicle.clone(),
        law: args.law.clone(),
        set: args.set.clone(),
        over: None,
        json: false,
        report: None,
        write: None,
        check: None,
    };
    let Certifiable { mut config, sets, note, .. } = certifiable(&of)?;
    if let Some(seed) = args.seed {
        config.run.seed = seed;
    }
    let file = file_of(args, &config.gains_name());
    if file.exists() {
        let file = file.display();
        return Err(Failure::User(format!(
            "{file}: exists already; remove it, or name another file with --out"
        )));
    }
    let envelope = if args.from.is_empty() {
        let is_shown = std::io::stderr().is_terminal();
        let tell = |done: u32| {
            if is_shown && (done.is_multiple_of(TELL_EVERY) || done == args.drives) {
                eprint!("\rpathtune: {done} of {} drives", args.drives);
            }
        };
        let found = calibration::calibrate(&config, &sets, args.drives, Spread::Varied, tell);
        if is_shown {
            eprintln!();
        }
        found.map_err(Failure::User)?
    } else {
        let recorded = recorded::read(&args.from, &config).map_err(Failure::User)?;
        for warning in &recorded.warnings {
            eprintln!("pathtune: {warning}");
        }
        let files = args.from.len();
        let from = format!("recorded, in {files} {}", if files == 1 { "file" } else { "files" });
        calibration::envelope_of(&config, &sets, recorded.traces, recorded.left_out, from)
            .map_err(Failure::User)?
    };
    write(&file, &envelope)?;
    let promises = promises(&envelope);
    if args.json {
        let text = json!({
            "schema": 1, "file": file, "note": note, "made_for": envelope.made_for, "promise": envelope.promise,
            "threshold": envelope.threshold, "channels": envelope.channels, "words": promises,
        });
        return print_line(&serde_json::to_string_pretty(&text).map_err(anyhow::Error::from)?);
    }
    print_line(&note)?;
    let header = ["looked at", "over s", "mean", "deviation", "limit"];
    let range = |numbers: &[f64]| {
        let least = numbers.iter().copied().fold(f64::INFINITY, f64::min);
        let most = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if numbers.len() == 1 {
            number(least)
        } else {
            format!("{} to {}", number(least), number(most))
        }
    };
    let rows = envelope.channels.iter().map(|it| {
        vec![
            it.kind.replace('_', " "),
            it.over_s.to_string(),
            range(&it.mean),
            range(&it.sd),
            if it.limit < 1e6 {
                format!("{:.2}", it.limit)
            } else {
                "none: drives too short".to_owned()
            },
        ]
    });
    print_table(&header, rows)?;
    promises.iter().try_for_each(|line| print_line(line))?;
    print_line(&file.display().to_string())
}

/// With three digits, small or large.
fn number(number: f64) -> String {
    match number.abs() {
        size if size == 0.0 || (0.001..1000.0).contains(&size) => format!("{number:.3}"),
        _ => format!("{number:.1e}"),
    }
}

/// What the envelope promises, in words.
fn promises(envelope: &Envelope) -> Vec<String> {
    let it = &envelope.promise;
    let percent = |share: f64| {
        format!("{:.3}", 100.0 * share).trim_end_matches('0').trim_end_matches('.').to_owned()
    };
    let mut lines = vec![
        format!("drives: {}", it.varied),
        format!(
            "{} drives for the scales, {} others for the threshold, of which {} are above it; {} left out (too far from the \
             path, or ended early)",
            it.scaled_on, it.threshold_on, it.above, it.left_out
        ),
        format!(
            "a drive is out of the envelope if its score is above {:.3}: for drives like these, that is at most {} % of them, \
             with a probability of {} %",
            envelope.threshold,
            percent(it.alpha),
            percent(1.0 - it.delta)
        ),
    ];
    if it.alpha > 0.01 {
        lines.push(format!(
            "few drives promise little: with {} for the threshold, {} % of good drives may raise a false alarm; 459 support 1 %",
            it.threshold_on,
            percent(it.alpha)
        ));
    }
    lines.extend(rests_on_one(envelope));
    let left_out = it.left_out as f64 / (it.left_out + it.scaled_on + it.threshold_on) as f64;
    if left_out > 0.01 {
        lines.push(format!(
            "warning: {} % of the drives were left out: these gains do not hold the path well, and the promise says nothing of \
             such drives",
            percent(left_out)
        ));
    }
    lines
}

/// The largest score and the next are as far apart as this where a single drive delays all alarms.
const APART: f64 = 1.15;
/// So many drives for the threshold let two of them lie above it.
const DRIVES_THAT_FORGIVE: u64 = 1000;

/// Whether the threshold rests on a single drive that is not like the others, and what that means.
fn rests_on_one(envelope: &Envelope) -> Option<String> {
    let [.., next, largest] = envelope.scores[..] else { return None };
    (envelope.promise.above == 0 && largest > APART * next).then(|| {
        format!(
            "warning: the threshold is the score of a single drive, {largest:.3}, and the next one has {next:.3}: a fault must \
             show about {:.1} times as clearly, or as long, before there is an alarm. With {DRIVES_THAT_FORGIVE} drives for \
             the threshold (--drives {}), two such drives may lie above it",
            largest / next,
            2 * DRIVES_THAT_FORGIVE
        )
    })
}

fn file_of(args: &CalibrateArgs, maneuver: &str) -> PathBuf {
    if let Some(out) = &args.out {
        return out.clone();
    }
    let run = args.what.as_deref().map(Path::new).filter(|it| it.join("config.toml").is_file());
    run.map_or_else(|| format!("{maneuver}.envelope.toml").into(), |run| run.join("envelope.toml"))
}

fn write(file: &Path, envelope: &Envelope) -> Result<(), Failure> {
    let failed = |why: std::io::Error| Failure::User(format!("{}: {why}", file.display()));
    let text = toml::to_string(envelope).map_err(anyhow::Error::from)?;
    let mut options = OpenOptions::new();
    let mut opened = options.write(true).create_new(true).open(file).map_err(failed)?;
    opened.write_all(text.as_bytes()).map_err(failed)
}
