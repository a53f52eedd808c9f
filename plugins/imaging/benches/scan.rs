//! From file to mesh, with the errors beside the times: `cargo bench -p keyhole-imaging`.
//!
//! A kidney with its tumour out of a label volume of 512 x 512 x 611 voxels, file to VTU, at several cells; and 200 images of 512 x 512 in
//! run lengths. The label volume is the public KiTS19 case that `shared/data` beside the repository holds; without it that part is left
//! out. Each time is the least of five.
#![expect(clippy::unwrap_used, reason = "a bench stops where it fails")]

#[path = "../tests/common/ct.rs"]
#[expect(dead_code, reason = "other tests use the rest")]
mod ct;

use ct::Ct;
use dicom_dictionary_std::uids;
use keyhole_imaging::dicom_series::{self, Gaps};
use keyhole_imaging::{Centring, ComponentChoice, LabelChoice, MeshOptions, MeshReport, Selection, input, pipeline};
use keyhole_tetmesh::vtu;
use std::path::Path;
use std::time::Instant;

const REPEATS: usize = 5;

fn main() {
    // `cargo test --benches` runs this too, to see that it works.
    let repeats = if std::env::args().any(|a| a == "--bench") { REPEATS } else { 1 };
    kidney(repeats);
    series(repeats);
}

fn kidney(repeats: usize) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/kits19/case_00000.nii.gz");
    if !file.is_file() {
        println!("kidney: left out, there is no {}", file.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let label = |name: &str, value| LabelChoice { name: name.into(), value };
    let selection = Selection::Labels(vec![label("kidney", 1), label("tumour", 2)]);
    println!("kidney   cell    tets   total s  read s  labels   field  stuffing  figures  write   least deg  volume %  distance mm");
    for (edge_mm, core_doublings) in [(6.0, 0), (5.2, 0), (4.0, 0), (4.0, 3), (2.0, 0), (2.0, 3)] {
        let once = || {
            let start = Instant::now();
            let labels = input::read(&file, &selection).unwrap();
            let read = start.elapsed().as_secs_f64();
            let options = MeshOptions { edge_mm, core_doublings, component: ComponentChoice::Auto, centring: Centring::Patient };
            let (mesh, report) = pipeline::mesh(labels, &options, &mut |_| {}).unwrap();
            let write = Instant::now();
            vtu::write(&folder.path().join("k.vtu"), &mesh, &[]).unwrap();
            (start.elapsed().as_secs_f64(), read, write.elapsed().as_secs_f64(), report)
        };
        let (total, read, write, r): (f64, f64, f64, MeshReport) = (0..repeats).map(|_| once()).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        let (s, d) = (r.seconds, r.surface_distance.both.mean_mm);
        println!(
            "{:>9} mm {:>8} {total:>8.2} {read:>7.2} {:>7.2} {:>7.2} {:>9.3} {:>8.2} {write:>6.2} {:>11.2} {:>9.3} {d:>12.3}",
            format!("{edge_mm}{}", if core_doublings > 0 { "+" } else { "" }),
            r.tets,
            s.labels,
            s.field,
            s.stuffing,
            s.figures,
            r.min_dihedral_deg,
            r.volume_error_percent
        );
    }
    println!("+: with a core of cells doubled up to three times");
}

fn series(repeats: usize) {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = 0;
    for z in 0..200 {
        // A body with texture, as noise compresses badly.
        let hu: Vec<i32> = (0..512 * 512)
            .map(|i| {
                let (x, y) = (i % 512 - 256, i / 512 - 256);
                if x * x + y * y > 200 * 200 { -1000 } else { 40 + (i * 31 + z * 17) % 53 }
            })
            .collect();
        let image =
            Ct { instance: z as u32, columns: 512, rows: 512, position: [0.0, 0.0, f64::from(z)], ..Ct::default() }.run_lengths(&hu);
        let file = ct::file(image, uids::CT_IMAGE_STORAGE, uids::RLE_LOSSLESS);
        bytes += file.len();
        std::fs::write(folder.path().join(format!("{z:03}")), file).unwrap();
    }
    let time = |f: &dyn Fn()| {
        let start = Instant::now();
        f();
        start.elapsed().as_secs_f64()
    };
    let least = |f: &dyn Fn()| (0..repeats).map(|_| time(f)).fold(f64::INFINITY, f64::min);
    let plain = least(&|| {
        for z in 0..200 {
            std::hint::black_box(std::fs::read(folder.path().join(format!("{z:03}"))).unwrap());
        }
    });
    let decoded = least(&|| drop(dicom_series::find(folder.path(), None, Gaps::Refuse).unwrap().read().unwrap()));
    let megabytes = bytes as f64 * 1e-6;
    println!(
        "series   200 images, {megabytes:.0} MB in run lengths: {decoded:.2} s to Hounsfield units, {plain:.3} s to read the bytes alone"
    );
}
