//! Bits of a report.

/// A run of bits of a report, least significant bit first as HID packs them (HID 1.11, 8.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitField {
    /// Identifier that the report begins with; `None` where reports have none.
    pub report: Option<u8>,
    /// First bit, counted from the report's first byte, its identifier included.
    pub start: usize,
    /// Number of bits, 1 to 32.
    pub bits: usize,
    /// Whether the value is in two's complement.
    pub signed: bool,
}

impl BitField {
    /// Whether a report is one that holds this field.
    #[must_use]
    pub fn is_in(&self, report: &[u8]) -> bool {
        self.report.is_none_or(|id| report.first() == Some(&id))
    }

    /// The value in a report; `None` when the report is another one, or ends before the field does.
    #[must_use]
    pub fn read(&self, report: &[u8]) -> Option<i64> {
        if self.bits == 0 || self.bits > 32 || !self.is_in(report) {
            return None;
        }
        let end = self.start.checked_add(self.bits)?;
        let bytes = report.get(self.start / 8..end.div_ceil(8))?;
        let word = bytes.iter().enumerate().fold(0u64, |word, (i, byte)| word | u64::from(*byte) << (8 * i));
        let value = (word >> (self.start % 8)) & ((1u64 << self.bits) - 1);
        let sign = 1u64 << (self.bits - 1);
        // Both fit: a value has at most 32 bits.
        let value = value as i64;
        Some(if self.signed && value as u64 & sign != 0 { value - 2 * sign as i64 } else { value })
    }

    /// Writes a value into a report, its lowest bits; a report that ends before the field does is left alone.
    pub fn write(&self, report: &mut [u8], value: i64) {
        if self.start.saturating_add(self.bits) > 8 * report.len() {
            return;
        }
        for bit in 0..self.bits.min(32) {
            let at = self.start + bit;
            let mask = 1u8 << (at % 8);
            if value >> bit & 1 == 1 {
                report[at / 8] |= mask;
            } else {
                report[at / 8] &= !mask;
            }
        }
    }

    /// Smallest and largest value that the bits can hold.
    #[must_use]
    pub fn limits(&self) -> (i64, i64) {
        let bits = self.bits.clamp(1, 32);
        if self.signed { (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) } else { (0, (1 << bits) - 1) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_written_is_read_and_nothing_else_changes(
            start in 0usize..70, bits in 1usize..=32, signed: bool, value: i64, mut report in prop::collection::vec(any::<u8>(), 0..16),
        ) {
            let field = BitField { report: None, start, bits, signed };
            let (low, high) = field.limits();
            let value = low + value.rem_euclid(high - low + 1);
            let before = report.clone();
            field.write(&mut report, value);
            if start + bits <= 8 * report.len() {
                prop_assert_eq!(field.read(&report), Some(value));
                let changed = |bit: &usize| (report[bit / 8] ^ before[bit / 8]) >> (bit % 8) & 1 == 1;
                prop_assert!((0..8 * report.len()).filter(changed).all(|bit| (start..start + bits).contains(&bit)));
            } else {
                prop_assert_eq!(field.read(&report), None);
                prop_assert_eq!(report, before);
            }
        }
    }

    #[test]
    fn a_report_with_another_identifier_is_not_read() {
        let field = BitField { report: Some(2), start: 8, bits: 8, signed: true };
        assert_eq!(field.read(&[2, 0xff]), Some(-1));
        assert_eq!(field.read(&[1, 0xff]), None);
        assert_eq!(field.read(&[]), None);
    }
}
