//! What everything is drawn with: one material, lit by what lights the theatre and by nothing else.
//!
//! Bevy's own material asks every fragment for what it might have: textures, transmission, soft shadows of unknown width, area lights, a second cascade. A
//! software adapter (lavapipe, Mesa 22) does not jump over what is switched off: it works all of it out and throws it away. This one has the lights of the theatre,
//! those of each view in pipelines of its own, the same equations of reflection, and what is not needed is not compiled.

use bevy::light::ShadowFilteringMethod;
use bevy::mesh::MeshVertexBufferLayoutRef;
use bevy::pbr::{MaterialPipeline, MaterialPipelineKey, MeshPipelineKey};
use bevy::prelude::*;
use bevy::reflect::TypePath;
use bevy::render::render_resource::{AsBindGroup, Face, RenderPipelineDescriptor, ShaderType, SpecializedMeshPipelineError};
use bevy::shader::{ShaderDefVal, ShaderRef};

/// How light and a surface meet.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Shading {
    /// Lit.
    #[default]
    Lit,
    /// Lit, under a clear film.
    Coated,
    /// Lit, and mirrors nothing.
    Matt,
    /// Its colour is what is seen.
    Unlit,
    /// An unlit disc that fades towards its rim, blended with what is behind; it has texture coordinates from 0 to 1.
    Disc,
}

/// Which sides of its faces are seen.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Sides {
    /// The front.
    #[default]
    Front,
    /// The back.
    Back,
    /// Both, lit each from its own side.
    Both,
}

/// Which of the theatre's lights shine in a view, see `theatre.rs`: pipelines are made for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lights {
    /// The endoscope's.
    Endoscope,
    /// Two lamps, of which one casts shadows, and the endoscope's light.
    Theatre,
    /// Three lamps without shadows.
    Specimen,
}

impl Lights {
    /// What a camera of such a view has. Of what a camera has and a material knows, how shadows are filtered is left to the material, which
    /// filters them as the lights want it.
    #[must_use]
    pub fn filter(self) -> ShadowFilteringMethod {
        match self {
            Self::Endoscope => ShadowFilteringMethod::Hardware2x2,
            Self::Theatre => ShadowFilteringMethod::Gaussian,
            Self::Specimen => ShadowFilteringMethod::Temporal,
        }
    }

    fn of(view: MeshPipelineKey) -> Self {
        match view & MeshPipelineKey::SHADOW_FILTER_METHOD_RESERVED_BITS {
            MeshPipelineKey::SHADOW_FILTER_METHOD_HARDWARE_2X2 => Self::Endoscope,
            MeshPipelineKey::SHADOW_FILTER_METHOD_TEMPORAL => Self::Specimen,
            _ => Self::Theatre,
        }
    }

    /// What the shader is told.
    fn defs(self) -> Vec<ShaderDefVal> {
        let lamps = |count| ShaderDefVal::UInt("LAMPS".into(), count);
        match self {
            Self::Endoscope => vec!["SPOT".into(), lamps(0)],
            Self::Theatre => vec!["SPOT".into(), lamps(2)],
            Self::Specimen => vec![lamps(3)],
        }
    }
}

/// The numbers of a material. Colours are linear RGB, and are multiplied by those of the vertices.
#[derive(Clone, Copy, Debug, PartialEq, ShaderType)]
pub struct Look {
    /// Colour: of diffuse reflection, and of the mirror of a metal.
    pub colour: Vec4,
    /// Light that it sends out itself, as it is seen.
    pub glow: Vec4,
    /// Perceived roughness, 0 to 1: the square root of that of the equations.
    pub roughness: f32,
    /// How strongly it mirrors what comes at right angles, 0 to 1: 0.5 for 4 %.
    pub reflectance: f32,
    /// How much of a metal it is, 0 to 1.
    pub metallic: f32,
    /// Strength of the film over it, 0 to 1, where it is [`Shading::Coated`].
    pub coat: f32,
    /// Perceived roughness of the film, 0 to 1.
    pub coat_roughness: f32,
}

impl Default for Look {
    fn default() -> Self {
        Self { colour: Vec4::ONE, glow: Vec4::ZERO, roughness: 0.5, reflectance: 0.5, metallic: 0.0, coat: 0.0, coat_roughness: 0.5 }
    }
}

/// The material.
#[derive(Asset, AsBindGroup, TypePath, Clone, Copy, Debug, Default, PartialEq)]
#[bind_group_data(Variant)]
pub struct SceneMaterial {
    /// Its numbers.
    #[uniform(0)]
    pub look: Look,
    /// How it is lit.
    pub shading: Shading,
    /// Its sides.
    pub sides: Sides,
}

/// What a pipeline of it is made for.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Variant(Shading, Sides);

impl From<&SceneMaterial> for Variant {
    fn from(material: &SceneMaterial) -> Self {
        Self(material.shading, material.sides)
    }
}

impl Look {
    /// Of a colour, linear RGB.
    #[must_use]
    pub fn of([r, g, b]: [f32; 3]) -> Self {
        Self { colour: Vec4::new(r, g, b, 1.0), ..Self::default() }
    }
}

impl SceneMaterial {
    /// Lit from the front.
    #[must_use]
    pub fn lit(look: Look) -> Self {
        Self { look, ..Self::default() }
    }

    /// Lit from the front, under a clear film.
    #[must_use]
    pub fn coated(look: Look) -> Self {
        Self { look, shading: Shading::Coated, ..Self::default() }
    }
}

impl Material for SceneMaterial {
    fn fragment_shader() -> ShaderRef {
        "embedded://keyhole_view/shading.wgsl".into()
    }

    fn alpha_mode(&self) -> AlphaMode {
        if self.shading == Shading::Disc { AlphaMode::Blend } else { AlphaMode::Opaque }
    }

    fn specialize(
        _: &MaterialPipeline,
        descriptor: &mut RenderPipelineDescriptor,
        _: &MeshVertexBufferLayoutRef,
        key: MaterialPipelineKey<Self>,
    ) -> Result<(), SpecializedMeshPipelineError> {
        let Variant(shading, sides) = key.bind_group_data;
        descriptor.primitive.cull_mode = match sides {
            Sides::Front => Some(Face::Back),
            Sides::Back => Some(Face::Front),
            Sides::Both => None,
        };
        let mut defs: Vec<&str> = match shading {
            Shading::Lit => vec!["LIT"],
            Shading::Coated => vec!["LIT", "COATED"],
            Shading::Matt => vec!["LIT", "MATT"],
            Shading::Unlit => Vec::new(),
            Shading::Disc => vec!["DISC"],
        };
        if sides == Sides::Both {
            defs.push("TWO_SIDED");
        }
        if let Some(fragment) = &mut descriptor.fragment {
            fragment.shader_defs.extend(defs.into_iter().map(Into::into));
            fragment.shader_defs.extend(Lights::of(key.mesh_key).defs());
        }
        Ok(())
    }
}
