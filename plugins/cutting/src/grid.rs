//! A uniform grid over the rest shape: which base tetrahedra are near a point. Kept up as tetrahedra come and go.

use keyhole_tetmesh::{DVec3, TetId};
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

/// Base tetrahedra by the cells that their boxes overlap.
#[derive(Clone, Debug)]
pub(crate) struct RestGrid {
    cell_m: f64,
    cells: FxHashMap<[i32; 3], SmallVec<[TetId; 8]>>,
}

impl RestGrid {
    /// An empty grid with cells of the given edge, m.
    pub fn new(cell_m: f64) -> Self {
        Self { cell_m: if cell_m > 0.0 { cell_m } else { 1.0 }, cells: FxHashMap::default() }
    }

    pub fn insert(&mut self, tet: TetId, points: [DVec3; 4]) {
        for cell in self.range(points) {
            self.cells.entry(cell).or_default().push(tet);
        }
    }

    pub fn remove(&mut self, tet: TetId, points: [DVec3; 4]) {
        for cell in self.range(points) {
            if let Some(list) = self.cells.get_mut(&cell) {
                list.retain(|t| *t != tet);
            }
        }
    }

    /// The tetrahedra whose boxes overlap the cell of a point.
    pub fn near(&self, point: DVec3) -> &[TetId] {
        self.cells.get(&self.cell_of(point)).map_or(&[], SmallVec::as_slice)
    }

    /// The tetrahedra whose boxes overlap a cell that the box of some points overlaps; some more than once.
    pub fn touching(&self, points: &[DVec3; 4]) -> impl Iterator<Item = TetId> + '_ {
        self.range(*points).filter_map(|cell| self.cells.get(&cell)).flatten().copied()
    }

    fn cell_of(&self, p: DVec3) -> [i32; 3] {
        (p / self.cell_m).floor().as_ivec3().to_array()
    }

    fn range(&self, points: [DVec3; 4]) -> impl Iterator<Item = [i32; 3]> + use<> {
        let low = self.cell_of(points.into_iter().fold(DVec3::INFINITY, DVec3::min));
        let high = self.cell_of(points.into_iter().fold(DVec3::NEG_INFINITY, DVec3::max));
        (low[0]..=high[0]).flat_map(move |x| (low[1]..=high[1]).flat_map(move |y| (low[2]..=high[2]).map(move |z| [x, y, z])))
    }
}
