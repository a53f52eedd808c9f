//! VTU files: read into a checked mesh, and written for ParaView and meshio.
//!
//! The file's points are the rest positions in metres. Cell data that is always written: `material`, `source` (index of the original
//! tetrahedron) and `layer` (0 core, 1 hull). Arrays are written uncompressed in base64 and read in every encoding
//! that VTK, ParaView and meshio write.

use crate::check::{MeshError, checked};
use crate::ids::MaterialId;
use crate::mesh::TetMesh;
use crate::vtu_xml::{File, Numbers, Refusal, Section};
use glam::DVec3;
use std::path::{Path, PathBuf};
use vtkio::model::{
    Attribute, Attributes, ByteOrder, CellType, Cells, DataArray, DataSet, UnstructuredGridPiece, Version, VertexNumbers, Vtk,
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
    /// The file is not a VTU file, or is damaged.
    #[error("{}: {place} {reason}; expected a VTU file (XML, UnstructuredGrid)", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The element.
        place: String,
        /// What is wrong with it.
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
        cell_type: i64,
        /// Its type's name.
        cell_name: &'static str,
    },
    /// An array of another length or kind than expected.
    #[error("{}: array `{array}` {reason}", path.display())]
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

/// Reads a mesh from the bytes of a file; `path` gives the name for errors.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, bytes: &[u8]) -> Result<TetMesh, VtuError> {
    let array = |(array, reason): Refusal| VtuError::Array { path: path.into(), array, reason };
    let refuse = |name: &str, reason: String| array((name.into(), reason));
    let file = File::open(bytes).map_err(|(place, reason)| VtuError::Format { path: path.into(), place, reason })?;
    let (mut nodes, mut tets, mut materials) = (Vec::new(), Vec::new(), Vec::new());
    for piece in &file.pieces {
        let get = |section, name: &str, count: usize| {
            let numbers = file.numbers(piece, section, name).map_err(array)?;
            let wrong = numbers.as_ref().map(Numbers::len).filter(|n| *n != count);
            wrong.map_or(Ok(numbers), |n| Err(refuse(name, format!("has {n} numbers, {count} were expected"))))
        };
        let need = |section, name: &str, count| get(section, name, count)?.ok_or_else(|| refuse(name, "is missing".into()));
        let (first_node, first_cell) = (nodes.len(), tets.len());
        match need(Section::Points, "Points", piece.points.saturating_mul(3))? {
            Numbers::Real(x) => nodes.extend(x.chunks_exact(3).map(|p| DVec3::new(p[0], p[1], p[2]))),
            Numbers::Whole(x) => nodes.extend(x.chunks_exact(3).map(|p| DVec3::new(p[0] as f64, p[1] as f64, p[2] as f64))),
        }
        let types = whole(need(Section::Cells, "types", piece.cells)?).map_err(|e| refuse("types", e))?;
        if let Some((i, kind)) = types.iter().enumerate().find(|(_, kind)| **kind != VTK_TETRA) {
            let cell = first_cell + i;
            return Err(VtuError::CellType { path: path.into(), cell, cell_type: *kind, cell_name: cell_name(*kind) });
        }
        let offsets = whole(need(Section::Cells, "offsets", piece.cells)?).map_err(|e| refuse("offsets", e))?;
        if let Some((end, i)) = offsets.iter().zip(1..).find(|(end, i)| **end != 4 * i) {
            return Err(refuse("offsets", format!("cell {} ends at {end}: expected {}, four nodes a cell", i - 1, 4 * i)));
        }
        let corners = need(Section::Cells, "connectivity", piece.cells.saturating_mul(4))?;
        let corners = whole(corners).map_err(|e| refuse("connectivity", e))?;
        for (i, n) in corners.chunks_exact(4).enumerate() {
            let node = |n: i64| usize::try_from(n).ok().filter(|n| *n < piece.points).and_then(|n| u32::try_from(n + first_node).ok());
            let bad = |n: i64| MeshError::UnknownNode { tet: first_cell + i, node: n, nodes: piece.points };
            let mut tet = [0; 4];
            for (to, n) in tet.iter_mut().zip(n) {
                *to = node(*n).ok_or_else(|| VtuError::Mesh { path: path.into(), source: bad(*n) })?;
            }
            tets.push(tet);
        }
        match get(Section::CellData, "material", piece.cells)? {
            Some(numbers) => {
                for (i, m) in whole(numbers).map_err(|e| refuse("material", e))?.into_iter().enumerate() {
                    let id = u16::try_from(m).map_err(|_| refuse("material", format!("cell {i} has {m}: expected 0 to 65535")))?;
                    materials.push(MaterialId(id));
                }
            }
            None => materials.resize(tets.len(), MaterialId::default()),
        }
    }
    checked(&nodes, &tets, &materials).map_err(|source| VtuError::Mesh { path: path.into(), source })
}

/// The one type of cell that is read and written.
const VTK_TETRA: i64 = 10;

fn whole(numbers: Numbers) -> Result<Vec<i64>, String> {
    match numbers {
        Numbers::Whole(v) => Ok(v),
        // Others write everything as floating-point numbers; those that are whole are exact far beyond any index.
        Numbers::Real(v) => match v.iter().position(|x| x.fract() != 0.0 || x.abs() > 1e15) {
            None => Ok(v.into_iter().map(|x| x as i64).collect()),
            Some(i) => Err(format!("number {i} is {}: expected a whole one", v[i])),
        },
    }
}

/// The names of the types that a user is likely to meet.
fn cell_name(cell_type: i64) -> &'static str {
    match cell_type {
        1 => "vertex",
        3 => "line",
        5 => "triangle",
        9 => "quadrilateral",
        11 => "voxel",
        12 => "hexahedron",
        13 => "wedge",
        14 => "pyramid",
        22 => "quadratic triangle",
        24 => "quadratic tetrahedron",
        42 => "polyhedron",
        _ => "another one",
    }
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
    publish(file, path).map_err(io)
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
