//! Disjoint sets (Tarjan 1975, with path halving): what is joined, directly or through others, ends in one set.

/// Sets of the items `0..n`.
pub(crate) struct DisjointSets(Vec<u32>);

impl DisjointSets {
    /// Each item in a set of its own.
    pub fn new(items: usize) -> Self {
        Self((0..items as u32).collect())
    }

    /// Makes the sets of two items one.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }

    /// The set of each item, numbered by first appearance, and the number of sets.
    pub fn numbers(mut self) -> (Vec<u32>, usize) {
        // The root of a set is its smallest item, so it is numbered before the others.
        let mut of: Vec<u32> = Vec::with_capacity(self.0.len());
        let mut count = 0;
        for i in 0..self.0.len() as u32 {
            let root = self.root(i);
            if root == i {
                of.push(count);
                count += 1;
            } else {
                of.push(of[root as usize]);
            }
        }
        (of, count as usize)
    }

    fn root(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_numbered_by_first_appearance() {
        let mut sets = DisjointSets::new(7);
        for (a, b) in [(5, 1), (6, 3), (3, 5), (4, 2)] {
            sets.join(a, b);
        }
        assert_eq!(sets.numbers(), (vec![0, 1, 2, 1, 2, 1, 1], 3));
    }
}
