//! Random cases for the kernel: a mesh, settings and strokes drawn from bytes, run with every invariant checked after every sample. The
//! bounded run of the test suite, the long run and the fuzzer share this file.

use crate::common::{Verdict, block, line, verdict};
use arbitrary::{Arbitrary, Result, Unstructured};
use keyhole_cutting::{BladeId, Cutter};
use keyhole_tetmesh::{DVec3, NodeEdit, NodeId, TetId, TetMesh, TopologyDelta};
use keyhole_whiteboard::{CutMethod, CutPattern, CutSettings};
use std::collections::BTreeMap;

/// Edge of the cubes of the block, m.
const H: f64 = 0.004;

/// One case. Coordinates are in cubes of the block.
#[derive(Clone, Debug)]
pub struct Case {
    /// Cubes along each axis.
    pub cubes: [usize; 3],
    /// How far inner nodes are off the lattice, in cubes.
    pub jitter: f64,
    pub settings: CutSettings,
    /// Thickness that the blade takes away, in cubes.
    pub kerf: f64,
    pub strokes: Vec<Drawn>,
}

/// A stroke as the places that the blade is led through.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Tip and heel.
    pub places: Vec<[DVec3; 2]>,
    /// Whether the stroke is ended where it stands; otherwise it ends when the blade leaves, or the next one goes on from it by a jump.
    pub ends: bool,
}

impl<'a> Arbitrary<'a> for Case {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let is_sheet = u.ratio(1, 4)?;
        let cubes = if is_sheet {
            [u.int_in_range(4..=7)?, u.int_in_range(4..=7)?, 1]
        } else {
            [u.int_in_range(1..=4)?, u.int_in_range(1..=3)?, u.int_in_range(1..=3)?]
        };
        let jitter = *u.choose(&[0.0, 0.1, 0.2, 0.25])?;
        let method = *u.choose(&[CutMethod::Progressive, CutMethod::NonProgressive, CutMethod::Hybrid])?;
        let patterns = [CutPattern::Minimal, CutPattern::Symmetric];
        let settings =
            CutSettings { method, hull: *u.choose(&patterns)?, core: *u.choose(&patterns)?, snap: *u.choose(&[0.0, 0.1, 0.2, 0.3, 0.4])? };
        let kerf = *u.choose(&[0.0, 0.0, 0.0, 0.05])?;
        let mut strokes = Vec::new();
        for _ in 0..u.int_in_range(1..=4)? {
            strokes.push(drawn(u, cubes)?);
        }
        Ok(Self { cubes, jitter, settings, kerf, strokes })
    }
}

/// A coordinate somewhat outside [0, n] or in it: any, or exactly on the lattice of nodes, face planes and middles.
fn coordinate(u: &mut Unstructured, n: usize) -> Result<f64> {
    let whole = f64::from(u.int_in_range(-2_i32..=2 * n as i32 + 2)?) / 2.0;
    if u.ratio(1, 3)? { Ok(whole) } else { Ok(whole + f64::from(u.int_in_range(-250_i32..=250)?) / 500.0) }
}

fn place(u: &mut Unstructured, cubes: [usize; 3]) -> Result<DVec3> {
    Ok(DVec3::new(coordinate(u, cubes[0])?, coordinate(u, cubes[1])?, coordinate(u, cubes[2])?))
}

fn drawn(u: &mut Unstructured, cubes: [usize; 3]) -> Result<Drawn> {
    let size = DVec3::from(cubes.map(|n| n as f64));
    let tip = place(u, cubes)?;
    let heel = place(u, cubes)?;
    let mut places = vec![[tip, heel]];
    match u.int_in_range(0..=7)? {
        // Straight, both ends anywhere.
        0 | 1 => places.push([place(u, cubes)?, place(u, cubes)?]),
        // Right through along an axis, the blade across another one, maybe exactly on nodes and faces.
        2 => {
            let axis = u.int_in_range(0..=2)?;
            let across = (axis + u.int_in_range(1..=2)?) % 3;
            let (mut low, mut high) = (tip, tip);
            low[across] = -0.5;
            high[across] = size[across] + 0.5;
            let at = |x: f64| {
                [low, high].map(|mut p| {
                    p[axis] = x;
                    p
                })
            };
            places = vec![at(-0.5), at(size[axis] + 0.5)];
        }
        // Trembling: to and fro about a place, drifting.
        3 => {
            let mut at = [tip, heel];
            for _ in 0..u.int_in_range(2..=12)? {
                for p in &mut at {
                    let mut d = || -> Result<f64> { Ok(f64::from(u.int_in_range(-100_i32..=100)?) / 250.0) };
                    *p += DVec3::new(d()?, d()?, d()?);
                }
                places.push(at);
            }
        }
        // There and back by the way it came, pausing.
        4 => {
            let far = [place(u, cubes)?, place(u, cubes)?];
            places.extend([far, far, [tip, heel], far]);
        }
        // A stab along its own line, and out again.
        5 => {
            let along = (heel - tip).normalize_or(DVec3::X) * 2.0;
            places = vec![[tip + along, heel + along], [tip, heel], [tip + along, heel + along]];
        }
        // Around in a loop, past its beginning, where it began or somewhat beside.
        6 => {
            let centre = DVec3::new(size.x / 2.0, size.y / 2.0, 0.0);
            let radius = f64::from(u.int_in_range(40_u32..=140)?) / 100.0 * (size.x.min(size.y) / 3.0).max(1.0);
            let wider = *u.choose(&[0.0, 0.0, -0.1, -0.03, 0.03, 0.1])?;
            let low = f64::from(u.int_in_range(-50_i32..=150)?) / 100.0;
            places = (0..=26)
                .map(|i| {
                    let angle = std::f64::consts::TAU * f64::from(i) / 24.0 + 0.1;
                    let at = centre + DVec3::new(angle.cos(), angle.sin(), 0.0) * radius * (1.0 + wider * f64::from(i) / 24.0);
                    [at + DVec3::Z * low, at + DVec3::Z * (size.z + 0.5)]
                })
                .collect();
        }
        // Any places: a path that crosses itself.
        _ => {
            for _ in 0..u.int_in_range(2..=4)? {
                places.push([place(u, cubes)?, place(u, cubes)?]);
            }
        }
    }
    Ok(Drawn { places, ends: u.ratio(1, 2)? })
}

/// What is known of the mesh from its deltas alone, as an observer keeps it.
struct Observer {
    tets: BTreeMap<TetId, [NodeId; 4]>,
    rest: Vec<DVec3>,
}

impl Observer {
    fn new(mesh: &TetMesh) -> Self {
        Self { tets: mesh.iter().collect(), rest: mesh.rest_positions().to_vec() }
    }

    /// Follows a delta; checks that each new place is the point of the tissue that the delta says it is, and that nothing else has moved.
    fn follow(&mut self, mesh: &TetMesh, delta: &TopologyDelta) {
        for edit in &delta.nodes {
            let (node, at) = match edit {
                NodeEdit::Added { node, from } | NodeEdit::Moved { node, from } => {
                    let sum: f64 = from.iter().map(|(_, w)| w).sum();
                    assert!((sum - 1.0).abs() < 1e-9, "weights of {node:?} add up to {sum}");
                    (*node, from.iter().fold(DVec3::ZERO, |p, (n, w)| p + self.rest[n.index()] * *w))
                }
                NodeEdit::Split { node, of } => (*node, self.rest[of.index()]),
                NodeEdit::Removed { .. } => continue,
            };
            if self.rest.len() <= node.index() {
                self.rest.resize(node.index() + 1, DVec3::NAN);
            }
            self.rest[node.index()] = at;
        }
        for tet in &delta.removed {
            assert!(self.tets.remove(tet).is_some(), "{tet:?} removed twice");
        }
        for added in &delta.added {
            assert!(self.tets.insert(added.tet, added.nodes).is_none(), "{:?} added twice", added.tet);
        }
        assert!(self.tets.iter().map(|(t, c)| (*t, *c)).eq(mesh.iter()), "the delta does not lead to the mesh");
        for node in mesh.nodes() {
            let (known, is) = (self.rest[node.index()], mesh.rest(node));
            assert!(known.distance(is) <= 1e-9 * H, "{node:?} is at {is}, the deltas lead to {known}");
            self.rest[node.index()] = is;
        }
    }
}

/// Runs a case. Returns the number of samples, each of them checked.
///
/// # Panics
/// When an invariant is broken.
pub fn run(case: &Case) -> usize {
    let mut mesh = block(case.cubes, H, case.jitter);
    let mut cutter = Cutter::new(&mesh);
    let before = verdict(&mesh);
    let mut observer = Observer::new(&mesh);
    let mut samples = 0;
    let mut opened = 0.0;
    let mut blade = BladeId(0);
    for stroke in &case.strokes {
        cutter.set_kerf(blade, case.kerf * H);
        cutter.set_settings(case.settings);

        let mut last = stroke.places[0];
        for place in &stroke.places {
            let moved = last[0].distance(place[0]).max(last[1].distance(place[1]));
            let parts = (moved / 0.25).ceil().max(1.0) as usize;
            for k in 1..=parts {
                let s = k as f64 / parts as f64;
                let [tip, heel] = [last[0].lerp(place[0], s) * H, last[1].lerp(place[1], s) * H];
                let count = cutter.line_points(blade);
                let points =
                    count.map_or_else(|| line(tip, heel, H), |n| (0..n).map(|i| tip.lerp(heel, i as f64 / (n - 1) as f64)).collect());
                cutter.advance(&mut mesh, blade, &points);
                samples += 1;
                opened = check(&mut mesh, &cutter, &before, &mut observer, case, opened);
            }
            last = *place;
        }
        if stroke.ends {
            cutter.end_stroke(&mut mesh);
        } else {
            // The next one is that of another blade, while this one is in the tissue.
            blade = BladeId(1 - blade.0);
        }
        check(&mut mesh, &cutter, &before, &mut observer, case, 0.0);
        opened = cutter.opened_m2(&mesh);
    }
    cutter.end_stroke(&mut mesh);
    check(&mut mesh, &cutter, &before, &mut observer, case, 0.0);
    samples
}

/// The invariants. Returns the opened area, m2.
fn check(mesh: &mut TetMesh, cutter: &Cutter, before: &Verdict, observer: &mut Observer, case: &Case, opened: f64) -> f64 {
    let delta = mesh.take_delta();
    let area = cutter.opened_m2(mesh);
    if delta.is_empty() {
        return area;
    }
    observer.follow(mesh, &delta);
    let now = verdict(mesh);
    let kept = now.volume + cutter.removed_m3();
    assert!((kept - before.volume).abs() <= 1e-12 * before.volume, "volume {} became {kept}", before.volume);
    let grown = (now.boundary_area - before.boundary_area) / 2.0;
    // A kerf changes the outline of the skin beside the cut, and its lips lie apart.
    if case.kerf == 0.0 {
        let within = 1e-9 * before.boundary_area;
        assert!((grown - area).abs() <= within, "the boundary grew by {grown} a side, {area} is said to be open");
        now.check_lips(before.boundary_area);
    }
    // What is open stays open, but for the straightening of its edge as the sheet is found to run right through a tetrahedron, and where a wild path
    // turns out to have a node on the other side.
    if case.settings.method == CutMethod::Progressive {
        assert!(area >= opened - 3.0 * H * H, "the cut closed from {opened} to {area} m2");
    }
    area
}
