//! Needles and threads as they are drawn: the needle a tapered arc of steel that is moved, the thread a tube along its points that is written anew when it has moved.

use crate::layers;
use crate::shading::{Look, SceneMaterial};
use crate::tools::Draws;
use bevy::asset::RenderAssetUsages;
use bevy::camera::visibility::{NoAutoAabb, NoFrustumCulling};
use bevy::mesh::{Indices, PrimitiveTopology, VertexAttributeValues};
use bevy::prelude::*;
use keyhole_whiteboard::{Needle, Thread};

/// Corners around a thread and a wire.
const SIDES: usize = 8;
/// Rings along a needle.
const RINGS: usize = 48;
/// Part of a needle's length in which it tapers to its tip.
const TAPER: f32 = 0.35;
/// Part of a thread's radius by which a point has to move for it to be drawn anew.
const STILL: f32 = 0.02;
/// Points that are drawn from one of a thread's points to the next: a thread bends, it has no corners.
const BETWEEN: usize = 3;

/// A needle that is drawn.
#[derive(Component, Clone, Copy, Debug)]
pub struct DrawnNeedle;

/// A thread that is drawn, and the points that it was drawn with, m.
#[derive(Component, Clone, Debug, Default)]
pub struct DrawnThread {
    points: Vec<Vec3>,
}

/// Draws sutures that have come.
pub fn draw_sutures(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<SceneMaterial>>,
    come: Query<(Entity, &Needle), Added<Needle>>,
) {
    for (suture, needle) in &come {
        let arc = (0..=RINGS).map(|i| {
            let part = i as f32 / RINGS as f32;
            let (sin, cos) = (needle.arc_rad * part).sin_cos();
            // The wire is a little thinner at the swage and ends in a point.
            let thickness = ((1.0 - part) / TAPER).clamp(0.02, 1.0) * (0.8 + 4.0 * part).min(1.0);
            (needle.radius_m * Vec3::new(cos, sin, 0.0), needle.wire_radius_m * thickness)
        });
        let mut mesh = empty();
        write_tube(&mut mesh, &arc.collect::<Vec<_>>());
        commands.spawn((
            Draws(suture),
            DrawnNeedle,
            Mesh3d(meshes.add(mesh)),
            MeshMaterial3d(materials.add(SceneMaterial::lit(Look {
                // Without an environment to mirror, bare metal would be black.
                metallic: 0.55,
                roughness: 0.25,
                reflectance: 0.6,
                ..Look::of([0.70, 0.71, 0.73])
            }))),
            Transform::from_isometry(needle.pose),
            layers::shared(),
        ));
        commands.spawn((
            Draws(suture),
            DrawnThread::default(),
            Mesh3d(meshes.add(empty())),
            MeshMaterial3d(materials.add(
                // Dyed, as most threads are, so that they are seen on tissue.
                SceneMaterial::lit(Look { roughness: 0.5, reflectance: 0.5, ..Look::of([0.035, 0.05, 0.24]) }),
            )),
            NoFrustumCulling,
            NoAutoAabb,
            layers::shared(),
        ));
    }
}

/// Moves needles, and writes the threads that have moved.
pub fn move_sutures(
    mut meshes: ResMut<Assets<Mesh>>,
    sutures: Query<(&Needle, Ref<Thread>)>,
    mut needles: Query<(&Draws, &mut Transform), With<DrawnNeedle>>,
    mut threads: Query<(&Draws, &Mesh3d, &mut DrawnThread)>,
) {
    for (of, mut transform) in &mut needles {
        if let Ok((needle, _)) = sutures.get(of.0) {
            transform.set_if_neq(Transform::from_isometry(needle.pose));
        }
    }
    for (of, mesh, mut drawn) in &mut threads {
        let Ok((_, thread)) = sutures.get(of.0) else { continue };
        let still = || {
            let moved = |(a, b): (&Vec3, &Vec3)| a.distance(*b) > STILL * thread.radius_m;
            drawn.points.len() == thread.points.len() && !drawn.points.iter().zip(&thread.points).any(moved)
        };
        if thread.points.len() < 2 || !thread.is_changed() || still() {
            continue;
        }
        drawn.points.clone_from(&thread.points);
        if let Some(mut mesh) = meshes.get_mut(&mesh.0) {
            let line: Vec<(Vec3, f32)> = rounded(&drawn.points).into_iter().map(|p| (p, thread.radius_m)).collect();
            write_tube(&mut mesh, &line);
        }
    }
}

/// A smooth line through points (Catmull & Rom 1974).
fn rounded(points: &[Vec3]) -> Vec<Vec3> {
    let mut line = Vec::with_capacity(BETWEEN * points.len());
    for (i, pair) in points.windows(2).enumerate() {
        let [p, q] = [pair[0], pair[1]];
        let (before, after) = (points[i.saturating_sub(1)], points[(i + 2).min(points.len() - 1)]);
        // Where points are unevenly apart the bend must not overshoot the shorter side.
        let length = p.distance(q);
        let slope = |a: Vec3, b: Vec3, c: Vec3| {
            let whole = a.distance(b) + b.distance(c);
            if whole > 0.0 { (c - a) * (length / whole) } else { Vec3::ZERO }
        };
        let (m, n) = (slope(before, p, q), slope(p, q, after));
        for k in 0..BETWEEN {
            let t = k as f32 / BETWEEN as f32;
            let (t2, t3) = (t * t, t * t * t);
            line.push((2.0 * t3 - 3.0 * t2 + 1.0) * p + (t3 - 2.0 * t2 + t) * m + (3.0 * t2 - 2.0 * t3) * q + (t3 - t2) * n);
        }
    }
    line.extend(points.last());
    line
}

fn empty() -> Mesh {
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, Vec::<[f32; 3]>::new())
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, Vec::<[f32; 3]>::new())
        .with_inserted_indices(Indices::U32(Vec::new()))
}

/// Writes a tube along points with radii (m): its frame is carried along by the least rotation from ring to ring (Bishop 1975), so that it does not twist.
fn write_tube(mesh: &mut Mesh, line: &[(Vec3, f32)]) {
    let (mut places, mut normals) = (Vec::with_capacity(line.len() * SIDES), Vec::with_capacity(line.len() * SIDES));
    let last = line.len() - 1;
    let mut along = (line[1].0 - line[0].0).normalize_or(Vec3::X);
    let mut across = along.any_orthonormal_vector();
    for (i, (place, radius)) in line.iter().enumerate() {
        let next = (line[(i + 1).min(last)].0 - line[i.saturating_sub(1)].0).normalize_or(along);
        across = (Quat::from_rotation_arc(along, next) * across).reject_from_normalized(next).normalize_or(next.any_orthonormal_vector());
        along = next;
        let other = along.cross(across);
        for k in 0..SIDES {
            let (sin, cos) = (std::f32::consts::TAU * k as f32 / SIDES as f32).sin_cos();
            let out = cos * across + sin * other;
            places.push((*place + *radius * out).to_array());
            normals.push(out.to_array());
        }
    }
    let ring = |i: usize, k: usize| (i * SIDES + k % SIDES) as u32;
    let mut indices = Vec::with_capacity(6 * SIDES * line.len());
    for (i, k) in (0..last).flat_map(|i| (0..SIDES).map(move |k| (i, k))) {
        let [a, b, c, d] = [ring(i, k), ring(i, k + 1), ring(i + 1, k + 1), ring(i + 1, k)];
        indices.extend([a, b, c, a, c, d]);
    }
    for k in 1..SIDES - 1 {
        indices.extend([ring(0, 0), ring(0, k + 1), ring(0, k), ring(last, 0), ring(last, k), ring(last, k + 1)]);
    }
    mesh.insert_attribute(Mesh::ATTRIBUTE_POSITION, VertexAttributeValues::Float32x3(places));
    mesh.insert_attribute(Mesh::ATTRIBUTE_NORMAL, VertexAttributeValues::Float32x3(normals));
    mesh.insert_indices(Indices::U32(indices));
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use bevy::ecs::system::RunSystemOnce;
    use std::f32::consts::{PI, TAU};

    fn volume(mesh: &Mesh) -> f32 {
        let Some(VertexAttributeValues::Float32x3(places)) = mesh.attribute(Mesh::ATTRIBUTE_POSITION) else { panic!("no places") };
        let corners: Vec<Vec3> = mesh.indices().unwrap().iter().map(|i| Vec3::from_array(places[i])).collect();
        corners.chunks_exact(3).map(|t| t[0].dot(t[1].cross(t[2])) / 6.0).sum()
    }

    /// A tube of `n` sides about a line of length `l` holds `n/2 sin(2 pi/n) r^2 l`, by Pappus about a circle too; outward, for it is positive.
    #[test]
    fn a_tube_is_closed_outward_and_as_thick_as_it_should_be() {
        let section = 0.5 * SIDES as f32 * (TAU / SIDES as f32).sin();
        let straight: Vec<_> = (0..10).map(|i| (Vec3::new(0.0, 0.02 * i as f32, 0.1), 0.003)).collect();
        let bent: Vec<_> = (0..=200).map(|i| (0.01 * Vec3::from_angle_xy(PI * i as f32 / 200.0), 0.001)).collect();
        for (line, expected) in [(straight, 0.18 * 0.003 * 0.003), (bent, PI * 0.01 * 0.001 * 0.001)] {
            let mut mesh = empty();
            write_tube(&mut mesh, &line);
            let found = volume(&mesh);
            assert!((found / (section * expected) - 1.0).abs() < 2e-3, "{found} against {}", section * expected);
        }
    }

    trait FromAngle {
        fn from_angle_xy(angle: f32) -> Vec3;
    }

    impl FromAngle for Vec3 {
        fn from_angle_xy(angle: f32) -> Vec3 {
            Vec3::new(angle.cos(), angle.sin(), 0.0)
        }
    }

    #[test]
    fn a_thread_is_drawn_where_it_is_and_not_again_while_it_lies_still() {
        let mut world = World::new();
        world.init_resource::<Assets<Mesh>>();
        world.init_resource::<Assets<SceneMaterial>>();
        let points = vec![Vec3::ZERO, 0.1 * Vec3::X, Vec3::new(0.1, 0.1, 0.0)];
        let thread = Thread { points: points.clone(), radius_m: 0.0002, ..default() };
        let suture = world.spawn((Needle::half_circle_26mm(default()), thread)).id();
        world.run_system_once(draw_sutures).unwrap();
        let mover = world.register_system(move_sutures);
        world.run_system(mover).unwrap();
        let handle = world.query_filtered::<&Mesh3d, With<DrawnThread>>().single(&world).unwrap().0.clone();
        let places = |world: &World| match world.resource::<Assets<Mesh>>().get(&handle).unwrap().attribute(Mesh::ATTRIBUTE_POSITION) {
            Some(VertexAttributeValues::Float32x3(places)) => places.clone(),
            _ => panic!("no places"),
        };
        let drawn = places(&world);
        for point in points {
            let near = drawn.iter().map(|p| point.distance(Vec3::from_array(*p))).fold(f32::INFINITY, f32::min);
            assert!((near - 0.0002).abs() < 2e-5, "{point} is {near} m off");
        }
        // Written again with what it was: nothing is drawn. Moved by a millimetre, it is.
        world.get_mut::<Thread>(suture).unwrap().points[1].y += 1e-7;
        world.run_system(mover).unwrap();
        assert_eq!(places(&world), drawn);
        world.get_mut::<Thread>(suture).unwrap().points[1].y += 1e-3;
        world.run_system(mover).unwrap();
        assert_ne!(places(&world), drawn);
    }
}
