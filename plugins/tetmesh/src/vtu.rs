//! VTU files: read into a checked mesh, and written for ParaView and meshio.
//!
//! The file's points are the rest positions in metres. Cell data that is always written: `material`, `source` (index of the original
//! tetrahedron) and `layer` (0 core, 1 hull). Arrays are uncompressed binary; on reading, zlib compression and ASCII are understood too.

use crate::check::{MeshError, checked};
use crate::ids::MaterialId;
use crate::mesh::TetMesh;
use glam::DVec3;
use std::path::{Path, PathBuf};
use vtkio::model::{
    Attribute, Attributes, ByteOrder, CellType, Cells, DataArray, DataSet, IOBuffer, UnstructuredGridPiece, Version, VertexNumbers, Vtk,
};

/// An array of cell data: one integer a tetrahedron, in the order of [`TetMesh::iter`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellArray {
    /// Name in the file.
    pub name: &'static str,
    /// One value a tetrahedron.
    pub values: Vec<i32>,
}

/// Why a mesh was not read or not written.
#[derive(Debug, thiserror::Error)]
pub enum VtuError {
    /// The file cannot be opened, read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a VTU or VTK file, or is damaged.
    #[error("{}: cannot be read as an unstructured grid ({reason}): expected a VTU file, or a legacy VTK file named .vtk", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        reason: String,
    },
    /// A cell that is not a tetrahedron.
    #[error("{}: cell {cell} is of VTK type {cell_type} ({cell_name}): expected type 10 (tetrahedron) only; remove or split the others", path.display())]
    CellType {
        /// The file.
        path: PathBuf,
        /// Index of the cell.
        cell: usize,
        /// Its VTK type.
        cell_type: u8,
        /// Its type's name.
        cell_name: String,
    },
    /// An array of another length or kind than expected.
    #[error("{}: array `{array}`: {reason}", path.display())]
    Array {
        /// The file.
        path: PathBuf,
        /// The array.
        array: String,
        /// What is wrong, what was expected.
        reason: String,
    },
    /// The mesh in the file is not a valid one.
    #[error("{}: {source}", path.display())]
    Mesh {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        source: MeshError,
    },
}

/// Reads a mesh: points in metres, tetrahedra, and the cell array `material` where there is one. `source` becomes the index in the file.
///
/// # Errors
/// When the file cannot be read, holds anything but tetrahedra, or the mesh fails [`checked`].
pub fn read(path: &Path) -> Result<TetMesh, VtuError> {
    let bytes = std::fs::read(path).map_err(|source| VtuError::Io { path: path.into(), source })?;
    parse(path, &bytes)
}

/// Reads a mesh from the bytes of a file; `path` gives the kind (`.vtk` legacy, everything else VTU) and the name for errors.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, bytes: &[u8]) -> Result<TetMesh, VtuError> {
    let format = |reason: String| VtuError::Format { path: path.into(), reason };
    let array = |array: &str, reason: String| VtuError::Array { path: path.into(), array: array.into(), reason };
    let legacy = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("vtk"));
    // vtkio indexes and multiplies what the file says without a check; a damaged file may make it panic.
    let parsed = std::panic::catch_unwind(|| if legacy { Vtk::parse_legacy_be(bytes) } else { Vtk::parse_xml(bytes) })
        .map_err(|_| format("its arrays are shorter than it says".into()))?;
    let vtk = parsed.map_err(|e| format(e.to_string()))?;
    let DataSet::UnstructuredGrid { pieces, .. } = vtk.data else {
        return Err(format("it holds another kind of data set".into()));
    };
    let (mut nodes, mut tets, mut materials) = (Vec::new(), Vec::new(), Vec::new());
    for piece in pieces {
        let piece: UnstructuredGridPiece = piece.into_loaded_piece_data(None).map_err(|e| format(e.to_string()))?;
        let first_node = nodes.len();
        let points = piece.points.cast_into::<f64>().ok_or_else(|| array("Points", "expected 32 or 64 bit floats".into()))?;
        if points.len() % 3 != 0 {
            return Err(array("Points", format!("has {} numbers: expected three a point", points.len())));
        }
        nodes.extend(points.chunks_exact(3).map(|p| DVec3::new(p[0], p[1], p[2])));
        let first_cell = tets.len();
        for (i, kind) in piece.cells.types.iter().enumerate() {
            if *kind != CellType::Tetra {
                let (cell_type, cell_name) = (*kind as u8, format!("{kind:?}"));
                return Err(VtuError::CellType { path: path.into(), cell: first_cell + i, cell_type, cell_name });
            }
        }
        for cell in corners(piece.cells.cell_verts).map_err(|(name, reason)| array(name, reason))? {
            let mut tet = [0; 4];
            for (to, n) in tet.iter_mut().zip(cell) {
                let node = n.checked_add(first_node as u64).and_then(|n| u32::try_from(n).ok());
                *to = node.ok_or_else(|| array("connectivity", format!("node {n} is beyond 32 bits")))?;
            }
            tets.push(tet);
        }
        if tets.len() - first_cell != piece.cells.types.len() {
            return Err(array("types", format!("has {} entries for {} cells", piece.cells.types.len(), tets.len() - first_cell)));
        }
        materials.resize(first_cell, MaterialId::default());
        if let Some(values) = cell_values(&piece.data.cell, "material") {
            let values = values.ok_or_else(|| array("material", "expected whole numbers from 0 to 65535".into()))?;
            if values.len() != tets.len() - first_cell {
                return Err(array("material", format!("has {} values for {} cells", values.len(), tets.len() - first_cell)));
            }
            materials.extend(values.into_iter().map(MaterialId));
        }
        materials.resize(tets.len(), MaterialId::default());
    }
    checked(&nodes, &tets, &materials).map_err(|source| VtuError::Mesh { path: path.into(), source })
}

/// Writes a mesh with `material`, `source` and `layer`, and `extra` arrays, one value a tetrahedron. The file appears under its name
/// only when it is complete.
///
/// # Errors
/// When the folder is not there or cannot be written to, or an extra array is not as long as there are tetrahedra.
pub fn write(path: &Path, mesh: &TetMesh, extra: &[CellArray]) -> Result<(), VtuError> {
    let io = |source| VtuError::Io { path: path.into(), source };
    if let Some(bad) = extra.iter().find(|a| a.values.len() != mesh.tet_count()) {
        let reason = format!("has {} values for {} tetrahedra", bad.values.len(), mesh.tet_count());
        return Err(VtuError::Array { path: path.into(), array: bad.name.into(), reason });
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let file = tempfile::Builder::new().prefix(".keyhole-").tempfile_in(folder).map_err(io)?;
    let mut out = std::io::BufWriter::new(file);
    // Explicitly little-endian: ParaView, meshio and this reader understand both.
    to_vtk(mesh, extra).write_xml(&mut out).map_err(|e| io(std::io::Error::other(e)))?;
    let file = out.into_inner().map_err(|e| io(e.into_error()))?;
    crate::vtu::publish(file, path).map_err(io)
}

/// Gives a complete temporary file its name and the permissions of an ordinary new file.
fn publish(file: tempfile::NamedTempFile, path: &Path) -> std::io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.as_file().set_permissions(std::fs::Permissions::from_mode(0o644))?;
    }
    file.persist(path).map(|_| ()).map_err(|e| e.error)
}

/// The cells' nodes, four each, or the array that is wrong and why.
fn corners(cells: VertexNumbers) -> Result<Vec<[u64; 4]>, (&'static str, String)> {
    let quad = |c: &[u64]| [c[0], c[1], c[2], c[3]];
    match cells {
        VertexNumbers::XML { connectivity, offsets } => {
            let offsets: &[u64] = if offsets.first() == Some(&0) { &offsets[1..] } else { &offsets };
            if let Some(i) = (0..offsets.len()).find(|&i| offsets[i] != 4 * (i as u64 + 1)) {
                return Err(("offsets", format!("cell {i} ends at {}: expected {}, four nodes a cell", offsets[i], 4 * (i + 1))));
            }
            if connectivity.len() != 4 * offsets.len() {
                return Err(("connectivity", format!("has {} nodes for {} tetrahedra", connectivity.len(), offsets.len())));
            }
            Ok(connectivity.chunks_exact(4).map(quad).collect())
        }
        VertexNumbers::Legacy { num_cells, vertices } => {
            if vertices.len() != 5 * num_cells as usize {
                return Err(("CELLS", format!("has {} numbers for {num_cells} cells: expected five a cell", vertices.len())));
            }
            if let Some(i) = vertices.chunks_exact(5).position(|c| c[0] != 4) {
                return Err(("CELLS", format!("cell {i} has {} nodes: expected four", vertices[5 * i])));
            }
            Ok(vertices.chunks_exact(5).map(|c| [1, 2, 3, 4].map(|k| u64::from(c[k]))).collect())
        }
    }
}

/// The values of a cell array: `None` when there is no array of this name, `Some(None)` when its values do not fit.
fn cell_values(attributes: &[Attribute], name: &str) -> Option<Option<Vec<u16>>> {
    attributes.iter().find_map(|a| match a {
        Attribute::DataArray(d) if d.name == name => Some(whole(&d.data)),
        Attribute::Field { data_array, .. } => data_array.iter().find(|d| d.name == name).map(|d| whole(&d.data)),
        Attribute::DataArray(_) => None,
    })
}

/// Whole numbers from 0 to 65535, whatever the type they are stored in.
fn whole(data: &IOBuffer) -> Option<Vec<u16>> {
    let values: Vec<f64> = data.cast_into()?;
    values.into_iter().map(|v| (v.fract() == 0.0 && (0.0..=65535.0).contains(&v)).then_some(v as u16)).collect()
}

fn to_vtk(mesh: &TetMesh, extra: &[CellArray]) -> Vtk {
    let mut index = vec![0_u64; mesh.node_slots()];
    let mut points: Vec<f64> = Vec::with_capacity(3 * mesh.node_count());
    for (i, node) in mesh.nodes().enumerate() {
        index[node.index()] = i as u64;
        points.extend(mesh.rest(node).to_array());
    }
    let connectivity: Vec<u64> = mesh.iter().flat_map(|(_, c)| c.map(|n| index[n.index()])).collect();
    let offsets: Vec<u64> = (1..=mesh.tet_count() as u64).map(|i| 4 * i).collect();
    let of_tets = |name: &str, values: Vec<i32>| Attribute::DataArray(DataArray::scalars(name, 1).with_vec(values));
    let mut cell = vec![
        of_tets("material", mesh.iter().map(|(t, _)| i32::from(mesh.tet(t).material.0)).collect()),
        of_tets("source", mesh.iter().map(|(t, _)| mesh.tet(t).source as i32).collect()),
        of_tets("layer", mesh.iter().map(|(t, _)| i32::from(mesh.tet(t).hull)).collect()),
    ];
    cell.extend(extra.iter().map(|a| of_tets(a.name, a.values.clone())));
    let cells = Cells { cell_verts: VertexNumbers::XML { connectivity, offsets }, types: vec![CellType::Tetra; mesh.tet_count()] };
    Vtk {
        // The newest version that meshio reads.
        version: Version::new_xml(1, 0),
        title: String::new(),
        byte_order: ByteOrder::LittleEndian,
        file_path: None,
        data: DataSet::inline(UnstructuredGridPiece { points: points.into(), cells, data: Attributes { point: Vec::new(), cell } }),
    }
}
