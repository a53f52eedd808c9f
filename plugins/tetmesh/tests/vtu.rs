//! VTU files: what is written is read back bit by bit, bad files give an error that names the place, damaged ones never a panic.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole_tetmesh::vtu::{self, CellArray, VtuError};
use keyhole_tetmesh::{DVec3, MaterialId, MeshError, TetMesh};
use std::path::Path;

/// Two tetrahedra at a face, with coordinates that no short decimal writes down.
fn pair() -> TetMesh {
    let nodes = [[0.1, 0.0, 0.0], [1.0 / 3.0, 0.0, 0.0], [0.1, 0.7_f64.sqrt(), 0.0], [0.1, 0.0, 1e-9], [0.2, 0.2, -0.3]];
    let nodes = nodes.map(DVec3::from_array).to_vec();
    TetMesh::new(nodes, &[[0, 1, 2, 3], [0, 2, 1, 4]], &[MaterialId(0), MaterialId(7)])
}

fn save(mesh: &TetMesh, extra: &[CellArray]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vtu");
    vtu::write(&path, mesh, extra).unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file was left");
    std::fs::read(path).unwrap()
}

fn parse(bytes: &[u8]) -> Result<TetMesh, VtuError> {
    vtu::parse(Path::new("a.vtu"), bytes)
}

#[test]
fn a_mesh_survives_the_round_trip_bit_by_bit() {
    let mesh = pair();
    let back = parse(&save(&mesh, &[CellArray { name: "fragment", values: vec![0, 1] }])).unwrap();
    assert_eq!(back.rest_positions(), mesh.rest_positions());
    assert!(back.iter().eq(mesh.iter()));
    for (t, _) in mesh.iter() {
        assert_eq!(back.tet(t), mesh.tet(t));
    }
}

#[test]
fn holes_left_by_removed_parts_are_closed() {
    let mut mesh = pair();
    let (first, nodes) = mesh.iter().next().unwrap();
    mesh.remove_tet(first);
    mesh.remove_node(nodes[3]);
    let back = parse(&save(&mesh, &[])).unwrap();
    assert_eq!((back.tet_count(), back.node_count()), (1, 4));
    assert_eq!(back.total_volume(), mesh.total_volume());
}

/// A file with one cell of four nodes in ASCII.
fn ascii(points: &str, cell_type: u8, connectivity: &str, cell_data: &str) -> String {
    format!(
        r#"<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="4" NumberOfCells="1"><Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">{points}</DataArray></Points>
<Cells><DataArray type="Int32" Name="connectivity" format="ascii">{connectivity}</DataArray>
<DataArray type="Int32" Name="offsets" format="ascii">4</DataArray><DataArray type="UInt8" Name="types" format="ascii">{cell_type}</DataArray></Cells>
<CellData>{cell_data}</CellData></Piece></UnstructuredGrid></VTKFile>"#
    )
}

const POINTS: &str = "0 0 0 1 0 0 0 1 0 0 0 1";

fn material(kind: &str, value: &str) -> String {
    format!(r#"<DataArray type="{kind}" Name="material" format="ascii">{value}</DataArray>"#)
}

#[test]
fn single_precision_and_ascii_are_read_and_material_is_optional() {
    let mesh = parse(ascii(POINTS, 10, "0 1 2 3", "").as_bytes()).unwrap();
    assert_eq!(mesh.total_volume(), 1.0 / 6.0);
    let mesh = parse(ascii(POINTS, 10, "0 1 2 3", &material("Float64", "3")).as_bytes()).unwrap();
    assert_eq!(mesh.iter().map(|(t, _)| mesh.tet(t).material).collect::<Vec<_>>(), [MaterialId(3)]);
}

#[test]
fn legacy_files_are_read() {
    let text = format!(
        "# vtk DataFile Version 2.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n{POINTS}\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n"
    );
    assert_eq!(vtu::parse(Path::new("a.vtk"), text.as_bytes()).unwrap().total_volume(), 1.0 / 6.0);
}

#[test]
fn errors_name_the_file_and_the_place() {
    let error = |text: String| parse(text.as_bytes()).unwrap_err();
    let e = error(ascii(POINTS, 5, "0 1 2 3", ""));
    assert!(matches!(e, VtuError::CellType { cell: 0, cell_type: 5, .. }), "{e}");
    assert!(e.to_string().starts_with("a.vtu: cell 0 is of VTK type 5 (Triangle)"), "{e}");
    let e = error(ascii(POINTS, 10, "0 2 1 3", ""));
    assert!(matches!(e, VtuError::Mesh { source: MeshError::NotPositive { tet: 0, .. }, .. }), "{e}");
    let e = error(ascii(POINTS, 10, "0 1 2 9", ""));
    assert!(matches!(e, VtuError::Mesh { source: MeshError::UnknownNode { tet: 0, node: 9, nodes: 4 }, .. }), "{e}");
    let e = error(ascii("0 0 0 1 0 0 0 1 0 0 0 NaN", 10, "0 1 2 3", ""));
    assert!(matches!(e, VtuError::Mesh { source: MeshError::NotFinite { node: 3, .. }, .. }), "{e}");
    let e = error(ascii(POINTS, 10, "0 1 2 3", &material("Int32", "-1")));
    assert!(e.to_string().contains("`material`: expected whole numbers"), "{e}");
    let e = vtu::read(Path::new("/no/such/file.vtu")).unwrap_err();
    assert!(e.to_string().starts_with("/no/such/file.vtu: "), "{e}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.vtu");
    vtu::write(&path, &pair(), &[CellArray { name: "fragment", values: vec![0] }]).unwrap_err();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "a failed write left something");
}

#[test]
fn damaged_files_never_panic() {
    let good = save(&pair(), &[]);
    let text = ascii(POINTS, 10, "0 1 2 3", &material("Int32", "1")).into_bytes();
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = move |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n
    };
    for _ in 0..1500 {
        let mut bytes = if random(2) == 0 { good.clone() } else { text.clone() };
        for _ in 0..=random(4) {
            let at = random(bytes.len());
            match random(3) {
                0 => bytes[at] ^= 1 << random(8),
                1 => bytes.truncate(at.max(1)),
                _ => bytes[at] = b"0149<>\"=/A"[random(10)],
            }
        }
        if let Ok(mesh) = parse(&bytes) {
            assert!(mesh.total_volume() > 0.0);
        }
    }
}
