//! `pathtune sweep status`: how the jobs of a study stand, from the records alone.

use serde_json::json;

use crate::cli::StudyArg;
use crate::study::manifest::Manifest;
use crate::study::store::{Standing, Store};
use crate::words::Failure;
use crate::words::terminal::{say, tell};

/// How many damaged lines and records are named one by one.
const NAMED: usize = 20;

/// Damaged lines and records: each is named, and in the end the command fails, after it has used the rest.
#[derive(Debug, Default)]
pub(crate) struct Damages {
    count: usize,
}

impl Damages {
    /// Names one.
    pub(crate) fn tell(&mut self, message: &str) {
        self.count += 1;
        match self.count {
            ..=NAMED => tell!("pathtune: {message}"),
            count if count == NAMED + 1 => tell!("pathtune: …"),
            _ => {}
        }
    }

    /// Whether there are none.
    pub(crate) fn end(&self) -> Result<(), Failure> {
        match self.count {
            0 => Ok(()),
            1 => Err(Failure::User("1 line or record is damaged".to_owned())),
            count => Err(Failure::User(format!("{count} lines or records are damaged"))),
        }
    }
}

/// A number of jobs as the subject of a sentence, with its verb.
pub(crate) fn jobs_have(count: usize) -> String {
    if count == 1 { "1 job has".to_owned() } else { format!("{count} jobs have") }
}

/// Numbers of jobs, written as ranges, as in `3, 7-12`; a long list ends in `…`.
pub(crate) fn ranges(numbers: &[u64]) -> String {
    const MOST: usize = 20;
    let mut ranges: Vec<(u64, u64)> = Vec::new();
    for number in numbers {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == *number => *last = *number,
            _ => ranges.push((*number, *number)),
        }
    }
    let mut words: Vec<String> = ranges
        .iter()
        .take(MOST)
        .map(|(from, to)| if from == to { from.to_string() } else { format!("{from}-{to}") })
        .collect();
    if ranges.len() > MOST {
        words.push("…".to_owned());
    }
    words.join(", ")
}

/// Says how many jobs are done, which are missing, and why others failed.
///
/// # Errors
/// If the manifest cannot be read, or a line or record is damaged.
pub(crate) fn status(at: &StudyArg, as_json: bool) -> Result<(), Failure> {
    let store = Store::of(at);
    let mut damages = Damages::default();
    let mut done = 0_u64;
    let (mut missing, mut failed, mut damaged) = (Vec::new(), Vec::new(), Vec::new());
    let mut lines = Manifest::open(&at.manifest)?.lines()?;
    for line in lines.by_ref() {
        match line {
            Err(line) => damages.tell(&line.message),
            Ok(job) => match store.standing(&job.job) {
                Standing::Done(_) => done += 1,
                Standing::Missing => missing.push(job.index),
                Standing::Failed(why) => failed.push((job.index, why)),
                Standing::Damaged(why) => {
                    damages.tell(&format!("job {}: {why}; run it again", job.index));
                    damaged.push(job.index);
                }
            },
        }
    }
    let jobs = lines.jobs();
    if as_json {
        let failed: Vec<_> = failed
            .iter()
            .map(|(index, why)| {
                json!({ "index": index, "code": why.code, "tries": why.tries, "line": why.line,
                        "host": why.host, "at": why.at })
            })
            .collect();
        let all = json!({ "jobs": jobs, "done": done, "missing": missing, "failed": failed,
                          "damaged": damaged });
        say!("{all:#}");
        return damages.end();
    }
    let (missed, fell) = (missing.len(), failed.len());
    say!("{done} of {jobs} jobs are done, {missed} missing, {fell} failed");
    if !missing.is_empty() {
        say!("missing: {}", ranges(&missing));
    }
    for (index, why) in &failed {
        let tries = if why.tries == 1 { "once" } else { &format!("{} times", why.tries) };
        say!(
            "failed: job {index} (exit code {}, tried {tries}, last on {}): {}",
            why.code,
            why.host,
            why.line
        );
    }
    damages.end()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_ranges() {
        assert_eq!(ranges(&[]), "");
        assert_eq!(ranges(&[3, 7, 8, 9, 12]), "3, 7-9, 12");
        let odd: Vec<u64> = (0..100).map(|it| 2 * it + 1).collect();
        assert!(ranges(&odd).ends_with("37, 39, …"));
    }
}
