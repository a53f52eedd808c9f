//! What of a body hangs together: one part, but for what a stroke has cut out before the tool has left.

use crate::rows::Rows;

/// The parts of a body that hang together by tetrahedra.
#[derive(Clone, Debug, Default)]
pub(crate) struct Connected {
    /// Number of the part of each node that is in use.
    of_node: Vec<Option<u32>>,
    /// Nodes of each part, ascending.
    parts: Vec<Vec<u32>>,
}

impl Connected {
    /// Finds the parts of a body of these rows; `used` says which nodes there are.
    pub(crate) fn new(rows: &Rows, nodes: usize, used: impl Fn(usize) -> bool) -> Self {
        let mut found = Self { of_node: vec![None; nodes], parts: Vec::new() };
        for first in (0..nodes).filter(|n| used(*n)) {
            if found.of_node[first].is_some() {
                continue;
            }
            let number = Some(found.parts.len() as u32);
            found.of_node[first] = number;
            let mut part = vec![first as u32];
            let mut at = 0;
            while let Some(node) = part.get(at).copied() {
                for n in rows.neighbours(node as usize) {
                    if found.of_node[*n as usize].is_none() {
                        found.of_node[*n as usize] = number;
                        part.push(*n);
                    }
                }
                at += 1;
            }
            part.sort_unstable();
            found.parts.push(part);
        }
        found
    }

    /// The nodes of each part.
    pub(crate) fn parts(&self) -> &[Vec<u32>] {
        &self.parts
    }

    /// The number of the part of a node that is in use.
    pub(crate) fn of(&self, node: u32) -> Option<usize> {
        self.of_node.get(node as usize).copied().flatten().map(|part| part as usize)
    }

    /// Bytes of all arrays.
    pub(crate) fn bytes(&self) -> usize {
        8 * self.of_node.capacity() + self.parts.iter().map(|p| 4 * p.capacity() + size_of::<Vec<u32>>()).sum::<usize>()
    }
}
