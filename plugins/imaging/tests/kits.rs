//! Real kidneys with their tumours: the promises hold on them.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common;

use common::labels;
use keyhole_imaging::stuffing::PROVED_DEGREES;
use keyhole_imaging::{Centring, ComponentChoice, MeshOptions, Selection, input, pipeline};
use keyhole_tetmesh::{Boundary, check};
use std::path::Path;

#[test]
fn both_kidneys_of_three_patients() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/kits19");
    if !folder.is_dir() {
        println!("skipped: there is no {}", folder.display());
        return;
    }
    // Slices of 0.5, 1 and 5 mm; the finest cell where the clefts are narrowest.
    for (case, edges) in [("case_00000", &[4.0, 6.0][..]), ("case_00003", &[4.0, 6.0]), ("case_00064", &[3.0, 4.0, 6.0])] {
        let selection = Selection::Labels(labels(&[("kidney", 1), ("tumour", 2)]));
        let volume = input::read(&folder.join(format!("{case}.nii.gz")), &selection).unwrap();
        let m = volume.voxel_to_lps.matrix3;
        let half_diagonal = (m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()).sqrt() / 2.0;
        for (rank, &edge_mm) in [0, 1].iter().flat_map(|r| edges.iter().map(move |e| (*r, e))) {
            let name = format!("{case}, kidney {rank}, {edge_mm} mm");
            let options = MeshOptions { edge_mm, core_doublings: 0, component: ComponentChoice::Rank(rank), centring: Centring::Patient };
            let (mesh, report) = pipeline::mesh(volume.clone(), &options, &mut |_| {}).unwrap();
            let most = if edge_mm < 5.0 { 0.5 } else { 1.0 };
            assert!(report.volume_error_percent.abs() < most, "{name}: {} %", report.volume_error_percent);
            let chosen = report.found.iter().find(|c| c.chosen).unwrap();
            let holes_ml = report.hole_voxels as f64 * chosen.volume_ml / chosen.voxels as f64;
            assert!((report.mesh_ml / (chosen.volume_ml + holes_ml) - 1.0).abs() < 0.01, "{name}: against the mask and its holes");
            // Angles with the tumour's border among the faces.
            assert!(report.min_dihedral_deg >= PROVED_DEGREES[0] - 0.05, "{name}: {}", report.min_dihedral_deg);
            assert!(report.max_dihedral_deg <= PROVED_DEGREES[1] + 0.05, "{name}: {}", report.max_dihedral_deg);
            let boundary = Boundary::of(&mesh);
            assert!(boundary.is_closed_manifold() && report.components == 1, "{name}");
            let distance = report.surface_distance;
            assert!(distance.mesh_to_mask.mean_mm < half_diagonal && distance.mask_to_mesh.mean_mm < half_diagonal, "{name}: {distance:?}");
            for part in report.parts.iter().filter(|p| p.mask_ml > 0.0) {
                assert!((part.mesh_ml / part.mask_ml - 1.0).abs() < 0.02, "{name}: {}", part.name);
            }
            for border in report.borders.iter().filter(|b| b.faces > 0) {
                assert!(border.off.mean_mm < edge_mm / 8.0, "{name}: {border:?}");
            }
            // What a reader of the file would refuse is not there.
            let tets: Vec<[u32; 4]> = mesh.iter().map(|(_, c)| c.map(|n| n.0)).collect();
            check::checked(mesh.rest_positions(), &tets, &[]).unwrap();
        }
    }
}
