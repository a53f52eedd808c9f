//! From file to mesh, with the errors beside the times: `cargo bench -p keyhole-imaging`.
//!
//! A kidney with its tumour out of a label volume of 512 x 512 x 611 voxels, file to VTU, at several cells; and 200 images of 512 x 512 in
//! run lengths and in JPEG-LS, read on all threads and on one. The label volume is the public KiTS19 case that `shared/data` beside the repository holds; without it that part is left
//! out. Each time is the least of five.

#[path = "../tests/common/ct.rs"]
#[expect(dead_code, clippy::unwrap_used, reason = "tests use the rest, and panic where they fail")]
mod ct;

use ct::Ct;
use dicom_core::value::PixelFragmentSequence;
use dicom_core::{DataElement, VR};
use dicom_dictionary_std::{tags, uids};
use keyhole_imaging::dicom_series::{self, Gaps};
use keyhole_imaging::{Centring, ComponentChoice, LabelChoice, MeshOptions, MeshReport, Selection, input, pipeline};
use keyhole_tetmesh::vtu;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

const REPEATS: usize = 5;

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    // `cargo test --benches` runs this too, to see that it works.
    let repeats = if std::env::args().any(|a| a == "--bench") { REPEATS } else { 1 };
    kidney(repeats)?;
    series(repeats)
}

fn kidney(repeats: usize) -> Outcome<()> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/kits19/case_00000.nii.gz");
    if !file.is_file() {
        println!("kidney: left out, there is no {}", file.display());
        return Ok(());
    }
    let folder = tempfile::tempdir()?;
    let label = |name: &str, value| LabelChoice { name: name.into(), value };
    let selection = Selection::Labels(vec![label("kidney", 1), label("tumour", 2)]);
    println!("kidney   cell    tets   total s  read s  labels   field  stuffing  figures  write   least deg  volume %  distance mm");
    for (edge_mm, core_doublings) in [(6.0, 0), (5.2, 0), (4.0, 0), (4.0, 3), (2.0, 0), (2.0, 3)] {
        let once = || -> Outcome<(f64, f64, f64, MeshReport)> {
            let start = Instant::now();
            let labels = input::read(&file, &selection)?;
            let read = start.elapsed().as_secs_f64();
            let options = MeshOptions { edge_mm, core_doublings, component: ComponentChoice::Auto, centring: Centring::Patient };
            let (mesh, report) = pipeline::mesh(labels, &options, &mut |_| {})?;
            let write = Instant::now();
            vtu::write(&folder.path().join("k.vtu"), &mesh, &[])?;
            Ok((start.elapsed().as_secs_f64(), read, write.elapsed().as_secs_f64(), report))
        };
        let mut least = once()?;
        for _ in 1..repeats {
            let next = once()?;
            least = if next.0 < least.0 { next } else { least };
        }
        let (total, read, write, r) = least;
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
    Ok(())
}

/// A body with texture, as noise compresses badly, Hounsfield units.
fn body(z: u32) -> Vec<i32> {
    (0..512 * 512)
        .map(|i| {
            let (x, y) = (i % 512 - 256, i / 512 - 256);
            if x * x + y * y > 200 * 200 { -1000 } else { 40 + (i * 31 + z as i32 * 17) % 53 }
        })
        .collect()
}

/// One image as a file.
type Encode = fn(&Ct, &[i32]) -> Outcome<Vec<u8>>;

fn run_lengths(ct: &Ct, hu: &[i32]) -> Outcome<Vec<u8>> {
    Ok(ct::file(ct.run_lengths(hu), uids::CT_IMAGE_STORAGE, uids::RLE_LOSSLESS))
}

fn jpeg_ls(ct: &Ct, hu: &[i32]) -> Outcome<Vec<u8>> {
    let words: Vec<u16> = hu.iter().map(|v| (v + 1024) as u16).collect();
    let mut stream = Vec::new();
    jpegls::encode(&words, 512, 512, &mut stream)?;
    stream.resize(stream.len().next_multiple_of(2), 0);
    let mut image = ct.image(hu);
    image.put(DataElement::new(tags::PIXEL_DATA, VR::OB, PixelFragmentSequence::new(Vec::<u32>::new(), vec![stream])));
    Ok(ct::file(image, uids::CT_IMAGE_STORAGE, uids::JPEGLS_LOSSLESS))
}

fn series(repeats: usize) -> Outcome<()> {
    let kinds: [(&str, Encode); 2] = [("run lengths", run_lengths), ("JPEG-LS", jpeg_ls)];
    for (name, encode) in kinds {
        let folder = tempfile::tempdir()?;
        let mut bytes = 0;
        for z in 0..200 {
            let ct = Ct { instance: z, columns: 512, rows: 512, position: [0.0, 0.0, f64::from(z)], ..Ct::default() };
            let file = encode(&ct, &body(z))?;
            bytes += file.len();
            std::fs::write(folder.path().join(format!("{z:03}")), file)?;
        }
        let least = |f: &dyn Fn() -> Outcome<()>| -> Outcome<f64> {
            let mut least = f64::INFINITY;
            for _ in 0..repeats {
                let start = Instant::now();
                f()?;
                least = least.min(start.elapsed().as_secs_f64());
            }
            Ok(least)
        };
        let plain = least(&|| {
            for z in 0..200 {
                std::hint::black_box(std::fs::read(folder.path().join(format!("{z:03}")))?);
            }
            Ok(())
        })?;
        let decode = || -> Outcome<()> {
            std::hint::black_box(dicom_series::find(folder.path(), None, Gaps::Refuse)?.read()?);
            Ok(())
        };
        let all = least(&decode)?;
        let single = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        let one = least(&|| single.install(|| decode().map_err(|e| e.to_string())).map_err(Into::into))?;
        let megabytes = bytes as f64 * 1e-6;
        println!(
            "series   200 images, {megabytes:.0} MB in {name}: {all:.2} s to Hounsfield units on {} threads, {one:.2} s on one, {plain:.3} s to read the bytes alone",
            rayon::current_num_threads()
        );
    }
    Ok(())
}
