//! Reads the records of an MCAP file one after the other, in bounded memory, whatever stands in it.
//!
//! The library that writes our files believes every length that it reads: one that is damaged or hostile makes it reserve
//! terabytes, or panic. Here each length is compared with what is left of the file and with a limit before anything is
//! reserved, checksums are checked, and a chunk is unpacked only up to the size that it names.
//!
//! See the [specification](https://mcap.dev/spec); opcodes are named after it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use anyhow::{Result, bail, ensure};

/// The first bytes of a file, and its last ones.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// The longest record. Ours are chunks of about 1 MiB, and the path, as one message, of a few.
const RECORD_LIMIT: u64 = 64 << 20;
/// The largest size of a chunk when it is unpacked.
const CHUNK_LIMIT: u64 = 64 << 20;
/// How much may be unpacked from a byte of the file, over the whole file: far more than drives of a car that stands.
const UNPACKED_PER_BYTE: u64 = 1000;
/// How much may be unpacked from the smallest file.
const UNPACKED_AT_LEAST: u64 = 64 << 20;

const FOOTER: u8 = 0x02;
const SCHEMA: u8 = 0x03;
const CHANNEL: u8 = 0x04;
const MESSAGE: u8 = 0x05;
const CHUNK: u8 = 0x06;
const ATTACHMENT: u8 = 0x09;
const METADATA: u8 = 0x0c;
const DATA_END: u8 = 0x0f;

/// A record that says something about a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Record<'a> {
    Schema { id: u16, name: &'a str },
    Channel { id: u16, schema: u16, topic: &'a str },
    Message { channel: u16, log_time_ns: u64, data: &'a [u8] },
    Metadata { name: &'a str, entries: BTreeMap<String, String> },
    Attachment { name: &'a str, data: &'a [u8] },
}

/// How the reading of a file ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum End {
    /// With the file's own end.
    Whole,
    /// Before it: what is missing, in words.
    CutOff(String),
    /// At a place that cannot be right: which one, and why.
    Damaged(String),
}

/// Calls `take` with each record of a file, as far as it goes, until `take` fails.
///
/// # Errors
/// If the file cannot be read, or is no MCAP file; or that of `take`.
pub(crate) fn scan(path: &Path, take: impl FnMut(Record<'_>) -> Result<()>) -> Result<End> {
    let meta = std::fs::metadata(path)?;
    ensure!(meta.is_file(), "it is not a regular file");
    scan_bytes(BufReader::new(File::open(path)?), meta.len(), take)
}

/// As [`scan`], for `len` bytes of any origin.
fn scan_bytes(
    from: impl Read,
    len: u64,
    mut take: impl FnMut(Record<'_>) -> Result<()>,
) -> Result<End> {
    let most = len.saturating_mul(UNPACKED_PER_BYTE).max(UNPACKED_AT_LEAST);
    let mut source = Source { from, left: len, crc: crc32fast::Hasher::new(), body: Vec::new() };
    let mut unpacker = Unpacker { left: most, chunk: Vec::new() };
    if len < MAGIC.len() as u64 || source.read(MAGIC.len())? != MAGIC {
        bail!("it is not a recording");
    }
    let mut has_data_ended = false;
    loop {
        let at = len - source.left;
        let damaged = |why: &str| Ok(End::Damaged(format!("at byte {at}: {why}")));
        if source.left < 9 {
            return Ok(End::CutOff("its end is missing".to_owned()));
        }
        let crc = source.crc.clone().finalize();
        let (opcode, size) = opcode_and_size(source.read(9)?);
        if size > source.left {
            return Ok(End::CutOff(format!("the record at byte {at} is longer than the file")));
        }
        if size > RECORD_LIMIT {
            return damaged("a record of more than 64 MiB");
        }
        let body = source.read(size as usize)?;
        match opcode {
            FOOTER if has_data_ended => {
                let is_closed =
                    source.left >= MAGIC.len() as u64 && source.read(MAGIC.len())? == MAGIC;
                let missing = || End::CutOff("its last bytes are missing".to_owned());
                return Ok(if is_closed { End::Whole } else { missing() });
            }
            FOOTER => return damaged("the end of the data is missing"),
            DATA_END => {
                has_data_ended = true;
                match Fields(body).u32() {
                    Some(0) => {}
                    Some(told) if told == crc => {}
                    _ => return damaged("the checksum of the data is another one"),
                }
            }
            // What follows is the summary, which says nothing new.
            _ if has_data_ended => {}
            CHUNK => match unpacker.unpack(body) {
                Err(why) => return damaged(why),
                Ok(mut records) => {
                    while !records.is_empty() {
                        let Some((opcode, body)) = next_record(&mut records) else {
                            return damaged("a record in a chunk is longer than the chunk");
                        };
                        match parse(opcode, body) {
                            Some(Some(record)) => take(record)?,
                            Some(None) => {}
                            None => return damaged("a record in a chunk cannot be read"),
                        }
                    }
                }
            },
            _ => match parse(opcode, body) {
                Some(Some(record)) => take(record)?,
                Some(None) => {}
                None => return damaged("a record cannot be read"),
            },
        }
    }
}

/// The bytes of a file, and a checksum over those that were read.
struct Source<R> {
    from: R,
    left: u64,
    crc: crc32fast::Hasher,
    body: Vec<u8>,
}

impl<R: Read> Source<R> {
    /// The next bytes; the caller has compared their number with what is left.
    fn read(&mut self, len: usize) -> io::Result<&[u8]> {
        self.body.resize(len, 0);
        self.from.read_exact(&mut self.body)?;
        self.left -= len as u64;
        self.crc.update(&self.body);
        Ok(&self.body)
    }
}

/// Unpacks chunks.
struct Unpacker {
    /// How many bytes may still be unpacked from this file.
    left: u64,
    chunk: Vec<u8>,
}

impl Unpacker {
    /// The records of a chunk, as bytes.
    fn unpack<'a>(&'a mut self, body: &'a [u8]) -> Result<&'a [u8], &'static str> {
        let mut fields = Fields(body);
        let mut header = || {
            let _times = (fields.u64()?, fields.u64()?);
            let (size, crc) = (fields.u64()?, fields.u32()?);
            let compression = fields.text()?;
            let packed_size = fields.u64()?;
            let packed = fields.0.get(..usize::try_from(packed_size).ok()?)?;
            Some((size, crc, compression, packed))
        };
        let (size, crc, compression, packed) = header().ok_or("a chunk cannot be read")?;
        if size > CHUNK_LIMIT {
            return Err("a chunk of more than 64 MiB");
        }
        self.left = self.left.checked_sub(size).ok_or("far more is packed than drives can be")?;
        let records = match compression {
            "" => packed,
            "zstd" => {
                self.chunk = zstd::bulk::decompress(packed, size as usize)
                    .map_err(|_| "a chunk cannot be unpacked")?;
                &self.chunk
            }
            "lz4" => {
                return Err(
                    "a chunk is packed with lz4, which is not read here; write the file anew with zstd, as `mcap compress --compression zstd` does",
                );
            }
            _ => return Err("a chunk is packed in a way that is not known here; only zstd is"),
        };
        if records.len() as u64 != size {
            return Err("a chunk has another size than it says");
        }
        if crc != 0 && crc != crc32fast::hash(records) {
            return Err("the checksum of a chunk is another one");
        }
        Ok(records)
    }
}

fn opcode_and_size(header: &[u8]) -> (u8, u64) {
    let mut fields = Fields(header);
    (fields.u8().unwrap_or_default(), fields.u64().unwrap_or_default())
}

/// Takes a record off the front of a chunk.
fn next_record<'a>(records: &mut &'a [u8]) -> Option<(u8, &'a [u8])> {
    let mut fields = Fields(records);
    let (opcode, size) = (fields.u8()?, fields.u64()?);
    let body = fields.bytes(usize::try_from(size).ok()?)?;
    *records = fields.0;
    Some((opcode, body))
}

/// What a record says; nothing if it is of no interest, and `None` if it cannot be read.
fn parse(opcode: u8, body: &[u8]) -> Option<Option<Record<'_>>> {
    let mut fields = Fields(body);
    Some(Some(match opcode {
        SCHEMA => Record::Schema { id: fields.u16()?, name: fields.text()? },
        CHANNEL => {
            let (id, schema) = (fields.u16()?, fields.u16()?);
            Record::Channel { id, schema, topic: fields.text()? }
        }
        MESSAGE => {
            let (channel, _sequence) = (fields.u16()?, fields.u32()?);
            let (log_time_ns, _publish_time_ns) = (fields.u64()?, fields.u64()?);
            Record::Message { channel, log_time_ns, data: fields.0 }
        }
        METADATA => {
            let name = fields.text()?;
            let size = fields.u32()? as usize;
            let mut pairs = Fields(fields.bytes(size)?);
            let mut entries = BTreeMap::new();
            while !pairs.0.is_empty() {
                entries.insert(pairs.text()?.to_owned(), pairs.text()?.to_owned());
            }
            Record::Metadata { name, entries }
        }
        ATTACHMENT => {
            let _times = (fields.u64()?, fields.u64()?);
            let (name, _media_type) = (fields.text()?, fields.text()?);
            let size = usize::try_from(fields.u64()?).ok()?;
            let data = fields.bytes(size)?;
            let told = fields.u32()?;
            let hashed = &body[..body.len() - fields.0.len() - 4];
            if told != 0 && told != crc32fast::hash(hashed) {
                return None;
            }
            Record::Attachment { name, data }
        }
        _ => return Some(None),
    }))
}

/// Takes fields off the front of a record.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, len: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(bytes)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }

    fn u8(&mut self) -> Option<u8> {
        self.array().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Option<&'a str> {
        let len = self.u32()? as usize;
        std::str::from_utf8(self.bytes(len)?).ok()
    }
}

#[cfg(test)]
mod tests;
