//! Solid anatomy: a tree of triangles with pseudo-normals, as the crate has it, beside a field of signed distances on a grid. Time of a query, its error,
//! and what either takes to build and to keep.

#![expect(clippy::unwrap_used, reason = "the surface is known to be sound")]

use bevy_math::Vec3;
use keyhole_collision::anatomy::{Nearest, SolidSurface};
use keyhole_whiteboard::StaticSurface;
use std::hint::black_box;
use std::time::Instant;

/// How far from the surface either has to tell the distance, m.
const REACH: f32 = 0.01;

fn main() {
    let (surface, exact) = (bumpy(), 0.06);
    let begin = Instant::now();
    let solid = SolidSurface::new(&surface).unwrap();
    println!("{} triangles, radius {exact} m; tree: {:.1} ms to build", surface.triangles.len(), begin.elapsed().as_secs_f64() * 1e3);
    let points = points();
    let truth: Vec<Nearest> = points.iter().map(|p| solid.nearest(*p, 2.0 * REACH).unwrap()).collect();
    // The sign is that of the surface as a function, but for points nearer to it than its triangles are flat.
    let wrong = points.iter().zip(&truth).filter(|(p, n)| n.distance_m.abs() > 1e-4 && (height(**p) > 0.0) != (n.distance_m > 0.0)).count();
    assert_eq!(wrong, 0, "signs");
    println!("tree: {:.0} ns a query; signs as the function's", time_ns(&points, |p| solid.nearest(p, REACH).map(|n| n.distance_m)));
    for cell_m in [0.004, 0.002, 0.001] {
        let begin = Instant::now();
        let field = Field::new(&solid, cell_m);
        let build_ms = begin.elapsed().as_secs_f64() * 1e3;
        let found: Vec<(f32, Vec3)> = points.iter().map(|p| field.at(*p)).collect();
        let errors = found.iter().zip(&truth).map(|(f, t)| (f.0 - t.distance_m).abs());
        let (mean, most) = errors.fold((0.0, 0.0_f32), |(sum, most), e| (sum + e / points.len() as f32, most.max(e)));
        let tilts = found.iter().zip(&truth).map(|(f, t)| f.1.angle_between(t.normal).to_degrees());
        let (tilt, most_tilt) = tilts.fold((0.0, 0.0_f32), |(sum, most), e| (sum + e / points.len() as f32, most.max(e)));
        println!(
            "grid of {:.0} mm: {:.0} ns a query; error {:.3} mm, at most {:.3}; normal {tilt:.1} degrees off, at most {most_tilt:.0}; {build_ms:.0} ms to build, {:.1} MB",
            cell_m * 1e3,
            time_ns(&points, |p| Some(field.at(p).0)),
            mean * 1e3,
            most * 1e3,
            4e-6 * field.values.len() as f64,
        );
    }
}

/// From the surface outwards, m, of a ball with bumps and a groove: about, for it is measured along the radius.
fn height(p: Vec3) -> f32 {
    let d = p.normalize_or_zero();
    p.length() - radius(d)
}

fn radius(d: Vec3) -> f32 {
    let groove = (-(d.y / 0.08).powi(2)).exp();
    0.06 + 0.002 * (9.0 * d.x).sin() * (8.0 * d.z).cos() - 0.006 * groove
}

/// The ball as triangles.
fn bumpy() -> StaticSurface {
    const N: u32 = 60;
    // Six faces of a cube, each a raster; vertices on its edges are shared.
    let mut places = std::collections::BTreeMap::new();
    let mut surface = StaticSurface::default();
    let mut vertex = |at: [i64; 3], surface: &mut StaticSurface| {
        *places.entry(at).or_insert_with(|| {
            let d = Vec3::new(at[0] as f32, at[1] as f32, at[2] as f32).normalize();
            surface.vertices.push(d * radius(d));
            surface.vertices.len() as u32 - 1
        })
    };
    let n = i64::from(N);
    for axis in 0..3 {
        for side in [-1, 1] {
            for i in 0..n {
                for j in 0..n {
                    let corner = |u: i64, v: i64| {
                        let mut at = [0; 3];
                        (at[axis], at[(axis + 1) % 3], at[(axis + 2) % 3]) = (side * n, 2 * (i + u) - n, 2 * (j + v) - n);
                        at
                    };
                    let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)].map(|at| vertex(at, &mut surface));
                    let [b, d] = if side > 0 { [b, d] } else { [d, b] };
                    surface.triangles.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
    }
    surface
}

/// Points not further than 5 mm from the surface along the radius, all around.
fn points() -> Vec<Vec3> {
    let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
    let at = |i: u16| {
        let y = 1.0 - 2.0 * (f32::from(i) + 0.5) / 20_000.0;
        let ring = (1.0 - y * y).sqrt();
        let d = Vec3::new(ring * (golden * f32::from(i)).cos(), y, ring * (golden * f32::from(i)).sin());
        d * (radius(d) + 0.005 * (2.0 * f32::from(i % 97) / 96.0 - 1.0))
    };
    (0..20_000).map(at).collect()
}

/// Least time of a query over several rounds, ns.
fn time_ns(points: &[Vec3], query: impl Fn(Vec3) -> Option<f32>) -> f64 {
    let round = |_| {
        let begin = Instant::now();
        points.iter().for_each(|p| _ = black_box(query(black_box(*p))));
        begin.elapsed().as_secs_f64() * 1e9 / points.len() as f64
    };
    (0..15).map(round).fold(f64::INFINITY, f64::min)
}

/// Signed distances at the corners of cubes, and between them as the cubes' corners have it.
struct Field {
    low: Vec3,
    cell_m: f32,
    counts: [usize; 3],
    values: Vec<f32>,
}

impl Field {
    fn new(solid: &SolidSurface, cell_m: f32) -> Self {
        let low = Vec3::splat(-0.062 - REACH);
        let count = (-2.0 * low.x / cell_m).ceil() as usize + 1;
        let at = |i: usize| low + cell_m * Vec3::new((i % count) as f32, (i / count % count) as f32, (i / count / count) as f32);
        let band = REACH + 2.0 * cell_m;
        let value = |p: Vec3| solid.nearest(p, band).map_or(band * height(p).signum(), |n| n.distance_m);
        Self { low, cell_m, counts: [count; 3], values: (0..count.pow(3)).map(|i| value(at(i))).collect() }
    }

    /// Distance (m) and direction outwards.
    fn at(&self, p: Vec3) -> (f32, Vec3) {
        let x = (p - self.low) / self.cell_m;
        let corner = x.floor();
        let t = x - corner;
        let [nx, ny, _] = self.counts;
        let at =
            |i: usize, j: usize, k: usize| self.values[((corner.z as usize + k) * ny + corner.y as usize + j) * nx + corner.x as usize + i];
        let c: [f32; 8] = std::array::from_fn(|b| at(b & 1, b >> 1 & 1, b >> 2));
        let mix = |a: f32, b: f32, t: f32| a + t * (b - a);
        let along_x: [f32; 4] = std::array::from_fn(|e| mix(c[2 * e], c[2 * e + 1], t.x));
        let along_y = [mix(along_x[0], along_x[1], t.y), mix(along_x[2], along_x[3], t.y)];
        let slopes_x: [f32; 4] = std::array::from_fn(|e| c[2 * e + 1] - c[2 * e]);
        let gradient = Vec3::new(
            mix(mix(slopes_x[0], slopes_x[1], t.y), mix(slopes_x[2], slopes_x[3], t.y), t.z),
            mix(along_x[1] - along_x[0], along_x[3] - along_x[2], t.z),
            along_y[1] - along_y[0],
        );
        (mix(along_y[0], along_y[1], t.z), gradient.normalize_or_zero())
    }
}
