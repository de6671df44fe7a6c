//! The data of PTP operations (ISO 15740): numbers, strings, arrays, and the descriptions
//! of a body, its store, its objects and its properties.

/// Data that are being put together.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Dataset(pub Vec<u8>);

impl Dataset {
    /// One byte.
    pub fn u8(mut self, value: u8) -> Self {
        self.0.push(value);
        self
    }

    /// Two bytes.
    pub fn u16(mut self, value: u16) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    /// Four bytes.
    pub fn u32(mut self, value: u32) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    /// Eight bytes.
    pub fn u64(mut self, value: u64) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    /// These bytes.
    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.extend(bytes);
        self
    }

    /// UTF-16 up to a zero.
    pub fn name(self, name: &str) -> Self {
        let units = name.encode_utf16().chain([0]);
        units.fold(self, Self::u16)
    }

    /// UTF-16 with its length, at most 254 units and a zero.
    pub fn text(mut self, text: &str) -> Self {
        let mut units: Vec<u16> = text.encode_utf16().take(254).collect();
        if !units.is_empty() {
            units.push(0);
        }
        self = self.u8(units.len() as u8);
        for unit in units {
            self = self.u16(unit);
        }
        self
    }

    /// Codes with their number.
    pub fn codes(mut self, codes: &[u16]) -> Self {
        self = self.u32(codes.len() as u32);
        for &code in codes {
            self = self.u16(code);
        }
        self
    }

    /// Handles with their number.
    pub fn handles(mut self, handles: &[u32]) -> Self {
        self = self.u32(handles.len() as u32);
        for &handle in handles {
            self = self.u32(handle);
        }
        self
    }

    fn value(self, width: Width, value: u32) -> Self {
        match width {
            Width::U8 => self.u8(value as u8),
            Width::U16 => self.u16(value as u16),
            Width::U32 => self.u32(value),
        }
    }
}

/// Type of a property's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// One byte.
    U8,
    /// Two bytes.
    U16,
    /// Four bytes.
    U32,
}

impl Width {
    /// Code of the type.
    fn code(self) -> u16 {
        match self {
            Self::U8 => 2,
            Self::U16 => 4,
            Self::U32 => 6,
        }
    }

    /// The value that these bytes are; `None` where their number is another.
    pub fn parse(self, bytes: &[u8]) -> Option<u32> {
        match (self, bytes) {
            (Self::U8, &[a]) => Some(a.into()),
            (Self::U16, &[a, b]) => Some(u16::from_le_bytes([a, b]).into()),
            (Self::U32, &[a, b, c, d]) => Some(u32::from_le_bytes([a, b, c, d])),
            _ => None,
        }
    }
}

/// A property of the body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// Which.
    pub code: u16,
    /// Type of its values.
    pub width: Width,
    /// What it is now.
    pub current: u32,
    /// What it may be, in the body's order; empty: it cannot be set.
    pub allowed: Vec<u32>,
}

impl Property {
    /// Its description.
    pub fn description(&self) -> Dataset {
        let is_writable = !self.allowed.is_empty();
        let start = Dataset::default()
            .u16(self.code)
            .u16(self.width.code())
            .u8(is_writable.into())
            .value(
                self.width,
                self.allowed.first().copied().unwrap_or(self.current),
            )
            .value(self.width, self.current);
        if !is_writable {
            return start.u8(0);
        }
        let start = start.u8(2).u16(self.allowed.len() as u16);
        self.allowed
            .iter()
            .fold(start, |data, &value| data.value(self.width, value))
    }

    /// Its value alone.
    pub fn value(&self) -> Dataset {
        Dataset::default().value(self.width, self.current)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_value_is_parsed_as_it_was_put(value: u32, which in 0_usize..3) {
            let width = [Width::U8, Width::U16, Width::U32][which];
            let value = value & [0xff, 0xffff, u32::MAX][which];
            let data = Dataset::default().value(width, value);
            prop_assert_eq!(data.0.len(), 1 << which);
            prop_assert_eq!(width.parse(&data.0), Some(value));
            prop_assert_eq!(width.parse(&data.u8(0).0), None);
        }

        #[test]
        fn a_text_states_its_length(text in "[ -~äλ😀]{0,300}") {
            let data = Dataset::default().text(&text).0;
            prop_assert_eq!(data.len(), 1 + 2 * usize::from(data[0]));
            if let [.., low, high] = data.as_slice() {
                prop_assert_eq!([*low, *high], [0, 0]);
            }
        }
    }

    #[test]
    fn a_property_lists_what_it_may_be() {
        let property = Property {
            code: 0x500f,
            width: Width::U16,
            current: 200,
            allowed: vec![100, 200],
        };
        let expected = [0x0f, 0x50, 4, 0, 1, 100, 0, 200, 0, 2, 2, 0, 100, 0, 200, 0];
        assert_eq!(property.description().0, expected);
        assert_eq!(property.value().0, [200, 0]);
        let fixed = Property {
            width: Width::U8,
            allowed: Vec::new(),
            ..property
        };
        assert_eq!(fixed.description().0, [0x0f, 0x50, 2, 0, 0, 200, 200, 0]);
    }
}
