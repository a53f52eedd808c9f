//! Eight numbers at a time. A kernel is written once over [`Lane`] and runs with AVX2 and FMA where the processor has them, found out at run time, and with
//! the four lanes that every x86-64 processor has (or none) where it has not. The two may differ in bits, for only one of them fuses
//! multiplication and addition; each gives the same bits every time.
//!
//! This is the only file that knows instruction sets. Kernels are made of functions that are always inlined, without closures and `map`: a function that is
//! not inlined has no such instructions.

use bevy_math::{Mat4, Vec4};
use std::ops::{Add, Mul, Sub};

/// Lanes of a vector.
pub(crate) const LANES: usize = 8;

/// Nodes that a kernel can have at hand. Few are, in the nearest cache; with so many an index of two bytes needs no test.
pub(crate) const NEAR: usize = 1 << 14;

/// The nodes at hand: three coordinates and an inverse mass each.
#[derive(Debug)]
pub(crate) struct Near(Vec<f32>);

impl Default for Near {
    fn default() -> Self {
        // Zeroed memory that is not touched is not there.
        Self(vec![0.0; 4 * NEAR + 4])
    }
}

impl Near {
    pub(crate) fn nodes(&mut self) -> &mut Nodes {
        self.0.first_chunk_mut().unwrap_or_else(|| unreachable!("made as long as that"))
    }
}

/// [`Near`] as kernels have it.
pub(crate) type Nodes = [f32; 4 * NEAR + 4];

/// Where a node is in [`Nodes`].
#[inline(always)]
pub(crate) fn index(place: usize) -> u16 {
    (4 * place) as u16
}

/// Rows of eight numbers, aligned to a load of eight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(32))]
pub(crate) struct Eight(pub(crate) [f32; LANES]);

/// Eight numbers in one or two registers.
pub(crate) trait Lane: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// The proof that the processor can.
    type Token: Copy;

    /// The same number in all lanes.
    fn splat(token: Self::Token, value: f32) -> Self;
    /// A row.
    fn load(token: Self::Token, row: &Eight) -> Self;
    /// The nodes at these [`index`]es, taken apart into coordinates and the fourth number.
    fn gather(token: Self::Token, near: &Nodes, at: &[u16; LANES]) -> [Self; 4];
    /// The reverse of [`Lane::gather`]; a node that is named twice gets the value of the last lane.
    fn scatter(values: [Self; 4], near: &mut Nodes, at: &[u16; LANES]);
    /// `self * b + c`.
    fn mul_add(self, b: Self, c: Self) -> Self;
    /// `c - self * b`.
    fn neg_mul_add(self, b: Self, c: Self) -> Self;
    /// `self / b`.
    fn over(self, b: Self) -> Self;
    /// The larger of the two.
    fn max(self, b: Self) -> Self;
    /// The square root.
    fn sqrt(self) -> Self;
    /// `self` where `sign` is above 0, else 0.
    fn where_positive(self, sign: Self) -> Self;
    /// The sum of all lanes.
    fn sum(self) -> f32;
}

/// A piece of work that is written over lanes.
pub(crate) trait Kernel {
    /// Does it.
    fn run<L: Lane>(self, token: L::Token);
}

/// Runs a kernel with the widest lanes of this processor.
#[inline]
pub(crate) fn run<K: Kernel>(kernel: K) {
    #[cfg(target_arch = "x86_64")]
    if let Some(token) = pulp::x86::V3::try_new() {
        return token.vectorize(wide::Job(kernel, token));
    }
    kernel.run::<Plain>(());
}

/// The node at an [`index`].
#[inline(always)]
pub(crate) fn at(near: &Nodes, i: u16) -> [f32; 4] {
    let i = usize::from(i);
    [near[i], near[i + 1], near[i + 2], near[i + 3]]
}

/// Changes the node at an [`index`].
#[inline(always)]
pub(crate) fn put(near: &mut Nodes, i: u16, value: [f32; 4]) {
    let i = usize::from(i);
    near[i..i + 4].copy_from_slice(&value);
}

/// Eight numbers as two vectors of four.
#[derive(Clone, Copy)]
pub(crate) struct Plain([Vec4; 2]);

impl Plain {
    #[inline(always)]
    fn with(self, b: Self, f: impl Fn(Vec4, Vec4) -> Vec4) -> Self {
        Self([f(self.0[0], b.0[0]), f(self.0[1], b.0[1])])
    }
}

impl Add for Plain {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        self.with(b, |a, b| a + b)
    }
}

impl Sub for Plain {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        self.with(b, |a, b| a - b)
    }
}

impl Mul for Plain {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        self.with(b, |a, b| a * b)
    }
}

impl Lane for Plain {
    type Token = ();

    #[inline(always)]
    fn splat((): (), value: f32) -> Self {
        Self([Vec4::splat(value); 2])
    }

    #[inline(always)]
    fn load((): (), row: &Eight) -> Self {
        let [a, b, c, d, e, f, g, h] = row.0;
        Self([Vec4::new(a, b, c, d), Vec4::new(e, f, g, h)])
    }

    #[inline(always)]
    fn gather((): (), near: &Nodes, nodes: &[u16; LANES]) -> [Self; 4] {
        let half = |k: usize| {
            let row = |i: usize| Vec4::from_array(at(near, nodes[4 * k + i]));
            Mat4::from_cols(row(0), row(1), row(2), row(3)).transpose()
        };
        let (a, b) = (half(0), half(1));
        [Self([a.x_axis, b.x_axis]), Self([a.y_axis, b.y_axis]), Self([a.z_axis, b.z_axis]), Self([a.w_axis, b.w_axis])]
    }

    #[inline(always)]
    fn scatter([x, y, z, w]: [Self; 4], near: &mut Nodes, nodes: &[u16; LANES]) {
        for k in 0..2 {
            let rows = Mat4::from_cols(x.0[k], y.0[k], z.0[k], w.0[k]).transpose();
            for (i, row) in [rows.x_axis, rows.y_axis, rows.z_axis, rows.w_axis].into_iter().enumerate() {
                put(near, nodes[4 * k + i], row.to_array());
            }
        }
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        self * b + c
    }

    #[inline(always)]
    fn neg_mul_add(self, b: Self, c: Self) -> Self {
        c - self * b
    }

    #[inline(always)]
    fn over(self, b: Self) -> Self {
        self.with(b, |a, b| a / b)
    }

    #[inline(always)]
    fn max(self, b: Self) -> Self {
        self.with(b, Vec4::max)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(|v| Vec4::from_array(v.to_array().map(f32::sqrt))))
    }

    #[inline(always)]
    fn where_positive(self, sign: Self) -> Self {
        self.with(sign, |a, s| Vec4::select(s.cmpgt(Vec4::ZERO), a, Vec4::ZERO))
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        let v = self.0[0] + self.0[1];
        (v.x + v.z) + (v.y + v.w)
    }
}

/// Eight numbers in one register.
#[cfg(target_arch = "x86_64")]
mod wide {
    use super::{Eight, Kernel, LANES, Lane, Nodes, at, put};
    use pulp::cast;
    use pulp::x86::V3;
    use std::arch::x86_64::{__m128, __m256};
    use std::ops::{Add, Mul, Sub};

    /// A kernel for lanes of this kind.
    pub(super) struct Job<K>(pub(super) K, pub(super) V3);

    impl<K: Kernel> pulp::NullaryFnOnce for Job<K> {
        type Output = ();

        #[inline(always)]
        fn call(self) {
            self.0.run::<Wide>(self.1);
        }
    }

    #[derive(Clone, Copy)]
    pub(crate) struct Wide(V3, __m256);

    impl Add for Wide {
        type Output = Self;
        #[inline(always)]
        fn add(self, b: Self) -> Self {
            Self(self.0, self.0.avx._mm256_add_ps(self.1, b.1))
        }
    }

    impl Sub for Wide {
        type Output = Self;
        #[inline(always)]
        fn sub(self, b: Self) -> Self {
            Self(self.0, self.0.avx._mm256_sub_ps(self.1, b.1))
        }
    }

    impl Mul for Wide {
        type Output = Self;
        #[inline(always)]
        fn mul(self, b: Self) -> Self {
            Self(self.0, self.0.avx._mm256_mul_ps(self.1, b.1))
        }
    }

    /// Turns four vectors of four a half into each other: rows into columns and columns into rows.
    #[inline(always)]
    fn transpose(token: V3, [a, b, c, d]: [__m256; 4]) -> [__m256; 4] {
        let avx = token.avx;
        let (s, t) = (avx._mm256_unpacklo_ps(a, b), avx._mm256_unpackhi_ps(a, b));
        let (u, v) = (avx._mm256_unpacklo_ps(c, d), avx._mm256_unpackhi_ps(c, d));
        [
            avx._mm256_shuffle_ps::<0x44>(s, u),
            avx._mm256_shuffle_ps::<0xEE>(s, u),
            avx._mm256_shuffle_ps::<0x44>(t, v),
            avx._mm256_shuffle_ps::<0xEE>(t, v),
        ]
    }

    /// Two nodes, four lanes apart.
    #[inline(always)]
    fn pair(token: V3, near: &Nodes, nodes: &[u16; LANES], i: usize) -> __m256 {
        let low: __m128 = cast(at(near, nodes[i]));
        let high: __m128 = cast(at(near, nodes[i + 4]));
        token.avx._mm256_insertf128_ps::<1>(token.avx._mm256_castps128_ps256(low), high)
    }

    /// The reverse of [`pair`].
    #[inline(always)]
    fn put_pair(token: V3, near: &mut Nodes, nodes: &[u16; LANES], i: usize, pair: __m256) {
        put(near, nodes[i], cast(token.avx._mm256_castps256_ps128(pair)));
        put(near, nodes[i + 4], cast(token.avx._mm256_extractf128_ps::<1>(pair)));
    }

    impl Lane for Wide {
        type Token = V3;

        #[inline(always)]
        fn splat(token: V3, value: f32) -> Self {
            Self(token, token.avx._mm256_set1_ps(value))
        }

        #[inline(always)]
        fn load(token: V3, row: &Eight) -> Self {
            Self(token, cast(row.0))
        }

        #[inline(always)]
        fn gather(token: V3, near: &Nodes, nodes: &[u16; LANES]) -> [Self; 4] {
            let rows = [pair(token, near, nodes, 0), pair(token, near, nodes, 1), pair(token, near, nodes, 2), pair(token, near, nodes, 3)];
            let [x, y, z, w] = transpose(token, rows);
            [Self(token, x), Self(token, y), Self(token, z), Self(token, w)]
        }

        #[inline(always)]
        fn scatter([x, y, z, w]: [Self; 4], near: &mut Nodes, nodes: &[u16; LANES]) {
            let token = x.0;
            let [a, b, c, d] = transpose(token, [x.1, y.1, z.1, w.1]);
            put_pair(token, near, nodes, 0, a);
            put_pair(token, near, nodes, 1, b);
            put_pair(token, near, nodes, 2, c);
            put_pair(token, near, nodes, 3, d);
        }

        #[inline(always)]
        fn mul_add(self, b: Self, c: Self) -> Self {
            Self(self.0, self.0.fma._mm256_fmadd_ps(self.1, b.1, c.1))
        }

        #[inline(always)]
        fn neg_mul_add(self, b: Self, c: Self) -> Self {
            Self(self.0, self.0.fma._mm256_fnmadd_ps(self.1, b.1, c.1))
        }

        #[inline(always)]
        fn over(self, b: Self) -> Self {
            Self(self.0, self.0.avx._mm256_div_ps(self.1, b.1))
        }

        #[inline(always)]
        fn max(self, b: Self) -> Self {
            Self(self.0, self.0.avx._mm256_max_ps(self.1, b.1))
        }

        #[inline(always)]
        fn sqrt(self) -> Self {
            Self(self.0, self.0.avx._mm256_sqrt_ps(self.1))
        }

        #[inline(always)]
        fn where_positive(self, sign: Self) -> Self {
            let avx = self.0.avx;
            // 30: greater than, ordered, quiet.
            let mask = avx._mm256_cmp_ps::<30>(sign.1, avx._mm256_set1_ps(0.0));
            Self(self.0, avx._mm256_and_ps(mask, self.1))
        }

        #[inline(always)]
        fn sum(self) -> f32 {
            let (avx, sse) = (self.0.avx, self.0.sse);
            let v = sse._mm_add_ps(avx._mm256_castps256_ps128(self.1), avx._mm256_extractf128_ps::<1>(self.1));
            let v = sse._mm_add_ps(v, sse._mm_movehl_ps(v, v));
            let [a, b, ..]: [f32; 4] = cast(v);
            a + b
        }
    }
}
