//! Real kidneys with their tumours: the promises hold on them.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;

use common::labels;
use keyhole_imaging::stuffing::PROVED_DEGREES;
use keyhole_imaging::{Centring, ComponentChoice, MeshOptions, Selection, input, pipeline};
use keyhole_tetmesh::{Boundary, check};
use std::path::Path;

#[test]
fn kidneys_at_four_millimetres() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/kits19");
    if !folder.is_dir() {
        println!("skipped: there is no {}", folder.display());
        return;
    }
    for case in ["case_00000", "case_00003", "case_00064"] {
        let selection = Selection::Labels(labels(&[("kidney", 1), ("tumour", 2)]));
        let volume = input::read(&folder.join(format!("{case}.nii.gz")), &selection).unwrap();
        let options = MeshOptions { edge_mm: 4.0, component: ComponentChoice::Auto, centring: Centring::Patient };
        let (mesh, report) = pipeline::mesh(volume, &options, &mut |_| {}).unwrap();
        assert!(report.volume_error_percent.abs() < 1.0, "{case}: {} %", report.volume_error_percent);
        let chosen = report.found.iter().find(|c| c.chosen).unwrap();
        assert!((report.mesh_ml / chosen.volume_ml - 1.0).abs() < 0.01, "{case}: against the mask with its holes");
        assert!(report.min_dihedral_deg >= PROVED_DEGREES[0] && report.max_dihedral_deg <= PROVED_DEGREES[1], "{case}");
        let boundary = Boundary::of(&mesh);
        assert!(boundary.is_closed_manifold() && report.components == 1, "{case}");
        assert_eq!(boundary.euler_characteristic(), 2, "{case}");
        assert!(report.surface_distance.mesh_to_mask.mean_mm < 0.6, "{case}");
        for part in &report.parts {
            assert!((part.mesh_ml / part.mask_ml - 1.0).abs() < 0.05, "{case}: {}", part.name);
        }
        // What a reader of the file would refuse is not there.
        let tets: Vec<[u32; 4]> = mesh.iter().map(|(_, c)| c.map(|n| n.0)).collect();
        check::checked(mesh.rest_positions(), &tets, &[]).unwrap();
    }
}
