//! A hash over names, types and offsets of a message's fields, checked while compiling.

/// One field of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Name.
    pub name: &'static str,
    /// Rust's name of the type: `u32`, `u64`, `f64`, `[u8; N]` or another message's.
    pub kind: &'static str,
    /// Offset in bytes.
    pub offset: usize,
}

/// One constant of a message: a bit or a value of one of its fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Constant {
    /// Name.
    pub name: &'static str,
    /// Value.
    pub value: u64,
}

/// What can be written byte by byte, as it lies in memory: little endian, field after field.
///
/// There is no padding that is not a field, so what is written equals the memory of a little endian machine.
pub trait Bytes: Sized {
    /// Adds the value's bytes.
    fn put(&self, to: &mut Vec<u8>);
    /// Takes a value off the front; none if there are too few bytes.
    fn take(from: &mut &[u8]) -> Option<Self>;
}

macro_rules! number {
    ($($kind:ty),+) => {
        $(impl Bytes for $kind {
            fn put(&self, to: &mut Vec<u8>) {
                to.extend_from_slice(&self.to_le_bytes());
            }

            fn take(from: &mut &[u8]) -> Option<Self> {
                let (bytes, rest) = from.split_first_chunk()?;
                *from = rest;
                Some(Self::from_le_bytes(*bytes))
            }
        })+
    };
}
number!(u32, u64, f64);

/// A struct whose fields are known.
pub trait Layout: Bytes {
    /// Name on the wire; ends in the hash of the layout.
    const TYPE_NAME: &'static str;
    /// The fields, in order.
    const FIELDS: &'static [Field];
}

/// FNV-1a over a message's fields and size.
pub const fn hash(fields: &[Field], size: usize) -> u32 {
    let mut hash = 0x811c_9dc5;
    let mut index = 0;
    while index < fields.len() {
        let field = &fields[index];
        hash = add_text(hash, field.name);
        hash = add_text(hash, field.kind);
        hash = add_number(hash, field.offset);
        index += 1;
    }
    add_number(hash, size)
}

const fn add_byte(hash: u32, byte: u8) -> u32 {
    (hash ^ byte as u32).wrapping_mul(0x0100_0193)
}

const fn add_text(mut hash: u32, text: &str) -> u32 {
    let bytes = text.as_bytes();
    let mut index = 0;
    while index < bytes.len() {
        // The spaces in `[u8; 4]` are the compiler's to choose.
        if bytes[index] != b' ' {
            hash = add_byte(hash, bytes[index]);
        }
        index += 1;
    }
    add_byte(hash, b';')
}

const fn add_number(hash: u32, number: usize) -> u32 {
    let bytes = (number as u32).to_le_bytes();
    add_byte(add_byte(add_byte(add_byte(hash, bytes[0]), bytes[1]), bytes[2]), bytes[3])
}

/// Whether `name` ends in `#` and the eight digits of `hash`.
pub const fn name_carries(name: &str, hash: u32) -> bool {
    let name = name.as_bytes();
    let digits = hex(hash);
    if name.len() < 9 || name[name.len() - 9] != b'#' {
        return false;
    }
    let mut index = 0;
    while index < 8 {
        if name[name.len() - 8 + index] != digits[index] {
            return false;
        }
        index += 1;
    }
    true
}

/// Eight lower-case digits.
pub const fn hex(number: u32) -> [u8; 8] {
    let mut digits = [0; 8];
    let mut index = 0;
    while index < 8 {
        digits[index] = b"0123456789abcdef"[(number >> (28 - 4 * index)) as usize & 15];
        index += 1;
    }
    digits
}

/// Defines a message: a plain C struct with explicit padding, a name that carries the hash of its layout,
/// and the table of its fields.
macro_rules! message {
    (
        $(#[doc = $doc:literal])+
        #[name = $type_name:literal]
        pub struct $name:ident {
            $($(#[doc = $field_doc:literal])+ pub $field:ident: $kind:ty),+ $(,)?
        }
    ) => {
        $(#[doc = $doc])+
        #[repr(C)]
        #[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
        #[type_name($type_name)]
        pub struct $name {
            $($(#[doc = $field_doc])+ pub $field: $kind),+
        }

        impl $name {
            /// Name on the wire; ends in the hash of the layout.
            pub const TYPE_NAME: &'static str = $type_name;
            /// The fields, in order.
            pub const FIELDS: &'static [$crate::layout::Field] = &[
                $($crate::layout::Field {
                    name: stringify!($field),
                    kind: stringify!($kind),
                    offset: std::mem::offset_of!($name, $field),
                }),+
            ];
            /// Hash of the layout.
            pub const LAYOUT_HASH: u32 =
                $crate::layout::hash(Self::FIELDS, std::mem::size_of::<Self>());
        }

        impl $crate::layout::Bytes for $name {
            fn put(&self, to: &mut Vec<u8>) {
                $($crate::layout::Bytes::put(&self.$field, to);)+
            }

            fn take(from: &mut &[u8]) -> Option<Self> {
                Some(Self { $($field: $crate::layout::Bytes::take(from)?),+ })
            }
        }

        impl $crate::layout::Layout for $name {
            const TYPE_NAME: &'static str = $name::TYPE_NAME;
            const FIELDS: &'static [$crate::layout::Field] = $name::FIELDS;
        }

        const _: () = {
            const DIGITS: [u8; 8] = $crate::layout::hex($name::LAYOUT_HASH);
            let Ok(digits) = std::str::from_utf8(&DIGITS) else { unreachable!() };
            assert!($crate::layout::name_carries($type_name, $name::LAYOUT_HASH), "{}", digits);
            // No byte between the fields, or behind them, that nobody writes.
            let fields = 0 $(+ std::mem::size_of::<$kind>())+;
            assert!(fields == std::mem::size_of::<$name>(), "implicit padding");
        };
    };
}
pub(crate) use message;

/// Defines the constants of a message, and the table of them: what other languages are told.
macro_rules! constants {
    (
        $message:ident:
        $($(#[doc = $doc:literal])+ pub const $name:ident: $kind:ty = $value:expr;)+
    ) => {
        impl $message {
            $($(#[doc = $doc])+ pub const $name: $kind = $value;)+
            /// The constants above, in order.
            pub const CONSTANTS: &'static [$crate::layout::Constant] = &[
                $($crate::layout::Constant {
                    name: stringify!($name),
                    value: $message::$name as u64,
                }),+
            ];
        }
    };
}
pub(crate) use constants;
