//! Space as cells: the published hash, and nodes in a dense table of cells.
//!
//! M. Teschner, B. Heidelberger, M. Mueller, D. Pomeranets, M. Gross, "Optimized spatial hashing for collision detection of deformable objects",
//! VMV 2003: `hash(i, j, k) = (i 73856093 xor j 19349663 xor k 83492791) mod n`. Where the paper has lists and time stamps, here nodes are sorted
//! into their cells by counting: the nodes of a cell lie side by side, in ascending order, and nothing is allocated once the table is warm.

use bevy_math::Vec3A;

/// A cell size: two to the power of `level - OFFSET`, m.
pub(crate) type Level = u8;

/// Number of levels: cells from 2^-40 m to 2^23 m.
pub(crate) const LEVELS: usize = 64;

const OFFSET: i32 = 40;

/// The level whose cells fit a box with this longest edge: its cells are 0.71 to 1.41 times as long. With larger ones a box meets fewer cells and more
/// nodes; for a mesh with a node a cube both together are fewest here.
pub(crate) fn level_of(extent_m: f32) -> Level {
    // The exponent of a positive float: the power of two at or below it.
    let exponent = (((extent_m * std::f32::consts::SQRT_2).to_bits() >> 23) & 0xff) as i32 - 127;
    (exponent + OFFSET).clamp(0, LEVELS as i32 - 1) as Level
}

/// Edge of the cells of a level, m.
pub(crate) fn cell_of(level: Level) -> f32 {
    f32::from_bits(((i32::from(level) - OFFSET + 127) as u32) << 23)
}

/// A node in a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tag {
    /// Whether tetrahedra of its own body are looked at.
    pub(crate) own: bool,
    /// Its slot.
    pub(crate) node: u32,
}

/// Nodes sorted into cells of one size.
#[derive(Clone, Debug, Default)]
pub(crate) struct CellTable {
    /// Cells a metre.
    inverse_m: f32,
    /// Number of places less one: a power of two less one.
    mask: u32,
    /// By place: where its nodes begin; one more at the end.
    starts: Vec<u32>,
    /// A bit a place: whether it has nodes. Most places that are looked at have none, and these fit into the nearest cache.
    occupied: Vec<u64>,
    points: Vec<Vec3A>,
    tags: Vec<Tag>,
    /// By node as it came: its place.
    places: Vec<u32>,
}

impl CellTable {
    /// Sorts the nodes into cells with edges of `cell_m`.
    pub(crate) fn build(&mut self, cell_m: f32, points: &[Vec3A], tags: &[Tag]) {
        self.inverse_m = cell_m.recip();
        // At least twice as many places as nodes.
        let places = (2 * points.len()).next_power_of_two().max(64);
        self.mask = places as u32 - 1;
        self.starts.clear();
        self.starts.resize(places + 1, 0);
        self.occupied.clear();
        self.occupied.resize(places / 64, 0);
        self.places.clear();
        for point in points {
            let [i, j, k] = self.cell(*point);
            let place = self.place(i, hash_row(j, k));
            self.places.push(place);
            self.starts[place as usize] += 1;
            self.occupied[place as usize / 64] |= 1 << (place % 64);
        }
        let mut sum = 0;
        for start in &mut self.starts {
            sum += *start;
            *start = sum;
        }
        self.points.resize(points.len(), Vec3A::ZERO);
        self.tags.resize(points.len(), Tag::default());
        for (i, place) in self.places.iter().enumerate().rev() {
            let at = &mut self.starts[*place as usize];
            *at -= 1;
            self.points[*at as usize] = points[i];
            self.tags[*at as usize] = tags[i];
        }
    }

    /// Lists the nodes in the box, as places in the table. A node may be listed more than once: cells that share a place are not told apart.
    pub(crate) fn list_box<'a>(&self, low: Vec3A, high: Vec3A, found: &'a mut Vec<u32>) -> &'a [u32] {
        let (from, to) = (self.cell(low), self.cell(high));
        let mut count = 0;
        // Written first and counted then: about every third node that is looked at is in the box, which no processor can foretell.
        let mut look = |nodes: std::ops::Range<u32>| {
            if found.len() < count + nodes.len() {
                found.resize(2 * (count + nodes.len()), 0);
            }
            for at in nodes {
                found[count] = at;
                let point = self.points[at as usize];
                count += usize::from((point.cmpge(low) & point.cmple(high)).all());
            }
        };
        let cells: f32 = (0..3).map(|k| to[k] as f32 - from[k] as f32 + 1.0).product();
        if cells > self.starts.len() as f32 {
            look(0..self.points.len() as u32);
        } else {
            for k in from[2]..=to[2] {
                for j in from[1]..=to[1] {
                    let row = hash_row(j, k);
                    for i in from[0]..=to[0] {
                        let place = self.place(i, row) as usize;
                        if self.occupied[place / 64] >> (place % 64) & 1 == 1 {
                            look(self.starts[place]..self.starts[place + 1]);
                        }
                    }
                }
            }
        }
        &found[..count]
    }

    /// A listed node.
    pub(crate) fn node(&self, at: u32) -> (Vec3A, Tag) {
        (self.points[at as usize], self.tags[at as usize])
    }

    /// The cell of a point. Rounding never turns the order of two points round, and what is out of range falls into the last cell.
    fn cell(&self, point: Vec3A) -> [i32; 3] {
        let c = (point * self.inverse_m).floor();
        [c.x as i32, c.y as i32, c.z as i32]
    }

    fn place(&self, i: i32, row: u32) -> u32 {
        ((i as u32).wrapping_mul(73_856_093) ^ row) & self.mask
    }
}

/// What all cells with the same `j` and `k` have in common in the published hash.
fn hash_row(j: i32, k: i32) -> u32 {
    (j as u32).wrapping_mul(19_349_663) ^ (k as u32).wrapping_mul(83_492_791)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_fits_its_box() {
        for extent in [1e-9_f32, 3.3e-4, 1e-3, 0.5, 1.0, 1.999, 2.0, 1e3] {
            let cell = cell_of(level_of(extent));
            assert!(0.707 * extent < cell && cell < 1.415 * extent, "{extent} {cell}");
        }
        assert_eq!((level_of(0.0), level_of(f32::INFINITY)), (0, 63));
    }
}
