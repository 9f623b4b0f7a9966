//! What an envelope's file has seen of its car: the score of each drive, in a file of its own beside it, and whether the
//! car has changed since it was calibrated.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use config::{Envelope, read_small};
use orchestrator::words::Failure;
use outcome::{Outcome, read_result};
use supervisor::envelope::Martingale;

/// Notes the score of a drive that has ended in this folder, and says whether the car has changed.
pub(crate) fn note(file: &Path, folder: &Path) -> Result<String, Failure> {
    let Ok(result) = read_result(folder) else { return Ok(String::new()) };
    let Outcome::Drive(drive) = result.decided.outcome else { return Ok(String::new()) };
    let Some(seen) = drive.envelope else { return Ok(String::new()) };
    let text = read_small(file).map_err(|why| user(file, &why))?;
    let envelope = Envelope::parse(&text).map_err(|why| user(file, &why))?;
    let journal = journal_of(file);
    let mut opened = OpenOptions::new()
        .append(true)
        .create(true)
        .open(&journal)
        .map_err(|why| user(&journal, &why))?;
    writeln!(opened, "{}", seen.score).map_err(|why| user(&journal, &why))?;
    seen_of(&envelope, &journal)
}

/// What an envelope's file has seen of its car so far, in words.
pub(crate) fn evidence(file: &Path) -> Result<String, Failure> {
    let text = read_small(file).map_err(|why| user(file, &why))?;
    let envelope = Envelope::parse(&text).map_err(|why| user(file, &why))?;
    seen_of(&envelope, &journal_of(file))
}

fn user(file: &Path, why: &dyn std::fmt::Display) -> Failure {
    Failure::User(format!("{}: {why}", file.display()))
}

fn seen_of(envelope: &Envelope, journal: &Path) -> Result<String, Failure> {
    let text = match journal.exists() {
        true => read_small(journal).map_err(|why| user(journal, &why))?,
        false => String::new(),
    };
    let mut martingale = Martingale::new(&envelope.scores);
    let mut drives = 0;
    for (index, line) in text.lines().enumerate() {
        let score: f64 = line.parse().map_err(|_| {
            user(journal, &format!("line {} is no score; remove the file to begin anew", index + 1))
        })?;
        martingale.add(score);
        drives += 1;
    }
    Ok(in_words(&martingale, drives))
}

/// The scores of the drives since the calibration, a line each.
fn journal_of(file: &Path) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(".drives");
    name.into()
}

fn in_words(martingale: &Martingale, drives: u32) -> String {
    if drives == 0 {
        return "no drive since this car was calibrated".to_owned();
    }
    let drives = if drives == 1 { "1 drive".to_owned() } else { format!("{drives} drives") };
    if martingale.has_changed() {
        return format!(
            "this car has changed since it was calibrated: {drives} with it say so, and if it had not, that would be so in at \
             most 1 of 100 cases; calibrate again"
        );
    }
    format!(
        "nothing says that this car has changed since it was calibrated: {drives}, evidence {:.2} of 100",
        martingale.wealth()
    )
}
