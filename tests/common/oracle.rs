//! An independent judge of tetrahedral meshes. It shares no code with the mesh or the cutting kernel: plain arrays in, facts or faults
//! out; signs are exact (`robust`), adjacency is counted anew, hanging nodes are looked for in space and not in indices.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt;
use std::path::Path;

type P = [f64; 3];

/// A mesh as plain arrays, with the integer cell data of its file.
#[derive(Clone, Debug, Default)]
pub struct Body {
    /// Points, m.
    pub points: Vec<P>,
    /// Tetrahedra.
    pub tets: Vec<[u32; 4]>,
    /// Cell data by name.
    pub cells: BTreeMap<String, Vec<i64>>,
}

/// What is true of a body without fault.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// Sum of the volumes, m3.
    pub volume: f64,
    /// Volumes of the face-connected pieces, largest first, m3.
    pub fragments: Vec<f64>,
    /// Area of the boundary faces without a twin at the same place: the outer surface, m2.
    pub outer_area: f64,
    /// Area of the boundary faces with a twin at the same place, each pair counted once: what was cut open, m2.
    pub opened_area: f64,
    /// Nodes whose tetrahedra do not hang together by faces: where pieces still hold by a point or an edge alone.
    pub pinched: usize,
}

/// Everything that is wrong with a body, at most a few lines of each kind.
#[derive(Clone, Debug, Default)]
pub struct Faults(pub Vec<String>);

impl fmt::Display for Facts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { volume, fragments, outer_area, opened_area, pinched } = self;
        write!(f, "{volume:e} m3 in {} pieces, {outer_area:e} m2 outside, {opened_area:e} m2 opened, {pinched} pinched", fragments.len())
    }
}

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.join("\n"))
    }
}

impl Faults {
    fn add(&mut self, kind: &str, what: impl fmt::Display) {
        const SHOWN: usize = 5;
        match self.0.iter().filter(|l| l.starts_with(kind)).count() {
            n if n < SHOWN => self.0.push(format!("{kind}: {what}")),
            SHOWN => self.0.push(format!("{kind}: and more")),
            _ => {}
        }
    }
}

impl TryFrom<&Path> for Body {
    type Error = String;

    /// Reads a VTU file through vtkio alone.
    fn try_from(path: &Path) -> Result<Self, String> {
        use vtkio::model::{Attribute, DataSet, VertexNumbers, Vtk};
        let vtk = Vtk::import(path).map_err(|e| format!("{}: {e}", path.display()))?;
        let DataSet::UnstructuredGrid { pieces, .. } = vtk.data else { return Err("not an unstructured grid".into()) };
        let piece = pieces.into_iter().next().ok_or("no piece")?.into_loaded_piece_data(None).map_err(|e| e.to_string())?;
        let numbers: Vec<f64> = piece.points.cast_into().ok_or("points are not numbers")?;
        let VertexNumbers::XML { connectivity, .. } = piece.cells.cell_verts else { return Err("not XML".into()) };
        let mut cells = BTreeMap::new();
        for attribute in piece.data.cell {
            if let Attribute::DataArray(array) = attribute {
                cells.insert(array.name, array.data.cast_into::<i64>().ok_or("cell data are not integers")?);
            }
        }
        Ok(Self {
            points: numbers.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect(),
            tets: connectivity.chunks_exact(4).map(|c| [c[0] as u32, c[1] as u32, c[2] as u32, c[3] as u32]).collect(),
            cells,
        })
    }
}

/// One face of one tetrahedron, seen from outside it.
#[derive(Clone, Copy)]
struct Side {
    tet: usize,
    nodes: [u32; 3],
}

impl Body {
    /// Judges the body.
    pub fn examine(&self) -> Result<Facts, Faults> {
        let mut faults = Faults::default();
        if let Some((t, n)) = self.tets.iter().enumerate().find(|(_, n)| n.iter().any(|n| *n as usize >= self.points.len())) {
            faults.add("unknown node", format!("tetrahedron {t} names {n:?} of {} points", self.points.len()));
            return Err(faults);
        }
        for (name, values) in self.cells.iter().filter(|(_, v)| v.len() != self.tets.len()) {
            faults.add("cell data", format!("`{name}` has {} values for {} tetrahedra", values.len(), self.tets.len()));
        }
        self.judge_signs(&mut faults);
        let faces = self.faces();
        let mut neighbours = vec![Vec::new(); self.tets.len()];
        let mut boundary = Vec::new();
        for (key, sides) in &faces {
            match sides[..] {
                [side] => boundary.push(side),
                [a, b] if even(a.nodes, b.nodes) => faults.add("orientation", format!("face {key:?} has both tetrahedra on one side")),
                [a, b] => {
                    neighbours[a.tet].push(b.tet);
                    neighbours[b.tet].push(a.tet);
                }
                _ => faults.add("overfull face", format!("face {key:?} has {} tetrahedra", sides.len())),
            }
        }
        judge_closed(&boundary, &mut faults);
        let (outer_area, opened_area) = self.judge_twins(&boundary, &mut faults);
        self.judge_hanging(&boundary, &mut faults);
        if !faults.0.is_empty() {
            return Err(faults);
        }
        let fragments = self.fragments(&neighbours);
        Ok(Facts { volume: fragments.iter().sum(), fragments, outer_area, opened_area, pinched: self.pinched(&neighbours) })
    }

    fn corners<const N: usize>(&self, nodes: [u32; N]) -> [P; N] {
        nodes.map(|n| self.points[n as usize])
    }

    fn judge_signs(&self, faults: &mut Faults) {
        for (i, t) in self.tets.iter().enumerate() {
            let p = self.corners(*t);
            if p.iter().flatten().any(|x| !x.is_finite()) {
                faults.add("not finite", format!("tetrahedron {i} at {p:?}"));
                continue;
            }
            let [a, b, c, d] = p.map(|[x, y, z]| robust::Coord3D { x, y, z });
            // robust counts d below the plane of a, b, c as positive; a positive tetrahedron of ours has it above.
            if robust::orient3d(a, b, c, d) >= 0.0 {
                faults.add("not positive", format!("tetrahedron {i} {t:?} has volume {:e} m3", volume(p)));
            }
        }
    }

    fn faces(&self) -> BTreeMap<[u32; 3], Vec<Side>> {
        let mut faces: BTreeMap<[u32; 3], Vec<Side>> = BTreeMap::new();
        for (tet, &[a, b, c, d]) in self.tets.iter().enumerate() {
            for nodes in [[b, c, d], [a, d, c], [a, b, d], [a, c, b]] {
                let mut key = nodes;
                key.sort_unstable();
                faces.entry(key).or_default().push(Side { tet, nodes });
            }
        }
        faces
    }

    /// Boundary faces at the same place must come in pairs that face each other, as the two lips of a cut do. Returns the area without a
    /// twin and the area of the pairs.
    fn judge_twins(&self, boundary: &[Side], faults: &mut Faults) -> (f64, f64) {
        let mut places: BTreeMap<[[u64; 3]; 3], Vec<Side>> = BTreeMap::new();
        for side in boundary {
            let mut key = self.corners(side.nodes).map(place);
            key.sort_unstable();
            places.entry(key).or_default().push(*side);
        }
        let (mut outer, mut opened) = (0.0, 0.0);
        for sides in places.values() {
            let area = area(self.corners(sides[0].nodes));
            match sides[..] {
                [_] => outer += area,
                [a, b] => {
                    opened += area;
                    let [p, q] = [a, b].map(|s| self.corners(s.nodes).map(place));
                    if even(p, q) {
                        faults.add("lips", format!("faces {:?} and {:?} lie on each other and face the same way", a.nodes, b.nodes));
                    }
                }
                _ => faults.add("lips", format!("{} boundary faces lie at {:?}", sides.len(), self.corners(sides[0].nodes))),
            }
        }
        (outer, opened)
    }

    /// No boundary node lies inside a boundary edge or face that does not end in it.
    fn judge_hanging(&self, boundary: &[Side], faults: &mut Faults) {
        let mut edges: BTreeSet<[[u64; 3]; 2]> = BTreeSet::new();
        let mut nodes: BTreeMap<[u64; 3], u32> = BTreeMap::new();
        for side in boundary {
            for k in 0..3 {
                let mut e = [place(self.points[side.nodes[k] as usize]), place(self.points[side.nodes[(k + 1) % 3] as usize])];
                e.sort_unstable();
                edges.insert(e);
                nodes.entry(place(self.points[side.nodes[k] as usize])).or_insert(side.nodes[k]);
            }
        }
        let cell = edges.iter().map(|[a, b]| length(sub(at(*a), at(*b)))).sum::<f64>() / edges.len().max(1) as f64;
        let mut grid: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
        for n in nodes.values() {
            grid.entry(self.points[*n as usize].map(|x| (x / cell).floor() as i64)).or_default().push(*n);
        }
        for [a, b] in edges.into_iter().map(|e| e.map(at)) {
            for n in near(&grid, cell, &[a, b]).filter(|n| inside_edge(self.points[*n as usize], a, b)) {
                faults.add("hanging node", format!("node {n} at {:?} lies inside the edge {a:?} - {b:?}", self.points[n as usize]));
            }
        }
        for side in boundary {
            let f = self.corners(side.nodes);
            for n in near(&grid, cell, &f).filter(|n| inside_face(self.points[*n as usize], f)) {
                faults.add("hanging node", format!("node {n} at {:?} lies inside the face {:?}", self.points[n as usize], side.nodes));
            }
        }
    }

    /// Volumes of the face-connected pieces, largest first.
    fn fragments(&self, neighbours: &[Vec<usize>]) -> Vec<f64> {
        let mut seen = vec![false; self.tets.len()];
        let mut volumes = Vec::new();
        for seed in 0..self.tets.len() {
            if std::mem::replace(&mut seen[seed], true) {
                continue;
            }
            let (mut stack, mut sum) = (vec![seed], 0.0);
            while let Some(t) = stack.pop() {
                sum += volume(self.corners(self.tets[t]));
                stack.extend(neighbours[t].iter().filter(|n| !std::mem::replace(&mut seen[**n], true)));
            }
            volumes.push(sum);
        }
        volumes.sort_by(|a, b| b.total_cmp(a));
        volumes
    }

    /// Number of nodes whose tetrahedra form more than one face-connected fan.
    fn pinched(&self, neighbours: &[Vec<usize>]) -> usize {
        let mut around: Vec<Vec<usize>> = vec![Vec::new(); self.points.len()];
        for (t, nodes) in self.tets.iter().enumerate() {
            for n in nodes {
                around[*n as usize].push(t);
            }
        }
        let one_fan = |fan: &Vec<usize>| {
            let mut left: BTreeSet<usize> = fan.iter().copied().collect();
            let mut stack: Vec<usize> = left.pop_first().into_iter().collect();
            while let Some(t) = stack.pop() {
                stack.extend(neighbours[t].iter().filter(|n| left.remove(n)));
            }
            left.is_empty()
        };
        around.iter().filter(|fan| !one_fan(fan)).count()
    }
}

/// Every edge of a closed surface is run through as often one way as the other.
fn judge_closed(boundary: &[Side], faults: &mut Faults) {
    let mut runs: BTreeMap<[u32; 2], (i32, u32)> = BTreeMap::new();
    for side in boundary {
        for k in 0..3 {
            let (a, b) = (side.nodes[k], side.nodes[(k + 1) % 3]);
            let run = runs.entry([a.min(b), a.max(b)]).or_default();
            run.0 += if a < b { 1 } else { -1 };
            run.1 += 1;
        }
    }
    for (edge, (sum, count)) in runs {
        if sum != 0 || count % 2 != 0 {
            faults.add("open surface", format!("edge {edge:?} has {count} boundary faces, {sum} more one way than the other"));
        }
    }
}

/// Nodes in the grid cells that the box of some points touches.
fn near<'a>(grid: &'a HashMap<[i64; 3], Vec<u32>>, cell: f64, points: &[P]) -> impl Iterator<Item = u32> + 'a {
    let bound = |k: usize, pick: fn(f64, f64) -> f64, start: f64| points.iter().map(|p| p[k]).fold(start, pick);
    let low = [0, 1, 2].map(|k| (bound(k, f64::min, f64::INFINITY) / cell - 1e-6).floor() as i64);
    let high = [0, 1, 2].map(|k| (bound(k, f64::max, f64::NEG_INFINITY) / cell + 1e-6).floor() as i64);
    (low[0]..=high[0])
        .flat_map(move |x| (low[1]..=high[1]).flat_map(move |y| (low[2]..=high[2]).map(move |z| [x, y, z])))
        .filter_map(|c| grid.get(&c))
        .flatten()
        .copied()
}

/// Off the line by less than 1e-10 of the edge and less than 1e-6 rad as seen from both ends. A cut point is on its edge to about 1e-16
/// of its coordinates; a point that is merely near an end is seen from that end under a wide angle.
fn inside_edge(p: P, a: P, b: P) -> bool {
    let (e, u, v) = (sub(b, a), sub(p, a), sub(p, b));
    let off = length(cross(e, u)) / length(e);
    dot(e, u) > 0.0 && dot(e, v) < 0.0 && off < 1e-10 * length(e) && off < 1e-6 * length(u) && off < 1e-6 * length(v)
}

/// Off the plane by less than 1e-10 of the face's size, and inside by more than 1e-6 of each height.
fn inside_face(p: P, [a, b, c]: [P; 3]) -> bool {
    let n = cross(sub(b, a), sub(c, a));
    let size = length(n).sqrt();
    let weights = [[b, c], [c, a], [a, b]].map(|[q, r]| dot(cross(sub(q, p), sub(r, p)), n) / dot(n, n));
    let off = dot(sub(p, a), n).abs() / length(n);
    off < 1e-10 * size && weights.iter().all(|w| *w > 1e-6) && weights.iter().all(|w| off < 1e-6 * w * size)
}

/// Whether two orders of the same three things are the same up to rotation.
fn even<T: PartialEq + Copy>(a: [T; 3], b: [T; 3]) -> bool {
    (0..3).any(|k| [a[k], a[(k + 1) % 3], a[(k + 2) % 3]] == b)
}

/// A position by its bits; negative zero is zero.
fn place(p: P) -> [u64; 3] {
    p.map(|x| (x + 0.0).to_bits())
}

fn at(place: [u64; 3]) -> P {
    place.map(f64::from_bits)
}

fn sub(a: P, b: P) -> P {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: P, b: P) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: P, b: P) -> P {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(a: P) -> f64 {
    dot(a, a).sqrt()
}

fn area([a, b, c]: [P; 3]) -> f64 {
    length(cross(sub(b, a), sub(c, a))) / 2.0
}

fn volume([a, b, c, d]: [P; 4]) -> f64 {
    dot(sub(b, a), cross(sub(c, a), sub(d, a))) / 6.0
}
