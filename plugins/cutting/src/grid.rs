//! A uniform grid over the rest shape: which base tetrahedra are near a point. Kept up as tetrahedra come and go.

use keyhole_tetmesh::{DVec3, FACES, TetId};
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

/// A cell by its three coordinates, 21 bits each. Cells two million cells apart share a list: it is then longer than need be, not wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Cell(u64);

impl Cell {
    fn new([x, y, z]: [i32; 3]) -> Self {
        let low = |i: i32| u64::from(i as u32 & 0x1f_ffff);
        Self(low(x) << 42 | low(y) << 21 | low(z))
    }
}

/// Base tetrahedra by the cells that they overlap, and some that they pass close by.
#[derive(Clone, Debug)]
pub(crate) struct RestGrid {
    cell_m: f64,
    cells: FxHashMap<Cell, SmallVec<[TetId; 8]>>,
}

impl RestGrid {
    /// An empty grid with cells of the given edge, m.
    pub fn new(cell_m: f64) -> Self {
        Self { cell_m: if cell_m > 0.0 { cell_m } else { 1.0 }, cells: FxHashMap::default() }
    }

    pub fn insert(&mut self, tet: TetId, points: [DVec3; 4]) {
        // A cell that lies beyond a face does not overlap the tetrahedron. Half of its edge, and what rounding may move its middle by.
        let largest = points.into_iter().fold(0.0, |m: f64, p| m.max(p.abs().max_element()));
        let half = 0.5 * self.cell_m + 8.0 * f64::EPSILON * largest;
        let faces = FACES.map(|[i, j, k]| {
            let normal = (points[j] - points[i]).cross(points[k] - points[i]);
            (points[i], normal, half * normal.abs().element_sum())
        });
        let cell_m = self.cell_m;
        self.range(points).each(|place| {
            let middle = (DVec3::from_array(place.map(f64::from)) + 0.5) * cell_m;
            // So far out that cells cannot be numbered, the last one holds all.
            let is_last = place.iter().any(|i| *i == i32::MAX || *i == i32::MIN);
            if is_last || faces.iter().all(|(point, normal, reach)| normal.dot(middle - *point) <= *reach) {
                self.cells.entry(Cell::new(place)).or_default().push(tet);
            }
        });
    }

    pub fn remove(&mut self, tet: TetId, points: [DVec3; 4]) {
        let range = self.range(points);
        range.each(|place| {
            if let Some(list) = self.cells.get_mut(&Cell::new(place)) {
                list.retain(|t| *t != tet);
            }
        });
    }

    /// Removes those that do not stay from the cells that the given boxes overlap: each cell is looked at once.
    pub fn remove_all(&mut self, boxes: impl Iterator<Item = [DVec3; 4]>, stays: impl Fn(TetId) -> bool) {
        let mut cells: Vec<Cell> = Vec::new();
        for points in boxes {
            self.range(points).each(|place| cells.push(Cell::new(place)));
        }
        cells.sort_unstable();
        cells.dedup();
        for cell in cells {
            if let Some(list) = self.cells.get_mut(&cell) {
                list.retain(|t| stays(*t));
            }
        }
    }

    /// The tetrahedra that overlap the cell of a point.
    pub fn near(&self, point: DVec3) -> &[TetId] {
        self.cells.get(&Cell::new(self.place_of(point))).map_or(&[], SmallVec::as_slice)
    }

    /// Gives the tetrahedra that overlap a cell that the box of some points overlaps; some more than once.
    pub fn touching(&self, points: [DVec3; 4], mut give: impl FnMut(TetId)) {
        self.range(points).each(|place| {
            for tet in self.cells.get(&Cell::new(place)).into_iter().flatten() {
                give(*tet);
            }
        });
    }

    fn place_of(&self, p: DVec3) -> [i32; 3] {
        (p / self.cell_m).to_array().map(floor)
    }

    fn range(&self, points: [DVec3; 4]) -> Range {
        let low = self.place_of(points.into_iter().fold(DVec3::INFINITY, DVec3::min));
        let high = self.place_of(points.into_iter().fold(DVec3::NEG_INFINITY, DVec3::max));
        Range { low, high }
    }
}

/// The cells from one to another, both with what is between them.
struct Range {
    low: [i32; 3],
    high: [i32; 3],
}

impl Range {
    fn each(&self, mut give: impl FnMut([i32; 3])) {
        let Self { low, high } = self;
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    give([x, y, z]);
                }
            }
        }
    }
}

/// The greatest integer that is not above `x`, without a call into the mathematics library.
fn floor(x: f64) -> i32 {
    let toward_zero = x as i32;
    toward_zero.saturating_sub(i32::from(f64::from(toward_zero) > x))
}
