// What everything in the theatre is drawn with. See shading.rs.

#import bevy_pbr::{
    forward_io::VertexOutput,
    mesh_view_bindings::{clustered_lights, directional_shadow_textures, lights, view},
    mesh_view_types::POINT_LIGHT_FLAGS_SPOT_LIGHT_Y_NEGATIVE,
    shadow_sampling::sample_shadow_map_hardware,
}
#import bevy_render::maths::orthonormalize
#ifdef TONEMAP_IN_SHADER
#import bevy_core_pipeline::tonemapping::{screen_space_dither, tone_mapping}
#endif

const PI: f32 = 3.14159265;

// What shines in a view is known when its pipeline is made: SPOT where the spot light does, LAMPS is how many lamps there are, and of two the second casts
// shadows. See Lights in shading.rs. An adapter that is software works out all that is compiled, and throws away what a condition leaves out; and it reads what
// has a number that is known once, and anything else fragment by fragment.
const SPOT_LIGHT: u32 = 0u;
const CASTER: u32 = 1u;

struct Look {
    colour: vec4<f32>,
    glow: vec4<f32>,
    roughness: f32,
    reflectance: f32,
    metallic: f32,
    coat: f32,
    coat_roughness: f32,
}

@group(#{MATERIAL_BIND_GROUP}) @binding(0) var<uniform> look: Look;

// A place on a surface.
struct Place {
    at: vec3<f32>,
    n: vec3<f32>,
    // Towards the eye.
    v: vec3<f32>,
    n_v: f32,
    diffuse: vec3<f32>,
    f0: vec3<f32>,
    // What light gains that is reflected more than once between facets.
    again: vec3<f32>,
    alpha: f32,
    coat_alpha: f32,
}

fn fifth(x: f32) -> f32 {
    let x2 = x * x;
    return x2 * x2 * x;
}

// How many facets face that way: Walter et al. 2007, equation 33.
fn facets(alpha: f32, n_h: f32) -> f32 {
    let a = n_h * alpha;
    let k = alpha / (1.0 - n_h * n_h + a * a);
    return k * k / PI;
}

// How much of a surface reflects at all, by angle: Karis 2014, "Physically based shading on mobile".
fn reflecting(roughness: f32, n_v: f32) -> vec2<f32> {
    let r = roughness * vec4<f32>(-1.0, -0.0275, -0.572, 0.022) + vec4<f32>(1.0, 0.0425, 1.04, -0.04);
    let a = min(r.x * r.x, exp2(-9.28 * n_v)) * r.x + r.y;
    return vec2<f32>(-1.04, 1.04) * a + r.zw;
}

// How much of its widening a lobe takes: a sharp one little. The renderer's own material has the same.
fn widening(alpha: f32) -> f32 {
    let k = (1.0 - alpha) * (1.0 - alpha);
    return 1.0 - k * k;
}

// What a light of unit illuminance at right angles sends to the eye. `l` is towards its middle; `mirrored` towards the point of it that is
// seen mirrored; `wider` is how much wider its size makes a lobe, and `sine2` the square of the sine of the angle that it is seen under
// (Karis 2013, "Real shading in Unreal Engine 4", spheres). Diffuse after Burley 2012; lobes, coat and energy after Guy and Agopian,
// "Physically based rendering in Filament", 4.4 to 4.9.
fn reflected(p: Place, l: vec3<f32>, mirrored: vec3<f32>, wider: f32, sine2: f32) -> vec3<f32> {
    let n_l = saturate(dot(p.n, l));
    let l_h = saturate(dot(l, normalize(l + p.v)));
    let grazing = 2.0 * p.alpha * l_h * l_h - 0.5;
    let diffuse = p.diffuse * ((1.0 + grazing * fifth(1.0 - n_l)) * (1.0 + grazing * fifth(1.0 - p.n_v)) / PI);

#ifdef MATT
    return diffuse * n_l;
#else
    let h = normalize(mirrored + p.v);
    let n_m = saturate(dot(p.n, mirrored));
    let n_h = saturate(dot(p.n, h));
    let m_h = saturate(dot(mirrored, h));
    let f5 = fifth(1.0 - m_h);
    // What dips below the horizon of the surface is not mirrored.
    let above = saturate(n_m / max(n_m + sine2, 1e-4));

    let widened = saturate(p.alpha + wider);
    let energy = (p.alpha / widened) * (p.alpha / widened);
    let alpha = mix(p.alpha, widened, widening(p.alpha));
    let a2 = alpha * alpha;
    let seen = 0.5 / (n_m * sqrt((p.n_v - a2 * p.n_v) * p.n_v + a2) + p.n_v * sqrt((n_m - a2 * n_m) * n_m + a2));
    let f90 = saturate(dot(p.f0, vec3<f32>(16.5)));
    let mirror = (energy * facets(alpha, n_h) * seen * above) * (p.f0 + (f90 - p.f0) * f5) * p.again;
#ifdef COATED
    let coat_widened = saturate(p.coat_alpha + wider);
    let coat_energy = (p.coat_alpha / coat_widened) * (p.coat_alpha / coat_widened);
    let coat_alpha = mix(p.coat_alpha, coat_widened, widening(p.coat_alpha));
    let fresnel = look.coat * (0.04 + 0.96 * f5);
    let coat = coat_energy * facets(coat_alpha, n_h) * above * fresnel * 0.25 / max(m_h * m_h, 1e-4);
    let through = 1.0 - fresnel;
    return (diffuse * n_l + mirror * (n_m * through)) * through + coat * n_m;
#else
    return diffuse * n_l + mirror * n_m;
#endif // COATED
#endif // MATT
}

// A place in a shadow map, its depth, and the map's layer.
struct Shade {
    uv: vec2<f32>,
    depth: f32,
    layer: i32,
}

fn spot_direction() -> vec3<f32> {
    let d = clustered_lights.data[SPOT_LIGHT].light_custom_data.xy;
    let y = sqrt(max(0.0, 1.0 - dot(d, d)));
    let down = (clustered_lights.data[SPOT_LIGHT].flags & POINT_LIGHT_FLAGS_SPOT_LIGHT_Y_NEGATIVE) != 0u;
    return vec3<f32>(d.x, select(y, -y, down), d.y);
}

fn spot_shade(p: Place) -> Shade {
    let light = &clustered_lights.data[SPOT_LIGHT];
    let to_light = (*light).position_radius.xyz - p.at;
    let back = -spot_direction();
    let lifted = (*light).shadow_depth_bias * normalize(to_light) + p.n * (*light).shadow_normal_bias * dot(back, to_light) - to_light;
    let seen = lifted * orthonormalize(back);
    let uv = seen.xy / ((*light).spot_light_tan_angle * -seen.z) * vec2<f32>(0.5, -0.5) + 0.5;
    return Shade(uv, (*light).shadow_map_near_z / -seen.z, i32(SPOT_LIGHT) + lights.spot_light_shadowmap_offset);
}

// Lights of the theatre have one cascade.
fn directional_shade(p: Place) -> Shade {
    let light = &lights.directional_lights[CASTER];
    let lifted = p.at + (*light).shadow_normal_bias * (*light).cascades[0].texel_size * p.n
        + (*light).shadow_depth_bias * (*light).direction_to_light;
    let clip = (*light).cascades[0].clip_from_world * vec4<f32>(lifted, 1.0);
    return Shade(clip.xy * vec2<f32>(0.5, -0.5) + 0.5, clip.z, i32((*light).depth_texture_base_index));
}

// The part of a spot light that comes through, blended between the four nearest texels: as the endoscope sees them, they are hardly larger than
// a pixel.
fn spot_lit(s: Shade) -> f32 {
    return within(s, sample_shadow_map_hardware(s.uv, s.depth, s.layer));
}

// The part of a directional light that comes through: a tent of three by three texels in four looks (Castano 2013, "Shadow mapping summary").
fn directional_lit(s: Shade) -> f32 {
    let size = vec2<f32>(textureDimensions(directional_shadow_textures));
    let texel = s.uv * size;
    let corner = floor(texel + 0.5);
    let part = texel + 0.5 - corner;
    let w0 = 3.0 - 2.0 * part;
    let w1 = 1.0 + 2.0 * part;
    let u0 = (corner - 0.5 + (2.0 - part) / w0 - 1.0) / size;
    let u1 = (corner - 0.5 + part / w1 + 1.0) / size;
    let sum = w0.x * w0.y * sample_shadow_map_hardware(u0, s.depth, s.layer)
        + w1.x * w0.y * sample_shadow_map_hardware(vec2<f32>(u1.x, u0.y), s.depth, s.layer)
        + w0.x * w1.y * sample_shadow_map_hardware(vec2<f32>(u0.x, u1.y), s.depth, s.layer)
        + w1.x * w1.y * sample_shadow_map_hardware(u1, s.depth, s.layer);
    return within(s, sum / 16.0);
}

// Beyond the map there is no shadow.
fn within(s: Shade, part: f32) -> f32 {
    let inside = all(s.uv >= vec2<f32>(0.0)) && all(s.uv <= vec2<f32>(1.0)) && s.depth >= 0.0 && s.depth <= 1.0;
    return select(1.0, part, inside);
}

#ifdef SPOT
fn spot_light(p: Place) -> vec3<f32> {
    let light = &clustered_lights.data[SPOT_LIGHT];
    let to_light = (*light).position_radius.xyz - p.at;
    let radius = (*light).position_radius.w;
    let d2 = dot(to_light, to_light);
    let l = to_light * inverseSqrt(d2);
    let r = reflect(-p.v, p.n);
    let to_ray = max(1e-4, dot(to_light, r)) * r - to_light;
    let mirrored = normalize(to_light + to_ray * saturate(radius * inverseSqrt(dot(to_ray, to_ray))));
    let range = d2 * (*light).color_inverse_square_range.w;
    let near = saturate(1.0 - range * range);
    let cone = saturate(dot(-spot_direction(), l) * (*light).light_custom_data.z + (*light).light_custom_data.w);
    // Nearer than a centimetre light grows no more.
    let strength = near * near / max(d2, 1e-4) * cone * cone;
    let colour = (spot_lit(spot_shade(p)) * strength) * (*light).color_inverse_square_range.rgb;
    return colour * reflected(p, l, mirrored, radius * 0.5 * inverseSqrt(d2), radius * radius / d2);
}
#endif

#if LAMPS >= 1
fn lamp_light(p: Place, lamp: u32) -> vec3<f32> {
    let l = lights.directional_lights[lamp].direction_to_light;
    return lights.directional_lights[lamp].color.rgb * reflected(p, l, l, 0.0, 0.0);
}
#endif

fn shaded(p: Place) -> vec3<f32> {
    var sum = vec3<f32>(0.0);
#ifdef SPOT
    sum += spot_light(p);
#endif
#if LAMPS == 2
    sum += lamp_light(p, 0u) + lamp_light(p, CASTER) * directional_lit(directional_shade(p));
#endif
#if LAMPS == 3
    sum += lamp_light(p, 0u) + lamp_light(p, 1u) + lamp_light(p, 2u);
#endif
    let all_round = reflecting(1.0, p.n_v);
    let mirrored = reflecting(look.roughness, p.n_v);
    let open = saturate(dot(p.f0, vec3<f32>(16.5)));
    let ambient = p.diffuse * all_round.x + all_round.y + (p.f0 * mirrored.x + mirrored.y) * open;
    return view.exposure * (sum + ambient * lights.ambient_color.rgb);
}

@fragment
fn fragment(in: VertexOutput, @builtin(front_facing) front: bool) -> @location(0) vec4<f32> {
    var colour = look.colour;
#ifdef VERTEX_COLORS
    colour *= in.color;
#endif
#ifdef DISC
    // Soft towards the rim.
    let from_middle = 2.0 * in.uv - 1.0;
    let soft = saturate(1.0 - dot(from_middle, from_middle));
    colour.a *= soft * soft;
#endif
#ifdef LIT
    var p: Place;
    p.at = in.world_position.xyz;
    p.n = normalize(in.world_normal);
#ifdef TWO_SIDED
    p.n = select(-p.n, p.n, front);
#endif
    p.v = normalize(view.world_position.xyz - p.at);
    p.n_v = max(dot(p.n, p.v), 1e-4);
    let roughness = clamp(look.roughness, 0.089, 1.0);
    p.alpha = roughness * roughness;
    let coat_roughness = clamp(look.coat_roughness, 0.089, 1.0);
    p.coat_alpha = coat_roughness * coat_roughness;
    p.diffuse = colour.rgb * (1.0 - look.metallic);
    p.f0 = mix(vec3<f32>(0.16 * look.reflectance * look.reflectance), colour.rgb, look.metallic);
    let ab = reflecting(look.roughness, p.n_v);
    p.again = 1.0 + p.f0 * (1.0 / (ab.x + ab.y) - 1.0);
    colour = vec4<f32>(shaded(p) + look.glow.rgb, colour.a);
#endif
#ifdef TONEMAP_IN_SHADER
    colour = tone_mapping(colour, view.color_grading);
#ifdef DEBAND_DITHER
    // Even to the eye, not in light.
    let even = sqrt(max(colour.rgb, vec3<f32>(0.0))) + screen_space_dither(in.position.xy);
    colour = vec4<f32>(even * max(even, vec3<f32>(0.0)), colour.a);
#endif
#endif
    return colour;
}
