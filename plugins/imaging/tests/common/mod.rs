//! What several test files need.

use keyhole_imaging::LabelChoice;

/// Labels by name and value.
pub fn labels(list: &[(&str, i64)]) -> Vec<LabelChoice> {
    list.iter().map(|(name, value)| LabelChoice { name: (*name).into(), value: *value }).collect()
}
