#![allow(missing_docs, clippy::unwrap_used)]
use keyhole_tissue::beam::*;
use keyhole_tissue::*;
use keyhole_whiteboard::TissueState;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let (cells, model, threads, ticks, sub): (u32, String, usize, u32, u32) =
        (a[1].parse().unwrap(), a[2].clone(), a[3].parse().unwrap(), a[4].parse().unwrap(), a[5].parse().unwrap());
    let mesh = beam(cells, cells / 2);
    let mut body = Body::new(&mesh, &beam_material()).unwrap();
    let holds = clamp(&mesh);
    let mut state = TissueState::at_rest(&mesh);
    let (model, per) = match model.as_str() {
        "xpbd" => (TissueModel::Xpbd(XpbdSettings { substeps: sub, ..Default::default() }), sub),
        "springs" => (TissueModel::Xpbd(XpbdSettings { substeps: sub, constraints: Constraints::DistanceVolume }), sub),
        "vbd" => (TissueModel::Vbd(VbdSettings { substeps: sub, ..Default::default() }), 20 * sub),
        _ => (TissueModel::Teschner(Default::default()), 1),
    };
    let mut kept = ModelState::new(model, None, &body, &mesh, &beam_material()).unwrap();
    let settings = TissueSettings { drag_1_s: 6.0, ..Default::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let (mut all, mut best) = (0.0, f64::MAX);
        for _ in 0..ticks {
            let start = std::time::Instant::now();
            kept.step(&mut body, &mut state, &holds, GRAVITY, 1.0 / 60.0, &settings);
            let t = start.elapsed().as_secs_f64();
            all += t;
            best = f64::min(best, t);
        }
        let n = 1e9 / (f64::from(per) * mesh.tet_count() as f64);
        println!("{} tets: {:.2} ns mean {:.2} ns best tick; tip {}", mesh.tet_count(), all * n / f64::from(ticks), best * n, tip_mm(&mesh, &state));
    });
}
