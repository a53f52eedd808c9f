//! The tools: opening angles, cutting lines, and what they look like.
//!
//! Shapes after the instruments of 5 mm laparoscopic sets: an insulated black shaft with a metal collar, tapered jaws of about 20 mm, a
//! hook electrode whose dissecting blade may be chosen longer, and a scalpel with a pointed straight blade like a number 11.

use crate::model::{Profile, Ring};
use bevy_math::Vec3;
use keyhole_whiteboard::{CutTrigger, CuttingLine, InstrumentKind, JawPads, Joint, LineShape, Suction, ToolModel, ToolPart};

/// Length of a grasper's jaws from their pivot, m.
pub const GRASPER_JAW_M: f32 = 0.020;
/// From the middle plane to each pad of a closed grasper, m: the depth of its teeth.
pub const PAD_GAP_M: f32 = 0.0003;
/// Length of a needle holder's jaws from their pivot, m.
pub const NEEDLE_HOLDER_JAW_M: f32 = 0.014;
/// From the middle plane to each pad of a closed needle holder, m: its inserts are flat and finely cut.
pub const NEEDLE_HOLDER_GAP_M: f32 = 0.0002;
/// Length of scissors' blades from their pivot, m.
pub const SCISSORS_JAW_M: f32 = 0.018;
/// Length of a hook's blade where the scene says nothing, m.
pub const HOOK_BLADE_M: f32 = 0.016;
/// Length of a scalpel's blade from its holder to its point, m.
pub const SCALPEL_BLADE_M: f32 = 0.014;
/// How far below the shaft's axis a scalpel's edge ends at the holder, m; its point is on the axis.
pub const SCALPEL_DROP_M: f32 = 0.002;

const STEEL: [f32; 3] = [0.62, 0.63, 0.65];
const INSULATION: [f32; 3] = [0.02, 0.02, 0.022];
const CERAMIC: [f32; 3] = [0.82, 0.80, 0.74];

/// What people call a kind of instrument.
#[must_use]
pub fn name(kind: InstrumentKind) -> &'static str {
    match kind {
        InstrumentKind::Grasper => "Grasper",
        InstrumentKind::Scissors => "Scissors",
        InstrumentKind::Hook => "Hook",
        InstrumentKind::Scalpel => "Scalpel",
        InstrumentKind::ClipApplier => "Clip applier",
        InstrumentKind::NeedleHolder => "Needle holder",
        InstrumentKind::Suction => "Suction",
    }
}

/// Largest angle of each jaw from the shaft's axis, rad: 30 degrees for graspers, 25 for scissors and needle holders.
#[must_use]
pub fn widest_angle_rad(kind: InstrumentKind) -> f32 {
    match kind {
        InstrumentKind::Grasper => 30f32.to_radians(),
        InstrumentKind::Scissors | InstrumentKind::NeedleHolder => 25f32.to_radians(),
        InstrumentKind::Hook | InstrumentKind::Scalpel | InstrumentKind::Suction => 0.0,
        InstrumentKind::ClipApplier => crate::applier::WIDEST_RAD,
    }
}

/// What about a kind of instrument cuts where the scene says nothing; graspers, needle holders, clip appliers and suctions cut nothing. Every blade is cold.
#[must_use]
pub fn cutting_line(kind: InstrumentKind) -> Option<CuttingLine> {
    let edge = |length_m: f32, drop_m: f32| LineShape::Edge { tip: Vec3::new(0.0, 0.0, -length_m), heel: Vec3::new(0.0, -drop_m, 0.0) };
    let (line, trigger) = match kind {
        InstrumentKind::Grasper | InstrumentKind::NeedleHolder | InstrumentKind::ClipApplier | InstrumentKind::Suction => return None,
        InstrumentKind::Scissors => (LineShape::JawLine { length_m: SCISSORS_JAW_M }, CutTrigger::Closing),
        InstrumentKind::Hook => (edge(HOOK_BLADE_M, 0.0), CutTrigger::Pedal),
        InstrumentKind::Scalpel => (edge(SCALPEL_BLADE_M, SCALPEL_DROP_M), CutTrigger::Pedal),
    };
    Some(CuttingLine { line, trigger, kerf_m: 0.0 })
}

/// The pads of a kind of instrument with a shaft of this radius (m): those of graspers and needle holders, as their models have them.
#[must_use]
pub fn jaw_pads(kind: InstrumentKind, shaft_radius_m: f32) -> Option<JawPads> {
    let pads = |length_m: f32, half_width: f32, closed_gap_m: f32| JawPads {
        from_m: 0.15 * length_m,
        to_m: 0.95 * length_m,
        half_width_m: half_width * shaft_radius_m,
        closed_gap_m,
    };
    match kind {
        InstrumentKind::Grasper => Some(pads(GRASPER_JAW_M, 0.74, PAD_GAP_M)),
        InstrumentKind::NeedleHolder => Some(pads(NEEDLE_HOLDER_JAW_M, 0.60, NEEDLE_HOLDER_GAP_M)),
        _ => None,
    }
}

/// What a kind of instrument takes up where the scene says nothing: suctions alone take anything up.
#[must_use]
pub fn suction(kind: InstrumentKind) -> Option<Suction> {
    (kind == InstrumentKind::Suction).then(Suction::default)
}

/// How far ahead of the frame's origin the point lies that a hand steers, m: the blade's tip, the end of the jaws' pads, the middle of a clip between them, or a suction's mouth.
#[must_use]
pub fn working_reach(kind: InstrumentKind, line: Option<&CuttingLine>) -> f32 {
    let without_line = || match kind {
        InstrumentKind::Grasper => 0.8 * GRASPER_JAW_M,
        InstrumentKind::NeedleHolder => 0.8 * NEEDLE_HOLDER_JAW_M,
        InstrumentKind::ClipApplier => crate::applier::MIDDLE_M,
        InstrumentKind::Suction => Suction::default().mouth_m,
        InstrumentKind::Scissors | InstrumentKind::Hook | InstrumentKind::Scalpel => 0.0,
    };
    line.map_or_else(without_line, |l| l.line.reach_m())
}

/// What an instrument looks like.
#[must_use]
pub fn tool_model(kind: InstrumentKind, shaft_length_m: f32, shaft_radius_m: f32, line: Option<&CuttingLine>) -> ToolModel {
    let r = shaft_radius_m;
    let length = |default: f32| line.map_or(default, |l| l.line.reach_m());
    let mut parts = shaft(shaft_length_m, r);
    match kind {
        InstrumentKind::Grasper => parts.extend(jaws(GRASPER_JAW_M, r, JawShape::Pad)),
        InstrumentKind::Scissors => parts.extend(jaws(length(SCISSORS_JAW_M), r, JawShape::Edge)),
        InstrumentKind::Hook => parts.extend(hook(length(HOOK_BLADE_M), r)),
        InstrumentKind::Scalpel => parts.extend(scalpel(length(SCALPEL_BLADE_M), r)),
        InstrumentKind::ClipApplier => parts.extend(crate::applier::jaws(r)),
        InstrumentKind::NeedleHolder => parts.extend(needle_holder(NEEDLE_HOLDER_JAW_M, r)),
        InstrumentKind::Suction => parts.extend(crate::suction::tube(r)),
    }
    ToolModel { parts }
}

/// Insulated tube, steel collar at its end, and the knob that the surgeon turns.
fn shaft(length: f32, r: f32) -> Vec<ToolPart> {
    let round = |z: f32, r: f32| Ring { z, half_x: r, half_y: r, offset: Vec3::ZERO };
    let collar = 3.0 * r;
    let tube = Profile::Round.loft(&[round(collar, r), round(length, r)]);
    let metal = Profile::Round.loft(&[round(0.3 * r, 0.75 * r), round(0.8 * r, 0.95 * r), round(collar, 0.95 * r)]);
    let knob = Profile::Round.loft(&[
        round(length - 8.0 * r, 1.1 * r),
        round(length - 7.0 * r, 4.0 * r),
        round(length - 1.5 * r, 4.0 * r),
        round(length, 2.5 * r),
    ]);
    vec![
        ToolPart { name: "shaft", mesh: tube, joint: Joint::Fixed, colour: INSULATION, metallic: 0.0 },
        ToolPart { name: "collar", mesh: metal, joint: Joint::Fixed, colour: STEEL, metallic: 1.0 },
        ToolPart { name: "knob", mesh: knob, joint: Joint::Fixed, colour: INSULATION, metallic: 0.0 },
    ]
}

#[derive(Clone, Copy, PartialEq)]
enum JawShape {
    /// Broad, with a blunt rounded end and a raised pad inside.
    Pad,
    /// Narrow, pointed, one behind the other.
    Edge,
}

/// Two jaws that open up and down (about X), each in its half of the shaft's round when closed.
fn jaws(length: f32, r: f32, shape: JawShape) -> Vec<ToolPart> {
    let mut parts = Vec::new();
    for (name, side, factor) in [("jaw_upper", 1.0f32, 1.0), ("jaw_lower", -1.0, -1.0)] {
        let ring = |along: f32, half_x: f32, half_y: f32, shift_x: f32| Ring {
            z: -along * length,
            half_x: half_x * r,
            half_y: half_y * r,
            offset: Vec3::new(shift_x * r, side * half_y * r, 0.0),
        };
        let rings = match shape {
            JawShape::Pad => vec![
                ring(-0.12, 0.70, 0.42, 0.0),
                ring(0.0, 0.80, 0.46, 0.0),
                ring(0.25, 0.88, 0.44, 0.0),
                ring(0.75, 0.74, 0.34, 0.0),
                ring(0.95, 0.56, 0.24, 0.0),
                ring(1.0, 0.30, 0.12, 0.0),
            ],
            // Blades lie beside each other, sharp towards the middle plane, bent a little to one side like Metzenbaum's.
            JawShape::Edge => vec![
                ring(-0.12, 0.55, 0.42, side * 0.25),
                ring(0.0, 0.50, 0.46, side * 0.25),
                ring(0.4, 0.30, 0.44, side * 0.18 + 0.10),
                ring(0.8, 0.20, 0.28, side * 0.12 + 0.45),
                ring(1.0, 0.08, 0.08, side * 0.06 + 0.75),
            ],
        };
        let joint = Joint::Hinge { pivot: Vec3::ZERO, axis: Vec3::X, factor };
        parts.push(ToolPart { name, mesh: Profile::Slab.loft(&rings), joint, colour: STEEL, metallic: 1.0 });
        if shape == JawShape::Pad {
            // Ridges across the pad, 1 mm apart: what keeps tissue from slipping.
            let mut pad = keyhole_whiteboard::PartMesh::default();
            let ridges = 10u8;
            for k in 0..ridges {
                let at = -length * (0.30 + 0.60 * f32::from(k) / f32::from(ridges));
                let width = (0.80 - 0.25 * f32::from(k) / f32::from(ridges)) * r;
                let ridge = |z: f32, y: f32| Ring { z, half_x: width, half_y: y, offset: Vec3::new(0.0, side * y, 0.0) };
                crate::model::append(&mut pad, &Profile::Slab.loft(&[ridge(at, 0.02 * r), ridge(at + 0.012 * length, 0.10 * r)]));
            }
            let name = if side > 0.0 { "pad_upper" } else { "pad_lower" };
            parts.push(ToolPart { name, mesh: pad, joint, colour: [0.45, 0.46, 0.48], metallic: 1.0 });
        }
    }
    parts
}

/// Two short jaws, broad and high at their root, straight and blunt at their end, with inserts of carbide, finely cut, in gilt: the colour by which theatres tell a needle
/// holder from a grasper.
fn needle_holder(length: f32, r: f32) -> Vec<ToolPart> {
    const GILT: [f32; 3] = [0.72, 0.53, 0.20];
    const CARBIDE: [f32; 3] = [0.30, 0.31, 0.33];
    let mut parts = Vec::new();
    for (name, insert, side, factor) in [("jaw_upper", "insert_upper", 1.0f32, 1.0), ("jaw_lower", "insert_lower", -1.0, -1.0)] {
        // From the insert's back to the jaw's.
        let ring = |along: f32, half_x: f32, half_y: f32| Ring {
            z: -along * length,
            half_x: half_x * r,
            half_y: half_y * r,
            offset: Vec3::new(0.0, side * (half_y + 0.08) * r, 0.0),
        };
        let jaw = [ring(-0.22, 0.78, 0.42), ring(0.0, 0.86, 0.44), ring(0.3, 0.72, 0.36), ring(0.92, 0.60, 0.22), ring(1.0, 0.46, 0.12)];
        let joint = Joint::Hinge { pivot: Vec3::ZERO, axis: Vec3::X, factor };
        parts.push(ToolPart { name, mesh: Profile::Slab.loft(&jaw), joint, colour: GILT, metallic: 1.0 });
        let plate = |along: f32, half_x: f32| Ring {
            z: -along * length,
            half_x: half_x * r,
            half_y: 0.06 * r,
            offset: Vec3::new(0.0, side * 0.09 * r, 0.0),
        };
        let inserts = Profile::Slab.loft(&[plate(0.15, 0.60), plate(0.95, 0.52)]);
        parts.push(ToolPart { name: insert, mesh: inserts, joint, colour: CARBIDE, metallic: 1.0 });
    }
    parts
}

/// A ceramic sleeve, a flat dissecting blade along the shaft's axis, and the hook at its end.
fn hook(length: f32, r: f32) -> Vec<ToolPart> {
    let ring = |z: f32, half_x: f32, half_y: f32, y: f32| Ring { z, half_x, half_y, offset: Vec3::new(0.0, y, 0.0) };
    let sleeve = Profile::Round.loft(&[
        ring(-1.2 * r, 0.45 * r, 0.45 * r, 0.0),
        ring(-0.4 * r, 0.8 * r, 0.8 * r, 0.0),
        ring(0.6 * r, 0.9 * r, 0.9 * r, 0.0),
    ]);
    let (thin, flat) = (0.09 * r, 0.30 * r);
    // The blade's edge is the frame's -Z axis; its body lies on the +Y side and thickens towards the sleeve.
    let blade = Profile::Slab.loft(&[
        ring(-length, thin, 0.5 * flat, 0.0),
        ring(-length + 0.5 * r, thin, flat, 0.0),
        ring(-0.5 * length, 1.4 * thin, 1.1 * flat, 0.0),
        ring(0.0, 1.8 * thin, 1.2 * flat, 0.0),
    ]);
    let bend = crate::model::tube(
        &[
            Vec3::new(0.0, 0.0, -length + 0.2 * r),
            Vec3::new(0.0, 0.10 * r, -length - 0.05 * r),
            Vec3::new(0.0, 0.45 * r, -length - 0.15 * r),
            Vec3::new(0.0, 1.25 * r, -length - 0.05 * r),
        ],
        0.20 * r,
    );
    vec![
        ToolPart { name: "sleeve", mesh: sleeve, joint: Joint::Fixed, colour: CERAMIC, metallic: 0.0 },
        ToolPart { name: "blade", mesh: blade, joint: Joint::Fixed, colour: STEEL, metallic: 1.0 },
        ToolPart { name: "hook", mesh: bend, joint: Joint::Fixed, colour: STEEL, metallic: 1.0 },
    ]
}

/// A holder, and a pointed blade whose edge runs straight from the point on the axis down to the holder; its back is blunt.
fn scalpel(length: f32, r: f32) -> Vec<ToolPart> {
    let holder = Profile::Slab.loft(&[
        Ring { z: -0.12 * length, half_x: 0.16 * r, half_y: 0.55 * r, offset: Vec3::new(0.0, -0.12 * r, 0.0) },
        Ring { z: 0.0, half_x: 0.45 * r, half_y: 0.75 * r, offset: Vec3::ZERO },
        Ring { z: 0.6 * r, half_x: 0.8 * r, half_y: 0.8 * r, offset: Vec3::ZERO },
    ]);
    // A ring from the edge up to the back: of a lens it is the whole, of the plate the blunt upper part.
    let back = |along: f32| (0.32 * r * (1.0 - along) / 0.12).min(0.32 * r) + 0.02 * r;
    let ring = |along: f32, half_x: f32, from: f32| {
        let edge = -SCALPEL_DROP_M * (1.0 - along);
        let (low, high) = (edge + from * (back(along) - edge), back(along));
        Ring { z: -along * length, half_x: half_x * r, half_y: (high - low) / 2.0, offset: Vec3::new(0.0, (low + high) / 2.0, 0.0) }
    };
    let blade = Profile::Round.loft(&[ring(1.0, 0.02, 0.0), ring(0.88, 0.08, 0.0), ring(0.0, 0.11, 0.0)]);
    let plate = Profile::Slab.loft(&[ring(0.97, 0.02, 0.5), ring(0.85, 0.09, 0.5), ring(0.0, 0.12, 0.5)]);
    vec![
        ToolPart { name: "holder", mesh: holder, joint: Joint::Fixed, colour: [0.30, 0.31, 0.33], metallic: 1.0 },
        ToolPart { name: "blade", mesh: blade, joint: Joint::Fixed, colour: [0.78, 0.79, 0.80], metallic: 1.0 },
        ToolPart { name: "plate", mesh: plate, joint: Joint::Fixed, colour: STEEL, metallic: 1.0 },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::tests::{assert_closed, assert_normals_point_out, signed_volume};
    use bevy_math::FloatExt;

    const KINDS: [InstrumentKind; 7] = [
        InstrumentKind::Grasper,
        InstrumentKind::Scissors,
        InstrumentKind::Hook,
        InstrumentKind::Scalpel,
        InstrumentKind::ClipApplier,
        InstrumentKind::NeedleHolder,
        InstrumentKind::Suction,
    ];

    #[test]
    fn every_part_is_a_closed_surface_with_outward_normals() {
        for kind in KINDS {
            for part in tool_model(kind, 0.33, 0.0025, cutting_line(kind).as_ref()).parts {
                assert_closed(part.name, &part.mesh);
                assert!(signed_volume(&part.mesh) > 0.0, "{kind:?} {}", part.name);
                assert_normals_point_out(part.name, &part.mesh);
            }
        }
    }

    /// The line of the kind, made `length` m long, and the part of its model of that name.
    fn drawn(kind: InstrumentKind, length: f32, name: &str) -> (LineShape, Vec<Vec3>) {
        let Some(line) = cutting_line(kind).map(|l| CuttingLine { line: l.line.with_reach(length), ..l }) else { panic!("{kind:?}") };
        let model = tool_model(kind, 0.33, 0.0025, Some(&line));
        let part = model.parts.into_iter().find(|p| p.name == name);
        (line.line, part.into_iter().flat_map(|p| p.mesh.vertices).map(Vec3::from_array).collect())
    }

    #[test]
    fn the_blade_that_is_drawn_is_the_blade_that_cuts() {
        for (kind, name, length) in
            [(InstrumentKind::Hook, "blade", 0.06), (InstrumentKind::Scalpel, "blade", 0.02), (InstrumentKind::Scissors, "jaw_upper", 0.03)]
        {
            let (line, vertices) = drawn(kind, length, name);
            assert_eq!((line.reach_m(), vertices.iter().map(|v| v.z).fold(f32::MAX, f32::min)), (length, -length), "{kind:?}");
        }
    }

    /// Nothing of a scalpel's blade is below its cutting line, and all along the line there is blade.
    #[test]
    fn the_edge_of_a_scalpel_is_its_cutting_line() {
        let (LineShape::Edge { tip, heel }, vertices) = drawn(InstrumentKind::Scalpel, 0.02, "blade") else { panic!("an edge") };
        let above = |v: &Vec3| v.y - heel.y.lerp(tip.y, (v.z - heel.z) / (tip.z - heel.z));
        assert!(vertices.iter().all(|v| above(v) > -1e-6 * tip.distance(heel)));
        for end in [tip, heel] {
            assert!(vertices.iter().any(|v| v.distance(end) < 1e-4 * tip.distance(heel)), "{end}");
        }
    }

    #[test]
    fn jaws_open_away_from_each_other() {
        let model = tool_model(InstrumentKind::Grasper, 0.33, 0.0025, None);
        for (name, sign) in [("jaw_upper", 1.0), ("jaw_lower", -1.0)] {
            let Some(part) = model.parts.iter().find(|p| p.name == name) else { panic!("no {name}") };
            let tip = part.joint.at(0.5) * Vec3::new(0.0, 0.0, -GRASPER_JAW_M);
            assert!(sign * tip.y > 0.4 * GRASPER_JAW_M, "{name} {tip}");
        }
    }
}
