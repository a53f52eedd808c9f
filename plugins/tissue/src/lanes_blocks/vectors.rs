//! Vectors in lanes.

use crate::lanes::Lane;

/// A vector in each lane.
pub(super) type Vector<L> = [L; 3];

#[inline(always)]
pub(super) fn minus<L: Lane>(a: [L; 4], b: [L; 4]) -> Vector<L> {
    apart(place(a), place(b))
}

#[inline(always)]
pub(super) fn apart<L: Lane>(a: Vector<L>, b: Vector<L>) -> Vector<L> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(super) fn dot<L: Lane>(a: Vector<L>, b: Vector<L>) -> L {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

#[inline(always)]
pub(super) fn cross<L: Lane>(a: Vector<L>, b: Vector<L>) -> Vector<L> {
    [a[2].neg_mul_add(b[1], a[1] * b[2]), a[0].neg_mul_add(b[2], a[2] * b[0]), a[1].neg_mul_add(b[0], a[0] * b[1])]
}

#[inline(always)]
pub(super) fn times<L: Lane>(a: Vector<L>, s: L) -> Vector<L> {
    [a[0] * s, a[1] * s, a[2] * s]
}

#[inline(always)]
pub(super) fn sum<L: Lane>(a: Vector<L>, b: Vector<L>) -> Vector<L> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a s + b`.
#[inline(always)]
pub(super) fn along<L: Lane>(a: Vector<L>, s: L, b: Vector<L>) -> Vector<L> {
    [a[0].mul_add(s, b[0]), a[1].mul_add(s, b[1]), a[2].mul_add(s, b[2])]
}

/// `b - a s`.
#[inline(always)]
pub(super) fn less<L: Lane>(a: Vector<L>, s: L, b: Vector<L>) -> Vector<L> {
    [a[0].neg_mul_add(s, b[0]), a[1].neg_mul_add(s, b[1]), a[2].neg_mul_add(s, b[2])]
}

/// The sum of four products, each with a weight.
#[inline(always)]
pub(super) fn weighted<L: Lane>(w: [L; 4], a: [Vector<L>; 4], b: [Vector<L>; 4]) -> L {
    let first = dot(a[0], b[0]).mul_add(w[0], dot(a[1], b[1]) * w[1]);
    first + dot(a[2], b[2]).mul_add(w[2], dot(a[3], b[3]) * w[3])
}

#[inline(always)]
pub(super) fn place<L: Lane>(x: [L; 4]) -> Vector<L> {
    [x[0], x[1], x[2]]
}
