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

/// The same mesh in the other encodings: what VTK's own writer (appended, raw or base64, zlib in blocks) and meshio (in place, zlib) do.
#[test]
fn every_encoding_gives_the_same_mesh() {
    let mesh = pair();
    for zlib in [false, true] {
        for (header, big) in [(4, false), (8, false), (4, true), (8, true)] {
            for place in ["binary", "base64", "raw"] {
                let bytes = encoded(&mesh, zlib, header, big, place);
                let back = parse(&bytes).unwrap_or_else(|e| panic!("zlib {zlib}, header {header}, big-endian {big}, {place}: {e}"));
                assert_eq!(back.rest_positions(), mesh.rest_positions());
                assert!(back.iter().eq(mesh.iter()));
                assert!(mesh.iter().all(|(t, _)| back.tet(t) == mesh.tet(t)));
            }
        }
    }
}

/// A VTU file written by hand.
fn encoded(mesh: &TetMesh, zlib: bool, header: usize, big: bool, place: &str) -> Vec<u8> {
    use base64::Engine;
    use std::io::Write;
    let order = |mut b: Vec<u8>| {
        if big {
            b.reverse();
        }
        b
    };
    let words = |v: &[usize]| v.iter().flat_map(|n| order((*n as u64).to_le_bytes()[..header].to_vec())).collect::<Vec<u8>>();
    let base64 = |b: &[u8]| base64::engine::general_purpose::STANDARD.encode(b).into_bytes();
    let pack = |data: Vec<u8>| -> Vec<u8> {
        let runs: Vec<Vec<u8>> = if zlib {
            // Blocks of 24 bytes, the last one shorter.
            let blocks: Vec<Vec<u8>> = data
                .chunks(24)
                .map(|b| {
                    let mut z = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
                    z.write_all(b).unwrap();
                    z.finish().unwrap()
                })
                .collect();
            let mut head = vec![blocks.len(), 24, data.len() % 24];
            head.extend(blocks.iter().map(Vec::len));
            vec![words(&head), blocks.concat()]
        } else {
            vec![[words(&[data.len()]), data].concat()]
        };
        if place == "raw" { runs.concat() } else { runs.iter().flat_map(|r| base64(r)).collect() }
    };
    let mut appended = Vec::new();
    let mut array = |attributes: &str, data: Vec<u8>| -> String {
        let packed = pack(data);
        if place == "binary" {
            return format!("<DataArray {attributes} format=\"binary\">\n  {}\n</DataArray>", String::from_utf8(packed).unwrap());
        }
        appended.extend(&packed);
        format!("<DataArray {attributes} format=\"appended\" offset=\"{}\"/>", appended.len() - packed.len())
    };
    let tets: Vec<[u32; 4]> = mesh.iter().map(|(_, c)| c.map(|n| n.0)).collect();
    let points = array(
        "type=\"Float64\" NumberOfComponents=\"3\"",
        mesh.rest_positions().iter().flat_map(|p| p.to_array()).flat_map(|x| order(x.to_le_bytes().to_vec())).collect(),
    );
    let connectivity =
        array("type=\"Int32\" Name=\"connectivity\"", tets.iter().flatten().flat_map(|n| order(n.to_le_bytes().to_vec())).collect());
    let offsets =
        array("type=\"Int64\" Name=\"offsets\"", (1..=tets.len() as i64).flat_map(|i| order((4 * i).to_le_bytes().to_vec())).collect());
    let types = array("type=\"UInt8\" Name=\"types\"", vec![10; tets.len()]);
    let material = array(
        "type=\"UInt16\" Name=\"material\"",
        mesh.iter().flat_map(|(t, _)| order(mesh.tet(t).material.0.to_le_bytes().to_vec())).collect(),
    );
    let mut file = format!(
        "<VTKFile type=\"UnstructuredGrid\" byte_order=\"{}\" header_type=\"UInt{}\"{}><UnstructuredGrid><Piece NumberOfPoints=\"{}\" \
         NumberOfCells=\"{}\"><PointData/><Points>{points}</Points><Cells>{connectivity}{offsets}{types}</Cells><CellData>{material}\
         </CellData></Piece></UnstructuredGrid>",
        if big { "BigEndian" } else { "LittleEndian" },
        8 * header,
        if zlib { " compressor=\"vtkZLibDataCompressor\"" } else { "" },
        mesh.node_count(),
        tets.len(),
    )
    .into_bytes();
    if place != "binary" {
        file.extend(format!("<AppendedData encoding=\"{place}\">\n_").into_bytes());
        file.extend(&appended);
        file.extend(b"\n</AppendedData>");
    }
    file.extend(b"</VTKFile>");
    file
}

#[test]
fn errors_name_the_file_and_the_place() {
    let error = |text: String| parse(text.as_bytes()).unwrap_err();
    let e = error(ascii(POINTS, 5, "0 1 2 3", ""));
    assert!(matches!(e, VtuError::CellType { cell: 0, cell_type: 5, .. }), "{e}");
    assert!(e.to_string().starts_with("a.vtu: cell 0 is of VTK type 5 (triangle)"), "{e}");
    let e = error(ascii(POINTS, 10, "0 2 1 3", ""));
    assert!(matches!(e, VtuError::Mesh { source: MeshError::NotPositive { tet: 0, .. }, .. }), "{e}");
    let e = error(ascii(POINTS, 10, "0 1 2 9", ""));
    assert!(matches!(e, VtuError::Mesh { source: MeshError::UnknownNode { tet: 0, node: 9, nodes: 4 }, .. }), "{e}");
    let e = error(ascii("0 0 0 1 0 0 0 1 0 0 0 NaN", 10, "0 1 2 3", ""));
    assert!(matches!(e, VtuError::Mesh { source: MeshError::NotFinite { node: 3, .. }, .. }), "{e}");
    let e = error(ascii(POINTS, 10, "0 1 2 3", &material("Int32", "-1")));
    assert!(e.to_string().contains("`material` cell 0 has -1: expected 0 to 65535"), "{e}");
    let e = vtu::read(Path::new("/no/such/file.vtu")).unwrap_err();
    assert!(e.to_string().starts_with("/no/such/file.vtu: "), "{e}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.vtu");
    vtu::write(&path, &pair(), &[CellArray { name: "fragment", values: vec![0] }]).unwrap_err();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "a failed write left something");
}

#[test]
fn damaged_files_never_panic() {
    let mut good = vec![save(&pair(), &[]), ascii(POINTS, 10, "0 1 2 3", &material("Int32", "1")).into_bytes()];
    for place in ["binary", "base64", "raw"] {
        good.extend([false, true].map(|zlib| encoded(&pair(), zlib, 4, false, place)));
    }
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = move |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n
    };
    let mut read = 0;
    for round in 0..20_000 {
        let mut bytes = good[round % good.len()].clone();
        for _ in 0..=random(4) {
            let at = random(bytes.len());
            match random(4) {
                0 => bytes[at] ^= 1 << random(8),
                1 => bytes.truncate(at.max(1)),
                2 => bytes[at] = b"0149<>\"=/A_"[random(11)],
                _ => bytes[at] = [0, 0x7f, 0xff][random(3)],
            }
        }
        if let Ok(mesh) = parse(&bytes) {
            assert!(mesh.total_volume() > 0.0);
            read += 1;
        }
    }
    assert!(read > 100, "the damage is too great to reach the inner parts: {read}");
}

#[test]
fn a_file_that_claims_to_be_huge_is_refused_by_its_own_length() {
    for huge in ["4000000000", "18446744073709551615"] {
        let text = ascii(POINTS, 10, "0 1 2 3", "").replace("NumberOfPoints=\"4\"", &format!("NumberOfPoints=\"{huge}\""));
        assert!(parse(text.as_bytes()).is_err());
    }
    let good = encoded(&pair(), true, 8, false, "raw");
    let at = good.windows(2).position(|w| w == b"\n_").unwrap() + 2;
    for word in 0..3 {
        let mut bytes = good.clone();
        bytes[at + 8 * word..at + 8 * word + 8].fill(0x7f);
        assert!(parse(&bytes).unwrap_err().to_string().contains("bytes"), "word {word}");
    }
}
