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

use crate::study::axes::{MOST_JOBS, compared_over};
use crate::study::status::{jobs_have, ranges};
use crate::words::Failure;

/// The longest line that is read; that of a job has some 300 bytes.
const LONGEST: u64 = 64 << 10;
/// The most bytes of a line that are skipped in search of its end.
const MOST_SKIPPED: u64 = 16 << 20;

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

/// A line, but for its checksum.
#[derive(Serialize, Deserialize)]
struct Line<J> {
    #[serde(flatten)]
    job: J,
    /// Number of jobs in the manifest: a line that is lost can be missed.
    of: u64,
}

#[derive(Deserialize)]
struct Checked {
    #[serde(flatten)]
    line: Line<Job>,
    /// CRC-32 of the line without this key.
    check: String,
}

impl Job {
    /// Its line in a manifest of so many jobs, without padding and line feed.
    fn to_line(&self, of: u64) -> String {
        let text = serde_json::to_string(&Line { job: self, of }).expect("plain data");
        let check = checksum(&text);
        format!("{},\"check\":\"{check}\"}}", text.strip_suffix('}').expect("an object"))
    }

    /// Reads a line: the job, and the number of jobs in its manifest.
    fn parse(line: &str) -> Result<(Self, u64), String> {
        let Checked { line, check } =
            serde_json::from_str(line.trim_end()).map_err(|error| error.to_string())?;
        let text = serde_json::to_string(&line).expect("plain data");
        let Line { job, of } = line;
        if checksum(&text) != check || job.job.len() != IDENTITY || !is_hex(&job.job) {
            return Err("its checksum does not fit".to_owned());
        }
        if job.index >= of || of > MOST_JOBS {
            return Err(format!("there is no job {} of {of}", job.index));
        }
        Ok((job, of))
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
    let (mut longest, mut of) = (0, 0);
    each(&mut |job| {
        longest = longest.max(job.to_line(MOST_JOBS).len());
        of += 1;
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
    each(&mut |job| writeln!(file, "{:longest$}", job.to_line(of)).map_err(fail))?;
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
        Some(Job::parse(&line).ok()?.0)
    }

    /// All lines in their order: jobs, lines that are damaged, and at last, if there are any, the jobs without a line.
    ///
    /// # Errors
    /// If the file cannot be opened.
    pub(crate) fn lines(&self) -> Result<Lines, Failure> {
        let file = open_regular(&self.path).map_err(|error| {
            Failure::User(format!("{}: cannot be read: {error}", self.path.display()))
        })?;
        Ok(Lines {
            path: self.path.clone(),
            reader: Some(BufReader::with_capacity(1 << 16, file)),
            number: 0,
            damaged: 0,
            of: None,
            seen: Vec::new(),
        })
    }
}

/// Reads the lines of a manifest one after the other.
#[derive(Debug)]
pub(crate) struct Lines {
    path: PathBuf,
    /// Until the end.
    reader: Option<BufReader<File>>,
    /// Lines read so far, and how many of them were damaged.
    number: u64,
    damaged: u64,
    /// Number of jobs in the manifest, as its first whole line says.
    of: Option<u64>,
    /// The jobs seen, a bit each.
    seen: Vec<u64>,
}

impl Lines {
    /// Number of jobs in the manifest; of lines, if no line is whole. To be asked at the end.
    pub(crate) fn jobs(&self) -> u64 {
        self.of.unwrap_or(self.number)
    }

    /// The jobs of which no whole line was seen. To be asked at the end.
    pub(crate) fn lost(&self) -> Vec<u64> {
        let is_seen = |index: &u64| {
            self.seen.get((index / 64) as usize).is_some_and(|bits| bits >> (index % 64) & 1 == 1)
        };
        (0..self.jobs()).filter(|index| !is_seen(index)).collect()
    }

    /// Takes a line that was read, with its line feed.
    fn take(&mut self, line: &[u8]) -> Result<Job, String> {
        let line = std::str::from_utf8(line).map_err(|_| "not UTF-8".to_owned())?;
        let (job, of) = Job::parse(line)?;
        if *self.of.get_or_insert(of) != of {
            return Err("it belongs to another manifest".to_owned());
        }
        let (word, bit) = ((job.index / 64) as usize, 1 << (job.index % 64));
        if self.seen.len() <= word {
            self.seen.resize(word + 1, 0);
        }
        if self.seen[word] & bit != 0 {
            return Err(format!("job {} again", job.index));
        }
        self.seen[word] |= bit;
        Ok(job)
    }

    fn damage(&mut self, why: &str) -> Damaged {
        self.damaged += 1;
        let place = format!("{}:{}", self.path.display(), self.number);
        Damaged { message: format!("{place}: damaged ({why}); {WAY_ON}") }
    }

    /// What is said at the end, if more jobs have no line than lines were damaged.
    fn end(&self) -> Option<Damaged> {
        let lost = self.lost();
        let (path, have, ranges) = (self.path.display(), jobs_have(lost.len()), ranges(&lost));
        (lost.len() as u64 > self.damaged)
            .then(|| Damaged { message: format!("{path}: {have} no line ({ranges}); {WAY_ON}") })
    }
}

const WAY_ON: &str = "write the manifest again with `pathtune sweep plan`";

impl Iterator for Lines {
    type Item = Result<Job, Damaged>;

    fn next(&mut self) -> Option<Self::Item> {
        let reader = self.reader.as_mut()?;
        let mut bytes = Vec::new();
        match reader.take(LONGEST).read_until(b'\n', &mut bytes) {
            Ok(0) => {
                self.reader = None;
                return self.end().map(Err);
            }
            Ok(_) => self.number += 1,
            Err(error) => {
                // Nothing more can be read: this is the last item.
                self.reader = None;
                self.number += 1;
                return Some(Err(self.damage(&error.to_string())));
            }
        }
        let taken = if bytes.last() != Some(&b'\n') && bytes.len() as u64 == LONGEST {
            // The rest of it is skipped, in pieces; after that much the file is none of ours.
            let skipped = reader.take(MOST_SKIPPED).skip_until(b'\n');
            if skipped.map_or(true, |bytes| bytes as u64 == MOST_SKIPPED) {
                self.reader = None;
            }
            Err(format!("longer than {} KiB", LONGEST >> 10))
        } else {
            self.take(&bytes)
        };
        Some(taken.map_err(|why| self.damage(&why)))
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
    fn lines_that_are_lost_or_there_twice_are_missed() {
        let (_folder, path) = written(5);
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let (_other, other) = written(6);
        let foreign = std::fs::read_to_string(other).unwrap();
        let foreign = foreign.lines().next_back().unwrap();
        // The lines that are left, what is said of them, and the jobs that are lost.
        let cases: [(Vec<&str>, &[&str], &[u64]); 7] = [
            (lines[..4].to_vec(), &["study.jsonl: 1 job has no line (4); "], &[4]),
            (lines[2..].to_vec(), &["study.jsonl: 2 jobs have no line (0-1); "], &[0, 1]),
            ([&lines[..], &lines[3..4]].concat(), &["study.jsonl:6: damaged (job 3 again); "], &[]),
            (
                [&lines[..2], &lines[..1], &lines[3..]].concat(),
                &["study.jsonl:3: damaged (job 0 again)"],
                &[2],
            ),
            ([&lines[..4], &["{"]].concat(), &["study.jsonl:5: damaged (EOF"], &[4]),
            (
                [&lines[..3], &["{"]].concat(),
                &["study.jsonl:4: damaged (EOF", "study.jsonl: 2 jobs have no line (3-4)"],
                &[3, 4],
            ),
            (
                [&lines[..], &[foreign]].concat(),
                &["study.jsonl:6: damaged (it belongs to another manifest)"],
                &[],
            ),
        ];
        for (left, said, lost) in cases {
            std::fs::write(&path, left.join("\n") + "\n").unwrap();
            let mut lines = Manifest::open(&path).unwrap().lines().unwrap();
            let damaged: Vec<String> =
                lines.by_ref().filter_map(|it| Some(it.err()?.message)).collect();
            assert_eq!(damaged.len(), said.len(), "{damaged:?}");
            assert!(damaged.iter().zip(said).all(|(it, part)| it.contains(part)), "{damaged:?}");
            assert_eq!((lines.lost(), lines.jobs()), (lost.to_vec(), 5));
        }
        // The order of the lines is not what they say.
        std::fs::write(&path, lines.iter().rev().map(|it| format!("{it}\n")).collect::<String>())
            .unwrap();
        assert!(Manifest::open(&path).unwrap().lines().unwrap().all(|it| it.is_ok()));
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
