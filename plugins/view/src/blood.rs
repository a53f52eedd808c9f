//! Blood where it bleeds: what leaves a vessel flies as drops, by gravity alone, onto the anatomy that it falls on, where it lies as the pools of [`BleedReport`] until it is
//! aspirated.
//!
//! The rate is that of [`BleedSite`]; drops have the speed of a free jet through the opening, and the pulse of a heart that is at rest, which changes their
//! number and speed about the mean and not what flows. Nothing here is read by the simulation: tissue is not wetted, and drops pass through it.

use crate::layers;
use crate::shading::{Look, SceneMaterial};
use bevy::light::NotShadowCaster;
use bevy::prelude::*;
use keyhole_whiteboard::{Anatomy, BleedReport, BleedSite, Gravity};

/// Volume of a drop, ml: of about 2 mm.
const DROP_ML: f32 = 0.004;
/// Beats of the heart, 1/s.
const BEATS_1_S: f32 = 1.2;
/// How much more there is of it in a beat, and less between beats.
const PULSE: f32 = 0.6;
/// How wide a jet scatters, as a part of its speed.
const SCATTER: f32 = 0.06;
/// Longest that a drop flies, s.
const LONGEST_S: f32 = 0.8;

/// A drop on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Drop {
    at: Vec3,
    v: Vec3,
    age_s: f32,
}

/// A surface that blood falls on, in the world, and the box around it.
#[derive(Clone, Debug)]
struct Floor {
    triangles: Vec<[Vec3; 3]>,
    low: Vec3,
    high: Vec3,
}

/// All blood that is seen. Empty while nothing bleeds and nothing has.
#[derive(Resource, Default, Debug)]
pub struct Blood {
    drops: Vec<Drop>,
    /// What has flowed of the next drop, ml, by site.
    owed_ml: Vec<f32>,
    floors: Option<Vec<Floor>>,
    /// Lost when it was last looked at, ml.
    lost_ml: f64,
    time_s: f32,
    /// Drops so far: where each goes follows from its number.
    count: u32,
}

impl Blood {
    fn is_none(&self) -> bool {
        self.drops.is_empty() && self.floors.is_none()
    }
}

/// Run condition: something bleeds, or has.
#[must_use]
pub fn bleeds(report: Res<BleedReport>, blood: Res<Blood>) -> bool {
    !report.sites.is_empty() || !report.pools.is_empty() || !blood.is_none()
}

/// A tick of everything that flows.
pub fn flow_blood(
    report: Res<BleedReport>,
    gravity: Res<Gravity>,
    time: Res<Time>,
    anatomy: Query<(&Anatomy, &Transform)>,
    mut blood: ResMut<Blood>,
) {
    if report.lost_ml < blood.lost_ml {
        // The scene has started over.
        *blood = Blood::default();
        return;
    }
    blood.lost_ml = report.lost_ml;
    if blood.floors.is_none() {
        blood.floors = Some(anatomy.iter().filter_map(|(anatomy, place)| floor(anatomy, place)).collect());
    }
    blood.advance(&report.sites, gravity.0, time.delta_secs());
}

fn floor(anatomy: &Anatomy, place: &Transform) -> Option<Floor> {
    let at = |i: &u32| place.transform_point(Vec3::from_array(anatomy.surface.vertices[*i as usize]));
    let triangles: Vec<[Vec3; 3]> = anatomy.surface.indices.chunks_exact(3).map(|t| [at(&t[0]), at(&t[1]), at(&t[2])]).collect();
    let all = triangles.iter().flatten().copied();
    let (low, high) = all.fold(None, |b: Option<(Vec3, Vec3)>, p| Some(b.map_or((p, p), |(l, h)| (l.min(p), h.max(p)))))?;
    Some(Floor { triangles, low, high })
}

impl Blood {
    fn advance(&mut self, sites: &[BleedSite], gravity: Vec3, dt_s: f32) {
        self.time_s += dt_s;
        let floors = self.floors.take().unwrap_or_default();
        let mut drops = std::mem::take(&mut self.drops);
        drops.retain_mut(|drop| {
            let from = drop.at;
            drop.v += gravity * dt_s;
            drop.at += drop.v * dt_s;
            drop.age_s += dt_s;
            drop.age_s < LONGEST_S && !lands(&floors, from, drop.at)
        });
        self.floors = Some(floors);
        self.owed_ml.resize(sites.len(), 0.0);
        let beat = 1.0 + PULSE * (std::f32::consts::TAU * BEATS_1_S * self.time_s).sin();
        for (i, site) in sites.iter().enumerate() {
            let now = BleedSite { rate_ml_min: site.rate_ml_min * beat, ..*site };
            let mut owed = self.owed_ml[i] + now.rate_ml_min / 60.0 * dt_s;
            let speed = now.speed_m_s();
            let whole = (owed / DROP_ML) as u32;
            owed -= whole as f32 * DROP_ML;
            for k in 0..whole {
                self.count = self.count.wrapping_add(1);
                let v = speed * (site.towards + SCATTER * scattered(self.count));
                // They have left evenly over the tick.
                let age_s = dt_s * (k as f32 + 0.5) / whole as f32;
                let at = site.at + v * age_s + 0.5 * gravity * age_s * age_s;
                drops.push(Drop { at, v: v + gravity * age_s, age_s });
            }
            self.owed_ml[i] = owed;
        }
        self.drops = drops;
    }
}

/// Whether a straight way goes through a surface.
fn lands(floors: &[Floor], from: Vec3, to: Vec3) -> bool {
    let way = to - from;
    let (low, high) = (from.min(to), from.max(to));
    let near = floors.iter().filter(|f| f.low.cmple(high).all() && f.high.cmpge(low).all());
    near.flat_map(|f| &f.triangles).any(|[a, b, c]| {
        let normal = (*b - *a).cross(*c - *a);
        let part = normal.dot(*a - from) / normal.dot(way);
        // Not a number where the way lies in the plane.
        if !(0.0..=1.0).contains(&part) {
            return false;
        }
        let p = from + part * way;
        [(*a, *b), (*b, *c), (*c, *a)].into_iter().all(|(u, v)| (v - u).cross(p - u).dot(normal) >= 0.0)
    })
}

/// A vector in the unit cube about zero that looks as if by chance, from a number (the finalizer of MurmurHash3, A. Appleby).
fn scattered(number: u32) -> Vec3 {
    let part = |k: u32| {
        let mut h = number.wrapping_mul(3).wrapping_add(k);
        h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
        h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
        (h ^ (h >> 16)) as f32 / u32::MAX as f32 * 2.0 - 1.0
    };
    Vec3::new(part(0), part(1), part(2))
}

/// Something of the blood that is drawn.
#[derive(Component, Clone, Copy, Debug)]
pub struct DrawnBlood;

/// The ball and the material that all blood is drawn with.
#[derive(Clone, Debug)]
pub struct BloodLook(Handle<Mesh>, Handle<SceneMaterial>);

/// Puts a ball where each drop and each pool is, and where blood leaves.
pub fn draw_blood(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<SceneMaterial>>,
    report: Res<BleedReport>,
    blood: Res<Blood>,
    mut drawn: Query<(&mut Transform, &mut Visibility), With<DrawnBlood>>,
    mut look: Local<Option<BloodLook>>,
) {
    let radius = (0.75 / std::f32::consts::PI * DROP_ML * 1e-6).cbrt();
    let drops = blood.drops.iter().map(|drop| {
        // Drawn out by its speed, so that a jet hangs together.
        let long = (0.008 * drop.v.length() / radius).clamp(1.0, 5.0);
        let scale = Vec3::new(1.0, long, 1.0) * radius * long.powf(-0.25);
        Transform { translation: drop.at, rotation: Quat::from_rotation_arc(Vec3::Y, drop.v.normalize_or(Vec3::Y)), scale }
    });
    let pools = report.pools.iter().map(|pool| {
        let (radius, deep) = pool.size_m();
        Transform { translation: pool.at, rotation: Quat::from_rotation_arc(Vec3::Y, pool.normal), scale: Vec3::new(radius, deep, radius) }
    });
    let sites = report.sites.iter().map(|site| {
        let radius = (site.area_m2 / std::f32::consts::PI).sqrt();
        let rotation = Quat::from_rotation_arc(Vec3::Y, site.towards);
        Transform { translation: site.at, rotation, scale: Vec3::new(radius, 0.5 * radius, radius) }
    });
    let mut wanted = drops.chain(pools).chain(sites);
    for (mut transform, mut visibility) in &mut drawn {
        match wanted.next() {
            Some(place) => {
                *transform = place;
                visibility.set_if_neq(Visibility::Inherited);
            }
            None => {
                visibility.set_if_neq(Visibility::Hidden);
            }
        }
    }
    for place in wanted {
        let BloodLook(ball, material) = look.get_or_insert_with(|| {
            let ball = Sphere::new(1.0).mesh().ico(6).unwrap_or_else(|_| Sphere::new(1.0).mesh().uv(32, 20));
            let material = SceneMaterial::lit(Look { roughness: 0.18, reflectance: 0.5, ..Look::of([0.28, 0.005, 0.006]) });
            BloodLook(meshes.add(ball), materials.add(material))
        });
        commands.spawn((
            DrawnBlood,
            Mesh3d(ball.clone()),
            MeshMaterial3d(material.clone()),
            place,
            Visibility::Inherited,
            NotShadowCaster,
            layers::shared(),
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn site(rate_ml_min: f32) -> BleedSite {
        BleedSite { organ: Entity::PLACEHOLDER, at: Vec3::Y * 0.01, towards: Vec3::X, area_m2: 7e-6, rate_ml_min }
    }

    fn bed() -> Floor {
        let [a, b, c, d] = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]].map(|[x, z]| Vec3::new(x, 0.0, z));
        Floor { triangles: vec![[a, b, c], [a, c, d]], low: a, high: c }
    }

    /// What flows in ten whole beats leaves as drops, to a drop; they fly as what is thrown does, and none goes through the bed.
    #[test]
    fn what_flows_leaves_as_drops_that_fall_onto_the_bed() {
        for rate in [6.0, 150.0] {
            let mut blood = Blood { floors: Some(vec![bed()]), ..default() };
            let (ticks, mut furthest) = (500, 0.0f32);
            for _ in 0..ticks {
                blood.advance(&[site(rate)], Vec3::NEG_Y * 9.81, 1.0 / 60.0);
                assert!(blood.drops.iter().all(|drop| drop.at.y > 0.0));
                furthest = blood.drops.iter().map(|drop| drop.at.x).fold(furthest, f32::max);
            }
            let (left, flowed) = (blood.count as f32 * DROP_ML, rate / 60.0 * ticks as f32 / 60.0);
            assert!((left + blood.owed_ml[0] - flowed).abs() < 0.01 * flowed, "{left} of {flowed}");
            // From 10 mm it falls for 45 ms, at no more than the mean speed with its beat.
            assert!(furthest > 0.0 && furthest < site(rate * (1.0 + PULSE)).speed_m_s() * (1.0 + SCATTER) * 0.0475 * 1.1, "{furthest}");
            for _ in 0..10 {
                blood.advance(&[], Vec3::NEG_Y * 9.81, 1.0 / 60.0);
            }
            assert!(blood.drops.is_empty(), "all have come down");
        }
    }
}
