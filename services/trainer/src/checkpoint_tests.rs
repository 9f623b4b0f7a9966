use std::sync::LazyLock;

use config::Layers;
use proptest::prelude::*;

use super::*;
use crate::journal::REMEMBERED_AT_ONCE;
use crate::story::{DRIVES_FILE, EPISODES_FILE, Story};
use crate::training::Taken;
use crate::{Ranking, digest};

const JOURNAL: &str = "journal";

fn config() -> RunConfig {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    let short = ["learning.episodes=6", "learning.step_limit=12", "learning.bins=8"];
    for set in short.into_iter().chain(["run.alphas=[0.1,0.5,0.9]"]) {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

/// Driven once for all tests.
static RANKING: LazyLock<Ranking> = LazyLock::new(|| Ranking::by_rollout(&config()));

/// Rounds between two checkpoints.
const OFTEN: usize = 3;
const SELDOM: usize = 12;
const NEVER: usize = usize::MAX;

/// What a trainer does until it is killed after so many rounds, with a checkpoint after each `every` of them. Returns
/// the digest once the training is over, and how many steps were replayed.
fn live(folder: &Path, rounds: usize, every: usize) -> (Option<String>, usize) {
    let config = config();
    let mut journal = Journal::open(&folder.join(JOURNAL), "c").unwrap();
    let new = Training::new(&config, *RANKING.objective());
    let (mut training, lengths) = take_up(folder, "c", &config, &mut journal, new).unwrap();
    let mut story = Story::open(folder, &config.law, 10.0, lengths).unwrap();
    let mut keeper = Keeper::new(folder, "c".to_owned());
    let mut replayed = 0;
    let mut each = |taken: &Taken| {
        replayed += 1;
        story.add(taken).unwrap();
    };
    while !journal.replay(&mut training, &mut each).unwrap() {}
    for round in 0..rounds {
        let mut remembered = Vec::new();
        // As if the most were two: then rounds end in the middle of what memory answers.
        let most = REMEMBERED_AT_ONCE.min(2);
        let answered = training.remember(most, |taken| remembered.push(taken.clone()));
        journal.note_remembered(remembered.len());
        remembered.iter().for_each(|taken| story.add(taken).unwrap());
        journal.write().unwrap();
        if round % every == every - 1 {
            keeper.keep(&journal, story.written().unwrap(), &training).unwrap();
            keeper.finish().unwrap();
        }
        if !answered {
            continue;
        }
        let wanted = training.wanted();
        if wanted.is_empty() {
            story.flush().unwrap();
            return (Some(digest(&training)), replayed);
        }
        let take = |ask: &crate::tuners::Ask| {
            training.take(ask.learner, ask.step, RANKING.drive(&ask.parameters)).unwrap()
        };
        let taken: Vec<Taken> = wanted.iter().map(take).collect();
        journal.note_driven(&taken, config.law.count());
        taken.iter().for_each(|taken| story.add(taken).unwrap());
    }
    // A kill loses what is not in the files yet.
    std::mem::forget(story);
    (None, replayed)
}

/// A training's files at its end.
fn files(folder: &Path) -> [Vec<u8>; 3] {
    [JOURNAL, EPISODES_FILE, DRIVES_FILE].map(|name| fs::read(folder.join(name)).unwrap())
}

/// Files and digest of a training that nobody disturbed.
static CALM: LazyLock<([Vec<u8>; 3], String)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let (digest, _) = live(folder.path(), usize::MAX, NEVER);
    (files(folder.path()), digest.unwrap())
});

#[track_caller]
fn ends_as_the_calm_one(folder: &Path, every: usize) -> usize {
    let (digest, replayed) = live(folder, usize::MAX, every);
    assert_eq!(digest.as_ref(), Some(&CALM.1));
    assert!(files(folder) == CALM.0, "journal or tables differ");
    replayed
}

#[test]
fn kills_at_any_round_change_no_byte_and_cost_a_few_steps() {
    for rounds in [2, 3, 4, 5, 7] {
        let folder = tempfile::tempdir().unwrap();
        let mut kills = 0;
        let (digest, most) = loop {
            let (digest, replayed) = live(folder.path(), rounds, OFTEN);
            kills += 1;
            // What comes after a checkpoint is at most two rounds of three learners.
            let most = if rounds < 3 { usize::MAX } else { 20 };
            assert!(replayed <= most, "{replayed} steps replayed after {kills} kills");
            // Without a checkpoint a killed trainer comes no further than its journal.
            if digest.is_some() || kills > 2000 {
                break (digest, kills);
            }
        };
        assert_eq!(digest.as_ref(), Some(&CALM.1), "killed {most} times after {rounds} rounds");
        assert!(files(folder.path()) == CALM.0, "{rounds}: journal or tables differ");
    }
}

/// What may happen to checkpoints and to the files that they belong to: no harm comes of it.
#[test]
fn no_checkpoint_is_needed_and_none_does_harm() {
    let newest = FILES[0];
    let previous = FILES[1];
    let cut = |path: &Path, less: u64| {
        let file = File::options().write(true).open(path).unwrap();
        file.set_len(file.metadata().unwrap().len().saturating_sub(less)).unwrap();
    };
    let flip = |path: &Path| {
        let mut bytes = fs::read(path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 4;
        fs::write(path, bytes).unwrap();
    };
    type Blow<'a> = &'a dyn Fn(&Path);
    let blows: [(&str, Blow<'_>, usize); 12] = [
        ("nothing", &|_| {}, 20),
        ("half a part file", &|it| fs::write(it.join(PART), "half").unwrap(), 20),
        ("killed between the renames", &|it| fs::remove_file(it.join(newest)).unwrap(), 40),
        ("newest damaged", &|it| flip(&it.join(newest)), 40),
        ("newest torn", &|it| cut(&it.join(newest), 100), 40),
        ("newest empty", &|it| fs::write(it.join(newest), "").unwrap(), 40),
        ("both damaged", &|it| FILES.iter().for_each(|name| flip(&it.join(name))), usize::MAX),
        (
            "none left",
            &|it| FILES.iter().for_each(|name| fs::remove_file(it.join(name)).unwrap()),
            usize::MAX,
        ),
        (
            "a folder",
            &|it| {
                fs::remove_file(it.join(previous)).unwrap();
                fs::create_dir(it.join(previous)).unwrap();
                fs::remove_file(it.join(newest)).unwrap();
            },
            usize::MAX,
        ),
        ("a table lost", &|it| fs::remove_file(it.join(DRIVES_FILE)).unwrap(), usize::MAX),
        ("a table cut short", &|it| cut(&it.join(EPISODES_FILE), 1), usize::MAX),
        ("an older journal", &|it| cut(&it.join(JOURNAL), 2500), usize::MAX),
    ];
    for (name, blow, most) in blows {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(live(folder.path(), 28, OFTEN).0, None);
        blow(folder.path());
        // A folder in the way of a checkpoint is told.
        if name == "a folder" {
            fs::remove_dir(folder.path().join(previous)).unwrap();
        }
        let replayed = ends_as_the_calm_one(folder.path(), SELDOM);
        println!("{name}: {replayed} steps replayed");
        assert!(replayed <= most, "{name}: {replayed} steps replayed");
        assert!(!folder.path().join(PART).exists(), "{name}");
    }
}

#[test]
fn a_checkpoint_of_another_journal_is_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    live(folder.path(), 9, OFTEN);
    let Checkpoint { journal: mark, .. } = read(&folder.path().join(FILES[0]), "c").unwrap();
    let path = folder.path().join(JOURNAL);
    let fits = || Journal::open(&path, "c").unwrap().go_to(&mark).unwrap();
    assert!(fits());
    let mut bytes = fs::read(&path).unwrap();
    let near_end = bytes.len() - 1000;
    bytes[near_end] ^= 1;
    fs::write(&path, bytes).unwrap();
    assert!(!fits());
}

#[test]
fn checkpoints_of_others_are_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    live(folder.path(), 9, OFTEN);
    let path = folder.path().join(FILES[0]);
    assert!(read(&path, "c").is_some());
    assert!(read(&path, "another configuration").is_none());
    let edited = |edit: &dyn Fn(&mut Checkpoint)| {
        let mut checkpoint = read(&path, "c").unwrap();
        edit(&mut checkpoint);
        let other = folder.path().join("other");
        fs::write(&other, pack(&checkpoint)).unwrap();
        read(&other, "c").is_some()
    };
    assert!(edited(&|_| {}));
    assert!(!edited(&|it| it.version += 1));
    assert!(!edited(&|it| it.release.push('1')));
}

/// The files of a training that was killed.
static KILLED: LazyLock<[(&str, Vec<u8>); 5]> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    live(folder.path(), 28, OFTEN);
    let names = [FILES[0], FILES[1], JOURNAL, EPISODES_FILE, DRIVES_FILE];
    names.map(|name| (name, fs::read(folder.path().join(name)).unwrap()))
});

proptest! {
    /// PROPTEST_CASES sets the number of cases.
    #[test]
    fn damaged_checkpoints_change_nothing(
        at in 0.0..1.0, removed in 0usize..300, bytes in prop::collection::vec(any::<u8>(), 0..300), damaged in 1..3usize,
    ) {
        let folder = tempfile::tempdir().unwrap();
        for (index, (name, there)) in KILLED.iter().enumerate() {
            let mut there = there.clone();
            if index < damaged {
                let at = (at * there.len() as f64) as usize;
                let end = (at + removed).min(there.len());
                there.splice(at..end, bytes.iter().copied());
            }
            fs::write(folder.path().join(name), there).unwrap();
        }
        ends_as_the_calm_one(folder.path(), NEVER);
    }
}
