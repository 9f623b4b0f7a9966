//! Runs whose files were damaged or edited: a page or one line that says what is wrong, never a panic.

mod support;

use std::fs;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use proptest::sample::Index;
use report::write_report;
use serde_json::{Value, json};

type Run = (tempfile::TempDir, Vec<PathBuf>);

thread_local! {
    /// A run of each kind. A thread's own, because a static one would leave its folders behind.
    static RUNS: Vec<Run> = [support::train, support::validate, support::grid]
        .into_iter()
        .map(|write| {
            let folder = tempfile::tempdir().unwrap();
            write(folder.path()).unwrap();
            let files = files_below(folder.path());
            (folder, files)
        })
        .collect();
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(files_below(&path));
        } else {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// What is done to one file of a run.
#[derive(Debug, Clone)]
enum Damage {
    /// A value of the result becomes another one.
    Value(Index, Value),
    /// A value of the result is left out.
    Gone(Index),
    /// A bit of any file is flipped.
    Bit(Index, Index, u8),
    /// Any file is cut.
    Cut(Index, Index),
    /// A number in any file becomes another text.
    Number(Index, Index, &'static str),
}

fn damage() -> impl Strategy<Value = Damage> {
    let value = prop::sample::select(vec![
        json!(null),
        json!(-1),
        json!(0),
        json!(u64::MAX),
        json!(1e308),
        json!(-1e308),
        json!(5e-324),
        json!(""),
        json!("x".repeat(5000)),
        json!([]),
        json!({}),
        json!(true),
        json!([0, 0, 0, 0, 0, 0, 0, 0, 0]),
    ]);
    let number = prop::sample::select(vec![
        "nan",
        "inf",
        "-1e308",
        "1e308",
        "",
        "0",
        "99999999999999999999",
    ]);
    prop_oneof![
        4 => (any::<Index>(), value).prop_map(|(at, value)| Damage::Value(at, value)),
        1 => any::<Index>().prop_map(Damage::Gone),
        1 => (any::<Index>(), any::<Index>(), 0u8..8).prop_map(|(file, at, bit)| Damage::Bit(file, at, bit)),
        1 => (any::<Index>(), any::<Index>()).prop_map(|(file, at)| Damage::Cut(file, at)),
        2 => (any::<Index>(), any::<Index>(), number)
            .prop_map(|(file, at, number)| Damage::Number(file, at, number)),
    ]
}

/// Where all values below one are, as JSON pointers.
fn pointers(value: &Value, at: &str, all: &mut Vec<String>) {
    all.push(at.to_owned());
    match value {
        Value::Array(items) => {
            items
                .iter()
                .enumerate()
                .for_each(|(index, item)| pointers(item, &format!("{at}/{index}"), all));
        }
        Value::Object(items) => {
            items.iter().for_each(|(key, item)| pointers(item, &format!("{at}/{key}"), all));
        }
        _ => {}
    }
}

impl Damage {
    /// Damages a file of a run, of which `files` are there; returns which, and what it held.
    fn inflict(&self, run: &Path, files: &[PathBuf]) -> (PathBuf, Vec<u8>) {
        let file = match self {
            Self::Value(..) | Self::Gone(_) => run.join("result.json"),
            Self::Bit(file, ..) | Self::Cut(file, _) | Self::Number(file, ..) => {
                file.get(files).clone()
            }
        };
        let was = fs::read(&file).unwrap();
        let mut bytes = was.clone();
        match self {
            Self::Value(at, _) | Self::Gone(at) => {
                let mut result: Value = serde_json::from_slice(&bytes).unwrap();
                let mut all = Vec::new();
                pointers(&result, "", &mut all);
                let pointer = at.get(&all);
                if let Self::Value(_, value) = self {
                    *result.pointer_mut(pointer).unwrap() = value.clone();
                } else if let Some((above, last)) = pointer.rsplit_once('/') {
                    match result.pointer_mut(above).unwrap() {
                        Value::Object(items) => drop(items.remove(last)),
                        Value::Array(items) => drop(items.remove(last.parse().unwrap())),
                        _ => {}
                    }
                }
                bytes = serde_json::to_vec(&result).unwrap();
            }
            Self::Bit(_, at, bit) => bytes[at.index(was.len())] ^= 1 << bit,
            Self::Cut(_, at) => bytes.truncate(at.index(was.len())),
            Self::Number(_, at, number) => {
                let is_number = |byte: &u8| byte.is_ascii_digit() || b".+-e".contains(byte);
                let at = at.index(was.len());
                if let Some(from) = was[at..].iter().position(is_number).map(|more| at + more) {
                    let to = was[from..]
                        .iter()
                        .position(|it| !is_number(it))
                        .map_or(was.len(), |more| from + more);
                    bytes.splice(from..to, number.bytes());
                }
            }
        }
        fs::write(&file, bytes).unwrap();
        (file, was)
    }
}

proptest! {
    // PROPTEST_CASES sets another number of cases.
    #![proptest_config(ProptestConfig {
        cases: std::env::var("PROPTEST_CASES").map_or(48, |it| it.parse().unwrap()),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]
    #[test]
    fn a_damaged_run_is_a_page_or_one_line_that_names_the_file(kind in 0usize..3, damage in damage()) {
        // One thread runs all cases of a property.
        RUNS.with(|runs| {
            let (folder, files) = &runs[kind];
            let (file, was) = damage.inflict(folder.path(), files);
            let written = write_report(folder.path());
            fs::write(file, was).unwrap();
            if let Err(error) = written {
                let told = error.to_string();
                prop_assert!(told.len() < 2000 && !told.contains('\n'), "{told}");
                let is_named = |file: &PathBuf| told.contains(&*file.display().to_string());
                prop_assert!(files.iter().any(is_named), "{told}");
            }
            Ok(())
        })?;
    }
}
