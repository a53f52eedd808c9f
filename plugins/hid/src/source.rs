//! Numbers and buttons of a report, found once and read often.

use crate::descriptor::Layout;
use crate::error::FitError;
use crate::profile::{Button, Direction, Source};
use crate::report::BitField;

/// Where a whole number is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field {
    place: BitField,
    /// What the descriptor says the value stays within.
    pub range: Option<(i64, i64)>,
}

impl Field {
    fn find(axis: &str, source: &Source, layout: &Layout) -> Result<Self, FitError> {
        match *source {
            Source::Usage { page, usage, nth } => {
                let control = layout.control((page, usage), nth);
                let control = control.ok_or_else(|| FitError::NoUsage { axis: axis.into(), page, usage, nth })?;
                Ok(Self { place: control.field, range: (control.least < control.most).then_some((control.least, control.most)) })
            }
            Source::Bits { report, start, bits, signed } => {
                let place = BitField { report, start: usize::from(start), bits: usize::from(bits), signed };
                Ok(Self { place, range: Some(place.limits()) })
            }
            Source::Buttons { ref plus, .. } => Self::find(axis, &plus.from, layout),
        }
    }

    fn read(&self, report: &[u8]) -> Option<i64> {
        self.place.read(report)
    }

    /// Whether a value is one that the descriptor allows.
    fn allows(&self, value: i64) -> bool {
        self.range.is_none_or(|(least, most)| (least..=most).contains(&value))
    }
}

/// A button, with what it was when it was heard of last.
#[derive(Clone, Debug)]
pub struct Switch {
    place: SwitchPlace,
    values: Option<Vec<i64>>,
    /// Whether it is held.
    pub held: bool,
}

#[derive(Clone, Debug)]
enum SwitchPlace {
    Field(Field),
    /// In a list of the buttons that are pressed.
    Listed {
        first: BitField,
        places: usize,
        value: i64,
    },
}

impl Switch {
    /// Finds a button.
    ///
    /// # Errors
    /// When the device has none.
    pub fn find(axis: &str, button: &Button, layout: &Layout) -> Result<Self, FitError> {
        let place = match (&*button.from, Field::find(axis, &button.from, layout)) {
            (_, Ok(field)) => SwitchPlace::Field(field),
            (Source::Usage { page, usage, .. }, Err(error)) => match layout.selection((*page, *usage)) {
                Some((list, value)) => SwitchPlace::Listed { first: list.field, places: list.places, value },
                None => return Err(error),
            },
            (_, Err(error)) => return Err(error),
        };
        Ok(Self { place, values: button.values.clone(), held: false })
    }

    /// Takes note of a report; one that does not speak of the button changes nothing.
    pub fn hear(&mut self, report: &[u8]) {
        match self.place {
            SwitchPlace::Field(field) => {
                if let Some(value) = field.read(report) {
                    self.held = self.values.as_ref().map_or(value != 0, |values| values.contains(&value));
                }
            }
            SwitchPlace::Listed { first, places, value } => {
                let read = |i: usize| BitField { start: first.start + i * first.bits, ..first }.read(report);
                if first.is_in(report) && read(0).is_some() {
                    self.held = (0..places).any(|i| read(i) == Some(value));
                }
            }
        }
    }
}

/// A number of an axis.
#[derive(Clone, Debug)]
pub enum Number {
    /// Counts of a field, which stay within what the descriptor says if that is asked for.
    Counts {
        /// The field.
        field: Field,
        /// Whether a value outside of the field's range is refused.
        strict: bool,
    },
    /// Two buttons.
    Pair(Switch, Switch),
    /// The angle of a direction to the right, degrees.
    Rightward([Field; 3]),
    /// The angle of a direction upwards, degrees.
    Upward([Field; 3]),
}

/// A field holds a value that it cannot have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutOfRange;

impl Number {
    /// Finds a number, with the counts at its ends; `None` where they have to come from the profile.
    ///
    /// # Errors
    /// When the device has none.
    pub fn find(axis: &str, source: &Source, layout: &Layout) -> Result<(Self, Option<(i64, i64)>), FitError> {
        if let Source::Buttons { plus, minus } = source {
            let pair = Self::Pair(Switch::find(axis, plus, layout)?, Switch::find(axis, minus, layout)?);
            return Ok((pair, Some((-1, 1))));
        }
        let field = Field::find(axis, source, layout)?;
        Ok((Self::Counts { field, strict: true }, field.range))
    }

    /// Finds both angles of a direction.
    ///
    /// # Errors
    /// When the device does not have all of its parts.
    pub fn find_direction(direction: &Direction, layout: &Layout) -> Result<[Self; 2], FitError> {
        let find = |source| Field::find("direction", source, layout);
        let fields = [find(&direction.right)?, find(&direction.up)?, find(&direction.inward)?];
        Ok([Self::Rightward(fields), Self::Upward(fields)])
    }

    /// The number in a report; `None` when the report does not speak of it.
    ///
    /// # Errors
    /// When the field holds what it cannot.
    pub fn hear(&mut self, report: &[u8]) -> Result<Option<f64>, OutOfRange> {
        match self {
            Self::Counts { field, strict } => match field.read(report) {
                Some(value) if *strict && !field.allows(value) => Err(OutOfRange),
                value => Ok(value.map(|v| v as f64)),
            },
            Self::Pair(plus, minus) => {
                plus.hear(report);
                minus.hear(report);
                Ok(Some(f64::from(i8::from(plus.held) - i8::from(minus.held))))
            }
            Self::Rightward(fields) => Ok(parts(fields, report)?.map(|[right, _, inward]| right.atan2(inward).to_degrees())),
            Self::Upward(fields) => Ok(parts(fields, report)?.map(|[right, up, inward]| up.atan2(right.hypot(inward)).to_degrees())),
        }
    }
}

fn parts(fields: &[Field; 3], report: &[u8]) -> Result<Option<[f64; 3]>, OutOfRange> {
    let [Some(right), Some(up), Some(inward)] = fields.map(|f| f.read(report)) else { return Ok(None) };
    // No direction at all is what a device says that has not found it.
    if right == 0 && up == 0 && inward == 0 { Err(OutOfRange) } else { Ok(Some([right as f64, up as f64, inward as f64])) }
}
