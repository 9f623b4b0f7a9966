//! Plain data as compact bytes with a checksum: what the journal and the checkpoints consist of.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// The bytes of a value, and behind them their CRC-32.
pub(crate) fn pack(value: &impl Serialize) -> Vec<u8> {
    let mut bytes = to_bytes(value);
    let sum = crc32fast::hash(&bytes);
    bytes.extend_from_slice(&sum.to_le_bytes());
    bytes
}

/// The value that [`pack`] packed; `None` if the bytes are damaged or of something else.
pub(crate) fn unpack<T: DeserializeOwned>(packed: &[u8]) -> Option<T> {
    let (bytes, sum) = packed.split_last_chunk()?;
    if crc32fast::hash(bytes) != u32::from_le_bytes(*sum) {
        return None;
    }
    from_bytes(bytes)
}

/// The bytes of a value, numbers to the bit.
pub(crate) fn to_bytes(value: &impl Serialize) -> Vec<u8> {
    postcard::to_allocvec(value).expect("what is packed is plain data")
}

/// The value of these bytes; `None` if they are not those of one.
pub(crate) fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let (value, rest) = postcard::take_from_bytes(bytes).ok()?;
    rest.is_empty().then_some(value)
}
