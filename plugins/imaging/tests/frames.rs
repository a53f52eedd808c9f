//! Left stays left: one asymmetric body in every way a file can store it ends up at the same place in the world.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;
#[path = "common/nifti.rs"]
mod nifti_bytes;

use common::labels;
use keyhole_imaging::{Centring, ComponentChoice, MeshOptions, frame, nifti_file, pipeline};
use keyhole_tetmesh::{DVec3, TetMesh};
use nifti_bytes::nifti;

/// Longest voxel axis, mm: the boundary of a part is known no better.
const VOXEL: f64 = 1.5;

/// An organ with its inner part in one octant: 1 at a block, 2 in the corner of it that is left, posterior, superior.
fn part(lps_mm: DVec3) -> u8 {
    let organ = lps_mm.abs().cmple(DVec3::new(14.0, 18.0, 22.0)).all();
    let inner = lps_mm.cmpgt(DVec3::new(2.0, 2.0, 2.0)).all();
    u8::from(organ) * (1 + u8::from(inner))
}

fn mesh_of(file: &[u8], name: &str) -> TetMesh {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, file).unwrap();
    let volume = nifti_file::read_labels(&path, &labels(&[("organ", 1), ("inner", 2)])).unwrap();
    let options = MeshOptions { edge_mm: 5.0, core_doublings: 0, component: ComponentChoice::Auto, centring: Centring::Patient };
    pipeline::mesh(volume, &options, &mut |_| {}).unwrap().0
}

fn centroid(mesh: &TetMesh, material: u16) -> DVec3 {
    let (mut sum, mut volume) = (DVec3::ZERO, 0.0);
    for (t, _) in mesh.iter().filter(|(t, _)| mesh.tet(*t).material.0 == material) {
        let v = mesh.volume(t);
        assert!(v > 0.0, "tetrahedron {} is turned inside out", t.0);
        sum += mesh.points(t).iter().sum::<DVec3>() / 4.0 * v;
        volume += v;
    }
    sum / volume
}

/// The body on a grid with these voxel axes (RAS, mm a voxel) and the corner at which it begins.
fn stored(axes: [DVec3; 3], origin_ras: DVec3, dims: [usize; 3]) -> ([[f32; 4]; 3], Vec<u8>) {
    let mut voxels = Vec::new();
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let ras = origin_ras + axes[0] * x as f64 + axes[1] * y as f64 + axes[2] * z as f64;
                voxels.push(part(DVec3::new(-ras.x, -ras.y, ras.z)));
            }
        }
    }
    let row = |k: usize| [axes[0][k] as f32, axes[1][k] as f32, axes[2][k] as f32, origin_ras[k] as f32];
    ([row(0), row(1), row(2)], voxels)
}

#[test]
fn every_storage_order_gives_the_same_world() {
    let dims = [60, 64, 40];
    let (h, k) = (1.0, 1.5);
    let far = |axes: [DVec3; 3]| -(axes[0] * 29.5 + axes[1] * 31.5 + axes[2] * 19.5);
    let orders = [
        ("RAS", [DVec3::X * h, DVec3::Y * h, DVec3::Z * k]),
        ("LAS", [-DVec3::X * h, DVec3::Y * h, DVec3::Z * k]),
        ("LPS", [-DVec3::X * h, -DVec3::Y * h, DVec3::Z * k]),
        ("ASR", [DVec3::Y * h, DVec3::Z * h, DVec3::X * k]),
        ("SPL, left-handed", [DVec3::Z * h, -DVec3::Y * h, -DVec3::X * k]),
    ];
    for (name, axes) in orders {
        let (sform, voxels) = stored(axes, far(axes), dims);
        let mesh = mesh_of(&nifti(dims, [1.0, 1.0, 1.0, 1.5], Some(sform), None, &voxels), "x.nii");
        // The inner part: left, posterior, superior of the organ's middle, so +X, +Y, -Z in the world.
        let at = centroid(&mesh, 1) * 1e3;
        assert!(at.distance(DVec3::new(8.0, 12.0, -10.0)) < VOXEL, "{name}: {at}");
        let whole = mesh.total_volume() * 1e9;
        assert!((whole / (28.0 * 36.0 * 44.0) - 1.0).abs() < 0.05, "{name}: {whole} mm3");
    }
}

#[test]
fn quaternion_and_gzip_agree_with_the_matrix() {
    let dims = [60, 64, 40];
    // Half a turn about z: x and y look to the right and to the front; qfac -1 turns z over.
    for (qfac, z) in [(1.0, DVec3::Z * 1.5), (-1.0, -DVec3::Z * 1.5)] {
        let axes = [-DVec3::X, -DVec3::Y, z];
        let origin = -(axes[0] * 29.5 + axes[1] * 31.5 + axes[2] * 19.5);
        let (_, voxels) = stored(axes, origin, dims);
        let q = [0.0, 0.0, 1.0, origin.x as f32, origin.y as f32, origin.z as f32];
        let bytes = nifti(dims, [qfac, 1.0, 1.0, 1.5], None, Some(q), &voxels);
        let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut gz, &bytes).unwrap();
        let mesh = mesh_of(&gz.finish().unwrap(), "x.nii.gz");
        let at = centroid(&mesh, 1) * 1e3;
        assert!(at.distance(DVec3::new(8.0, 12.0, -10.0)) < VOXEL, "qfac {qfac}: {at}");
    }
}

#[test]
fn the_patient_stands_upright_and_faces_positive_z() {
    let (left, posterior, superior) = (DVec3::X, DVec3::Y, DVec3::Z);
    assert!(frame::world_from_patient(left).x > 0.0);
    assert!(frame::world_from_patient(superior).y > 0.0);
    assert!(frame::world_from_patient(posterior).z < 0.0);
}
