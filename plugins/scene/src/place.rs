//! From the format to the whiteboard: placing meshes, finding held nodes, converting settings, deriving requirements.

use crate::error::SceneError;
use crate::format::*;
use bevy_math::{DQuat, DVec3, Isometry3d, Quat, Vec3};
use keyhole_tetmesh::{MaterialId, TetMesh};
use keyhole_whiteboard::{
    Attachment, Attachments, CutMethod, CutPattern, CutSettings, CutTrigger, CuttingLine, Hand, InstrumentKind, OrganMaterial,
    OrganMaterials, Port, SceneRequirements,
};
use std::path::Path;

impl Placement {
    /// The rotation: about X, then Y, then Z of the world.
    #[must_use]
    pub fn rotation(&self) -> DQuat {
        let [x, y, z] = self.rotation_deg.map(|d| f64::from(d).to_radians());
        DQuat::from_rotation_z(z) * DQuat::from_rotation_y(y) * DQuat::from_rotation_x(x)
    }

    /// The placement of a rotation and a translation (m).
    #[must_use]
    pub fn new(rotation: DQuat, translation: DVec3) -> Self {
        let (z, y, x) = rotation.to_euler(bevy_math::EulerRot::ZYX);
        Self { translation: translation.as_vec3().to_array(), rotation_deg: [x, y, z].map(|a| a.to_degrees() as f32) }
    }

    /// A point of the asset in the world, m.
    #[must_use]
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation() * point + Vec3::from_array(self.translation).as_dvec3()
    }

    /// As a pose, for what is drawn only.
    #[must_use]
    pub fn isometry(&self) -> Isometry3d {
        let r = self.rotation();
        Isometry3d::new(Vec3::from_array(self.translation), Quat::from_xyzw(r.x as f32, r.y as f32, r.z as f32, r.w as f32))
    }
}

impl Region {
    /// Whether a point of the world (m) is inside, its border included.
    #[must_use]
    pub fn contains(&self, point: DVec3) -> bool {
        let v = |t: Triple| Vec3::from_array(t).as_dvec3();
        match *self {
            Self::Sphere { centre, radius } => point.distance(v(centre)) <= f64::from(radius),
            Self::HalfSpace { point: origin, normal } => (point - v(origin)).dot(v(normal)) >= 0.0,
            Self::Box { min, max } => point.cmpge(v(min)).all() && point.cmple(v(max)).all(),
        }
    }
}

impl SceneOrgan {
    /// Reads the mesh (as [`crate::load()`] left its path) or makes the shape, and bakes the transform into its rest positions.
    ///
    /// # Errors
    /// [`SceneError::Mesh`] with the file and what is wrong with it.
    pub fn read_mesh(&self) -> Result<TetMesh, SceneError> {
        let wrong = |what| SceneError::Mesh { organ: self.name.clone(), what };
        let mesh = match (&self.mesh, &self.shape) {
            (Some(file), None) => keyhole_tetmesh::vtu::read(Path::new(file)).map_err(|e| wrong(e.to_string()))?,
            (None, Some(shape)) => shape.mesh(),
            _ => return Err(wrong("give either `mesh` or `shape`".into())),
        };
        Ok(self.placed(&mesh))
    }

    /// The mesh at its place in the world. `mesh` is as read: no node or tetrahedron has been removed from it.
    #[must_use]
    pub fn placed(&self, mesh: &TetMesh) -> TetMesh {
        let nodes = mesh.rest_positions().iter().map(|p| self.transform.apply(*p)).collect();
        let (tets, materials): (Vec<[u32; 4]>, Vec<MaterialId>) =
            mesh.iter().map(|(t, corners)| (corners.map(|n| n.0), mesh.tet(t).material)).unzip();
        TetMesh::new(nodes, &tets, &materials)
    }

    /// The attachments of the placed mesh, their times counted from the start of the scene, by ascending node; a node in several regions is held by the first.
    #[must_use]
    pub fn attachments(&self, placed: &TetMesh) -> Attachments {
        let held = placed.nodes().filter_map(|node| {
            let rest = placed.rest(node);
            let hold = self.attachments.iter().find(|h| h.region.contains(rest))?;
            let until_s = hold.until_s.map_or(f64::INFINITY, f64::from);
            Some(Attachment { until_s, ..Attachment::node_to_space(node, rest.as_vec3(), hold.compliance_m_n) })
        });
        Attachments(held.collect())
    }

    /// Its materials.
    #[must_use]
    pub fn organ_materials(&self) -> OrganMaterials {
        OrganMaterials(
            self.materials
                .iter()
                .map(|m| OrganMaterial {
                    name: m.name.clone(),
                    young_modulus_pa: m.young_modulus_pa,
                    poisson_ratio: m.poisson_ratio,
                    density_kg_m3: m.density_kg_m3,
                    inside: m.inside,
                    surface: m.surface,
                })
                .collect(),
        )
    }
}

impl ScenePort {
    /// On the whiteboard; a zero direction points down.
    #[must_use]
    pub fn port(&self) -> Port {
        Port { position: Vec3::from_array(self.position), inward: Vec3::from_array(self.inward).normalize_or(Vec3::NEG_Y) }
    }
}

impl SceneHand {
    /// On the whiteboard.
    #[must_use]
    pub fn hand(self) -> Hand {
        match self {
            Self::Left => Hand::Left,
            Self::Right => Hand::Right,
        }
    }
}

impl SceneInstrumentKind {
    /// On the whiteboard.
    #[must_use]
    pub fn kind(self) -> InstrumentKind {
        match self {
            Self::Grasper => InstrumentKind::Grasper,
            Self::Scissors => InstrumentKind::Scissors,
            Self::Hook => InstrumentKind::Hook,
            Self::Scalpel => InstrumentKind::Scalpel,
            Self::ClipApplier => InstrumentKind::ClipApplier,
            Self::NeedleHolder => InstrumentKind::NeedleHolder,
            Self::Suction => InstrumentKind::Suction,
        }
    }

    /// Whether it has a blade.
    #[must_use]
    pub fn cuts(self) -> bool {
        matches!(self, Self::Scissors | Self::Hook | Self::Scalpel)
    }

    /// Whether it has jaws that close.
    #[must_use]
    pub fn closes(self) -> bool {
        matches!(self, Self::Grasper | Self::Scissors | Self::NeedleHolder | Self::ClipApplier)
    }
}

impl SceneInstrument {
    /// Length of the cutting line where the scene chose one, m.
    #[must_use]
    pub fn blade_length(&self) -> Option<f32> {
        self.blade.and_then(|b| b.length_mm).map(|mm| mm / 1000.0).or(self.blade_length_m)
    }

    /// The cutting line, given that of the kind.
    #[must_use]
    pub fn cutting_line(&self, of_kind: CuttingLine) -> CuttingLine {
        let blade = self.blade.unwrap_or_default();
        CuttingLine {
            line: self.blade_length().map_or(of_kind.line, |length| of_kind.line.with_reach(length)),
            trigger: match blade.trigger {
                None => of_kind.trigger,
                Some(SceneTrigger::Pedal) => CutTrigger::Pedal,
                Some(SceneTrigger::Closing) => CutTrigger::Closing,
            },
            kerf_m: blade.kerf_mm / 1000.0,
        }
    }
}

impl SceneCut {
    /// On the whiteboard.
    #[must_use]
    pub fn settings(&self) -> CutSettings {
        let pattern = |p| match p {
            SceneCutPattern::Minimal => CutPattern::Minimal,
            SceneCutPattern::Symmetric => CutPattern::Symmetric,
        };
        CutSettings {
            method: match self.method {
                SceneCutMethod::Hybrid => CutMethod::Hybrid,
                SceneCutMethod::Progressive => CutMethod::Progressive,
                SceneCutMethod::NonProgressive => CutMethod::NonProgressive,
            },
            hull: pattern(self.hull),
            core: pattern(self.core),
            snap: self.snap,
        }
    }
}

impl Scene {
    /// The port of that name.
    #[must_use]
    pub fn port(&self, name: &str) -> Option<Port> {
        self.ports.iter().find(|p| p.name == name).map(ScenePort::port)
    }

    /// Whether there are clips to be set.
    fn clips(&self) -> bool {
        self.instruments.iter().any(|i| std::iter::once(&i.kind).chain(&i.exchange).any(|k| *k == SceneInstrumentKind::ClipApplier))
    }

    /// What the scene requires: nothing else runs.
    #[must_use]
    pub fn requirements(&self) -> SceneRequirements {
        let tissue = !self.organs.is_empty();
        SceneRequirements {
            tissue,
            cutting: tissue && self.instruments.iter().any(|i| i.kind.cuts() || i.exchange.iter().any(|kind| kind.cuts())),
            instruments: !self.instruments.is_empty() || self.endoscope.is_some(),
            collision: self.collision.on
                && tissue
                && (!self.instruments.is_empty()
                    || self.organs.len() > 1
                    || self.anatomy.iter().any(|a| a.solid)
                    || self.collision.itself == SceneSelfCollision::Always),
            assessment: !self.instruments.is_empty() || self.endoscope.is_some(),
            clipping: self.clips() || self.organs.iter().any(|o| o.vessel.is_some()),
            // Clips that close on nothing drop.
            rigid: self.clips(),
            suturing: !self.sutures.is_empty(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_placement_says_its_rotation(axis in (-1f64..1.0, -1f64..1.0, -1f64..1.0), angle in -3f64..3.0, p in (-0.1f64..0.1, -0.1f64..0.1, -0.1f64..0.1)) {
            let axis = DVec3::from(axis);
            prop_assume!(axis.length() > 0.1);
            let rotation = DQuat::from_axis_angle(axis.normalize(), angle);
            let (p, move_by) = (DVec3::from(p), DVec3::new(0.01, -0.2, 0.3));
            let placement = Placement::new(rotation, move_by);
            prop_assert!(placement.apply(p).distance(rotation * p + move_by) < 1e-6);
            prop_assert!((placement.isometry() * p.as_vec3()).as_dvec3().distance(placement.apply(p)) < 1e-6);
        }
    }

    #[test]
    fn a_blade_says_what_differs_from_its_kind() {
        use keyhole_whiteboard::LineShape;
        let of_kind = CuttingLine { line: LineShape::JawLine { length_m: 0.018 }, trigger: CutTrigger::Closing, kerf_m: 0.0 };
        let line = |fields: &str| {
            let text = format!("(version: 1, name: \"s\", organs: [], instruments: [(kind: Scissors, hand: Left, port: \"p\"{fields})])");
            crate::parse(&text).map(|s| s.instruments[0].cutting_line(of_kind))
        };
        assert_eq!(line(""), Ok(of_kind));
        assert_eq!(line(", blade: ()"), Ok(of_kind));
        let longer = CuttingLine { line: LineShape::JawLine { length_m: 0.025 }, ..of_kind };
        assert_eq!(line(", blade: (length_mm: 25)"), Ok(longer));
        assert_eq!(line(", blade_length_m: 0.025"), Ok(longer));
        assert_eq!(
            line(", blade: (trigger: Pedal, kerf_mm: 0.5)"),
            Ok(CuttingLine { trigger: CutTrigger::Pedal, kerf_m: 0.0005, ..of_kind })
        );
    }

    #[test]
    fn a_quarter_turn_about_x_takes_y_to_z() {
        let turn = Placement { rotation_deg: [90.0, 0.0, 0.0], ..Default::default() };
        assert!(turn.apply(DVec3::Y).distance(DVec3::Z) < 1e-12);
        let both = Placement { rotation_deg: [90.0, 0.0, 90.0], ..Default::default() };
        assert!(both.apply(DVec3::X).distance(DVec3::Y) < 1e-12);
    }

    #[test]
    fn held_nodes_are_those_of_the_regions_and_the_first_region_wins() {
        let nodes = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let mesh = TetMesh::new(nodes, &[[0, 1, 2, 3]], &[]);
        let organ = SceneOrgan {
            name: "o".into(),
            mesh: None,
            shape: None,
            friction: None,
            vessel: None,
            tear_n_m: None,
            bruise_pa: None,
            materials: Vec::new(),
            transform: Placement { translation: [0.0, 0.0, 1.0], ..Default::default() },
            attachments: vec![
                Hold { region: Region::Sphere { centre: [0.0, 0.0, 2.0], radius: 0.1 }, compliance_m_n: 0.5, until_s: None },
                Hold { region: Region::HalfSpace { point: [0.0, 0.5, 0.0], normal: [0.0, 1.0, 1.0] }, compliance_m_n: 0.0, until_s: None },
            ],
        };
        let placed = organ.placed(&mesh);
        let held: Vec<(u32, f32)> = organ.attachments(&placed).0.iter().map(|a| (a.point[0].0.0, a.compliance_m_n)).collect();
        assert_eq!(held, [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.5)]);
        assert_eq!(placed.rest(keyhole_tetmesh::NodeId(0)), DVec3::Z);
    }
}
