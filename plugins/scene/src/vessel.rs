//! Vessels, clips and suctions of the scene format: what each field means, with unit and default; from there to the whiteboard; and what must hold of them.

use crate::format::Triple;
use bevy_math::Vec3;
use keyhole_whiteboard::{ClipApplier, ClipShape, Suction, Vessel, VesselEnd};
use serde::{Deserialize, Serialize};

/// Pascals in a millimetre of mercury.
const MMHG_PA: f32 = 133.322;

/// A vessel in an organ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneVessel {
    /// Its centre line from the near end to the far one, m, in the world; two points or more.
    pub line: Vec<Triple>,
    /// Radius of the lumen, mm; above 0.
    pub radius_mm: f32,
    /// Thickness of the wall where the organ is a hollow tube, mm. Default 0: the lumen runs through the organ's tissue.
    #[serde(default)]
    pub wall_mm: f32,
    /// What comes from where the line begins.
    pub near: SceneVesselEnd,
    /// What comes from where it ends. Default nothing.
    #[serde(default)]
    pub far: SceneVesselEnd,
}

/// An end of a vessel, as a source.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneVesselEnd {
    /// Pressure behind it, mmHg above that of the cavity, 0 to 300: of an artery about 100, of a vein about 5.
    pub pressure_mmhg: f32,
    /// What flows out of it when nothing stands in its way, ml/min; 0 or more.
    pub supply_ml_min: f32,
}

/// The clips of a clip applier.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneClips {
    /// Clips in the cartridge. Default 20.
    pub count: u32,
    /// Length of a leg, mm, 2 to 15. Default 9.
    pub leg_mm: f32,
    /// Thickness of the wire, mm, 0.3 to 2. Default 0.8.
    pub wire_mm: f32,
    /// Between the legs of a closed clip, mm, 0.05 to 2. Default 0.3.
    pub gap_mm: f32,
    /// Force at which the closed legs give, N; above 0. Default 8.
    pub most_pinch_n: f32,
}

impl Default for SceneClips {
    fn default() -> Self {
        let ClipApplier { clips, shape, .. } = ClipApplier::default();
        let mm = |m: f32| (m * 1e6).round() * 1e-3;
        Self { count: clips, leg_mm: mm(shape.leg_m), wire_mm: mm(shape.wire_m), gap_mm: mm(shape.gap_m), most_pinch_n: shape.most_pinch_n }
    }
}

/// What a suction takes up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneSuction {
    /// Blood that it takes up at most, ml/s, 0.1 to 100. Default 16.7: a litre a minute, which is what irrigation beside it is asked to deliver where something bleeds.
    pub most_ml_s: f32,
    /// How far from its mouth blood may be, mm, 0.5 to 20. Default 3.
    pub reach_mm: f32,
}

impl Default for SceneSuction {
    fn default() -> Self {
        let Suction { most_ml_s, reach_m, .. } = Suction::default();
        Self { most_ml_s, reach_mm: reach_m * 1e3 }
    }
}

impl SceneSuction {
    /// On the whiteboard.
    #[must_use]
    pub fn suction(&self) -> Suction {
        Suction { most_ml_s: self.most_ml_s, reach_m: self.reach_mm * 1e-3, ..Suction::default() }
    }

    /// What is wrong with it: the path below it, and what to do.
    pub(crate) fn problems(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        out_of(&mut found, "most_ml_s", self.most_ml_s, 0.1, 100.0, " ml/s; a litre a minute is 16.7");
        out_of(&mut found, "reach_mm", self.reach_mm, 0.5, 20.0, " mm");
        found
    }
}

impl SceneVessel {
    /// On the whiteboard, under the name of its organ.
    #[must_use]
    pub fn vessel(&self, name: &str) -> Vessel {
        let end = |end: SceneVesselEnd| VesselEnd { pressure_pa: end.pressure_mmhg * MMHG_PA, supply_ml_min: end.supply_ml_min };
        Vessel {
            name: name.to_owned(),
            line: self.line.iter().map(|p| Vec3::from_array(*p)).collect(),
            radius_m: self.radius_mm * 1e-3,
            wall_m: self.wall_mm * 1e-3,
            near: end(self.near),
            far: end(self.far),
        }
    }

    /// What is wrong with it: the path below it, and what to do.
    pub(crate) fn problems(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        if self.line.len() < 2 {
            found.push(("line".into(), format!("{} points are no line: give two or more", self.line.len())));
        }
        for (i, point) in self.line.iter().enumerate() {
            if !Vec3::from_array(*point).is_finite() {
                found.push((format!("line[{i}]"), "is not finite: write three numbers".into()));
            } else if i > 0 && *point == self.line[i - 1] {
                found.push((format!("line[{i}]"), "is the point before: remove one".into()));
            }
        }
        out_of(&mut found, "radius_mm", self.radius_mm, 0.05, 20.0, " mm");
        out_of(&mut found, "wall_mm", self.wall_mm, 0.0, 10.0, " mm; 0 where the lumen runs through tissue");
        for (name, end) in [("near", self.near), ("far", self.far)] {
            out_of(&mut found, &format!("{name}.pressure_mmhg"), end.pressure_mmhg, 0.0, 300.0, " mmHg; an artery has about 100");
            out_of(&mut found, &format!("{name}.supply_ml_min"), end.supply_ml_min, 0.0, 1e4, " ml/min; the heart gives about 5000");
        }
        found
    }
}

impl SceneClips {
    /// The applier that has them.
    #[must_use]
    pub fn applier(&self) -> ClipApplier {
        let own = ClipApplier::default();
        let (leg_m, wire_m, gap_m) = (self.leg_mm * 1e-3, self.wire_mm * 1e-3, self.gap_mm * 1e-3);
        let shape = ClipShape { leg_m, wire_m, gap_m, most_pinch_n: self.most_pinch_n, ..own.shape };
        // The legs end where those of the kind's own clip do.
        ClipApplier { clips: self.count, shape, crown_m: own.crown_m + own.shape.leg_m - leg_m, ..own }
    }

    /// What is wrong with them: the path below them, and what to do.
    pub(crate) fn problems(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        out_of(&mut found, "leg_mm", self.leg_mm, 2.0, 15.0, " mm");
        out_of(&mut found, "wire_mm", self.wire_mm, 0.3, 2.0, " mm");
        out_of(&mut found, "gap_mm", self.gap_mm, 0.05, 2.0, " mm");
        out_of(&mut found, "most_pinch_n", self.most_pinch_n, 0.1, 100.0, " N");
        found
    }
}

fn out_of(found: &mut Vec<(String, String)>, path: &str, value: f32, low: f32, high: f32, unit: &str) {
    if !(low..=high).contains(&value) {
        found.push((path.to_owned(), format!("{value} is out of range: expected {low} to {high}{unit}")));
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::parse;

    /// A scene with a vessel and an applier, each with these fields.
    fn scene(vessel: &str, clips: &str) -> crate::Scene {
        parse(&format!(
            "(version: 1, name: \"s\", organs: [(name: \"artery\", shape: Tube(length: 0.04, outer_radius: 0.002, inner_radius: 0.0014, cells: (4, 8, 1)), \
             materials: [], vessel: (line: [(0, -0.02, 0), (0, 0.02, 0)], radius_mm: 1.4{vessel}))], \
             instruments: [(kind: ClipApplier, hand: Left, port: \"p\", clips: ({clips}))])"
        ))
        .unwrap()
    }

    #[test]
    fn what_is_not_said_is_as_the_whiteboard_has_it() {
        let scene = scene(", near: (pressure_mmhg: 100, supply_ml_min: 200)", "");
        let applier = scene.instruments[0].clips.unwrap().applier();
        let own = ClipApplier::default();
        assert_eq!((applier.clips, applier.closed_rad), (own.clips, own.closed_rad));
        for (told, own) in [(applier.shape.leg_m, own.shape.leg_m), (applier.shape.gap_m, own.shape.gap_m), (applier.crown_m, own.crown_m)]
        {
            assert!((told / own - 1.0).abs() < 1e-5, "{told} {own}");
        }
        let vessel = scene.organs[0].vessel.as_ref().unwrap().vessel("artery");
        assert!((vessel.near.pressure_pa - 13_332.2).abs() < 0.1 && vessel.far == VesselEnd::default(), "{vessel:?}");
        let needs = scene.requirements();
        assert!(needs.clipping && needs.rigid && !needs.cutting, "{needs:?}");
    }

    #[test]
    fn what_is_wrong_is_said_with_its_path() {
        let scene = scene(", wall_mm: -1, near: (pressure_mmhg: NaN, supply_ml_min: 1e9)", "leg_mm: 90, gap_mm: 0");
        let paths = |found: Vec<(String, String)>| found.into_iter().map(|f| f.0).collect::<Vec<_>>();
        let mut vessel = scene.organs[0].vessel.clone().unwrap();
        assert_eq!(paths(vessel.problems()), ["wall_mm", "near.pressure_mmhg", "near.supply_ml_min"]);
        vessel.line[1] = vessel.line[0];
        assert_eq!(paths(vessel.problems())[0], "line[1]");
        vessel.line.truncate(1);
        assert_eq!(paths(vessel.problems())[0], "line");
        assert_eq!(paths(scene.instruments[0].clips.unwrap().problems()), ["leg_mm", "gap_mm"]);
    }
}
