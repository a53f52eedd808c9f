//! What a report descriptor asks for, before it is given to a parser that would do it.
//!
//! A descriptor is a little program: a few bytes of it can declare four thousand million fields, or leave out what the parser takes for
//! granted. This walks the items as HID 1.11, 6.2.2 lays them out and refuses what no device needs.

use crate::error::DescriptorError;

/// Longest descriptor, bytes: what hidraw gives at most.
pub const LONGEST: usize = 4096;
/// Most fields of all reports together.
const MOST_FIELDS: u64 = 4096;
/// Most bits of one item of a report.
const MOST_BITS: u64 = 65_536;
/// Most usages of an item that declares fields.
const MOST_USAGES: u64 = 4096;
/// Most usages of a collection.
const MOST_NAMES: u64 = 16;
/// Deepest nesting of collections, and of pushed states.
const DEEPEST: usize = 16;

#[derive(Clone, Copy, Default)]
struct Globals {
    page: bool,
    size: u64,
    count: u64,
}

#[derive(Clone, Copy, Default)]
struct Locals {
    usages: u64,
    /// A usage without a page of its own is among them.
    bare: bool,
    minimum: Option<u64>,
    maximum: Option<u64>,
}

impl Locals {
    fn usages(&self) -> Option<u64> {
        match (self.minimum, self.maximum) {
            (Some(low), Some(high)) => high.checked_sub(low).map(|n| n + 1),
            (Some(_), None) => None,
            (None, _) => Some(self.usages),
        }
    }
}

/// Checks that a descriptor is whole and asks for no more than a device can need.
///
/// # Errors
/// What is wrong, with the offset of the item.
pub fn check(descriptor: &[u8]) -> Result<(), DescriptorError> {
    if descriptor.is_empty() || descriptor.len() > LONGEST {
        return Err(DescriptorError::Length { bytes: descriptor.len(), most: LONGEST });
    }
    let mut state = vec![(Globals::default(), Locals::default())];
    let (mut depth, mut fields, mut at) = (0usize, 0u64, 0usize);
    while at < descriptor.len() {
        let bad = |what: &'static str| DescriptorError::Item { offset: at, what };
        let prefix = descriptor[at];
        if prefix == 0xfe {
            // A long item: size, tag, data. Nothing uses them.
            let size = usize::from(*descriptor.get(at + 1).ok_or(bad("a long item is cut off"))?);
            at += 3 + size;
            if at > descriptor.len() {
                return Err(DescriptorError::Item { offset: descriptor.len(), what: "a long item is cut off" });
            }
            continue;
        }
        let size = [0, 1, 2, 4][usize::from(prefix & 3)];
        let data = descriptor.get(at + 1..at + 1 + size).ok_or(bad("its data is cut off"))?;
        let value = data.iter().enumerate().fold(0u64, |v, (i, b)| v | u64::from(*b) << (8 * i));
        let Some((globals, locals)) = state.last_mut() else { return Err(bad("more states are popped than were pushed")) };
        match prefix & 0xfc {
            0x04 => globals.page = true,
            0x74 => globals.size = value,
            0x94 => globals.count = value,
            // Identifier 0 is reserved (6.2.2.7), and they have one byte.
            0x84 if value == 0 || value > 255 => return Err(bad("an identifier of a report is between 1 and 255")),
            0xa4 => {
                if state.len() >= DEEPEST {
                    return Err(bad("states are pushed too deep"));
                }
                let top = *state.last().unwrap_or(&Default::default());
                state.push(top);
            }
            0xb4 => {
                state.pop();
                if state.is_empty() {
                    return Err(bad("more states are popped than were pushed"));
                }
            }
            0x08 => {
                locals.usages += 1;
                locals.bare |= size < 4;
            }
            0x18 => locals.minimum = Some(value),
            0x28 => locals.maximum = Some(value),
            kind @ (0x80 | 0x90 | 0xb0 | 0xa0) => {
                let named = locals.usages().ok_or(bad("a range of usages has no end, or ends before it begins"))?;
                if !globals.page && (locals.bare || locals.minimum.is_some()) {
                    return Err(bad("a usage has no page"));
                }
                if kind == 0xa0 {
                    depth += 1;
                    if depth > DEEPEST || named > MOST_NAMES {
                        return Err(bad("collections are nested too deep, or have too many usages"));
                    }
                } else {
                    let bits = globals.size.saturating_mul(globals.count);
                    fields = fields.saturating_add(globals.count);
                    if bits > MOST_BITS || fields > MOST_FIELDS || named > MOST_USAGES {
                        return Err(bad("it declares more than a report can hold"));
                    }
                }
                *locals = Locals::default();
            }
            0xc0 => {
                depth = depth.checked_sub(1).ok_or(bad("a collection ends that did not begin"))?;
                *locals = Locals::default();
            }
            _ => {}
        }
        at += 1 + size;
    }
    Ok(())
}
