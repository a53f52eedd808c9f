//! Scratch.
#[path = "../tests/common/mod.rs"]
mod common;
use bevy_math::Vec3;
use keyhole_tissue::{Body, TissueSettings, xpbd};
use keyhole_whiteboard::TissueState;
use std::time::Instant;
fn main() {
    for (n, m, reference) in [(10, 5, -21.763), (16, 8, -23.446), (20, 10, -23.9)] {
        let mesh = common::beam(n, m);
        let body = Body::new(&mesh, &common::beam_material()).unwrap();
        println!("{} tets {} colours", mesh.tet_count(), body.colouring().colours().len());
        let holds = common::clamp(&mesh);
        for substeps in [10, 20, 40, 80] {
            let mut state = TissueState::at_rest(&mesh);
            let settings = TissueSettings { substeps, drag_1_s: 8.0, ..Default::default() };
            let t = Instant::now();
            let ticks = if n > 10 { 120 } else { 180 };
            for _ in 0..ticks {
                xpbd::step(&body, &mut state, &holds, Vec3::new(0.0, -9.81, 0.0), 1.0 / 60.0, &settings);
            }
            let ms = t.elapsed().as_secs_f64() * 1e3 / f64::from(ticks);
            let tip = common::tip_mm(&mesh, &state);
            println!("  n {substeps}: {ms:.2} ms/tick, {:.1} ns/tet, tip {tip:.3} ratio {:.3}", ms * 1e6 / f64::from(substeps) / mesh.tet_count() as f64, tip / reference);
        }
    }
}
