// The lens of the endoscope: barrel distortion, round mask, fall of light, notch, fog. See optics.rs.

#import bevy_core_pipeline::fullscreen_vertex_shader::FullscreenVertexOutput

struct Lens {
    viewport: vec4<f32>,
    k1: f32,
    k2: f32,
    mask_diameter: f32,
    notch_rad: f32,
    falloff: f32,
    fog: f32,
}

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var nearest: sampler;
@group(0) @binding(2) var<uniform> lens: Lens;

// The sampler is a nearest one: four texels are blended here, none from outside the viewport.
fn bilinear(pixel: vec2<f32>, low: vec2<i32>, high: vec2<i32>) -> vec3<f32> {
    let corner = floor(pixel - 0.5);
    let part = pixel - 0.5 - corner;
    let at = vec2<i32>(corner);
    let a = textureLoad(picture, clamp(at, low, high), 0).rgb;
    let b = textureLoad(picture, clamp(at + vec2<i32>(1, 0), low, high), 0).rgb;
    let c = textureLoad(picture, clamp(at + vec2<i32>(0, 1), low, high), 0).rgb;
    let d = textureLoad(picture, clamp(at + vec2<i32>(1, 1), low, high), 0).rgb;
    return mix(mix(a, b, part.x), mix(c, d, part.x), part.y);
}

// What a film of droplets makes of the picture: blurred, pale, more so in the middle, which is the last to dry.
fn fogged(colour: vec3<f32>, pixel: vec2<f32>, rim: f32, r: f32, low: vec2<i32>, high: vec2<i32>) -> vec3<f32> {
    let fog = lens.fog * (1.0 - 0.35 * r * r);
    var sum = colour;
    // A clean lens takes none. The number is worked out on purpose: of a loop that can be unrolled an adapter that is software takes all, for nothing.
    let points = 12 * i32(ceil(lens.fog));
    for (var i = 0; i < points; i++) {
        // Points of a spiral with equal areas between them (Vogel 1979).
        let turn = 2.3999632 * f32(i + 1);
        let reach = 0.05 * fog * rim * sqrt(f32(i + 1) / 12.0);
        let at = clamp(vec2<i32>(pixel + reach * vec2<f32>(cos(turn), sin(turn))), low, high);
        sum += textureLoad(picture, at, 0).rgb;
    }
    let haze = vec3<f32>(0.30, 0.29, 0.28);
    return mix(mix(colour, sum / 13.0, min(1.0, 3.0 * fog)), haze, 0.62 * fog);
}

@fragment
fn fragment(in: FullscreenVertexOutput) -> @location(0) vec4<f32> {
    let whole = vec2<f32>(textureDimensions(picture));
    var origin = lens.viewport.xy;
    var size = lens.viewport.zw;
    if size.x <= 0.0 {
        origin = vec2<f32>(0.0);
        size = whole;
    }
    let centre = origin + 0.5 * size;
    let low = vec2<i32>(origin);
    let high = vec2<i32>(origin + size) - 1;
    let from_centre = in.uv * whole - centre;
    let rim = lens.mask_diameter * 0.5 * size.y;
    let r = length(from_centre) / rim;
    if r >= 1.0 + 2.0 / rim {
        return vec4<f32>(0.0, 0.0, 0.0, 1.0);
    }
    // The pinhole's rim is the upper edge of its picture.
    let r2 = r * r;
    let undistorted = (1.0 + r2 * (lens.k1 + lens.k2 * r2)) / (1.0 + lens.k1 + lens.k2) / lens.mask_diameter;
    let pixel = centre + from_centre * undistorted;
    var colour = bilinear(pixel, low, high);
    if lens.fog > 0.0 {
        colour = fogged(colour, pixel, rim, r, low, high);
    }
    colour *= 1.0 - lens.falloff * r2 * r2;
    colour *= 1.0 - smoothstep(1.0 - 1.5 / rim, 1.0 + 0.5 / rim, r);

    // A small black triangle in the rim.
    let towards = vec2<f32>(cos(lens.notch_rad), -sin(lens.notch_rad));
    let along = dot(from_centre, towards) / rim;
    let across = abs(dot(from_centre, vec2<f32>(-towards.y, towards.x))) / rim;
    colour *= smoothstep(0.0, 2.0 / rim, across - 0.6 * (along - 0.95));
    return vec4<f32>(colour, 1.0);
}
