//! Graph colouring of elements: two elements of one colour share no node, so their order does not change a bit of the result.

use keyhole_tetmesh::{NodeId, TetId, Topology};

const NONE: u16 = u16::MAX;

/// Elements by colour; updated by insertion and removal, each at a cost that depends on the neighbourhood alone.
#[derive(Clone, Debug, Default)]
pub struct Colouring {
    /// The elements of each colour, as slots.
    colours: Vec<Vec<u32>>,
    /// Colour of each slot.
    of: Vec<u16>,
    /// Place of each slot in the list of its colour.
    place: Vec<u32>,
    used: Vec<bool>,
}

impl Colouring {
    /// The elements of each colour, as slots.
    #[must_use]
    pub fn colours(&self) -> &[Vec<u32>] {
        &self.colours
    }

    /// The colour of an element, by its slot.
    pub(crate) fn of(&self, slot: u32) -> u16 {
        self.of.get(slot as usize).copied().unwrap_or(NONE)
    }

    /// Makes room for this many elements.
    pub fn reserve(&mut self, elements: usize) {
        self.of.reserve(elements);
        self.place.reserve(elements);
    }

    /// Gives an element of `topology` the smallest colour that no coloured neighbour has.
    pub fn insert(&mut self, tet: TetId, corners: [NodeId; 4], topology: &Topology) {
        let slot = tet.index();
        if self.of.len() <= slot {
            self.of.resize(slot + 1, NONE);
            self.place.resize(slot + 1, 0);
        }
        let used = &mut self.used;
        used.clear();
        used.resize(self.colours.len() + 1, false);
        for node in corners {
            for t in topology.around_node(node) {
                if let Some(&c) = self.of.get(t.index()).filter(|c| **c != NONE) {
                    used[usize::from(c)] = true;
                }
            }
        }
        let colour = used.iter().position(|u| !u).unwrap_or(self.colours.len());
        if colour == self.colours.len() {
            self.colours.push(Vec::new());
        }
        self.of[slot] = colour as u16;
        self.place[slot] = self.colours[colour].len() as u32;
        self.colours[colour].push(tet.0);
    }

    /// Takes an element out.
    pub fn remove(&mut self, tet: TetId) {
        let Some(&colour) = self.of.get(tet.index()).filter(|c| **c != NONE) else { return };
        let place = self.place[tet.index()] as usize;
        let list = &mut self.colours[usize::from(colour)];
        list.swap_remove(place);
        if let Some(&moved) = list.get(place) {
            self.place[moved as usize] = place as u32;
        }
        self.of[tet.index()] = NONE;
    }
}
