use std::fs;
use std::sync::LazyLock;

use config::{Layers, RunConfig};
use proptest::prelude::*;

use super::*;
use crate::{Ranking, digest};

fn config(sets: &[&str]) -> RunConfig {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    for set in sets {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

fn short() -> RunConfig {
    let sets =
        ["learning.episodes=3", "learning.step_limit=8", "run.alphas=[0.1,0.5]", "learning.bins=8"];
    config(&sets)
}

/// Driven once for all tests: then a training takes only microseconds.
static RANKING: LazyLock<Ranking> = LazyLock::new(|| Ranking::by_rollout(&short()));

/// Continues the training from where the journal ends; returns it.
fn train(path: &Path, config: &RunConfig, most_drives: usize) -> Result<Training, JournalError> {
    let mut training = Training::new(config, *RANKING.objective());
    let mut journal = Journal::open(path, "c")?;
    while !journal.replay(&mut training, |_| {})? {}
    for _ in 0..most_drives {
        let mut answered = false;
        while !answered {
            let mut steps = 0;
            answered = training.remember(REMEMBERED_AT_ONCE, |_| steps += 1);
            journal.note_remembered(steps);
        }
        let Some(ask) = training.wanted().first().copied() else { break };
        let drive = RANKING.drive(&ask.parameters);
        let taken = training.take(ask.learner, ask.step, drive).unwrap();
        journal.note_driven(&[taken], training.law().count());
        journal.write()?;
    }
    journal.write()?;
    Ok(training)
}

/// The bytes of a whole journal, and the digest of its training.
static WHOLE: LazyLock<(Vec<u8>, String)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    let training = train(&path, &short(), usize::MAX).unwrap();
    (fs::read(&path).unwrap(), digest(&training))
});

#[test]
fn every_cut_goes_on_to_the_same_digest_and_journal() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    let (bytes, wanted) = &*WHOLE;
    for length in (0..bytes.len()).step_by(3) {
        fs::write(&path, &bytes[..length]).unwrap();
        assert_eq!(
            digest(&train(&path, &short(), usize::MAX).unwrap()),
            *wanted,
            "cut at {length}"
        );
        assert!(fs::read(&path).unwrap() == *bytes, "cut at {length}");
    }
}

/// What may happen to a journal.
#[derive(Debug, Clone)]
enum Damage {
    Flip {
        at: f64,
        bit: u8,
    },
    Cut {
        at: f64,
    },
    Splice {
        at: f64,
        removed: usize,
        bytes: Vec<u8>,
    },
    /// A record whose checksum is right.
    Record {
        at: f64,
        record: Record,
    },
    Zeros {
        count: usize,
    },
}

fn damage() -> impl Strategy<Value = Damage> {
    let share = 0.0..1.0;
    let numbers = prop::collection::vec(any::<f64>(), 0..6);
    let driven = (0u32..4, 0u32..30, numbers, any::<f64>(), any::<u64>()).prop_map(
        |(learner, step, parameters, mean_abs_cross_m, trace)| {
            let drive = DriveRecord { mean_abs_cross_m, trace, ..DriveRecord::default() };
            DrivenStep { learner, step, parameters, drive }
        },
    );
    let record = prop_oneof![
        any::<u32>().prop_map(Record::Remembered),
        prop::collection::vec(driven, 0..3).prop_map(Record::Driven),
    ];
    prop_oneof![
        (share.clone(), 0u8..8).prop_map(|(at, bit)| Damage::Flip { at, bit }),
        share.clone().prop_map(|at| Damage::Cut { at }),
        (share.clone(), 0usize..300, prop::collection::vec(any::<u8>(), 0..300))
            .prop_map(|(at, removed, bytes)| Damage::Splice { at, removed, bytes }),
        (share, record).prop_map(|(at, record)| Damage::Record { at, record }),
        (0usize..5000).prop_map(|count| Damage::Zeros { count }),
    ]
}

fn inflict(bytes: &mut Vec<u8>, damage: &Damage) {
    let place = |bytes: &[u8], at: f64| (at * bytes.len() as f64) as usize;
    match damage {
        Damage::Flip { at, bit } => {
            let at = place(bytes, *at);
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << bit;
            }
        }
        Damage::Cut { at } => bytes.truncate(place(bytes, *at)),
        Damage::Splice { at, removed, bytes: new } => {
            let at = place(bytes, *at);
            let end = (at + removed).min(bytes.len());
            bytes.splice(at..end, new.iter().copied());
        }
        Damage::Record { at, record } => {
            // Between two records.
            let at = place(bytes, *at);
            let at = bytes[at..].iter().position(|byte| *byte == END).map_or(at, |it| at + it + 1);
            let packed = pack(record);
            let mut framed = vec![0; cobs::max_encoding_length(packed.len())];
            let length = cobs::encode_with_sentinel(&packed, &mut framed, END);
            framed.truncate(length);
            framed.push(END);
            bytes.splice(at..at, framed);
        }
        Damage::Zeros { count } => bytes.extend(std::iter::repeat_n(0, *count)),
    }
}

proptest! {
    /// PROPTEST_CASES sets the number of cases.
    #[test]
    fn damaged_bytes_are_refused_or_change_nothing(all in prop::collection::vec(damage(), 1..4)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let (mut bytes, wanted) = WHOLE.clone();
        all.iter().for_each(|damage| inflict(&mut bytes, damage));
        fs::write(&path, &bytes).unwrap();
        let invented = all.iter().any(|damage| {
            matches!(damage, Damage::Record { record: Record::Driven(drives), .. } if !drives.is_empty())
        });
        match train(&path, &short(), usize::MAX) {
            Ok(training) => prop_assert!(digest(&training) == wanted || invented),
            Err(error) => prop_assert!(error.to_string().contains("journal"), "{error}"),
        }
    }
}

#[test]
fn damage_in_the_middle_is_named_by_its_offset() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    let (bytes, _) = &*WHOLE;
    for at in (0..bytes.len() - 200).step_by(11) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1;
        fs::write(&path, &damaged).unwrap();
        let error = train(&path, &short(), 0).unwrap_err();
        let JournalError::Damaged { offset, .. } = error else { panic!("{error}") };
        assert!(offset <= at as u64 && at as u64 - offset < 2000, "{at}: {error}");
    }
}

#[test]
fn a_sparse_journal_is_refused_and_a_short_row_of_zeros_cut_off() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    let (bytes, wanted) = &*WHOLE;
    let open = |from: u64, length: u64| {
        fs::write(&path, &bytes[..from as usize]).unwrap();
        File::options().write(true).open(&path).unwrap().set_len(length).unwrap();
        train(&path, &short(), usize::MAX)
    };
    for from in [0, bytes.len() as u64] {
        let error = open(from, 2 << 30).unwrap_err().to_string();
        assert!(error.contains(&format!("damaged at byte {from}: a record without")), "{error}");
    }
    assert_eq!(digest(&open(bytes.len() as u64, bytes.len() as u64 + 9999).unwrap()), *wanted);
    assert!(fs::read(&path).unwrap() == *bytes);
}

#[test]
fn a_journal_of_another_configuration_or_version_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    train(&path, &short(), 3).unwrap();
    assert!(matches!(Journal::open(&path, "d"), Err(JournalError::Foreign { .. })));
    let configuration = || "c".to_owned();
    for earlier in [
        Record::Opening { version: VERSION - 1, layout: layout(), configuration: configuration() },
        Record::Opening { version: VERSION, layout: !layout(), configuration: configuration() },
    ] {
        fs::write(&path, []).unwrap();
        inflict_record(&path, earlier);
        assert!(matches!(Journal::open(&path, "c"), Err(JournalError::Earlier { .. })));
    }
    // The first line of a journal as earlier versions wrote it.
    let earlier = r#"{"journal":2,"configuration":"c"}"#;
    fs::write(&path, format!("{:08x} {earlier}\n", crc32fast::hash(earlier.as_bytes()))).unwrap();
    assert!(matches!(Journal::open(&path, "c"), Err(JournalError::Earlier { .. })));
}

fn inflict_record(path: &Path, record: Record) {
    let mut bytes = fs::read(path).unwrap();
    inflict(&mut bytes, &Damage::Record { at: 0.0, record });
    fs::write(path, bytes).unwrap();
}

#[test]
fn remembered_steps_cost_next_to_nothing_and_drives_little() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    let training = train(&path, &config(&["learning.episodes=200"]), usize::MAX).unwrap();
    let (asked, driven) = (training.asked_drives(), training.distinct_drives());
    let length = fs::metadata(&path).unwrap().len();
    println!("{asked} steps, {driven} of them driven, {length} bytes");
    assert!(asked > 100 * driven, "mostly remembered");
    assert!(length < 210 * driven + asked / 50 + 100, "{length} bytes");
}
