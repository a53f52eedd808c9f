//! Cholesky's decomposition of a symmetric positive matrix whose rows begin late: all but the few rows of knots are a narrow band.
//!
//! A row is stored from its first entry to the diagonal; the factor has the same shape (Jennings, "A compact storage scheme for the solution of
//! symmetric linear simultaneous equations", The Computer Journal 9, 1966).

/// The lower half of a matrix, row by row.
#[derive(Clone, Debug, Default)]
pub struct Skyline {
    /// Column of the first entry of each row.
    first: Vec<usize>,
    /// Where each row's diagonal is in `values`.
    diagonal: Vec<usize>,
    values: Vec<f64>,
}

impl Skyline {
    /// A zero matrix whose row `r` begins in column `first[r]`, at most `r`. Keeps its memory.
    pub fn reset(&mut self, first: impl Iterator<Item = usize>) {
        self.first.clear();
        self.diagonal.clear();
        let mut end = 0;
        for (row, first) in first.enumerate() {
            end += row - first.min(row) + 1;
            self.first.push(first.min(row));
            self.diagonal.push(end - 1);
        }
        self.values.clear();
        self.values.resize(end, 0.0);
    }

    /// Adds to an entry; `column` at most `row` and not before the row's first.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        self.values[self.diagonal[row] + column - row] += value;
    }

    /// Puts the factor `L` of `L L^T` in the matrix's place. A pivot that rounding has eaten is put back to that part of its diagonal which doubles
    /// can tell from zero, so that a direction without resistance stays finite.
    pub fn factor(&mut self) {
        for row in 0..self.first.len() {
            let (start, end) = (self.first[row], self.diagonal[row]);
            let most = self.values[end];
            for column in start..row {
                let from = start.max(self.first[column]);
                let known = self.dot(row, column, from, column);
                let pivot = self.values[self.diagonal[column]];
                let entry = &mut self.values[end + column - row];
                *entry = (*entry - known) / pivot;
            }
            let pivot = most - self.dot(row, row, start, row);
            self.values[end] = pivot.max(most * f64::EPSILON * row.max(1) as f64).sqrt();
        }
    }

    /// Solves for `b`, in place. The matrix has been factored, its diagonal was positive.
    pub fn solve(&self, b: &mut [f64]) {
        for row in 0..self.first.len() {
            let (start, end) = (self.first[row], self.diagonal[row]);
            let known: f64 = self.values[end + start - row..end].iter().zip(&b[start..row]).map(|(l, b)| l * b).sum();
            b[row] = (b[row] - known) / self.values[end];
        }
        for row in (0..self.first.len()).rev() {
            let (start, end) = (self.first[row], self.diagonal[row]);
            b[row] /= self.values[end];
            let now = b[row];
            for (l, b) in self.values[end + start - row..end].iter().zip(&mut b[start..row]) {
                *b -= l * now;
            }
        }
    }

    /// Sum over the columns from `from` to before `to` of the products of two rows.
    fn dot(&self, a: usize, b: usize, from: usize, to: usize) -> f64 {
        let part = |row: usize| &self.values[self.diagonal[row] + from - row..self.diagonal[row] + to - row];
        part(a).iter().zip(part(b)).map(|(a, b)| a * b).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// A matrix `B B^T + I` of any envelope times a vector gives it back.
        #[test]
        fn it_solves_what_it_was_made_from(starts in prop::collection::vec(0usize..12, 1..12), seed in prop::collection::vec(-1f64..1.0, 144), x in prop::collection::vec(-9f64..9.0, 12)) {
            let n = starts.len();
            let first: Vec<usize> = starts.iter().enumerate().map(|(r, s)| (*s).min(r)).collect();
            let b = |r: usize, c: usize| if c >= first[r] && c <= r { seed[12 * r + c] } else { 0.0 };
            let a = |r: usize, c: usize| (0..n).map(|k| b(r, k) * b(c, k)).sum::<f64>() + f64::from(u8::from(r == c));
            let mut matrix = Skyline::default();
            matrix.reset(first.iter().copied());
            for (r, begins) in first.iter().enumerate() {
                for c in 0..=r {
                    if c >= *begins {
                        matrix.add(r, c, a(r, c));
                    } else {
                        prop_assert!(a(r, c) == 0.0);
                    }
                }
            }
            let mut y: Vec<f64> = (0..n).map(|r| (0..n).map(|c| a(r, c) * x[c]).sum()).collect();
            matrix.factor();
            matrix.solve(&mut y);
            for (y, x) in y.iter().zip(&x) {
                prop_assert!((y - x).abs() < 1e-9);
            }
        }
    }
}
