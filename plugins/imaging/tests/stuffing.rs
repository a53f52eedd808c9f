//! Isosurface stuffing on fields with known answers, and on random ones.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole_imaging::stuffing::{Keep, PROVED_DEGREES, Stuffed, Stuffer};
use keyhole_tetmesh::{Boundary, DVec3, TetMesh, quality};
use proptest::prelude::*;
use std::f64::consts::PI;

/// Rounding of the published digits, degrees.
const DIGITS: f64 = 0.05;

fn mesh(s: &Stuffed) -> TetMesh {
    keyhole_tetmesh::check::checked(&s.nodes, &s.tets, &[]).unwrap()
}

fn assert_bounds(s: &Stuffed) {
    let q = quality::of_tets(s.tets.iter().map(|t| t.map(|n| s.nodes[n as usize])));
    assert!(
        q.min_dihedral_deg >= PROVED_DEGREES[0] - DIGITS && q.max_dihedral_deg <= PROVED_DEGREES[1] + DIGITS,
        "dihedral angles in [{}, {}]",
        q.min_dihedral_deg,
        q.max_dihedral_deg
    );
    assert!(Boundary::of(&mesh(s)).is_closed_manifold());
}

fn euler(s: &Stuffed) -> i64 {
    Boundary::of(&mesh(s)).euler_characteristic()
}

fn close(got: f64, want: f64, part: f64) {
    assert!((got - want).abs() < part * want, "{got}, expected {want}");
}

#[test]
fn ball() {
    let r = 1.0;
    let field = move |p: DVec3| r - p.length();
    for a in [0.4, 0.2, 0.1] {
        let s = Stuffer::new(&field, DVec3::splat(-1.5), DVec3::splat(1.5), a).stuff(0.0, Keep::Largest).unwrap();
        assert_bounds(&s);
        assert_eq!(euler(&s), 2);
        // The surface is sampled with chords of length a: second order.
        close(mesh(&s).total_volume(), 4.0 / 3.0 * PI, 0.6 * a * a);
    }
}

#[test]
fn ellipsoid() {
    let r = DVec3::new(2.0, 1.0, 0.7);
    let field = move |p: DVec3| 1.0 - (p / r).length();
    let s = Stuffer::new(&field, -r * 1.4, r * 1.4, 0.13).stuff(0.0, Keep::Largest).unwrap();
    assert_bounds(&s);
    assert_eq!(euler(&s), 2);
    close(mesh(&s).total_volume(), 4.0 / 3.0 * PI * r.element_product(), 0.02);
}

#[test]
fn torus_has_one_handle() {
    let (major, minor) = (1.0, 0.35);
    let field = move |p: DVec3| minor - ((p.x.hypot(p.y) - major).powi(2) + p.z * p.z).sqrt();
    let s = Stuffer::new(&field, DVec3::new(-1.7, -1.7, -0.7), DVec3::new(1.7, 1.7, 0.7), 0.09).stuff(0.0, Keep::Largest).unwrap();
    assert_bounds(&s);
    assert_eq!(euler(&s), 0);
    close(mesh(&s).total_volume(), 2.0 * PI * PI * major * minor * minor, 0.03);
}

#[test]
fn two_balls_stay_two_and_touching_ones_are_never_pinched() {
    let balls = |gap: f64| move |p: DVec3| 1.0 - (p.abs() - DVec3::X * (1.0 + gap / 2.0)).with_y(p.y).with_z(p.z).length();
    let field = balls(0.5);
    let (min, max) = (DVec3::new(-2.8, -1.5, -1.5), DVec3::new(2.8, 1.5, 1.5));
    let s = Stuffer::new(&field, min, max, 0.15).stuff(0.0, Keep::All).unwrap();
    assert_bounds(&s);
    assert_eq!(euler(&s), 4);
    let one = Stuffer::new(&field, min, max, 0.15).stuff(0.0, Keep::Largest).unwrap();
    assert_eq!(euler(&one), 2);
    close(one.dropped_volume, 4.0 / 3.0 * PI, 0.02);
    // Gaps from clear overlap to clear distance, in steps that are no multiple of the cell.
    for i in -12..=12 {
        let field = balls(f64::from(i) * 0.0173);
        for keep in [Keep::All, Keep::Largest] {
            assert_bounds(&Stuffer::new(&field, min, max, 0.16).stuff(0.0, keep).unwrap());
        }
    }
}

#[test]
fn a_void_is_filled_and_an_empty_field_is_refused() {
    let shell = |p: DVec3| 0.3 - (p.length() - 1.0).abs();
    let s = Stuffer::new(&shell, DVec3::splat(-1.8), DVec3::splat(1.8), 0.15).stuff(0.0, Keep::Largest).unwrap();
    assert_bounds(&s);
    assert_eq!(euler(&s), 2);
    close(mesh(&s).total_volume(), 4.0 / 3.0 * PI * 1.3_f64.powi(3), 0.03);
    let stuffer = Stuffer::new(&shell, DVec3::splat(-1.8), DVec3::splat(1.8), 0.15);
    assert!(stuffer.stuff(-1.0, Keep::Largest).is_err());
    assert!(stuffer.stuff(1.0, Keep::Largest).is_err(), "a body that leaves the lattice");
}

#[test]
fn a_coarse_core_changes_nothing_at_the_surface() {
    let field = |p: DVec3| 1.0 - p.length();
    // A plane through the ball, as of a part in it.
    let sides = |p: DVec3| u32::from(p.x > 0.213);
    let all = |levels| {
        Stuffer::new(&field, DVec3::splat(-1.3), DVec3::splat(1.3), 0.065).with_core(levels, &sides).stuff(0.0, Keep::Largest).unwrap()
    };
    let fine = all(0);
    let surface = |s: &Stuffed| {
        let mesh = mesh(s);
        let mut faces: Vec<[[u64; 3]; 3]> = Boundary::of(&mesh)
            .triangles
            .iter()
            .map(|t| {
                let mut corners = t.map(|n| mesh.rest(n).to_array().map(f64::to_bits));
                corners.sort_unstable();
                corners
            })
            .collect();
        faces.sort_unstable();
        faces
    };
    let want = surface(&fine);
    let mut last = fine.tets.len();
    for levels in [1, 3] {
        let s = all(levels);
        assert_bounds(&s);
        assert_eq!(euler(&s), 2);
        let most = if levels == 1 { last * 9 / 10 } else { last };
        assert!(s.tets.len() <= most, "{levels} doublings: {} of {last} tetrahedra", s.tets.len());
        assert!(surface(&s) == want, "{levels} doublings: the surface is the same to the bit");
        close(mesh(&s).total_volume(), mesh(&fine).total_volume(), 1e-10);
        last = s.tets.len();
    }
}

/// With the thresholds of the paper one tetrahedron here had an angle of 10.3 degrees: a corner moved far along a short edge, towards the far end of a long
/// one that is cut near its other end.
#[test]
fn corners_that_move_far_keep_the_bound() {
    let waves = [
        ([6.416239259298551, 1.2761201739663752, -4.838737161878566], 2.193351659703323, 0.07278633460501636),
        ([-8.675217374997864, 8.695644388111605, 6.340227418467906], 6.173705916956388, 0.36670046592145916),
        ([-1.089712236395844, 3.213697481512047, 4.982676329884736], 0.9951606220798205, 0.3293340431331195),
    ];
    let shift = DVec3::new(0.13946000943909312, 0.13544754739341977, 0.0);
    let field = move |p: DVec3| {
        let w: f64 = waves.iter().map(|(k, phase, amplitude)| amplitude * (DVec3::from_array(*k).dot(p) + phase).sin()).sum();
        (1.3 - (p - shift).length()).min(0.4 + w)
    };
    let stuffer = Stuffer::new(&field, DVec3::splat(-2.0), DVec3::splat(2.3), 0.28774819299856613);
    assert_bounds(&stuffer.stuff(0.0, Keep::All).unwrap());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    /// Sums of waves with wavelengths down to two cells: blobs, tunnels, thin walls and kissing sheets, all within a ball.
    #[test]
    fn random_fields_keep_the_proved_bound(
        waves in prop::collection::vec((prop::array::uniform3(-9.0f64..9.0), 0.0f64..2.0 * PI, 0.05f64..0.4), 1..7),
        a in 0.16f64..0.3,
        shift in prop::array::uniform3(0.0f64..0.3),
    ) {
        let shift = DVec3::from_array(shift);
        let field = move |p: DVec3| {
            let w: f64 = waves.iter().map(|(k, phase, amplitude)| amplitude * (DVec3::from_array(*k).dot(p) + phase).sin()).sum();
            (1.3 - (p - shift).length()).min(0.4 + w)
        };
        let stuffer = Stuffer::new(&field, DVec3::splat(-2.0), DVec3::splat(2.3), a);
        for keep in [Keep::All, Keep::Largest] {
            if let Ok(s) = stuffer.stuff(0.0, keep) {
                assert_bounds(&s);
            }
        }
    }
}
