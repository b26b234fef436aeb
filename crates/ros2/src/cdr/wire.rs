//! The Rust types of message fields: how each is read from CDR and written to it.

use super::{CdrError, CdrReader, CdrWriter};

/// A field type of a ROS message.
pub trait Wire: Sized {
    /// Smallest size of a value on the wire, bytes, without padding.
    const MIN_BYTES: usize;

    /// Reads one value.
    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError>;

    /// Writes one value.
    fn write(&self, writer: &mut CdrWriter<'_>);

    /// Reads `count` values in a row. The caller has checked that the message can hold them ([`CdrReader::sequence`]).
    fn read_many(reader: &mut CdrReader<'_>, count: usize) -> Result<Vec<Self>, CdrError> {
        // In memory an element may be larger than on the wire. The vector reserves no more bytes than the message has left,
        // and grows as elements are read.
        let mut values = Vec::with_capacity(count.min(reader.remaining() / size_of::<Self>().max(1)));
        for _ in 0..count {
            values.push(Self::read(reader)?);
        }
        Ok(values)
    }

    /// Writes values in a row, without a count.
    fn write_many(values: &[Self], writer: &mut CdrWriter<'_>) {
        for value in values {
            value.write(writer);
        }
    }
}

/// Implements [`Wire`] for number types.
macro_rules! number {
    ($($number:ty, $name:literal;)*) => {$(
        impl Wire for $number {
            const MIN_BYTES: usize = size_of::<$number>();

            fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
                reader.number($name).map(Self::from_le_bytes)
            }

            fn write(&self, writer: &mut CdrWriter<'_>) {
                writer.number(self.to_le_bytes());
            }
        }
    )*};
}

number! {
    i8, "int8";
    u16, "uint16";
    i16, "int16";
    u32, "uint32";
    i32, "int32";
    u64, "uint64";
    i64, "int64";
    f32, "float32";
    f64, "float64";
}

impl Wire for u8 {
    const MIN_BYTES: usize = 1;

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        reader.u8()
    }

    fn write(&self, writer: &mut CdrWriter<'_>) {
        writer.number([*self]);
    }

    fn read_many(reader: &mut CdrReader<'_>, count: usize) -> Result<Vec<Self>, CdrError> {
        reader.raw(count).map(<[u8]>::to_vec)
    }

    fn write_many(values: &[Self], writer: &mut CdrWriter<'_>) {
        writer.raw(values);
    }
}

impl Wire for bool {
    const MIN_BYTES: usize = 1;

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        reader.bool()
    }

    fn write(&self, writer: &mut CdrWriter<'_>) {
        writer.number([u8::from(*self)]);
    }
}

impl Wire for String {
    const MIN_BYTES: usize = 4;

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        reader.str().map(str::to_owned)
    }

    fn write(&self, writer: &mut CdrWriter<'_>) {
        writer.str(self);
    }
}

impl<T: Wire> Wire for Vec<T> {
    const MIN_BYTES: usize = 4;

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let count = reader.sequence(T::MIN_BYTES)?;
        T::read_many(reader, count)
    }

    fn write(&self, writer: &mut CdrWriter<'_>) {
        writer.count(self.len());
        T::write_many(self, writer);
    }
}

impl<T: Wire + Copy + Default, const N: usize> Wire for [T; N] {
    const MIN_BYTES: usize = N * T::MIN_BYTES;

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let mut values = [T::default(); N];
        for value in &mut values {
            *value = T::read(reader)?;
        }
        Ok(values)
    }

    fn write(&self, writer: &mut CdrWriter<'_>) {
        T::write_many(self, writer);
    }
}

/// Declares a message struct whose fields are encoded in the order of their declaration.
macro_rules! wire_struct {
    ($(#[$attribute:meta])* pub struct $name:ident {
        $($(#[$field_attribute:meta])* pub $field:ident: $type:ty,)*
    }) => {
        $(#[$attribute])*
        pub struct $name {
            $($(#[$field_attribute])* pub $field: $type,)*
        }

        impl $crate::cdr::Wire for $name {
            const MIN_BYTES: usize = 0 $(+ <$type as $crate::cdr::Wire>::MIN_BYTES)*;

            fn read(
                reader: &mut $crate::cdr::CdrReader<'_>,
            ) -> Result<Self, $crate::cdr::CdrError> {
                Ok(Self { $($field: <$type as $crate::cdr::Wire>::read(reader)?,)* })
            }

            fn write(&self, writer: &mut $crate::cdr::CdrWriter<'_>) {
                $($crate::cdr::Wire::write(&self.$field, writer);)*
            }
        }

        #[cfg(test)]
        impl $crate::cdr::Sample for $name {
            fn sample(source: &mut $crate::cdr::SampleSource) -> Self {
                Self { $($field: <$type as $crate::cdr::Sample>::sample(source),)* }
            }
        }
    };
}
pub(crate) use wire_struct;

#[cfg(test)]
pub(crate) use sample::{Sample, SampleSource};

/// Arbitrary values of every message for property tests, made of numbers that the test draws.
#[cfg(test)]
mod sample {
    use std::vec;

    /// The drawn numbers.
    pub(crate) struct SampleSource(vec::IntoIter<u64>);

    impl SampleSource {
        pub(crate) fn new(numbers: Vec<u64>) -> Self {
            Self(numbers.into_iter())
        }

        /// Returns the next number, or 0 when none is left, so that every message ends.
        fn next(&mut self) -> u64 {
            self.0.next().unwrap_or_default()
        }
    }

    /// A type of which arbitrary values can be made.
    pub(crate) trait Sample {
        fn sample(source: &mut SampleSource) -> Self;
    }

    macro_rules! integers {
        ($($integer:ty)*) => {$(
            impl Sample for $integer {
                fn sample(source: &mut SampleSource) -> Self {
                    source.next() as $integer
                }
            }
        )*};
    }
    integers!(i8 u8 u32 i32 u64 i64);

    impl Sample for f64 {
        /// The value may be NaN, which equals itself only as bytes; the tests compare bytes.
        fn sample(source: &mut SampleSource) -> Self {
            f64::from_bits(source.next())
        }
    }

    impl Sample for f32 {
        /// The value may be NaN, as that of `f64`.
        fn sample(source: &mut SampleSource) -> Self {
            f32::from_bits(source.next() as u32)
        }
    }

    impl Sample for bool {
        fn sample(source: &mut SampleSource) -> Self {
            source.next() & 1 == 1
        }
    }

    impl Sample for String {
        fn sample(source: &mut SampleSource) -> Self {
            (0..source.next() % 9).filter_map(|_| char::from_u32(1 + source.next() as u32 % 0x2fff)).collect()
        }
    }

    impl<T: Sample> Sample for Vec<T> {
        fn sample(source: &mut SampleSource) -> Self {
            (0..source.next() % 7).map(|_| T::sample(source)).collect()
        }
    }

    impl<T: Sample, const N: usize> Sample for [T; N] {
        fn sample(source: &mut SampleSource) -> Self {
            std::array::from_fn(|_| T::sample(source))
        }
    }
}
