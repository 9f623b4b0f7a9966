//! The manifest: a file with one JSON line for each job of a study.
//!
//! All lines are padded with spaces to the same length, so that a job finds its own without reading those before it: a
//! million jobs on a shared file system would otherwise read a gigabyte each. A line carries a checksum, so that a damaged
//! line is one job's loss and no other's.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use config::open_regular;
use serde::{Deserialize, Serialize};

use crate::study::axes::compared_over;
use crate::words::Failure;

/// The longest line that is read; that of a job has some 300 bytes.
const LONGEST: u64 = 64 << 10;

/// One job of a study, as in its line.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Job {
    /// Its place in the manifest, counted from 0.
    pub(crate) index: u64,
    /// Its identity: a hash of what decides its result.
    pub(crate) job: String,
    /// The value of each axis that the study names.
    pub(crate) axes: BTreeMap<String, String>,
    /// The words after `pathtune`; names of files are relative to the manifest's folder.
    pub(crate) command: Vec<String>,
}

#[derive(Serialize, Deserialize)]
struct Line {
    #[serde(flatten)]
    job: Job,
    /// CRC-32 of the line without this key.
    check: String,
}

impl Job {
    /// Its line, without padding and line feed.
    fn to_line(&self) -> String {
        let text = serde_json::to_string(self).expect("plain data");
        let check = checksum(&text);
        format!("{},\"check\":\"{check}\"}}", text.strip_suffix('}').expect("an object"))
    }

    /// Reads a line.
    fn parse(line: &str) -> Result<Self, String> {
        let Line { job, check } =
            serde_json::from_str(line.trim_end()).map_err(|error| error.to_string())?;
        let text = serde_json::to_string(&job).expect("plain data");
        if checksum(&text) != check || job.job.len() != IDENTITY || !is_hex(&job.job) {
            return Err("its checksum does not fit".to_owned());
        }
        Ok(job)
    }

    /// The command as it is typed into a shell; what no option of it says follows as a comment.
    pub(crate) fn typed(&self) -> String {
        let typed = format!("pathtune {}", shell_words::join(&self.command));
        match compared_over(&self.axes) {
            Some(drives) => format!("{typed} # compared over {drives} drives"),
            None => typed,
        }
    }
}

/// Number of digits of an identity.
pub(crate) const IDENTITY: usize = 32;

fn is_hex(text: &str) -> bool {
    text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

/// A checksum of a text, as it stands in files.
pub(crate) fn checksum(text: &str) -> String {
    format!("{:08x}", crc32fast::hash(text.as_bytes()))
}

/// Writes the lines of a manifest, twice: once to learn the length of the longest, once for the file.
pub(crate) fn write(
    path: &Path,
    mut each: impl FnMut(&mut dyn FnMut(&Job) -> Result<(), Failure>) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut longest = 0;
    each(&mut |job| {
        longest = longest.max(job.to_line().len());
        Ok(())
    })?;
    if longest as u64 >= LONGEST {
        return Err(Failure::User(format!("a job's line has {longest} bytes; shorten its values")));
    }
    let fail = |error: std::io::Error| {
        Failure::User(format!("{}: cannot be written: {error}", path.display()))
    };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let part = path.with_file_name(format!(".{name}.part"));
    let _ = std::fs::remove_file(&part);
    let mut file = std::io::BufWriter::new(File::create_new(&part).map_err(fail)?);
    each(&mut |job| writeln!(file, "{:longest$}", job.to_line()).map_err(fail))?;
    file.into_inner().map_err(|error| fail(error.into_error()))?;
    std::fs::rename(&part, path).map_err(fail)
}

/// A manifest that is read.
#[derive(Debug)]
pub(crate) struct Manifest {
    path: PathBuf,
    /// Length of a line with its line feed, as the first line tells it.
    width: u64,
    /// Length of the file.
    bytes: u64,
}

/// A line that cannot be read: which one, and why.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Damaged {
    /// What is said of it, with the file and the line.
    pub(crate) message: String,
}

impl Manifest {
    /// Opens a manifest.
    ///
    /// # Errors
    /// If it cannot be read.
    pub(crate) fn open(path: &Path) -> Result<Self, Failure> {
        let fail = |why: String| Failure::User(format!("{}: {why}", path.display()));
        let read = || {
            let file = open_regular(path)?;
            let bytes = file.metadata()?.len();
            let mut first = Vec::new();
            BufReader::new(file).take(LONGEST).read_until(b'\n', &mut first)?;
            Ok((bytes, first.len() as u64))
        };
        let (bytes, width) = read().map_err(|error: std::io::Error| fail(error.to_string()))?;
        if width == 0 {
            return Err(fail("is empty; `pathtune sweep plan` writes a manifest".to_owned()));
        }
        Ok(Self { path: path.to_owned(), width, bytes })
    }

    /// The number of lines, if all have the same length.
    pub(crate) fn len(&self) -> u64 {
        self.bytes.div_ceil(self.width)
    }

    /// The job with this index.
    ///
    /// # Errors
    /// If there is none, or its line is damaged.
    pub(crate) fn job(&self, index: u64) -> Result<Job, Failure> {
        if let Some(job) = self.job_at(index).filter(|job| job.index == index) {
            return Ok(job);
        }
        // Lines were lost or made longer: the job is where its line says so.
        let mut at_its_place = None;
        for (number, line) in (0..).zip(self.lines()?) {
            match line {
                Ok(job) if job.index == index => return Ok(job),
                Err(damaged) if number == index => at_its_place = Some(damaged.message),
                _ => {}
            }
        }
        Err(Failure::User(at_its_place.unwrap_or_else(|| {
            let last = self.len().saturating_sub(1);
            format!("{}: holds no job {index}; they are 0 to {last}", self.path.display())
        })))
    }

    fn job_at(&self, index: u64) -> Option<Job> {
        let mut file = open_regular(&self.path).ok()?;
        file.seek(SeekFrom::Start(index.checked_mul(self.width)?)).ok()?;
        let mut line = String::new();
        file.take(self.width).read_to_string(&mut line).ok()?;
        Job::parse(&line).ok()
    }

    /// All lines in their order: jobs, and lines that are damaged.
    ///
    /// # Errors
    /// If the file cannot be opened.
    pub(crate) fn lines(
        &self,
    ) -> Result<impl Iterator<Item = Result<Job, Damaged>> + use<>, Failure> {
        let file = open_regular(&self.path).map_err(|error| {
            Failure::User(format!("{}: cannot be read: {error}", self.path.display()))
        })?;
        let mut reader = BufReader::with_capacity(1 << 16, file);
        let path = self.path.clone();
        let mut number = 0_u64;
        Ok(std::iter::from_fn(move || {
            let mut bytes = Vec::new();
            number += 1;
            let damaged = |why: String| {
                let place = format!("{}:{number}", path.display());
                let way_on = "write the manifest again with `pathtune sweep plan`";
                Some(Err(Damaged { message: format!("{place}: damaged ({why}); {way_on}") }))
            };
            match reader.by_ref().take(LONGEST).read_until(b'\n', &mut bytes) {
                Ok(0) => None,
                Ok(_) if bytes.last() != Some(&b'\n') && bytes.len() as u64 == LONGEST => {
                    // The rest of a line without end is skipped, in pieces.
                    let _ = reader.skip_until(b'\n');
                    damaged(format!("longer than {} KiB", LONGEST >> 10))
                }
                Ok(_) => match std::str::from_utf8(&bytes) {
                    Ok(line) => match Job::parse(line) {
                        Ok(job) => Some(Ok(job)),
                        Err(why) => damaged(why),
                    },
                    Err(_) => damaged("not UTF-8".to_owned()),
                },
                Err(error) => {
                    // Nothing more can be read: this is the last item.
                    bytes.clear();
                    reader = BufReader::new(open_regular(Path::new("/dev/null")).ok()?);
                    damaged(error.to_string())
                }
            }
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jobs(count: u64) -> Vec<Job> {
        let job = |index: u64| Job {
            index,
            job: format!("{index:032x}"),
            axes: BTreeMap::from([("seed".to_owned(), index.to_string())]),
            command: vec!["train".to_owned(), "a b".repeat(index as usize)],
        };
        (0..count).map(job).collect()
    }

    fn written(count: u64) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("study.jsonl");
        write(&path, |take| jobs(count).iter().try_for_each(take)).unwrap();
        (folder, path)
    }

    #[test]
    fn each_job_is_found_alone_and_in_its_order() {
        let (_folder, path) = written(12);
        let manifest = Manifest::open(&path).unwrap();
        assert_eq!(manifest.len(), 12);
        let all: Vec<Job> = manifest.lines().unwrap().map(Result::unwrap).collect();
        assert_eq!(all, jobs(12));
        for index in 0..12 {
            assert_eq!(manifest.job_at(index).unwrap(), all[index as usize]);
        }
        let why = manifest.job(12).unwrap_err();
        assert_eq!(why.code(), 64);
        assert!(why.message().contains("holds no job 12; they are 0 to 11"), "{}", why.message());
    }

    #[test]
    fn a_damaged_line_costs_its_own_job_alone() {
        let (_folder, path) = written(5);
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let damages: [&dyn Fn(&str) -> String; 6] = [
            // Another digit in the command or in the axes, which JSON allows.
            &|line| line.replace("train", "trail"),
            &|line| line.replace("\"seed\":\"2\"", "\"seed\":\"3\""),
            &|line| line[..20].to_owned(),
            &|_| String::new(),
            &|line| line.repeat(1000),
            &|_| "\u{0}\u{1}".to_owned(),
        ];
        for damage in damages {
            let changed: Vec<String> = (0..5)
                .map(|at| if at == 2 { damage(lines[at]) } else { lines[at].to_owned() })
                .collect();
            std::fs::write(&path, changed.join("\n") + "\n").unwrap();
            let manifest = Manifest::open(&path).unwrap();
            for index in [0, 1, 3, 4] {
                assert_eq!(manifest.job(index).unwrap().index, index);
            }
            let why = manifest.job(2).unwrap_err();
            assert_eq!(why.code(), 64);
            assert!(why.message().contains("study.jsonl:3: damaged"), "{}", why.message());
            let good = manifest.lines().unwrap().filter(Result::is_ok).count();
            assert_eq!(good, 4);
        }
    }
}
