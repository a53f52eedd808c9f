//! What the trainee is told to do about a device.

use crate::profile::Profile;
use crate::session::Snapshot;
use keyhole_whiteboard::DeviceCondition;

/// What to do about a device in this state; empty when nothing has to be done.
#[must_use]
pub fn advice(snapshot: &Snapshot, profile: &Profile) -> String {
    let axis = snapshot.axis.map_or_else(|| "an axis".to_owned(), |(_, dof)| dof.to_string());
    match snapshot.condition {
        DeviceCondition::Live | DeviceCondition::Denied | DeviceCondition::Unsuitable | DeviceCondition::Missing => String::new(),
        DeviceCondition::Starting => "move it once".into(),
        DeviceCondition::Noisy => {
            format!("{axis} trembles: check its cable and its sensor; a `filter` in the profile {:?} smooths it", profile.name)
        }
        DeviceCondition::Stuck => format!("{axis} does not change while the rest moves: move it; if it stays, check its sensor"),
        DeviceCondition::Homing => {
            let flag = snapshot.not_homed.and_then(|i| profile.homing.get(i));
            flag.map_or_else(|| "move it to its stops".into(), |flag| flag.advice.clone())
        }
        DeviceCondition::Silent => "it says nothing: the instruments hold still; check its power, or plug it in again".into(),
        DeviceCondition::Garbage => {
            format!("what it sends is not what the profile {:?} expects: the instruments hold still; plug it in again", profile.name)
        }
        DeviceCondition::Unplugged => "plug it in again: the instruments hold still and go on from where they are".into(),
    }
}
