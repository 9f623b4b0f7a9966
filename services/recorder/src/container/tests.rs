//! Damaged and hostile files: none makes the reader panic, believe what is not so, or take memory without bound.
//!
//! `PROPTEST_CASES=100000 cargo test --release -p recorder container` for many cases.

use std::sync::OnceLock;

use config::Layers;
use ipc_types::layout::Bytes;
use ipc_types::{Odometry, TickHeader};
use proptest::prelude::*;

use super::*;
use crate::service::settings;
use crate::tape::{Files, Tape};
use crate::topics::{Sample, index_of};
use crate::{Place, raw};

/// What a reading of a file came to: its records in words, and its end; nothing if it is no recording.
type Read = Option<(Vec<String>, End)>;

fn read(bytes: &[u8]) -> Read {
    let mut records = Vec::new();
    let end = scan_bytes(bytes, bytes.len() as u64, |record| {
        records.push(format!("{record:?}"));
        Ok(())
    });
    Some((records, end.ok()?))
}

/// A small recording.
fn whole() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("config.toml"), "drive.tick_s = 0.01\n").unwrap();
        let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        let files = Files::first_free(folder.path().join("recording"), None);
        let mut tape = Tape::start(settings(files, folder.path(), &config, 1, true)).unwrap();
        let block: Vec<Sample> = (0..50)
            .map(|tick| {
                let mut bytes = Vec::new();
                TickHeader { tick, ..TickHeader::default() }.put(&mut bytes);
                Odometry { speed_mps: tick as f64, ..Odometry::default() }.put(&mut bytes);
                let place = Place { tick: Some(tick), ..Place::default() };
                Sample { topic: index_of("odometry"), place, bytes }
            })
            .collect();
        assert!(tape.offer(block).unwrap().is_none());
        let file = tape.finish(Vec::new(), BTreeMap::new()).unwrap();
        std::fs::read(file).unwrap()
    })
}

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = vec![opcode];
    bytes.extend((body.len() as u64).to_le_bytes());
    bytes.extend(body);
    bytes
}

/// A chunk that says that it is of this size when it is unpacked.
fn chunk(size: u64, compression: &str, packed: &[u8]) -> Vec<u8> {
    let mut body = vec![0; 16];
    body.extend(size.to_le_bytes());
    body.extend(0u32.to_le_bytes());
    body.extend((compression.len() as u32).to_le_bytes());
    body.extend(compression.as_bytes());
    body.extend((packed.len() as u64).to_le_bytes());
    body.extend(packed);
    record(CHUNK, &body)
}

fn file(records: &[Vec<u8>]) -> Vec<u8> {
    [&MAGIC[..], &records.concat()].concat()
}

#[test]
fn a_recording_is_read_as_the_library_wrote_it() {
    let (records, end) = read(whole()).unwrap();
    assert_eq!(end, End::Whole);
    let messages = records.iter().filter(|it| it.starts_with("Message")).count();
    // Each tick as our own message, on /odom and on /tf.
    assert_eq!(messages, 50 * 3);
    assert!(records.iter().any(|it| it.contains("config.toml")));
    assert!(records.iter().any(|it| it.contains("/pathtune/odometry")));
    assert!(whole().windows(raw::SCHEMA.len()).any(|it| it == raw::SCHEMA.as_bytes()));
}

#[test]
fn lengths_that_cannot_be_are_refused_before_anything_is_reserved() {
    let zeros = |size: usize| zstd::bulk::compress(&vec![0; size], 1).unwrap();
    let endless = |opcode: u8| {
        let mut bytes = record(opcode, &[]);
        bytes[1..9].fill(0xff);
        bytes
    };
    let damaged = |records: &[Vec<u8>], why: &str| match read(&file(records)) {
        Some((_, End::Damaged(told))) => assert!(told.contains(why), "{told}"),
        other => panic!("{why}: {other:?}"),
    };
    let Some((_, End::CutOff(_))) = read(&file(&[endless(CHUNK)])) else { panic!("2^64 - 1") };
    // Within a chunk.
    damaged(&[chunk(9, "", &endless(MESSAGE))], "longer than the chunk");
    damaged(&[chunk(1 << 40, "zstd", &zeros(1 << 20))], "more than 64 MiB");
    damaged(&[chunk(u64::MAX, "", &[])], "more than 64 MiB");
    // More than it says, and less.
    damaged(&[chunk(1 << 10, "zstd", &zeros(1 << 20))], "cannot be unpacked");
    damaged(&[chunk(1 << 21, "zstd", &zeros(1 << 20))], "another size");
    damaged(&[chunk(4, "lz4", b"1234")], "packed with lz4");
    damaged(&[chunk(4, "br", b"1234")], "not known here");
    // Zeros are empty records of no kind, so nothing is wrong with them but their number.
    let zeros = chunk(63 << 20, "zstd", &zeros(63 << 20));
    damaged(&vec![zeros; 40], "far more is packed");
    damaged(&[record(FOOTER, &[0; 20])], "end of the data is missing");
}

proptest! {
    #[test]
    fn a_file_with_flipped_bits_is_damaged_or_says_the_same(
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0u8..8), 1..4)
    ) {
        let mut bytes = whole().to_vec();
        for (at, bit) in flips {
            bytes[at.index(whole().len())] ^= 1 << bit;
        }
        match read(&bytes) {
            Some((records, End::Whole)) => prop_assert_eq!(records, read(whole()).unwrap().0),
            None | Some((_, End::CutOff(_) | End::Damaged(_))) => {}
        }
    }

    #[test]
    fn a_file_that_was_cut_is_read_up_to_there(at in any::<prop::sample::Index>()) {
        let at = at.index(whole().len());
        if let Some((records, end)) = read(&whole()[..at]) {
            prop_assert!(matches!(end, End::CutOff(_)), "{:?}", end);
            prop_assert!(read(whole()).unwrap().0.starts_with(&records));
        }
    }

    #[test]
    fn numbers_of_any_size_do_no_harm(
        at in any::<prop::sample::Index>(),
        number in prop_oneof![any::<u64>(), Just(u64::MAX), 0u64..1 << 32],
    ) {
        let mut bytes = whole().to_vec();
        let at = at.index(bytes.len() - 8);
        bytes[at..at + 8].copy_from_slice(&number.to_le_bytes());
        if let Some((records, End::Whole)) = read(&bytes) {
            prop_assert_eq!(records, read(whole()).unwrap().0);
        }
    }

    #[test]
    fn records_of_any_content_are_read_or_refused(
        records in prop::collection::vec((0u8..0x12, prop::collection::vec(any::<u8>(), 0..80)), 0..20),
        in_chunk in any::<bool>(),
        longer in 0u64..3,
    ) {
        let all: Vec<Vec<u8>> =
            records.iter().map(|(opcode, body)| record(*opcode, body)).collect();
        let bytes = if in_chunk {
            let inner = all.concat();
            let packed = zstd::bulk::compress(&inner, 1).unwrap();
            file(&[chunk(inner.len() as u64 + longer, "zstd", &packed)])
        } else {
            file(&all)
        };
        prop_assert!(read(&bytes).is_some());
    }
}
