//! What a performance came to with clips and blood, where there is either.

use bevy::prelude::*;
use keyhole_whiteboard::{BleedReport, ClipApplier, ClipReport, Vessel};
use serde::Serialize;

/// Clips and blood.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Bleeding {
    /// Clips set on tissue.
    pub clips_set: u32,
    /// Of these on no vessel, or not across the whole of one.
    pub clips_misplaced: u32,
    /// Clips that closed on nothing.
    pub clips_dropped: u32,
    /// Clips that slipped off.
    pub clips_slipped: u32,
    /// Clips left in the cartridges.
    pub clips_left: u32,
    /// Blood lost, ml.
    pub blood_lost_ml: f64,
    /// What of it was aspirated, ml.
    pub blood_aspirated_ml: f64,
    /// What of it lies at the end, ml.
    pub blood_pooled_ml: f64,
    /// How much bleeds at the end, ml/min.
    pub rate_ml_min: f32,
}

impl Bleeding {
    /// As it is now; `None` where there are neither vessels nor clip appliers.
    pub fn of(world: &mut World) -> Option<Self> {
        let mut appliers = world.query::<&ClipApplier>();
        let left: Vec<u32> = appliers.iter(world).map(|a| a.clips).collect();
        let vessels = world.query::<&Vessel>().iter(world).count();
        let (clips, bleeding) = (world.resource::<ClipReport>(), world.resource::<BleedReport>());
        (vessels + left.len() > 0).then(|| Self {
            clips_set: clips.set,
            clips_misplaced: clips.misplaced,
            clips_dropped: clips.dropped,
            clips_slipped: clips.slipped,
            clips_left: left.iter().sum(),
            blood_lost_ml: bleeding.lost_ml,
            blood_aspirated_ml: bleeding.aspirated_ml,
            blood_pooled_ml: bleeding.pooled_ml(),
            rate_ml_min: bleeding.rate_ml_min,
        })
    }

    /// In a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        format!(
            "Clips: {} set, {} of them misplaced, {} dropped, {} slipped off, {} left. Blood lost: {:.1} ml, {:.1} ml of it aspirated; at the end {:.0} ml/min.",
            self.clips_set,
            self.clips_misplaced,
            self.clips_dropped,
            self.clips_slipped,
            self.clips_left,
            self.blood_lost_ml,
            self.blood_aspirated_ml,
            self.rate_ml_min
        )
    }
}
