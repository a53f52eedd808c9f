//! Clips as they are drawn: open between the jaws of an applier, closed on tissue, and dropped.

use crate::layers;
use crate::shading::{Look, SceneMaterial};
use crate::smoothing::Smoothing;
use crate::tools::Draws;
use bevy::math::Isometry3d;
use bevy::prelude::*;
use keyhole_whiteboard::{Clip, ClipApplier, ClipShape, InstrumentPose, Jaws, RigidPose};

/// Titanium, linear RGB.
const TITANIUM: [f32; 3] = [0.66, 0.67, 0.70];

/// A part of a drawn clip: `side` is 1 for the upper leg, -1 for the lower one, 0 for the crown.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct ClipPart {
    side: f32,
}

/// On a drawn part of a clip between jaws: whether there is one now, and how many there were when it was last looked at.
#[derive(Component, Clone, Copy, Debug)]
pub struct Loaded {
    there: bool,
    clips: u32,
    /// Widest angle of the jaws so far, rad: a clip comes between them when they are nearly as wide again.
    widest_rad: f32,
}

/// Draws clips that have come, and the one in each applier.
pub fn draw_clips(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<SceneMaterial>>,
    come: Query<(Entity, &ClipShape), Added<ClipShape>>,
    appliers: Query<(Entity, &ClipApplier), Added<ClipApplier>>,
) {
    let in_jaws = appliers.iter().map(|(entity, applier)| (entity, applier.shape, Some(applier.clips)));
    for (entity, shape, cartridge) in come.iter().map(|(entity, shape)| (entity, *shape, None)).chain(in_jaws) {
        let radius = 0.5 * shape.wire_m;
        let leg = Capsule3d::new(radius, (shape.leg_m - radius).max(radius)).mesh().build();
        // A capsule's axis is Y and its origin its middle.
        let leg = leg.rotated_by(Quat::from_rotation_x(std::f32::consts::FRAC_PI_2)).translated_by(Vec3::NEG_Z * (0.5 * shape.leg_m));
        let leg = meshes.add(leg);
        let crown = meshes.add(Cylinder::new(radius, 1.0));
        let [r, g, b] = TITANIUM;
        let material = materials.add(SceneMaterial::lit(Look { metallic: 0.5, roughness: 0.28, reflectance: 0.7, ..Look::of([r, g, b]) }));
        for (side, mesh) in [(1.0, &leg), (-1.0, &leg), (0.0, &crown)] {
            let mut part = commands.spawn((
                Draws(entity),
                ClipPart { side },
                Mesh3d(mesh.clone()),
                MeshMaterial3d(material.clone()),
                Transform::default(),
                Visibility::Inherited,
                layers::shared(),
            ));
            if let Some(clips) = cartridge {
                part.insert(Loaded { there: clips > 0, clips, widest_rad: 0.0 });
            }
        }
    }
}

type Lying<'a> = (&'a ClipShape, Option<&'a Clip>, Option<&'a RigidPose>);

/// Moves them with the tissue, the rigid body or the jaws.
pub fn move_clips(
    smoothing: Smoothing,
    clips: Query<Lying>,
    appliers: Query<(&ClipApplier, &InstrumentPose, &Jaws)>,
    mut parts: Query<(&Draws, &ClipPart, &mut Transform, &mut Visibility, Option<&mut Loaded>)>,
) {
    for (of, part, mut transform, mut visibility, loaded) in &mut parts {
        if let Some(mut loaded) = loaded {
            let Ok((applier, pose, jaws)) = appliers.get(of.0) else { continue };
            loaded.follow(applier.clips, jaws.angle_rad);
            visibility.set_if_neq(if loaded.there { Visibility::Inherited } else { Visibility::Hidden });
            let frame = blend(&pose.before, &pose.now, smoothing.fraction());
            *transform = place(part.side, &applier.shape, applier.shape.gap_m, Some((applier.crown_m, jaws.angle_rad)), &frame);
            continue;
        }
        let Ok((shape, clip, body)) = clips.get(of.0) else { continue };
        let (frame, gap_m) = match (clip, body) {
            (Some(clip), _) => (clip.pose, apart_m(clip).unwrap_or(shape.gap_m)),
            (None, Some(body)) => (blend(&body.before, &body.now, smoothing.fraction()), shape.gap_m),
            (None, None) => continue,
        };
        *transform = place(part.side, shape, gap_m, None, &frame);
    }
}

impl Loaded {
    fn follow(&mut self, clips: u32, angle_rad: f32) {
        self.widest_rad = self.widest_rad.max(angle_rad);
        if clips < self.clips {
            self.there = false;
        }
        self.there = clips > 0 && (self.there || angle_rad > 0.9 * self.widest_rad);
        self.clips = clips;
    }
}

/// How far apart the walls between the legs are, in the mean of the pieces, m.
fn apart_m(clip: &Clip) -> Option<f32> {
    let count = clip.pairs.len();
    (count > 0).then(|| clip.pairs.iter().map(|p| p.apart_m).sum::<f32>() / count as f32)
}

/// Where a part of a clip is whose legs are `gap_m` apart from face to face, and turned with jaws about a pivot that is so far behind the crown (m), by so much
/// (rad). `frame` is that of the clip, or of the jaws.
fn place(side: f32, shape: &ClipShape, gap_m: f32, jaws: Option<(f32, f32)>, frame: &Isometry3d) -> Transform {
    let half = 0.5 * (gap_m + shape.wire_m);
    let (crown_m, angle_rad) = jaws.unwrap_or((0.0, 0.0));
    let turn = |side: f32| Quat::from_rotation_x(side * angle_rad);
    let root = |side: f32| turn(side) * Vec3::new(0.0, side * half, -crown_m);
    let local = if side == 0.0 {
        let [upper, lower] = [root(1.0), root(-1.0)];
        Transform { translation: (upper + lower) / 2.0, scale: Vec3::new(1.0, upper.distance(lower), 1.0), ..default() }
    } else {
        Transform { translation: root(side), rotation: turn(side), ..default() }
    };
    Transform::from_isometry(*frame) * local
}

fn blend(before: &Isometry3d, now: &Isometry3d, fraction: f32) -> Isometry3d {
    Isometry3d { translation: before.translation.lerp(now.translation, fraction), rotation: before.rotation.slerp(now.rotation, fraction) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clip_is_gone_when_it_is_set_and_the_next_comes_when_the_jaws_are_open() {
        let mut loaded = Loaded { there: true, clips: 2, widest_rad: 0.0 };
        let mut after = |clips, angle| {
            loaded.follow(clips, angle);
            loaded.there
        };
        assert!(after(2, 0.3) && after(2, 0.1) && !after(1, 0.0) && !after(1, 0.1) && after(1, 0.29));
        assert!(!after(0, 0.0) && !after(0, 0.3), "the cartridge is empty");
    }

    /// The crown joins the legs, whose inner faces are as far apart as the walls.
    #[test]
    fn the_crown_joins_the_legs() {
        let shape = ClipShape::default();
        for jaws in [None, Some((0.008, 0.3))] {
            let part = |side| place(side, &shape, 0.001, jaws, &Isometry3d::from_xyz(0.1, 0.2, 0.3));
            let (upper, lower, crown) = (part(1.0), part(-1.0), part(0.0));
            assert!(crown.transform_point(Vec3::Y * 0.5).distance(upper.translation) < 1e-6);
            assert!(crown.transform_point(Vec3::NEG_Y * 0.5).distance(lower.translation) < 1e-6);
            if jaws.is_none() {
                assert!((upper.translation.y - lower.translation.y - 0.001 - shape.wire_m).abs() < 1e-6);
            }
        }
    }
}
