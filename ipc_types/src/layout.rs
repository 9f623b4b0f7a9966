//! A hash over the names, types and offsets of a message's fields, checked at compile time.

/// What may lie in shared memory.
#[cfg(feature = "transport")]
pub use iceoryx2::prelude::ZeroCopySend;

/// Stands in for the transport's trait if there is no transport: pure cores use messages as plain data.
#[cfg(not(feature = "transport"))]
pub trait ZeroCopySend {}
#[cfg(not(feature = "transport"))]
impl<M: Copy + 'static> ZeroCopySend for M {}

/// One field of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Name.
    pub name: &'static str,
    /// What it is made of.
    pub kind: Kind,
    /// Offset in bytes.
    pub offset: usize,
}

/// What a field is made of: a number, a message, or an array of either.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kind {
    /// Rust's name of a number (`u32`, `u64` or `f64`), or the name of a message.
    pub name: &'static str,
    /// The length of an array; 1 if it is not an array.
    pub count: usize,
    /// Bytes of one element.
    pub bytes: usize,
    /// Hash of a message's layout; 0 for numbers.
    pub hash: u32,
    /// The fields of a message; empty for numbers.
    pub fields: &'static [Field],
}

/// One plain number somewhere in a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Number {
    /// The field's name: with a dot for a field of an inner message, with an index for an element of an array, as in
    /// `report.parameters[3]`.
    pub name: String,
    /// `u32`, `u64` or `f64`.
    pub kind: &'static str,
    /// Offset in the whole message.
    pub offset: usize,
    /// Its bytes.
    pub bytes: usize,
}

/// All numbers of which the fields consist, in order, for uses without structs inside structs.
pub fn numbers(fields: &[Field]) -> Vec<Number> {
    let mut all = Vec::new();
    for Field { name, kind, offset } in fields {
        for index in 0..kind.count {
            let name =
                if kind.count == 1 { (*name).to_owned() } else { format!("{name}[{index}]") };
            let offset = offset + index * kind.bytes;
            if kind.fields.is_empty() {
                all.push(Number { name, kind: kind.name, offset, bytes: kind.bytes });
                continue;
            }
            all.extend(numbers(kind.fields).into_iter().map(|inner| Number {
                name: format!("{name}.{}", inner.name),
                offset: offset + inner.offset,
                ..inner
            }));
        }
    }
    all
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
/// All padding is in explicit fields, so what is written equals the memory of a little endian machine.
pub trait Bytes: Sized + Copy {
    /// What a field of this type is made of.
    const KIND: Kind;
    /// All numbers 0.
    const ZERO: Self;
    /// Adds the value's bytes.
    fn put(&self, to: &mut Vec<u8>);
    /// Takes a value off the front; `None` if there are too few bytes.
    fn take(from: &mut &[u8]) -> Option<Self>;
}

macro_rules! number {
    ($($kind:ty = $zero:literal),+) => {
        $(impl Bytes for $kind {
            const KIND: Kind = Kind {
                name: stringify!($kind),
                count: 1,
                bytes: std::mem::size_of::<$kind>(),
                hash: 0,
                fields: &[],
            };
            const ZERO: Self = $zero;

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
number!(u32 = 0, u64 = 0, f64 = 0.0);

impl<T: Bytes, const N: usize> Bytes for [T; N] {
    const KIND: Kind = Kind { count: N * T::KIND.count, ..T::KIND };
    const ZERO: Self = [T::ZERO; N];

    fn put(&self, to: &mut Vec<u8>) {
        self.iter().for_each(|item| item.put(to));
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let mut items = Self::ZERO;
        for item in &mut items {
            *item = T::take(from)?;
        }
        Some(items)
    }
}

/// A struct whose fields are known.
pub trait Layout: Bytes {
    /// Name on the wire; ends in the hash of the layout.
    const TYPE_NAME: &'static str;
    /// The fields, in order.
    const FIELDS: &'static [Field];
}

/// FNV-1a over a message's fields and size; the layout of a message inside is part of it.
pub const fn hash(fields: &[Field], size: usize) -> u32 {
    let mut hash = 0x811c_9dc5;
    let mut index = 0;
    while index < fields.len() {
        let field = &fields[index];
        hash = add_text(hash, field.name);
        hash = add_text(hash, field.kind.name);
        hash = add_number(hash, field.kind.count);
        hash = add_number(hash, field.kind.hash as usize);
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
        hash = add_byte(hash, bytes[index]);
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

/// Defines the struct of a message, for the transport or without it. It is a separate macro, because a condition inside
/// [`message!`] would test the features of the crate that uses it.
#[cfg(feature = "transport")]
#[doc(hidden)]
#[macro_export]
macro_rules! message_struct {
    ($type_name:literal; $($item:tt)+) => {
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
        #[type_name($type_name)]
        $($item)+
    };
}
#[cfg(not(feature = "transport"))]
#[doc(hidden)]
#[macro_export]
macro_rules! message_struct {
    ($type_name:literal; $($item:tt)+) => {
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq)]
        $($item)+
    };
}

/// Defines a message: a plain C struct with explicit padding, a name that carries the hash of its layout,
/// and the table of its fields. The build fails if name and layout differ, and shows the hash. The
/// derive needs [`ZeroCopySend`] in scope.
#[macro_export]
macro_rules! message {
    (
        $(#[doc = $doc:literal])+
        #[name = $type_name:literal]
        pub struct $name:ident {
            $($(#[doc = $field_doc:literal])+ pub $field:ident: $kind:ty),+ $(,)?
        }
    ) => {
        $crate::message_struct! {
            $type_name;
            $(#[doc = $doc])+
            pub struct $name {
                $($(#[doc = $field_doc])+ pub $field: $kind),+
            }
        }

        impl $name {
            /// Name on the wire; ends in the hash of the layout.
            pub const TYPE_NAME: &'static str = $type_name;
            /// The fields, in order.
            pub const FIELDS: &'static [$crate::layout::Field] = &[
                $($crate::layout::Field {
                    name: stringify!($field),
                    kind: <$kind as $crate::layout::Bytes>::KIND,
                    offset: std::mem::offset_of!($name, $field),
                }),+
            ];
            /// Hash of the layout.
            pub const LAYOUT_HASH: u32 =
                $crate::layout::hash(Self::FIELDS, std::mem::size_of::<Self>());
        }

        // Not derived, because the standard library has no default for long arrays.
        impl Default for $name {
            fn default() -> Self {
                <Self as $crate::layout::Bytes>::ZERO
            }
        }

        impl $crate::layout::Bytes for $name {
            const KIND: $crate::layout::Kind = $crate::layout::Kind {
                name: stringify!($name),
                count: 1,
                bytes: std::mem::size_of::<Self>(),
                hash: Self::LAYOUT_HASH,
                fields: Self::FIELDS,
            };
            const ZERO: Self = Self { $($field: <$kind as $crate::layout::Bytes>::ZERO),+ };

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
            // There must be no byte between the fields, or after them, that is never written.
            let fields = 0 $(+ std::mem::size_of::<$kind>())+;
            assert!(fields == std::mem::size_of::<$name>(), "implicit padding");
        };
    };
}
pub use message;

/// Defines the constants of a message, and a table of them for other languages.
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

#[cfg(all(test, feature = "transport"))]
#[allow(unreachable_pub, reason = "the macro makes messages that others see")]
mod tests {
    use super::*;

    mod as_it_is {
        use super::ZeroCopySend;

        crate::message!(
            /// A place.
            #[name = "test.Place#9d6a789c"]
            pub struct Place {
                /// x.
                pub x_m: f64,
                /// y.
                pub y_m: f64,
            }
        );
        crate::message!(
            /// What holds places.
            #[name = "test.Outer#3298cc93"]
            pub struct Outer {
                /// Places.
                pub places: [Place; 2],
                /// A number.
                pub number: u32,
                /// More numbers.
                pub more: [u32; 3],
            }
        );
    }

    mod swapped {
        use super::ZeroCopySend;

        crate::message!(
            /// A place.
            #[name = "test.Place#85c5ff70"]
            pub struct Place {
                /// y.
                pub y_m: f64,
                /// x.
                pub x_m: f64,
            }
        );
        crate::message!(
            /// What holds places.
            #[name = "test.Outer#f59d8785"]
            pub struct Outer {
                /// Places.
                pub places: [Place; 2],
                /// A number.
                pub number: u32,
                /// More numbers.
                pub more: [u32; 3],
            }
        );
    }

    #[test]
    fn swapped_fields_of_an_inner_message_change_the_name_of_the_outer_one() {
        assert_ne!(as_it_is::Outer::TYPE_NAME, swapped::Outer::TYPE_NAME);
        let (is, was) = (as_it_is::Outer::FIELDS, swapped::Outer::FIELDS);
        assert_eq!((is[0].name, is[0].kind.name), (was[0].name, was[0].kind.name));
        assert_eq!((is[1], is[2]), (was[1], was[2]));
        assert!(!name_carries(as_it_is::Outer::TYPE_NAME, swapped::Outer::LAYOUT_HASH));
    }

    #[test]
    fn the_length_of_an_array_is_part_of_the_layout() {
        let of = |count| [Field { name: "numbers", kind: Kind { count, ..f64::KIND }, offset: 0 }];
        assert_ne!(hash(&of(2), 16), hash(&of(1), 16));
    }

    #[test]
    fn arrays_and_inner_messages_are_written_as_they_lie_in_memory() {
        use as_it_is::{Outer, Place};
        let places = [Place { x_m: 1.0, y_m: 2.0 }, Place { x_m: 3.0, y_m: 4.0 }];
        let outer = Outer { places, number: 5, more: [6, 7, 8] };
        let mut bytes = Vec::new();
        outer.put(&mut bytes);
        assert_eq!(bytes.len(), std::mem::size_of::<Outer>());
        assert_eq!(Outer::take(&mut &bytes[..]), Some(outer));
        assert_eq!(Outer::take(&mut &bytes[1..]), None);
        let numbers = numbers(Outer::FIELDS);
        let names: Vec<_> = numbers.iter().map(|it| it.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "places[0].x_m",
                "places[0].y_m",
                "places[1].x_m",
                "places[1].y_m",
                "number",
                "more[0]",
                "more[1]",
                "more[2]",
            ]
        );
        let mut next = 0;
        for number in &numbers {
            assert_eq!(number.offset, next);
            next += number.bytes;
        }
        assert_eq!(bytes[numbers[3].offset..][..8], 4f64.to_le_bytes());
        assert_eq!(Outer::default(), Outer::ZERO);
    }
}
