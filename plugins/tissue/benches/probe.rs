//! scratch
use keyhole_tissue::beam::*;
use keyhole_tissue::{Body, Solver, TissueSettings};
use keyhole_whiteboard::TissueState;
use std::time::Instant;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let g = |i: usize, d: f64| a.get(i).and_then(|s| s.parse().ok()).unwrap_or(d);
    let size = g(1, 2.0) as usize;
    let sub = g(2, 1.0) as u32;
    let tol = g(3, 0.1) as f32;
    let its = g(4, 50.0) as u32;
    let drag = g(5, 4.0) as f32;
    let ticks = g(6, 180.0) as u32;
    let threads = g(7, 1.0) as usize;
    let solver = if g(8, 0.0) > 0.5 { Solver::Xpbd } else { Solver::Implicit };
    let ([n, m], reference) = if size < 3 { REFERENCE[size] } else { REFERENCE[3] };
    let mesh = beam(n, m);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let holds = clamp(&mesh);
    let settings = TissueSettings { solver, substeps: sub, tolerance: tol, iterations: its, drag_1_s: drag, ..Default::default() };
    let mut state = TissueState::at_rest(&mesh);
    let scenario = g(9, 0.0) as usize;
    let mut s = 1_u32;
    let mut r = move || {
        s = s.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (s >> 8) as f32 / (1 << 24) as f32
    };
    if scenario > 0 {
        for p in state.positions.iter_mut().filter(|p| p.x > 0.0) {
            *p = match scenario {
                1 => bevy_math::Vec3::new(r() * 0.06, r() * 0.03, r() * 0.03),
                2 => bevy_math::Vec3::new(0.03, 0.015, 0.015),
                3 => bevy_math::Vec3::new(-p.x, p.y, p.z),
                _ => bevy_math::Vec3::new(p.x, p.y, 0.015),
            };
        }
    }
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
        let mut best = f64::MAX;
        let mut first = 0.0;
        let cpu = || std::fs::read_to_string("/proc/thread-self/schedstat").unwrap().split(' ').next().unwrap().parse::<f64>().unwrap() * 1e-6;
        let (c0, mut c1, mut its) = (cpu(), 0.0, 0);
        for t in 0..ticks {
            let s = Instant::now();
            body.step(&mut state, &holds, GRAVITY, 1.0 / 60.0, &settings);
            let e = s.elapsed().as_secs_f64() * 1e3;
            if t < 60 { c1 = cpu() - c0; its += body.solver_report().0; first += e; best = best.min(e); }
            if t < 40 || t % 60 == 59 {
                println!("{t}: {e:.2} ms tip {:.4} ({:+.3} %) its {:?} kin {:.3e} ", tip_mm(&mesh, &state), (tip_mm(&mesh, &state) / reference - 1.0) * 100.0, body.solver_report(), body.kinetic_energy(&state));
                if std::env::var("DBG").is_ok() {
                    let mut w: Vec<(f32, usize)> = body.elements().iter().enumerate().map(|(i, e)| (e.deformation(e.indices().map(|i| state.positions[i])).determinant(), i)).collect();
                    w.sort_by(|a, b| a.0.total_cmp(&b.0));
                    println!("   worst {:?} {:?} last {:?}", w[0], mesh.points(keyhole_tetmesh::TetId(w[0].1 as u32)), w.last());
                }
                if scenario > 0 {
                    let inv = body.elements().iter().filter(|e| e.deformation(e.indices().map(|i| state.positions[i])).determinant() <= 0.0).count();
                    println!("   inverted {inv}");
                }
            }
        }
        println!("first second {first:.1} ms, best tick {best:.2}, cpu {c1:.1}, its {its}");
    });
}
