//! What soft tissue must survive: extreme materials and steps, tangles, violence, cuts, and a long rest.
//!
//! The body is a beam of 60 x 30 x 30 mm, clamped at one end, E 10 kPa, nu 0.45, 1050 kg/m3 where nothing else is said.

use bevy_math::Vec3;
use keyhole_tetmesh::{DVec3, NodeId, TetId, TetMesh};
use keyhole_tissue::Hold;
use keyhole_tissue::beam::{beam, beam_material, clamp, fix};
use keyhole_whiteboard::{OrganMaterials, TissueState};

/// What is done to a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hardship {
    /// Young's modulus, Pa.
    Young(f32),
    /// Poisson's ratio.
    Poisson(f32),
    /// Length of a tick, s.
    Tick(f32),
    /// Density of one half by that of the other.
    MassRatio(f32),
    /// Gravity in g.
    Gravity(f32),
    /// Smallest dihedral angle, degrees: edges split close to their ends.
    Sliver(f32),
    /// All free nodes in a plane.
    Plane,
    /// All free nodes on a line.
    Line,
    /// All free nodes in one point.
    Point,
    /// All free nodes anywhere in the box.
    Scrambled,
    /// Mirrored: every tetrahedron inside out.
    InsideOut,
    /// The end pulled to ten times the length within a second, and let go.
    Pulled,
    /// A node seized by a tool that moves at 10 m/s for one tick, back in the next, and lets go.
    FastTool,
    /// A hundred strokes of a blade while it hangs; what comes off falls as a body of its own.
    Cuts,
    /// An hour at rest under its weight.
    LongRest,
}

impl Hardship {
    /// All of them.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut all: Vec<Self> = [10.0, 1e3, 1e5, 1e7, 1e9].map(Self::Young).into();
        all.extend([0.0, 0.3, 0.49, 0.499, 0.4999].map(Self::Poisson));
        all.extend([1e-4, 1e-3, 0.0167, 0.033, 0.1].map(Self::Tick));
        all.extend([1e2, 1e4, 1e6].map(Self::MassRatio));
        all.extend([0.0, 1.0, 10.0, 100.0, 1000.0].map(Self::Gravity));
        all.extend([10.0, 1.0, 0.1, 0.01].map(Self::Sliver));
        all.extend([Self::Plane, Self::Line, Self::Point, Self::Scrambled, Self::InsideOut]);
        all.extend([Self::Pulled, Self::FastTool, Self::Cuts, Self::LongRest]);
        all
    }

    /// Its name in tables.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Young(e) => format!("E {e:e} Pa"),
            Self::Poisson(nu) => format!("nu {nu}"),
            Self::Tick(dt) => format!("tick {:.1} ms", dt * 1e3),
            Self::MassRatio(r) => format!("mass ratio {r:e}"),
            Self::Gravity(g) => format!("{g} g"),
            Self::Sliver(angle) => format!("slivers of {angle} degrees"),
            Self::Plane => "in a plane".into(),
            Self::Line => "on a line".into(),
            Self::Point => "in a point".into(),
            Self::Scrambled => "scrambled".into(),
            Self::InsideOut => "inside out".into(),
            Self::Pulled => "pulled to 10 x".into(),
            Self::FastTool => "tool at 10 m/s".into(),
            Self::Cuts => "a hundred cuts".into(),
            Self::LongRest => "an hour at rest".into(),
        }
    }

    /// Simulated time, s.
    #[must_use]
    pub fn seconds(&self) -> f32 {
        match self {
            Self::LongRest => 3600.0,
            Self::Cuts => 3.5,
            Self::Pulled => 5.0,
            Self::Tick(dt) if *dt < 1e-3 => 1.0,
            _ => 4.0,
        }
    }

    /// How many times as long as others it may take by the clock.
    #[must_use]
    pub fn patience(&self) -> f64 {
        match self {
            Self::LongRest => 10.0,
            Self::Cuts => 6.0,
            _ => 1.0,
        }
    }

    /// Length of a tick, s.
    #[must_use]
    pub fn tick_s(&self) -> f32 {
        if let Self::Tick(dt) = self { *dt } else { 1.0 / 60.0 }
    }

    /// Gravity, m/s2. A body that is to come back to its rest shape has none.
    #[must_use]
    pub fn gravity(&self) -> Vec3 {
        Vec3::NEG_Y
            * match self {
                Self::Gravity(g) => 9.81 * g,
                Self::Cuts | Self::LongRest => 9.81,
                _ => 0.0,
            }
    }

    /// Whether it is to come back to its rest shape in its time: not under gravity, and not where its slowest swing takes minutes.
    #[must_use]
    pub fn has_rest_shape(&self) -> bool {
        let is_slow = match self {
            Self::Young(e) => *e < 100.0,
            Self::MassRatio(r) => *r > 1e3,
            _ => false,
        };
        self.gravity() == Vec3::ZERO && !is_slow
    }

    /// Mesh and materials.
    #[must_use]
    pub fn body(&self) -> (TetMesh, OrganMaterials) {
        let mut mesh = beam(6, 3);
        let mut materials = beam_material();
        match self {
            Self::Young(e) => materials.0[0].young_modulus_pa = *e,
            Self::Poisson(nu) => materials.0[0].poisson_ratio = *nu,
            Self::MassRatio(ratio) => {
                let mut heavy = materials.0[0].clone();
                heavy.density_kg_m3 *= ratio;
                materials.0.push(heavy);
                mesh = two_materials(&mesh);
            }
            Self::Sliver(angle) => slivers(&mut mesh, f64::from(*angle)),
            _ => {}
        }
        (mesh, materials)
    }

    /// What holds it in a tick that ends at `t` s.
    #[must_use]
    pub fn holds(&self, mesh: &TetMesh, state: &TissueState, t: f32) -> Vec<Hold> {
        let mut holds = clamp(mesh);
        let end = |mesh: &TetMesh| mesh.nodes().filter(|n| mesh.rest(*n).x > 0.06 - 1e-9).collect::<Vec<NodeId>>();
        match self {
            Self::Pulled if t <= 1.0 => {
                for n in end(mesh) {
                    let to = mesh.rest(n).as_vec3() + Vec3::X * (0.54 * t);
                    holds.push(Hold { from: state.position(n), ..fix(n, to) });
                }
            }
            Self::FastTool if t <= 2.5 * self.tick_s() => {
                if let Some(n) = end(mesh).first() {
                    // 10 m/s along a diagonal, in one tick.
                    let way = if t <= 1.5 * self.tick_s() { 10.0 * self.tick_s() * std::f32::consts::FRAC_1_SQRT_2 } else { 0.0 };
                    holds.push(Hold { from: state.position(*n), ..fix(*n, mesh.rest(*n).as_vec3() + Vec3::new(way, way, 0.0)) });
                }
            }
            _ => {}
        }
        holds
    }

    /// Brings the state into its plight.
    pub fn disturb(&self, mesh: &TetMesh, state: &mut TissueState) {
        let mut random = random();
        for n in mesh.nodes().filter(|n| mesh.rest(*n).x > 0.0) {
            let p = &mut state.positions[n.index()];
            *p = match self {
                Self::Plane => Vec3::new(p.x, p.y, 0.015),
                Self::Line => Vec3::new(p.x, 0.015, 0.015),
                Self::Point => Vec3::new(0.03, 0.015, 0.015),
                Self::Scrambled => Vec3::new(random() * 0.06, random() * 0.03, random() * 0.03),
                Self::InsideOut => Vec3::new(-p.x, p.y, p.z),
                Self::Gravity(_) | Self::Cuts | Self::LongRest | Self::Pulled | Self::FastTool => *p,
                // Stretched by a third and bent.
                _ => Vec3::new(p.x * 1.3, p.y - 5.0 * p.x * p.x, p.z),
            };
        }
    }
}

/// Numbers in [0, 1), the same every time.
fn random() -> impl FnMut() -> f32 {
    let mut s = 1_u32;
    move || {
        s = s.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (s >> 8) as f32 / (1 << 24) as f32
    }
}

/// The outer half of a beam of material 1.
fn two_materials(mesh: &TetMesh) -> TetMesh {
    let tets: Vec<[u32; 4]> = mesh.iter().map(|(_, c)| c.map(|n| n.0)).collect();
    let outer = |t: TetId| u16::from(mesh.points(t).iter().map(|p| p.x).sum::<f64>() > 4.0 * 0.03);
    let materials: Vec<_> = mesh.iter().map(|(t, _)| keyhole_tetmesh::MaterialId(outer(t))).collect();
    TetMesh::new(mesh.rest_positions().to_vec(), &tets, &materials)
}

/// Splits an edge at some nodes so close to its end that the smallest dihedral angle is about `degrees`.
fn slivers(mesh: &mut TetMesh, degrees: f64) {
    // The part of the edge is about the tangent of the angle.
    let t = degrees.to_radians().tan();
    let free: Vec<NodeId> = mesh.nodes().filter(|n| mesh.rest(*n).x > 0.0).collect();
    for near in free.into_iter().step_by(5) {
        let tet = mesh.topology().around_node(near)[0];
        let Some(far) = mesh.corners(tet).into_iter().find(|n| *n != near) else { continue };
        let point: DVec3 = mesh.rest(near) * (1.0 - t) + mesh.rest(far) * t;
        let around: Vec<TetId> = mesh.topology().around_edge(near, far).collect();
        let middle = mesh.add_node(point, [(near, 1.0 - t), (far, t)].into_iter().collect());
        for tet in around {
            let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
            mesh.remove_tet(tet);
            mesh.add_tet(corners.map(|n| if n == near { middle } else { n }), attributes);
            mesh.add_tet(corners.map(|n| if n == far { middle } else { n }), attributes);
        }
    }
    mesh.take_delta();
}
