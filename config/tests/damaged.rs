//! Files of the user's that were damaged or edited: they are taken, or refused in one line; nothing panics.
//!
//! PROPTEST_CASES sets another number of cases.

// A property reads its number of cases, and paths and vehicles are files.
#![allow(clippy::disallowed_methods)]

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use config::launch::Launch;
use config::{Envelope, Layers, SweepPlan};
use proptest::prelude::*;
use proptest::sample::Index;

/// A kind of file, by its name: what one holds that is taken, and who reads it.
struct Kind {
    file: &'static str,
    text: String,
    read: fn(&Path, &str) -> Result<(), String>,
}

fn told(result: Result<impl Sized, impl ToString>) -> Result<(), String> {
    result.map(drop).map_err(|why| why.to_string())
}

/// A configuration in which a file has been laid.
fn resolved(
    layers: Layers,
    add: impl FnOnce(&mut Layers) -> Result<(), config::ConfigError>,
) -> Result<(), String> {
    let mut layers = layers;
    told(add(&mut layers).and_then(|()| layers.resolve()))
}

/// Whose first column is no time.
const LOOP: &str = "x_m,y_m,v_mps\n0,0,1\n1.5,0.5,1\n1,2,1.5\n2.5,3,1.5\n2,4.5,1\n3,6,0.5\n";
const TRACK: &str = "x_m,y_m,v_mps\n0,0,1\n1.5,0,1\n3,0.25,1.5\n4.5,1,1.5\n6,2.25,1\n7.5,4,0.5\n";

static KINDS: LazyLock<Vec<Kind>> = LazyLock::new(|| {
    let maneuver = |name: &str| Layers::maneuver(name).unwrap();
    let document = |name: &str| toml::to_string(&maneuver(name).resolve().unwrap()).unwrap();
    let path = |file: &Path, _: &str| {
        resolved(Layers::own_path(), |layers| {
            layers.set_vehicle("test", "f1tenth")?;
            layers.add_path(file)
        })
    };
    let vehicle = |file: &Path, _: &str| {
        let name = file.to_str().unwrap();
        resolved(Layers::maneuver("circuit").unwrap(), |layers| layers.set_vehicle("test", name))
    };
    let mut kinds = vec![
        Kind {
            file: "lane.toml",
            text: document("lane_change"),
            read: |_, text| {
                resolved(Layers::maneuver("lane_change").unwrap(), |it| it.add_document("lane.toml", text))
            },
        },
        Kind {
            file: "roundabout.toml",
            text: document("roundabout"),
            read: |_, text| {
                resolved(Layers::maneuver("roundabout").unwrap(), |it| {
                    it.add_document("roundabout.toml", text)
                })
            },
        },
        Kind {
            file: "launch.toml",
            text: include_str!("../launch/train.toml").to_owned(),
            read: |_, text| told(Launch::parse("launch.toml", text)),
        },
        Kind {
            file: "sweep.toml",
            text: "kind = \"drive\"\nrepeats = 0\nrealtime = true\n\
                   sets = [[{ kv = 0.1, k_l = 1.0, k_s = 6.0, k_phi = 0.7 }]]\n"
                .to_owned(),
            read: |_, text| told(SweepPlan::parse(text)),
        },
        Kind {
            file: "plants.toml",
            text: "[[plants]]\nname = \"as it is\"\n[[plants]]\nname = \"late\"\nadd = { steering_delay_s = 0.05 }\n\
                   [[plants]]\nname = \"slow\"\nscale = { steering_rate_radps = 0.5 }\n"
                .to_owned(),
            read: |file, _| {
                resolved(Layers::maneuver("lane_change").unwrap(), |it| it.add_plants(file))
            },
        },
        Kind {
            file: "envelope.toml",
            text: "threshold = 1.5\nscores = [0.5, 1.0]\n\
                   [made_for]\nmaneuver = \"lane\"\nvehicle = \"car\"\nlaw = \"paper\"\ngains = []\ntick_s = 0.01\npath = \"ab\"\n\
                   [promise]\nalpha = 0.01\ndelta = 0.05\nscaled_on = 10\nthreshold_on = 2\nabove = 0\nleft_out = 0\n\
                   varied = \"noise\"\n\
                   [[channels]]\nkind = \"yaw\"\nover_s = 1.0\nlimit = 3.0\nmean = [0.0]\nsd = [1.0]\n"
                .to_owned(),
            read: |_, text| told(Envelope::parse(text)),
        },
        Kind { file: "track.csv", text: TRACK.to_owned(), read: path },
        Kind { file: "track.txt", text: LOOP.replace(',', " ").replace("x_m y_m v_mps\n", ""), read: path },
    ];
    for (file, text) in [
        ("f1tenth.toml", include_str!("../vehicles/f1tenth.toml")),
        ("ackermann.toml", include_str!("../vehicles/ackermann.toml")),
        ("tesla.toml", include_str!("../vehicles/tesla_model_3_guarded.toml")),
    ] {
        kinds.push(Kind { file, text: text.to_owned(), read: vehicle });
    }
    kinds
});

/// What is done to a file.
#[derive(Debug, Clone)]
enum Damage {
    /// A bit is flipped.
    Bit(Index, u8),
    /// It is cut off.
    Cut(Index),
    /// A line is left out, or stands there twice.
    Line(Index, bool),
    /// A number, or a value of another kind, becomes this.
    Value(Index, &'static str),
    /// This is put in.
    Bytes(Index, Vec<u8>),
}

fn damage() -> impl Strategy<Value = Damage> {
    let values = prop::sample::select(vec![
        "nan",
        "inf",
        "-inf",
        "-1",
        "0",
        "0.0",
        "1e308",
        "-1e308",
        "5e-324",
        "99999999999999999999",
        "''",
        "\"x\"",
        "[]",
        "{}",
        "true",
        "[[[[1]]]]",
        "",
    ]);
    prop_oneof![
        2 => (any::<Index>(), 0u8..8).prop_map(|(at, bit)| Damage::Bit(at, bit)),
        1 => any::<Index>().prop_map(Damage::Cut),
        2 => (any::<Index>(), any::<bool>()).prop_map(|(at, twice)| Damage::Line(at, twice)),
        4 => (any::<Index>(), values).prop_map(|(at, value)| Damage::Value(at, value)),
        1 => (any::<Index>(), prop::collection::vec(any::<u8>(), 1..40))
            .prop_map(|(at, bytes)| Damage::Bytes(at, bytes)),
    ]
}

impl Damage {
    fn inflict(&self, bytes: &mut Vec<u8>) {
        if bytes.is_empty() {
            return;
        }
        match self {
            Self::Bit(at, bit) => {
                let at = at.index(bytes.len());
                bytes[at] ^= 1 << bit;
            }
            Self::Cut(at) => bytes.truncate(at.index(bytes.len())),
            Self::Line(at, twice) => {
                let mut lines: Vec<Vec<u8>> =
                    bytes.split_inclusive(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
                let at = at.index(lines.len());
                if *twice {
                    lines.insert(at, lines[at].clone());
                } else {
                    lines.remove(at);
                }
                *bytes = lines.concat();
            }
            Self::Value(at, value) => {
                let is_part = |byte: &u8| byte.is_ascii_alphanumeric() || b".+-\"_".contains(byte);
                let starts =
                    |at: usize| is_part(&bytes[at]) && at > 0 && b" =,[\n".contains(&bytes[at - 1]);
                let (size, first) = (bytes.len(), at.index(bytes.len()));
                if let Some(from) = (first..size).find(|it| starts(*it)) {
                    let to = (from..size).find(|it| !is_part(&bytes[*it])).unwrap_or(size);
                    bytes.splice(from..to, value.bytes());
                }
            }
            Self::Bytes(at, more) => {
                let at = at.index(bytes.len());
                bytes.splice(at..at, more.iter().copied());
            }
        }
    }
}

#[test]
fn files_that_nobody_has_damaged_are_taken() {
    let folder = tempfile::tempdir().unwrap();
    for Kind { file, text, read } in
        KINDS.iter().filter(|it| !["envelope.toml", "track.txt"].contains(&it.file))
    {
        let path = folder.path().join(file);
        fs::write(&path, text).unwrap();
        assert_eq!(read(&path, text), Ok(()), "{file}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: std::env::var("PROPTEST_CASES").map_or(400, |it| it.parse().unwrap()),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]
    #[test]
    fn damaged_files_are_taken_or_refused_in_a_line(
        kind in any::<Index>(), damages in prop::collection::vec(damage(), 1..4),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let Kind { file, text, read } = kind.get(&KINDS);
        let mut bytes = text.clone().into_bytes();
        damages.iter().for_each(|it| it.inflict(&mut bytes));
        let path = folder.path().join(file);
        fs::write(&path, &bytes).unwrap();
        if let Err(why) = read(&path, &String::from_utf8_lossy(&bytes)) {
            prop_assert!(!why.is_empty() && why.len() < 2000 && !why.contains('\n'), "{file}: {why}");
        }
    }
}
