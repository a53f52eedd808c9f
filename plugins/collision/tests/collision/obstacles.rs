//! Instruments and anatomy against tissue, against closed forms.

use crate::meshes::{Thing, block};
use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Quat, Vec3};
use keyhole_collision::anatomy::{AnatomyError, SolidSurface};
use keyhole_collision::contacts::{MovedPart, Party, with_anatomy, with_tools};
use keyhole_collision::mean_rest_edge_m;
use keyhole_collision::tool::{Motion, ToolPart};
use keyhole_whiteboard::{Contact, StaticSurface};

const DT: f32 = 1.0 / 60.0;

fn entity() -> Entity {
    World::new().spawn_empty().id()
}

fn party<'a>(thing: &'a Thing, velocities: &'a [Vec3]) -> Party<'a> {
    let Thing { mesh, shape, positions } = thing;
    Party { organ: entity(), topology: mesh.topology(), shape, positions, velocities, edge_m: mean_rest_edge_m(mesh), friction: 0.1 }
}

fn point(thing: &Thing, contact: &Contact) -> Vec3 {
    contact.point.iter().map(|(n, w)| *w * thing.positions[n.index()]).sum()
}

/// A flap of 50 x 5 x 50 mm, its upper face at y = 5 mm.
fn flap() -> Thing {
    Thing::new(block([10, 1, 10], [0.05, 0.005, 0.05]), |p| p)
}

fn touched(thing: &Thing, part: &ToolPart, motion: &Motion) -> Vec<Contact> {
    let velocities = vec![Vec3::ZERO; thing.positions.len()];
    let mut contacts = Vec::new();
    with_tools(&party(thing, &velocities), &[MovedPart { tool: entity(), part, motion, friction: 0.2, pad: None }], 0.0005, &mut contacts);
    contacts
}

/// A 5 mm shaft that lies across the flap and falls 83 mm in a tick, from above to far below: what is under it is touched from above and has to
/// go with it all the way.
#[test]
fn a_shaft_at_5_m_s_does_not_pass_a_flap_of_5_mm() {
    let (flap, radius, way) = (flap(), 0.0025, 5.0 * DT);
    let shaft = ToolPart::capsule(Vec3::new(0.025, 0.0, -0.1), Vec3::new(0.025, 0.0, 0.15), radius);
    for height in [0.0081_f32, 0.02, 0.05] {
        let at = |y: f32| Isometry3d::from_translation(Vec3::Y * y);
        let contacts = touched(&flap, &shaft, &Motion { from: at(height), to: at(height - way), dt_s: DT });
        assert!(contacts.len() >= 20, "{} contacts from {height}", contacts.len());
        for c in &contacts {
            let x = point(&flap, c);
            assert!((x.y - 0.005).abs() < 1e-5, "the upper face alone is touched: {c:?}");
            assert!((c.depth_m + (x - c.surface_m).dot(c.normal)).abs() < 1e-6);
            // Just under the shaft the plane is level; its gap when the tick begins and when it is over.
            if (x.x - 0.025).abs() < 1e-4 {
                assert!((c.normal + Vec3::Y).length() < 0.05, "{c:?}");
                assert!((c.depth_m - (0.005 - (height - radius))).abs() < 2e-4, "{c:?}");
                let missing = (c.surface_m + c.velocity_m_s * DT - x).dot(c.normal);
                assert!((missing - (0.005 - (height - way - radius))).abs() < 2e-4, "{missing}");
            }
        }
        assert!(contacts.iter().any(|c| (point(&flap, c).x - 0.025).abs() < 1e-4));
    }
    let beside = |y: f32| Isometry3d::from_translation(Vec3::new(0.06, y, 0.0));
    assert!(touched(&flap, &shaft, &Motion { from: beside(0.02), to: beside(-0.06), dt_s: DT }).is_empty(), "what passes beside it");
}

/// The same for a shaft that swings about its port, with 5 m/s at the flap: a straight sweep between its poses would miss.
#[test]
fn a_shaft_that_swings_does_not_pass_either() {
    let flap = flap();
    let shaft = ToolPart::capsule(Vec3::ZERO, Vec3::X * 0.2, 0.0025);
    let at = |angle: f32| Isometry3d::new(Vec3::new(-0.15, 0.0025, 0.025), Quat::from_rotation_z(angle));
    let contacts = touched(&flap, &shaft, &Motion { from: at(0.25), to: at(-0.25), dt_s: DT });
    assert!(!contacts.is_empty());
    for c in &contacts {
        assert!((point(&flap, c).y - 0.005).abs() < 1e-5 && c.normal.y < -0.9, "{c:?}");
    }
}

/// A jaw pressed a little into the flap from above is out above, by as much as it is in; from outside it touches nothing.
#[test]
fn a_jaw_in_the_tissue_has_its_depth() {
    let corners: Vec<Vec3> =
        (0..8).map(|i| Vec3::new((i & 1) as f32 * 0.004, (i >> 1 & 1) as f32 * 0.003, (i >> 2) as f32 * 0.02)).collect();
    let jaw = ToolPart::hull(&corners).unwrap();
    let still = |y: f32| {
        let at = Isometry3d::from_translation(Vec3::new(0.0231, y, 0.0152));
        Motion { from: at, to: at, dt_s: DT }
    };
    let contacts = touched(&flap(), &jaw, &still(0.0047));
    assert!(!contacts.is_empty());
    for c in contacts.iter().filter(|c| c.depth_m > 1e-5) {
        assert!((c.normal + Vec3::Y).length() < 1e-3 && (c.depth_m - 0.0003).abs() < 1e-5 && c.velocity_m_s == Vec3::ZERO, "{c:?}");
    }
    assert!(touched(&flap(), &jaw, &still(0.006)).is_empty());
    assert!(ToolPart::hull(&corners[..2]).is_none());
}

/// A cube with its upper face at y = 0; `outward` or, for a cavity, the other way round.
fn cube(outward: bool) -> StaticSurface {
    let vertices =
        (0..8).map(|i| Vec3::new((i & 1) as f32 * 0.4 - 0.2, (i >> 1 & 1) as f32 * 0.4 - 0.4, (i >> 2) as f32 * 0.4 - 0.2)).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let mut triangles: Vec<[u32; 3]> = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    if !outward {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    StaticSurface { vertices, triangles }
}

#[test]
fn anatomy_holds_what_is_in_it_or_would_be() {
    let solid = SolidSurface::new(&cube(true)).unwrap();
    // The lower face is 3 mm in, the next layer of nodes 1 mm out.
    let sunk = Thing::new(block([4; 3], [0.016; 3]), |p| p - Vec3::new(0.008, 0.003, 0.008));
    let count = |speed: f32| {
        let velocities = vec![Vec3::Y * speed; sunk.positions.len()];
        let mut contacts = Vec::new();
        with_anatomy(&party(&sunk, &velocities), (entity(), &solid), 0.4, 0.01, DT, &mut contacts);
        for c in &contacts {
            let x = point(&sunk, c);
            assert!((c.normal - Vec3::Y).length() < 1e-4 && (c.depth_m + x.y).abs() < 1e-6 && c.surface_m.y.abs() < 1e-6, "{c:?} {x}");
            assert!((c.friction - 0.2).abs() < 1e-6, "geometric mean");
        }
        contacts.len()
    };
    // Of the lowest layer all 25 nodes are on the block's surface, of the next 16.
    assert_eq!([count(0.0), count(1.0), count(-0.05), count(-0.07)], [25, 25, 25, 25 + 16]);
}

/// A block far above, so fast that it would be through the wall by the end of the tick, finds the upper face; beside the wall it finds nothing.
#[test]
fn anatomy_is_found_ahead_of_what_is_fast() {
    let solid = SolidSurface::new(&cube(true)).unwrap();
    let found = |aside: f32, speed: f32| {
        let block = Thing::new(block([4; 3], [0.016; 3]), |p| p + Vec3::new(aside, 0.03, 0.0));
        let velocities = vec![Vec3::NEG_Y * speed; block.positions.len()];
        let mut contacts = Vec::new();
        with_anatomy(&party(&block, &velocities), (entity(), &solid), 0.4, 0.01, DT, &mut contacts);
        for c in &contacts {
            let x = point(&block, c);
            assert!((c.normal - Vec3::Y).length() < 1e-4 && (c.depth_m + x.y).abs() < 1e-6 && c.surface_m.y.abs() < 1e-6, "{c:?} {x}");
        }
        contacts.len()
    };
    let way = |m: f32| m / DT;
    // Layers of surface nodes 30, 34, ... 46 mm above the face: 25, 16, 16, 16, 25.
    assert_eq!([way(0.029), way(0.031), way(0.035), way(0.5)].map(|speed| found(0.0, speed)), [0, 25, 41, 98]);
    assert_eq!(found(0.3, way(0.5)), 0);
}

#[test]
fn a_cavity_is_free_inside_and_solid_outside() {
    let cavity = SolidSurface::new(&cube(false)).unwrap();
    let inside = cavity.nearest(Vec3::new(0.0, -0.003, 0.05), 0.01).unwrap();
    assert!((inside.distance_m - 0.003).abs() < 1e-6 && (inside.normal + Vec3::Y).length() < 1e-4, "{inside:?}");
    let outside = cavity.nearest(Vec3::new(0.0, 0.004, 0.05), 0.01).unwrap();
    assert!((outside.distance_m + 0.004).abs() < 1e-6 && (outside.normal + Vec3::Y).length() < 1e-4, "{outside:?}");
    assert_eq!(cavity.nearest(Vec3::new(0.0, -0.2, 0.0), 0.01), None, "too far to tell");
}

/// A sheet of 5 x 5 squares, as a piece of the abdominal wall: solid behind it, and nothing beside it.
#[test]
fn an_open_surface_is_solid_behind_and_ends_at_its_border() {
    let vertices = (0..36).map(|i| Vec3::new((i % 6) as f32 * 0.02 - 0.05, 0.0, (i / 6) as f32 * 0.02 - 0.05)).collect();
    let square = |i: u32| {
        let a = i / 5 * 6 + i % 5;
        [[a, a + 6, a + 1], [a + 1, a + 6, a + 7]]
    };
    let sheet = SolidSurface::new(&StaticSurface { vertices, triangles: (0..25).flat_map(square).collect() }).unwrap();
    for (x, z) in [(0.0, 0.0), (0.013, -0.049), (-0.03, 0.03), (0.01, 0.01)] {
        for y in [-0.004_f32, 0.003] {
            let nearest = sheet.nearest(Vec3::new(x, y, z), 0.01).unwrap();
            assert!((nearest.distance_m - y).abs() < 1e-6 && (nearest.normal - Vec3::Y).length() < 1e-4, "{nearest:?}");
        }
    }
    for beside in [Vec3::new(0.052, -0.001, 0.0), Vec3::new(-0.05, 0.001, 0.056), Vec3::new(0.051, -0.001, 0.051)] {
        assert_eq!(sheet.nearest(beside, 0.01), None, "{beside}");
    }
}

#[test]
fn a_surface_that_is_none_says_why() {
    let mut broken = cube(true);
    broken.triangles[3][1] = 8;
    assert!(matches!(SolidSurface::new(&broken), Err(AnatomyError::NoVertex { triangle: 3, vertex: 8, vertices: 8 })));
    broken.vertices[2].x = f32::NAN;
    assert!(matches!(SolidSurface::new(&broken), Err(AnatomyError::NotFinite(2))));
    let mut turned = cube(true);
    turned.triangles[5].swap(0, 1);
    assert!(matches!(SolidSurface::new(&turned), Err(AnatomyError::NoSurface(..))));
}
