//! What the reports of a device hold, read from its report descriptor.

use crate::error::DescriptorError;
use crate::guard;
use crate::report::BitField;
use hidreport::{Field, Report, ReportDescriptor, VariableField};
use std::panic::catch_unwind;

/// A control with a place of its own in a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Control {
    /// Usage page and usage.
    pub usage: (u16, u16),
    /// Where it is.
    pub field: BitField,
    /// Smallest value that it says it has.
    pub least: i64,
    /// Largest value that it says it has.
    pub most: i64,
    /// Whether it tells movements.
    pub relative: bool,
}

/// A list of the buttons that are pressed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// Usage page and usage of each button.
    pub usages: Vec<(u16, u16)>,
    /// The first place of the list.
    pub field: BitField,
    /// Number of places.
    pub places: usize,
    /// Value of the first button.
    pub least: i64,
}

/// The input reports of a device.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// Controls in the order of the descriptor.
    pub controls: Vec<Control>,
    /// Lists of pressed buttons.
    pub selections: Vec<Selection>,
    /// Identifier and length in bytes, identifier included, of each input report.
    pub reports: Vec<(Option<u8>, usize)>,
}

impl Layout {
    /// Reads a descriptor. Never panics, and takes time and memory in proportion to its length.
    ///
    /// # Errors
    /// When it is no descriptor, or asks for more than a device can need.
    pub fn read(descriptor: &[u8]) -> Result<Self, DescriptorError> {
        guard::check(descriptor)?;
        // The guard keeps away what the parser is known to panic at; should there be more, a device must not end the program.
        let parsed = catch_unwind(|| ReportDescriptor::try_from(descriptor).map_err(|e| e.to_string()));
        let parsed = parsed.unwrap_or_else(|_| Err("the parser failed".into())).map_err(DescriptorError::Parser)?;
        let mut layout = Self::default();
        for report in parsed.input_reports() {
            let id = report.report_id().map(u8::from);
            layout.reports.push((id, report.size_in_bytes()));
            for field in report.fields() {
                match field {
                    Field::Variable(field) => layout.controls.extend(control(id, field)),
                    Field::Array(field) => {
                        let places = usize::from(field.report_count);
                        let bits = field.bits.len() / places.max(1);
                        let signed = field.is_signed();
                        if (1..=32).contains(&bits) {
                            layout.selections.push(Selection {
                                usages: field.usages().iter().map(|u| (u16::from(u.usage_page), u16::from(u.usage_id))).collect(),
                                field: BitField { report: id, start: field.bits.start, bits, signed },
                                places,
                                least: i64::from(i32::from(field.logical_minimum)),
                            });
                        }
                    }
                    Field::Constant(_) => {}
                }
            }
        }
        Ok(layout)
    }

    /// Whether a report is as long as the descriptor says. One that the descriptor does not know is not.
    #[must_use]
    pub fn admits(&self, report: &[u8]) -> bool {
        let expected = self.reports.iter().find(|(id, _)| id.is_none() || report.first().copied() == *id);
        expected.is_some_and(|(_, bytes)| report.len() >= *bytes)
    }

    /// The `nth` control (from 0) of a usage.
    #[must_use]
    pub fn control(&self, usage: (u16, u16), nth: u8) -> Option<&Control> {
        self.controls.iter().filter(|c| c.usage == usage).nth(usize::from(nth))
    }

    /// The list that a usage can be selected in, and the value that selects it.
    #[must_use]
    pub fn selection(&self, usage: (u16, u16)) -> Option<(&Selection, i64)> {
        self.selections.iter().find_map(|list| {
            let index = list.usages.iter().position(|u| *u == usage)?;
            Some((list, list.least + index as i64))
        })
    }
}

fn control(report: Option<u8>, field: &VariableField) -> Option<Control> {
    use hidreport::FieldAttributes;
    let (bits, signed) = (field.bits.len(), field.is_signed());
    let place = BitField { report, start: field.bits.start, bits, signed };
    let least = i64::from(i32::from(field.logical_minimum));
    let most = i64::from(i32::from(field.logical_maximum));
    // 0 to 65535 in two bytes reads as 0 to -1: many devices say so.
    let most = if !signed && most < least { most & place.limits().1 } else { most };
    let usage = (u16::from(field.usage.usage_page), u16::from(field.usage.usage_id));
    (1..=32).contains(&bits).then_some(Control { usage, field: place, least, most, relative: field.is_relative() })
}
