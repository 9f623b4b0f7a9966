//! Our own messages in a recording: their bytes, as they were in shared memory, in a ROS 2 message of one `uint8[]`.
//!
//! Tools of ROS 2 open a file only if every channel is CDR and has a schema that they can read.

use crate::ros::ENCAPSULATION;

/// Name of the schema.
pub const SCHEMA: &str = "pathtune_msgs/msg/Bytes";
/// Text of the schema.
pub const DEFINITION: &str = "# Header and elements as in shared memory, little endian; the channel's metadata \
                              (`layout`) tells their fields.\nuint8[] data\n";
/// Where the bytes begin: after the encapsulation and the length.
pub const OFFSET: usize = 8;

/// Wraps a message's bytes; what `into` held is dropped.
pub(crate) fn wrap(bytes: &[u8], into: &mut Vec<u8>) {
    into.clear();
    into.extend(ENCAPSULATION);
    into.extend((bytes.len() as u32).to_le_bytes());
    into.extend(bytes);
}

/// The bytes of a wrapped message; none if it is not one.
pub(crate) fn unwrap(cdr: &[u8]) -> Option<&[u8]> {
    let (encapsulation, rest) = cdr.split_first_chunk::<4>()?;
    let (len, bytes) = rest.split_first_chunk::<4>()?;
    let is_whole = u32::from_le_bytes(*len) as usize == bytes.len();
    (*encapsulation == ENCAPSULATION && is_whole).then_some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_wrapped_is_unwrapped() {
        let mut wrapped = vec![9];
        wrap(b"12345", &mut wrapped);
        assert_eq!(wrapped.len(), OFFSET + 5);
        assert_eq!(unwrap(&wrapped), Some(&b"12345"[..]));
        for len in 0..wrapped.len() {
            assert_eq!(unwrap(&wrapped[..len]), None);
        }
        wrapped[1] = 0;
        assert_eq!(unwrap(&wrapped), None);
    }
}
