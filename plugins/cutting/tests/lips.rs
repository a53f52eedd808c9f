//! The lips of an earlier cut are cut alike. They lie on each other in the rest shape and nothing holds them together, so that one of them could be split
//! where the other is not; then a node of one hangs inside an edge of the other.

#[expect(dead_code, reason = "other tests use the rest of it")]
mod common;

use common::{block, line, verdict};
use keyhole_cutting::sheet::{Strip, pierce, weighted};
use keyhole_cutting::{BladeId, Cutter};
use keyhole_tetmesh::{DVec3, TetMesh};
use keyhole_whiteboard::{CutMethod, CutPattern, CutSettings};
use proptest::prelude::*;
use std::f64::consts::TAU;

const H: f64 = 0.004;
const METHODS: [CutMethod; 3] = [CutMethod::Progressive, CutMethod::NonProgressive, CutMethod::Hybrid];
const PATTERNS: [CutPattern; 2] = [CutPattern::Minimal, CutPattern::Symmetric];

/// A sheet of one layer of cubes being cut, with every face of its lips looked at after every step.
struct Sheet {
    mesh: TetMesh,
    cutter: Cutter,
    skin_m2: f64,
}

impl Sheet {
    fn new(cubes: usize, settings: CutSettings) -> Self {
        let mesh = block([cubes, 1, cubes], H, 0.0);
        let mut cutter = Cutter::new(&mesh);
        cutter.set_settings(settings);
        let skin_m2 = verdict(&mesh).boundary_area;
        Self { mesh, cutter, skin_m2 }
    }

    /// Leads a blade that goes through the sheet through places of it (in cubes), a fifth of a cube a step, and ends the stroke. `tilt` is how far its
    /// heel leans along both axes.
    fn stroke(&mut self, places: &[[f64; 2]], tilt: f64) {
        for way in places.windows(2) {
            let [from, to] = [0, 1].map(|i| DVec3::new(way[i][0], -0.6, way[i][1]));
            let parts = (from.distance(to) / 0.2).ceil().max(1.0) as usize;
            for k in 0..=parts {
                let tip = from.lerp(to, k as f64 / parts as f64) * H;
                self.cutter.advance(&mut self.mesh, BladeId(0), &line(tip, tip + DVec3::new(tilt, 2.2, tilt) * H, H));
                self.look();
            }
        }
        self.cutter.end_stroke(&mut self.mesh);
        self.look();
    }

    fn look(&mut self) {
        if self.mesh.take_delta().is_empty() {
            return;
        }
        verdict(&self.mesh).check_lips(self.skin_m2);
    }
}

fn settings(method: CutMethod, pattern: CutPattern) -> CutSettings {
    CutSettings { method, hull: pattern, core: pattern, snap: 0.2 }
}

/// A cut that crosses another one at a small angle passes its nodes close by: it goes through some of them and beside others.
#[test]
fn cuts_that_cross_at_a_small_angle() {
    for (method, pattern) in METHODS.into_iter().flat_map(|m| PATTERNS.map(|p| (m, p))) {
        for (slope, tilt) in [(0.1, 0.0), (0.2, 1.0), (0.4, 0.5), (0.4, 1.0)] {
            let mut sheet = Sheet::new(6, settings(method, pattern));
            sheet.stroke(&[[-0.5, 2.87], [6.5, 3.13]], 0.0);
            sheet.stroke(&[[-0.5, 3.0 - 3.5 * slope], [6.5, 3.0 + 3.5 * slope]], tilt);
        }
    }
}

/// A disc is cut out of a sheet and the blade goes on past the beginning of the circle, a little off it: as the demonstration of `pattern_cut` ends.
#[test]
fn a_circle_that_ends_past_its_beginning() {
    for (method, pattern) in METHODS.into_iter().flat_map(|m| PATTERNS.map(|p| (m, p))) {
        for off in [-0.4, -0.1, 0.1, 0.4] {
            let mut sheet = Sheet::new(8, settings(method, pattern));
            let circle: Vec<[f64; 2]> = (0..=30)
                .map(|i| {
                    let (angle, radius) = (TAU * f64::from(i) / 24.0 + 0.1, 2.4 + off * f64::from(i) / 28.0);
                    [4.0 + radius * angle.cos(), 4.0 + radius * angle.sin()]
                })
                .collect();
            sheet.stroke(&circle, 0.2);
            let now = verdict(&sheet.mesh);
            assert!(now.fragments >= 2, "{method:?} {pattern:?} {off}: the disc has not come free");
        }
    }
}

fn point() -> impl Strategy<Value = DVec3> {
    // Whole numbers among them: exact positions.
    let coordinate = || prop_oneof![(-2_i32..=2).prop_map(f64::from), -2.0..2.0];
    (coordinate(), coordinate(), coordinate()).prop_map(|(x, y, z)| DVec3::new(x, y, z))
}

proptest! {
    /// What an edge or a face is called does not tell where it is met, not by the last bit.
    #[test]
    fn names_decide_nothing(line in [point(), point(), point(), point()], face in [point(), point(), point()]) {
        let [a, b, c] = face;
        let strip = Strip::between(&line[..2], &line[2..]);
        let (mut there, mut back) = (Vec::new(), Vec::new());
        strip.crossings(a, b, &[0, 1], &mut there);
        strip.crossings(b, a, &[0, 1], &mut back);
        prop_assert_eq!(there.len(), back.len());
        for (there, back) in there.iter().zip(&back) {
            prop_assert_eq!(a.lerp(b, there.t), b.lerp(a, back.t));
            prop_assert_eq!(there.side, -back.side);
        }
        let pierced = pierce(face, line[0], line[1]);
        let turned = pierce([c, a, b], line[0], line[1]);
        prop_assert_eq!(pierced.map(|w| weighted(face, w)), turned.map(|w| weighted([c, a, b], w)));
        let mirrored = pierce([b, a, c], line[0], line[1]);
        prop_assert_eq!(pierced.map(|w| weighted(face, w)), mirrored.map(|w| weighted([b, a, c], w)));
    }
}
