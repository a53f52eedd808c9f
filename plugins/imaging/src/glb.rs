//! Surfaces as binary glTF 2.0: one mesh, positions, normals and indices in one chunk, one material.

use crate::error::ImagingError;
use crate::surface::Surface;
use glam::DVec3;
use gltf_json as json;
use json::validation::{Checked, USize64};
use std::path::Path;

/// "glTF", "JSON" and "BIN" in little-endian words (glTF 2.0, 4.4).
const MAGIC: [u32; 3] = [0x4654_6c67, 0x4e4f_534a, 0x004e_4942];
const VERSION: u32 = 2;

/// Writes a surface whose nodes are world metres. `colour` is linear RGB.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, name: &str, surface: &Surface, colour: [f32; 3]) -> Result<(), ImagingError> {
    let bytes = encode(name, surface, colour).map_err(ImagingError::io(path))?;
    crate::publish::whole_file(path, |out| out.write_all(&bytes).map_err(ImagingError::io(path)))
}

/// The bytes of the file.
fn encode(name: &str, surface: &Surface, colour: [f32; 3]) -> std::io::Result<Vec<u8>> {
    let floats = |v: &[DVec3]| v.iter().flat_map(|p| p.as_vec3().to_array()).flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    let positions = floats(&surface.nodes);
    let normals = floats(&surface.normals());
    let wide = surface.nodes.len() > usize::from(u16::MAX);
    let indices: Vec<u8> = if wide {
        surface.triangles.iter().flatten().flat_map(|n| n.to_le_bytes()).collect()
    } else {
        surface.triangles.iter().flatten().flat_map(|n| (*n as u16).to_le_bytes()).collect()
    };
    let mut root = json::Root::default();
    let mut chunk = Vec::new();
    let buffer = json::Index::new(0);
    let mut view = |root: &mut json::Root, bytes: &[u8], target| {
        let view = json::buffer::View {
            buffer,
            byte_length: USize64::from(bytes.len()),
            byte_offset: Some(USize64::from(chunk.len())),
            byte_stride: None,
            name: None,
            target: Some(Checked::Valid(target)),
            extensions: None,
            extras: json::Extras::default(),
        };
        chunk.extend_from_slice(bytes);
        chunk.resize(chunk.len().next_multiple_of(4), 0);
        root.push(view)
    };
    use json::accessor::{ComponentType, Type};
    use json::buffer::Target;
    let low = surface.nodes.iter().map(|p| p.as_vec3()).fold(glam::Vec3::INFINITY, glam::Vec3::min);
    let high = surface.nodes.iter().map(|p| p.as_vec3()).fold(glam::Vec3::NEG_INFINITY, glam::Vec3::max);
    let position_view = view(&mut root, &positions, Target::ArrayBuffer);
    let normal_view = view(&mut root, &normals, Target::ArrayBuffer);
    let index_view = view(&mut root, &indices, Target::ElementArrayBuffer);
    let accessor = |view, count: usize, kind, of| json::Accessor {
        buffer_view: Some(view),
        byte_offset: Some(USize64(0)),
        count: USize64::from(count),
        component_type: Checked::Valid(json::accessor::GenericComponentType(of)),
        extensions: None,
        extras: json::Extras::default(),
        type_: Checked::Valid(kind),
        min: None,
        max: None,
        name: None,
        normalized: false,
        sparse: None,
    };
    let mut position = accessor(position_view, surface.nodes.len(), Type::Vec3, ComponentType::F32);
    position.min = Some(json::Value::from(low.to_array().to_vec()));
    position.max = Some(json::Value::from(high.to_array().to_vec()));
    let position = root.push(position);
    let normal = root.push(accessor(normal_view, surface.nodes.len(), Type::Vec3, ComponentType::F32));
    let of = if wide { ComponentType::U32 } else { ComponentType::U16 };
    let index = root.push(accessor(index_view, 3 * surface.triangles.len(), Type::Scalar, of));
    let [r, g, b] = colour;
    let material = root.push(json::Material {
        name: Some(name.into()),
        pbr_metallic_roughness: json::material::PbrMetallicRoughness {
            base_color_factor: json::material::PbrBaseColorFactor([r, g, b, 1.0]),
            metallic_factor: json::material::StrengthFactor(0.0),
            roughness_factor: json::material::StrengthFactor(0.45),
            ..Default::default()
        },
        ..Default::default()
    });
    let attributes = [(json::mesh::Semantic::Positions, position), (json::mesh::Semantic::Normals, normal)];
    let mesh = root.push(json::Mesh {
        extensions: None,
        extras: json::Extras::default(),
        name: Some(name.into()),
        primitives: vec![json::mesh::Primitive {
            attributes: attributes.into_iter().map(|(s, a)| (Checked::Valid(s), a)).collect(),
            extensions: None,
            extras: json::Extras::default(),
            indices: Some(index),
            material: Some(material),
            mode: Checked::Valid(json::mesh::Mode::Triangles),
            targets: None,
        }],
        weights: None,
    });
    let node = root.push(json::Node { mesh: Some(mesh), name: Some(name.into()), ..Default::default() });
    let scene = root.push(json::Scene { extensions: None, extras: json::Extras::default(), name: None, nodes: vec![node] });
    root.scene = Some(scene);
    root.push(json::Buffer {
        byte_length: USize64::from(chunk.len()),
        name: None,
        uri: None,
        extensions: None,
        extras: json::Extras::default(),
    });
    root.asset.generator = Some("keyhole".into());
    let mut text = json::serialize::to_vec(&root)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + chunk.len();
    let mut out = Vec::with_capacity(total);
    for word in [MAGIC[0], VERSION, total as u32, text.len() as u32, MAGIC[1]] {
        out.extend(word.to_le_bytes());
    }
    out.extend(text);
    out.extend((chunk.len() as u32).to_le_bytes());
    out.extend(MAGIC[2].to_le_bytes());
    out.extend(chunk);
    Ok(out)
}
