// The lens of the endoscope: barrel distortion, round mask, fall of light, notch. See optics.rs.

#import bevy_core_pipeline::fullscreen_vertex_shader::FullscreenVertexOutput

struct Lens {
    kappa: f32,
    mask_diameter: f32,
    notch_rad: f32,
    falloff: f32,
}

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var nearest: sampler;
@group(0) @binding(2) var<uniform> lens: Lens;

// The sampler is a nearest one: four texels are blended here.
fn bilinear(pixel: vec2<f32>) -> vec3<f32> {
    let size = vec2<i32>(textureDimensions(picture));
    let corner = floor(pixel - 0.5);
    let part = pixel - 0.5 - corner;
    let at = vec2<i32>(corner);
    let top = vec2<i32>(size.x - 1, size.y - 1);
    let a = textureLoad(picture, clamp(at, vec2<i32>(0), top), 0).rgb;
    let b = textureLoad(picture, clamp(at + vec2<i32>(1, 0), vec2<i32>(0), top), 0).rgb;
    let c = textureLoad(picture, clamp(at + vec2<i32>(0, 1), vec2<i32>(0), top), 0).rgb;
    let d = textureLoad(picture, clamp(at + vec2<i32>(1, 1), vec2<i32>(0), top), 0).rgb;
    return mix(mix(a, b, part.x), mix(c, d, part.x), part.y);
}

@fragment
fn fragment(in: FullscreenVertexOutput) -> @location(0) vec4<f32> {
    let size = vec2<f32>(textureDimensions(picture));
    let half_height = 0.5 * size.y;
    let from_centre = in.uv * size - 0.5 * size;
    let rim = lens.mask_diameter * half_height;
    let r = length(from_centre) / rim;
    if r >= 1.0 + 2.0 / rim {
        return vec4<f32>(0.0, 0.0, 0.0, 1.0);
    }
    // The pinhole's rim is the upper edge of its picture.
    let undistorted = (1.0 + lens.kappa * r * r) / (1.0 + lens.kappa) / lens.mask_diameter;
    var colour = bilinear(0.5 * size + from_centre * undistorted);
    colour *= 1.0 - lens.falloff * r * r * r * r;
    colour *= 1.0 - smoothstep(1.0 - 1.5 / rim, 1.0 + 0.5 / rim, r);

    // A small black triangle in the rim.
    let towards = vec2<f32>(cos(lens.notch_rad), -sin(lens.notch_rad));
    let along = dot(from_centre, towards) / rim;
    let across = abs(dot(from_centre, vec2<f32>(-towards.y, towards.x))) / rim;
    colour *= smoothstep(0.0, 2.0 / rim, across - 0.6 * (along - 0.95));
    return vec4<f32>(colour, 1.0);
}
