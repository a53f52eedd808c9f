//! The strokes of the study, placed relative to a mesh's box.
//!
//! The blade goes along the longest axis of the box and stands along the shortest, so that a full stroke opens the largest section. A
//! stroke's own coordinates are parts of the box: `along`, `across`, `depth`, each 0 to 1.

use keyhole_cutting::BladeSample;
use keyhole_tetmesh::{DVec3, MaterialId, TetMesh};
use std::f64::consts::{PI, TAU};

/// Points by which a stroke's length is measured before it is divided into samples.
const MEASURED: usize = 4000;
/// Largest part of the box by which the seed moves a stroke sideways, and tilts the blade.
const JITTER: f64 = 0.02;
/// Part of the box by which a stroke begins and ends outside of it.
const OUTSIDE: f64 = 0.1;
/// Radius of the loop around a second material, as a part of that material's own.
const AROUND: f64 = 1.15;

/// A stroke by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stroke {
    /// Along the longest axis, through everything.
    Straight,
    /// The same in an S.
    S,
    /// In on one side, a half circle, out on the other.
    UTurn,
    /// Closed, around the second material, or around the middle when there is none.
    Loop,
    /// Straight, but only the upper quarter.
    Shallow,
    /// Straight, but only to the middle.
    Halfway,
    /// Straight along the longest axis, then three times across.
    Cross,
}

/// A name that no stroke has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no stroke `{name}`: expected one of {}", Stroke::ALL.map(Stroke::name).join(", "))]
pub struct UnknownStroke {
    /// What was asked for.
    pub name: String,
}

impl std::str::FromStr for Stroke {
    type Err = UnknownStroke;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|s| s.name() == text).ok_or_else(|| UnknownStroke { name: text.into() })
    }
}

/// The blade in a stroke's own coordinates: where along and across, and from which depth to which.
#[derive(Clone, Copy, Debug)]
struct Blade {
    along: f64,
    across: f64,
    depth: [f64; 2],
}

impl Stroke {
    /// All of them.
    pub const ALL: [Self; 7] = [Self::Straight, Self::S, Self::UTurn, Self::Loop, Self::Shallow, Self::Halfway, Self::Cross];

    /// Its name on the command line and in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Straight => "straight",
            Self::S => "s",
            Self::UTurn => "u-turn",
            Self::Loop => "loop",
            Self::Shallow => "shallow",
            Self::Halfway => "halfway",
            Self::Cross => "cross",
        }
    }

    /// Number of separate strokes of the blade.
    fn parts(self) -> usize {
        if self == Self::Cross { 4 } else { 1 }
    }

    /// The blade at `u` from 0 to 1 of a part.
    fn at(self, part: usize, u: f64, stage: &Stage) -> Blade {
        let through = [-OUTSIDE, 1.0 + OUTSIDE];
        let along = -OUTSIDE + u * (1.0 + 2.0 * OUTSIDE);
        match self {
            Self::Straight => Blade { along, across: 0.5, depth: through },
            Self::S => Blade { along, across: 0.5 + 0.15 * (TAU * along).sin(), depth: through },
            Self::Shallow => Blade { along, across: 0.5, depth: [0.75, 1.0 + OUTSIDE] },
            Self::Halfway => Blade { along: -OUTSIDE + u * (0.5 + OUTSIDE), across: 0.5, depth: through },
            Self::UTurn => {
                // Lengths of the two legs and of the half circle, in parts of the box across.
                let (radius, turn) = (0.18, 0.65);
                let leg = (turn + OUTSIDE) * stage.extent[0] / stage.extent[1];
                let s = u * (2.0 * leg + PI * radius);
                let to_along = stage.extent[1] / stage.extent[0];
                let (x, across) = if s < leg {
                    (-OUTSIDE + s * to_along, 0.5 - radius)
                } else if s < leg + PI * radius {
                    let angle = (s - leg) / radius;
                    (turn + radius * angle.sin() * to_along, 0.5 - radius * angle.cos())
                } else {
                    (turn - (s - leg - PI * radius) * to_along, 0.5 + radius)
                };
                Blade { along: x, across, depth: through }
            }
            Self::Loop => {
                // A little more than all the way round, so that it closes.
                let angle = stage.start_angle + u * TAU * 1.03;
                let [x, y] = [angle.cos(), angle.sin()];
                Blade {
                    along: stage.centre[0] + x * stage.radius_m / stage.extent[0],
                    across: stage.centre[1] + y * stage.radius_m / stage.extent[1],
                    depth: through,
                }
            }
            Self::Cross if part == 0 => Blade { along, across: 0.5, depth: through },
            Self::Cross => Blade { along: 0.25 * part as f64, across: along, depth: through },
        }
    }
}

/// Where strokes take place: the box of a mesh, its axes sorted, and what a loop goes around.
#[derive(Clone, Debug)]
pub struct Stage {
    low: DVec3,
    /// World axis of along, across, depth.
    axes: [usize; 3],
    /// Size of the box along each of the three, m.
    extent: [f64; 3],
    /// Middle of the loop, parts of the box.
    centre: [f64; 2],
    radius_m: f64,
    start_angle: f64,
    /// Part of the box by which this seed moves strokes: along, across; and tilts the blade: along, across.
    jitter: [f64; 4],
}

impl Stage {
    /// The stage of a mesh. The seed moves strokes a little, so that they do not follow the lattice by chance.
    #[must_use]
    pub fn of(mesh: &TetMesh, seed: u64) -> Self {
        let bounds = |points: &mut dyn Iterator<Item = DVec3>| {
            points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
        };
        let (low, high) = bounds(&mut mesh.nodes().map(|n| mesh.rest(n)));
        let size = high - low;
        let mut axes = [0, 1, 2];
        axes.sort_by(|a, b| size[*b].total_cmp(&size[*a]).then(a.cmp(b)));
        let extent = axes.map(|a| size[a]);
        let mut state = seed;
        let jitter = std::array::from_fn(|_| JITTER * (2.0 * uniform(&mut state) - 1.0));
        let mut stage = Self { low, axes, extent, centre: [0.5; 2], radius_m: 0.25 * extent[1], start_angle: 0.0, jitter };
        let inner: Vec<DVec3> = mesh
            .iter()
            .filter(|(t, _)| mesh.tet(*t).material != MaterialId(0))
            .flat_map(|(t, _)| mesh.points(t))
            .map(|p| stage.parts_of(p))
            .collect();
        if !inner.is_empty() {
            let (low, high) = bounds(&mut inner.iter().copied());
            let middle = (low + high) / 2.0;
            let reach = |p: &DVec3| ((p.x - middle.x) * extent[0]).hypot((p.y - middle.y) * extent[1]);
            stage.centre = [middle.x, middle.y];
            stage.radius_m = AROUND * inner.iter().map(reach).fold(0.0, f64::max);
            // It begins where the organ is farthest away: in the air, when what it goes around lies at the rim.
            stage.start_angle = ((middle.y - 0.5) * extent[1]).atan2((middle.x - 0.5) * extent[0]);
        }
        stage
    }

    /// Unit vectors of along, across and depth in the world.
    #[must_use]
    pub fn directions(&self) -> [DVec3; 3] {
        self.axes.map(|a| DVec3::AXES[a])
    }

    /// The path of a stroke with samples at most `spacing_m` apart, a second a sample sixty times over. Parts of a stroke are joined by a sample
    /// that does not cut.
    #[must_use]
    pub fn path(&self, stroke: Stroke, spacing_m: f64) -> Vec<BladeSample> {
        let mut path: Vec<BladeSample> = Vec::new();
        for part in 0..stroke.parts() {
            if let Some(last) = path.last().copied() {
                path.push(BladeSample { active: false, ..last });
            }
            let lines: Vec<[DVec3; 2]> = (0..=MEASURED).map(|i| self.line(stroke, part, i as f64 / MEASURED as f64)).collect();
            let mut lengths = vec![0.0];
            for pair in lines.windows(2) {
                let moved = pair[0][0].distance(pair[1][0]).max(pair[0][1].distance(pair[1][1]));
                lengths.push(lengths[lengths.len() - 1] + moved);
            }
            let count = (lengths[MEASURED] / spacing_m).ceil().max(1.0) as usize;
            for i in 0..=count {
                let wanted = lengths[MEASURED] * i as f64 / count as f64;
                let k = lengths.partition_point(|l| *l < wanted).clamp(1, MEASURED);
                let step = lengths[k] - lengths[k - 1];
                let s = if step > 0.0 { (wanted - lengths[k - 1]) / step } else { 0.0 };
                let [tip, heel] = [0, 1].map(|e| lines[k - 1][e].lerp(lines[k][e], s));
                path.push(BladeSample { t_s: 0.0, tip, heel, active: true });
            }
        }
        for (i, sample) in path.iter_mut().enumerate() {
            sample.t_s = i as f64 / 60.0;
        }
        path
    }

    /// Tip and heel, m.
    fn line(&self, stroke: Stroke, part: usize, u: f64) -> [DVec3; 2] {
        let blade = stroke.at(part, u, self);
        let [x, y, tilt_x, tilt_y] = self.jitter;
        blade.depth.map(|depth| {
            let lean = depth - 0.5;
            self.point([blade.along + x + lean * tilt_x, blade.across + y + lean * tilt_y, depth])
        })
    }

    fn point(&self, parts: [f64; 3]) -> DVec3 {
        let mut p = self.low;
        for k in 0..3 {
            p[self.axes[k]] += parts[k] * self.extent[k];
        }
        p
    }

    fn parts_of(&self, p: DVec3) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|k| (p - self.low)[self.axes[k]] / self.extent[k]))
    }
}

/// SplitMix64 (Steele, Lea, Flood 2014) as a number in [0, 1).
pub(crate) fn uniform(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    /// A box of 6 x 2 x 3 (one tetrahedron that spans it).
    fn stage() -> Stage {
        let nodes = vec![DVec3::ZERO, DVec3::X * 6.0, DVec3::Y * 2.0, DVec3::Z * 3.0];
        Stage::of(&TetMesh::new(nodes, &[[0, 1, 2, 3]], &[]), 1)
    }

    #[test]
    fn every_stroke_is_sampled_as_asked_and_runs_where_it_should() {
        let stage = stage();
        assert_eq!(stage.directions(), [DVec3::X, DVec3::Z, DVec3::Y]);
        for stroke in Stroke::ALL {
            assert_eq!(stroke.name().parse::<Stroke>().unwrap(), stroke);
            let path = stage.path(stroke, 0.05);
            let mut cuts = 0.0;
            for pair in path.windows(2) {
                assert!(pair[0].t_s < pair[1].t_s);
                let moved = pair[0].tip.distance(pair[1].tip).max(pair[0].heel.distance(pair[1].heel));
                if pair[0].active && pair[1].active {
                    assert!(moved <= 0.05 * (1.0 + 1e-9), "{stroke:?}: {moved}");
                    cuts += moved;
                }
            }
            assert!(cuts > 3.0, "{stroke:?}: {cuts}");
        }
        assert_eq!("zigzag".parse::<Stroke>(), Err(UnknownStroke { name: "zigzag".into() }));
    }

    #[test]
    fn lengths_are_those_of_the_figures() {
        let stage = stage();
        let length = |stroke| -> f64 {
            let path = stage.path(stroke, 0.02);
            path.windows(2).filter(|p| p[0].active && p[1].active).map(|p| p[0].tip.distance(p[1].tip)).sum()
        };
        assert!((length(Stroke::Straight) - 7.2).abs() < 1e-9);
        assert!((length(Stroke::Halfway) - 3.6).abs() < 1e-9);
        assert!((length(Stroke::Cross) - 7.2 - 3.0 * 3.6).abs() < 1e-6);
        // 1.03 circles of radius 0.25 * 3, and two legs of 0.75 * 6 with a half circle of 0.18 * 3.
        assert!((length(Stroke::Loop) - 1.03 * TAU * 0.75).abs() < 1e-3);
        assert!((length(Stroke::UTurn) - 9.0 - PI * 0.54).abs() < 1e-3);
    }
}
