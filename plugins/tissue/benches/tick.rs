//! Scratch.
#[path = "../tests/common/mod.rs"]
mod common;
use bevy_math::Vec3;
use keyhole_tissue::{Body, TissueSettings, Solver};
use keyhole_tetmesh::*;
use keyhole_whiteboard::TissueState;
use std::time::Instant;
fn sliver(mesh: &mut TetMesh, every: usize, t: f64) {
    let nodes: Vec<NodeId> = mesh.nodes().collect();
    let mut k = 0;
    for n in nodes {
        if mesh.rest(n).x == 0.0 { continue }
        k += 1;
        if k % every != 0 { continue }
        let tet = mesh.topology().around_node(n)[0];
        let other = *mesh.corners(tet).iter().find(|m| **m != n).unwrap();
        let p = mesh.rest(n) * (1.0 - t) + mesh.rest(other) * t;
        let around: Vec<TetId> = mesh.topology().around_edge(n, other).collect();
        let mid = mesh.add_node(p, [(n, 1.0 - t), (other, t)].into_iter().collect());
        for tet in around {
            let c = mesh.corners(tet);
            let a = mesh.tet(tet);
            mesh.remove_tet(tet);
            mesh.add_tet(c.map(|x| if x == n { mid } else { x }), a);
            mesh.add_tet(c.map(|x| if x == other { mid } else { x }), a);
        }
    }
    mesh.take_delta();
}
fn main() {
    for (name, n, m, reference, t, young) in [("plain", 10, 5, -21.763, 0.0, 1e4), ("plain", 20, 10, -23.9, 0.0, 1e4),
        ("sliver .01", 10, 5, -21.763, 0.01, 1e4),  ("sliver .01", 10, 5, -0.217, 0.01, 1e6), ("scrambled", 10, 5, -21.76, 0.0, 1e4)] {
        let mut mesh = common::beam(n, m);
        if t > 0.0 { sliver(&mut mesh, 5, t); }
        let mut mat = common::beam_material();
        mat.0[0].young_modulus_pa = young;
        let body = Body::new(&mesh, &mat).unwrap();
        println!("{name} {t} {young} {} tets {} colours", mesh.tet_count(), body.colouring().colours().len());
        let holds = common::clamp(&mesh);
        let mut cases = vec![];
        for substeps in [20, 80] { cases.push(TissueSettings { solver: Solver::Xpbd, substeps, ..Default::default() }); }
        for substeps in [1, 2, 4, 6, 8] { for (viscosity_s,tolerance) in [(0.0,0.1), (0.001, 0.02), (0.001,0.1), (0.001, 0.2)] {
            cases.push(TissueSettings { solver: Solver::SemiImplicit, substeps, viscosity_s, tolerance, ..Default::default() });
        }}
        for c in cases {
            let mut state = TissueState::at_rest(&mesh);
            if name == "scrambled" {
                let mut s = 1u32;
                for p in state.positions.iter_mut().filter(|p| p.x > 0.0) { let mut r = || { s = s.wrapping_mul(1664525).wrapping_add(1013904223); (s >> 8) as f32 / (1 << 24) as f32 }; *p = Vec3::new(r() * 0.06, r() * 0.03, r() * 0.03); }
            }
            let settings = TissueSettings { drag_1_s: 6.0, ..c };
            let t = Instant::now();
            let ticks = if n > 10 { 80 } else { 180 };
            let mut peak = 0.0_f64; let mut when = 0;
            let mut fault = None;
            for k in 0..ticks {
                fault = fault.or(body.step_safely(&mut state, &holds, Vec3::new(0.0, -9.81, 0.0), 1.0 / 60.0, &settings));
                if fault.is_some() { break }
                let tip = common::tip_mm(&mesh, &state);
                if tip < peak { peak = tip; when = k; }
            }
            let ms = t.elapsed().as_secs_f64() * 1e3 / f64::from(ticks);
            let tip = common::tip_mm(&mesh, &state);
            println!("  {:?} n {} visc {} tol {}: {ms:.2} ms/tick, {:.1} ns/tet, tip {tip:.3} ratio {:.3} peak {peak:.1} at {when} kin {:.1e} el {:.2e} {fault:?}", c.solver, c.substeps, c.viscosity_s, c.tolerance, ms * 1e6 / f64::from(c.substeps) / mesh.tet_count() as f64, tip / reference, body.kinetic_energy(&state), body.elastic_energy(&state));
        }
    }
}
