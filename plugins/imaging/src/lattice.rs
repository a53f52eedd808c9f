//! The body-centred cubic lattice: two cubic lattices, one at the cell corners and one at the cell centres.
//!
//! Edges join neighbours within each lattice (long, `a`) and each centre to its eight corners (short, `sqrt(3)/2 a`). A tetrahedron has
//! two long edges opposite to each other, one of each lattice, and four short ones; its dihedral angles are 60 and 90 degrees.

use glam::DVec3;

/// A lattice point by its place in the arrays: the corners first, then the centres.
pub(crate) type Point = u32;

/// A box of `cells` cells of size `a`, from `origin` on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    pub origin: DVec3,
    /// Cell size, in the units of the field's domain.
    pub a: f64,
    pub cells: [usize; 3],
}

impl Lattice {
    /// The smallest lattice that holds a box.
    pub fn around(min: DVec3, max: DVec3, a: f64) -> Self {
        let cells = ((max - min) / a).ceil().to_array().map(|n| (n as usize).max(1));
        let size = DVec3::from_array(cells.map(|n| n as f64)) * a;
        Self { origin: (min + max - size) / 2.0, a, cells }
    }

    fn corner_dims(&self) -> [usize; 3] {
        self.cells.map(|n| n + 1)
    }

    fn corner_count(&self) -> usize {
        self.corner_dims().iter().product()
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.corner_count() + self.cells.iter().product::<usize>()
    }

    /// Twice the coordinates in cells: all even at corners, all odd at centres.
    pub fn doubled(&self, p: Point) -> [i32; 3] {
        let corners = self.corner_count();
        let (dims, index, odd) =
            if (p as usize) < corners { (self.corner_dims(), p as usize, 0) } else { (self.cells, p as usize - corners, 1) };
        [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])].map(|i| 2 * i as i32 + odd)
    }

    /// The point at twice these coordinates, `None` outside.
    pub fn at(&self, d: [i32; 3]) -> Option<Point> {
        let odd = d[0] & 1;
        let dims = if odd == 0 { self.corner_dims() } else { self.cells };
        let i = d.map(|v| (v - odd) >> 1);
        if d.iter().any(|v| v & 1 != odd) || (0..3).any(|a| i[a] < 0 || i[a] as usize >= dims[a]) {
            return None;
        }
        let index = i[0] as usize + dims[0] * (i[1] as usize + dims[1] * i[2] as usize);
        Some((if odd == 0 { index } else { index + self.corner_count() }) as Point)
    }

    /// Place of a point.
    pub fn position(&self, p: Point) -> DVec3 {
        self.origin + DVec3::from_array(self.doubled(p).map(f64::from)) * (self.a / 2.0)
    }

    /// The fourteen neighbours of a point, those of its own lattice (long edges) first.
    pub fn neighbours(&self, p: Point) -> impl Iterator<Item = (Point, bool)> + '_ {
        let d = self.doubled(p);
        OFFSETS.iter().filter_map(move |o| {
            let n = self.at([d[0] + o[0], d[1] + o[1], d[2] + o[2]])?;
            Some((n, o.contains(&0)))
        })
    }

    /// All tetrahedra `[c, c', k, k']` between cells that are `wanted`: c-c' joins two centres along an axis, k-k' is an edge of the cell
    /// face between them.
    pub fn tets<'a>(&'a self, wanted: impl Fn(usize) -> bool + Copy + 'a) -> impl Iterator<Item = [Point; 4]> + 'a {
        let corners = self.corner_count();
        (corners..self.len()).filter(move |c| wanted(*c - corners)).flat_map(move |c| {
            let d = self.doubled(c as Point);
            (0..3).flat_map(move |axis| {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let shift = move |along: i32, su: i32, sv: i32| {
                    let mut e = d;
                    e[axis] += along;
                    e[u] += su;
                    e[v] += sv;
                    self.at(e)
                };
                let ring = [(1, 1), (-1, 1), (-1, -1), (1, -1)];
                (0..4).filter_map(move |i| {
                    let next = shift(2, 0, 0).filter(|n| wanted(*n as usize - corners))?;
                    let (p, q) = (ring[i], ring[(i + 1) % 4]);
                    Some([c as Point, next, shift(1, p.0, p.1)?, shift(1, q.0, q.1)?])
                })
            })
        })
    }
}

/// Steps to the neighbours in doubled coordinates.
const OFFSETS: [[i32; 3]; 14] = [
    [2, 0, 0],
    [-2, 0, 0],
    [0, 2, 0],
    [0, -2, 0],
    [0, 0, 2],
    [0, 0, -2],
    [1, 1, 1],
    [-1, 1, 1],
    [1, -1, 1],
    [-1, -1, 1],
    [1, 1, -1],
    [-1, 1, -1],
    [1, -1, -1],
    [-1, -1, -1],
];
