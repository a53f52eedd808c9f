use super::*;
use crate::Body;
use crate::beam::{beam, beam_material};
use crate::lanes::{Near, Plain};
use bevy_math::{DMat3, DVec3};
use keyhole_whiteboard::TissueState;

/// The positions of a stirred beam with the inverse masses of its nodes.
fn stirred(mesh: &TetMesh, body: &Body) -> Vec<[f32; 4]> {
    let mut s = 1_u32;
    let mut random = || {
        s = s.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((s >> 8) as f32 / (1 << 24) as f32 - 0.5) * 3e-3
    };
    let state = TissueState::at_rest(mesh);
    let moved = |(x, m): (&bevy_math::Vec3, &f32)| [x.x + random(), x.y + random(), x.z + random(), 1.0 / m];
    state.positions.iter().zip(body.masses()).map(moved).collect()
}

fn shared(x: &[[f32; 4]]) -> Shared {
    let mut shared = Shared::default();
    shared.resize(x.len());
    x.iter().enumerate().for_each(|(i, x)| shared.set(i, *x));
    shared
}

/// One element by the definitions: deformation gradient, cofactor, determinant of the 2x2 block.
fn plainly(e: &Element, x: &mut [DVec3], w: [f64; 4], h: f64) {
    let edges = DMat3::from_cols(x[1] - x[0], x[2] - x[0], x[3] - x[0]);
    let b = e.inverse_rest.as_dmat3();
    let f = edges * b;
    let cofactor = DMat3::from_cols(f.y_axis.cross(f.z_axis), f.z_axis.cross(f.x_axis), f.x_axis.cross(f.y_axis));
    let size = (f.x_axis.length_squared() + f.y_axis.length_squared() + f.z_axis.length_squared()).sqrt();
    let by_node = |m: DMat3| {
        let m = m * b.transpose();
        [-(m.x_axis + m.y_axis + m.z_axis), m.x_axis, m.y_axis, m.z_axis]
    };
    let (d, g) = (by_node(f * (1.0 / size)), by_node(cofactor));
    let product = |a: [DVec3; 4], b: [DVec3; 4]| (0..4).map(|i| w[i] * a[i].dot(b[i])).sum::<f64>();
    let (mu, lambda) = (f64::from(e.material.mu), f64::from(e.material.lambda));
    let soft = 1.0 / (f64::from(e.volume) * h * h);
    let (dd, dg, gg) = (product(d, d) + soft / mu, product(d, g), product(g, g) + soft / lambda);
    let (cd, cg) = (-size, 1.0 + mu / lambda - f.determinant());
    let det = dd * gg - dg * dg;
    let (ld, lg) = ((cd * gg - cg * dg) / det, (cg * dd - cd * dg) / det);
    for i in 0..4 {
        x[i] += (d[i] * ld + g[i] * lg) * w[i];
    }
}

/// Eight at a time, with wide lanes and without, is one after the other in f64.
#[test]
fn lanes_are_elements_one_after_the_other() {
    let mesh = beam(4, 2);
    let body = Body::new(&mesh, &beam_material()).unwrap();
    let blocks = Blocks::new(body.elements(), body.colouring(), Constraints::NeoHookean);
    let start = stirred(&mesh, &body);
    let h = 1.0 / 2400.0;
    let sweep = |plain: bool| {
        let (at, mut near) = (shared(&start), Near::default());
        for pack in &blocks.packs {
            let job = Sweep { pack, constraints: Constraints::NeoHookean, inverse_h2: 1.0 / (h * h), shared: &at, near: near.nodes() };
            if plain {
                job.run::<Plain>(());
            } else {
                crate::lanes::run(job);
            }
        }
        (0..start.len()).map(|i| at.point(i)).collect::<Vec<_>>()
    };
    let mut exact: Vec<DVec3> = start.iter().map(|[x, y, z, _]| bevy_math::Vec3::new(*x, *y, *z).as_dvec3()).collect();
    for pack in &blocks.packs {
        for batch in &pack.batches {
            for lane in (0..LANES).filter(|l| batch.nodes[0][*l] != 0) {
                let nodes = batch.nodes.map(|n| pack.nodes[usize::from(n[lane]) / 4 - 1]);
                let mut sorted = nodes;
                sorted.sort_unstable();
                let element = body.elements().iter().find(|e| {
                    let mut n = e.nodes;
                    n.sort_unstable();
                    n == sorted
                });
                let element = element.unwrap();
                let at = element.indices();
                let mut x = at.map(|i| exact[i]);
                plainly(element, &mut x, at.map(|i| f64::from(start[i][3])), f64::from(h));
                at.iter().zip(x).for_each(|(i, x)| exact[*i] = x);
            }
        }
    }
    for plain in [true, false] {
        let off = sweep(plain).iter().zip(&exact).map(|(a, b)| a.as_dvec3().distance(*b)).fold(0.0, f64::max);
        let way = start.iter().zip(&exact).map(|(a, b)| DVec3::new(a[0].into(), a[1].into(), a[2].into()).distance(*b)).fold(0.0, f64::max);
        assert!(off < 1e-4 * way && way > 1e-4, "plain {plain}: {off} m off in {way}");
    }
}

/// After cuts every element is in one lane, lanes of a batch share no node, and parts of a colour share none.
#[test]
fn batches_stay_sound() {
    let mut mesh = beam(16, 8);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let mut state = TissueState::at_rest(&mesh);
    body.xpbd.blocks = Some(Box::new(Blocks::new(body.elements(), body.colouring(), Constraints::NeoHookean)));
    for round in 0..40 {
        let (_, c) = mesh.iter().nth(37 * round + 5).unwrap();
        let around: Vec<_> = mesh.topology().around_edge(c[0], c[1]).collect();
        let middle = mesh.add_node((mesh.rest(c[0]) + mesh.rest(c[1])) * 0.5, [(c[0], 0.5), (c[1], 0.5)].into_iter().collect());
        for t in around {
            let (corners, attributes) = (mesh.corners(t), mesh.tet(t));
            mesh.remove_tet(t);
            for end in [c[0], c[1]] {
                mesh.add_tet(corners.map(|n| if n == end { middle } else { n }), attributes);
            }
        }
        let delta = mesh.take_delta();
        crate::adopt::adopt(&mut body, &mut state, &mesh, &delta, |_| crate::Momentum::default());
    }
    let blocks = body.xpbd.blocks.as_ref().unwrap();
    let mut lanes: Vec<[u32; 4]> = Vec::new();
    for colour in blocks.parts.colours() {
        let mut taken: Vec<u32> = Vec::new();
        for part in colour {
            let pack = &blocks.packs[*part as usize];
            taken.extend(&pack.nodes);
            for batch in &pack.batches {
                let used: Vec<usize> = (0..LANES).filter(|l| batch.nodes[0][*l] != 0).collect();
                let mut nodes: Vec<u16> = used.iter().flat_map(|l| batch.nodes.map(|n| n[*l])).collect();
                nodes.sort_unstable();
                nodes.dedup();
                assert_eq!(nodes.len(), 4 * used.len());
                lanes.extend(used.iter().map(|l| batch.nodes.map(|n| pack.nodes[usize::from(n[*l]) / 4 - 1])));
            }
        }
        let all = taken.len();
        taken.sort_unstable();
        taken.dedup();
        assert_eq!(taken.len(), all, "two parts of a colour share a node");
    }
    let mut elements: Vec<[u32; 4]> = body.elements().iter().filter(|e| !e.is_empty()).map(|e| e.nodes).collect();
    lanes.sort_unstable();
    elements.sort_unstable();
    assert_eq!(lanes, elements);
    let batches: usize = blocks.packs.iter().map(|p| p.batches.len()).sum();
    assert!(elements.len() * 10 > batches * LANES * 8, "lanes are mostly full: {batches} batches");
}
