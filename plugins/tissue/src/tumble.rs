//! A crumb in its tick: a rigid body to which everything that it touches is an obstacle.
//!
//! Its six velocities are found contact by contact (projected Gauss-Seidel on impulses: Jean and Moreau 1992; Catto 2005, "Iterative dynamics with temporal coherence"): none
//! comes nearer to an obstacle than a little inside, none is thrown back, friction is Coulomb's. What lies deeper is carried out by a velocity of its own, by which the crumb moves in this tick
//! and which it does not keep. Holds are points that go with their anchors. Shape: what it is off its rest shape halves with every tick, so it is never stretched further than it was.

use crate::body::Body;
use crate::hold::Hold;
use crate::rescue::{covariance, turn};
use crate::touch::SLOW_S;
use bevy_math::{DMat3, DVec3, Mat3, Quat, Vec3};
use keyhole_whiteboard::{Contact, Obstacle, TissuePoint, TissueState};

/// Rounds through all contacts.
const ROUNDS: u32 = 30;
/// How far inside an obstacle it rests, as a part of its own size: what is just outside is not found again in the next tick.
const INSIDE: f32 = 0.1;
/// Most that it turns in a tick, rad.
const MOST_TURNED: f32 = 0.5;
/// What is left after a tick of what it is off its rest shape.
const KEPT: f32 = 0.5;
/// Part of the trace of its inertia that is added to each moment: a needle turns about itself like something a little thicker.
const THINNEST: f64 = 1e-4;

/// What a tick does to it besides.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fall {
    /// Gravity, m/s2.
    pub gravity: Vec3,
    /// Length of the tick, s.
    pub dt: f32,
    /// Drag, 1/s: of turning. A body that nothing holds falls freely.
    pub drag_1_s: f32,
}

/// A contact of the crumb, or a hold.
#[derive(Clone, Copy, Debug)]
struct Row {
    /// From the middle to the point, m.
    arm: Vec3,
    /// The way out; `None` for a hold.
    normal: Option<Vec3>,
    /// Velocity of the obstacle, m/s.
    velocity: Vec3,
    /// Least velocity away from it, m/s: with what carries it out, and without.
    least: [f32; 2],
    /// Coulomb's coefficient.
    friction: f32,
    /// How the point's velocity changes with the impulse, 1/kg; for a hold with its compliance, inverted.
    mobility: Mat3,
    /// Of a hold: compliance over the square of the tick, 1/kg.
    soft: f32,
    /// Impulse, N s.
    impulse: Vec3,
}

/// The crumb's motion.
#[derive(Clone, Copy, Debug)]
struct Motion {
    velocity: Vec3,
    turning: Vec3,
}

/// A rigid body.
#[derive(Clone, Copy, Debug)]
struct Rigid {
    /// 1/kg.
    lightness: f32,
    /// 1/(kg m2).
    inverse_inertia: Mat3,
}

impl Rigid {
    fn mobility(&self, arm: Vec3) -> Mat3 {
        let cross = Mat3::from_cols(Vec3::new(0.0, arm.z, -arm.y), Vec3::new(-arm.z, 0.0, arm.x), Vec3::new(arm.y, -arm.x, 0.0));
        Mat3::from_diagonal(Vec3::splat(self.lightness)) - cross * self.inverse_inertia * cross
    }

    fn push(&self, motion: &mut Motion, arm: Vec3, impulse: Vec3) {
        motion.velocity += impulse * self.lightness;
        motion.turning += self.inverse_inertia * arm.cross(impulse);
    }
}

/// Moves the nodes of a crumb over a tick, and writes the forces at its contacts down.
pub(crate) fn step(body: &Body, nodes: &[u32], state: &mut TissueState, holds: &[Hold], contacts: &mut [Contact], fall: Fall) {
    let mass = |n: &u32| f64::from(body.masses()[*n as usize]);
    let all: f64 = nodes.iter().map(mass).sum();
    if all <= 0.0 {
        return;
    }
    let mean = |of: &dyn Fn(usize) -> Vec3| nodes.iter().map(|n| of(*n as usize).as_dvec3() * mass(n)).sum::<DVec3>() / all;
    let middle = mean(&|n| state.positions[n]);
    let rest_middle = mean(&|n| body.rest()[n]);
    let velocity = mean(&|n| state.velocities[n]);
    let points: Vec<(f64, DVec3, DVec3)> =
        nodes.iter().map(|n| (mass(n), body.rest()[*n as usize].as_dvec3(), state.positions[*n as usize].as_dvec3())).collect();
    let turned = turn(covariance(&points));
    // The rest shape where it is now, from its middle.
    let shape: Vec<DVec3> = points.iter().map(|p| turned * (p.1 - rest_middle)).collect();
    let (mut inertia, mut spin) = (DMat3::ZERO, DVec3::ZERO);
    for ((n, s), p) in nodes.iter().zip(&shape).zip(&points) {
        inertia += (DMat3::from_diagonal(DVec3::splat(s.length_squared())) - DMat3::from_cols(*s * s.x, *s * s.y, *s * s.z)) * p.0;
        spin += s.cross(state.velocities[*n as usize].as_dvec3() - velocity) * p.0;
    }
    let size = (shape.iter().map(|s| s.length_squared()).sum::<f64>() / shape.len() as f64).sqrt();
    inertia +=
        DMat3::from_diagonal(DVec3::splat(THINNEST * (inertia.x_axis.x + inertia.y_axis.y + inertia.z_axis.z).max(all * size * size)));
    let inverse_inertia = inertia.inverse();
    let rigid = Rigid { lightness: all.recip() as f32, inverse_inertia: inverse_inertia.as_mat3() };
    let start = Motion {
        velocity: velocity.as_vec3() + fall.gravity * fall.dt,
        turning: (inverse_inertia * spin).as_vec3() / (1.0 + fall.drag_1_s * fall.dt),
    };

    let mut rows = Vec::new();
    let mut of_contact = Vec::new();
    let is_own = |point: &TissuePoint| point.first().is_some_and(|(n, _)| nodes.binary_search(&n.0).is_ok());
    let place = |point: &TissuePoint, of: &[Vec3]| point.iter().map(|(n, w)| of[n.index()] * *w).sum::<Vec3>();
    for hold in holds.iter().filter(|h| is_own(&h.point)) {
        let at = place(&hold.point, &state.positions);
        let arm = at - middle.as_vec3();
        let soft = hold.compliance_m_n.max(0.0) / (fall.dt * fall.dt);
        let mobility = (rigid.mobility(arm) + Mat3::from_diagonal(Vec3::splat(soft))).inverse();
        let velocity = (hold.to - at) / fall.dt;
        rows.push(Row { arm, normal: None, velocity, least: [0.0; 2], friction: 0.0, mobility, soft, impulse: Vec3::ZERO });
    }
    let held = rows.len();
    let inside = INSIDE * size as f32;
    for (at, contact) in contacts.iter().enumerate() {
        // Of a contact of the body with itself either side may be the crumb.
        let (point, normal, velocity) = match &contact.against {
            _ if is_own(&contact.point) => (&contact.point, contact.normal, contact.velocity_m_s),
            Obstacle::Own(other) if is_own(other) => (other, -contact.normal, place(&contact.point, &state.velocities)),
            _ => continue,
        };
        let deeper = contact.depth_m - inside;
        let carried = if deeper > 0.0 { deeper / SLOW_S.max(fall.dt) } else { deeper / fall.dt };
        let arm = place(point, &state.positions) - middle.as_vec3();
        let Some(normal) = normal.try_normalize() else { continue };
        let row = Row {
            arm,
            normal: Some(normal),
            velocity,
            least: [carried, carried.min(0.0)],
            friction: contact.friction.max(0.0),
            mobility: rigid.mobility(arm),
            soft: 0.0,
            impulse: Vec3::ZERO,
        };
        if row.arm.is_finite() && row.velocity.is_finite() && carried.is_finite() {
            rows.push(row);
            of_contact.push(at);
        }
    }
    let carried = solve(rigid, start, &mut rows, 0);
    let kept = if of_contact.is_empty() { carried } else { solve(rigid, start, &mut rows, 1) };
    for (row, at) in rows[held..].iter().zip(of_contact) {
        let side = row.normal.map_or(0.0, |n| n.dot(contacts[at].normal).signum());
        contacts[at].force_n = row.impulse * side / fall.dt;
    }

    let way = carried.turning * fall.dt;
    let further = Quat::from_scaled_axis(way.clamp_length_max(MOST_TURNED)).as_dquat();
    let to = middle + (carried.velocity * fall.dt).as_dvec3();
    let turning = kept.turning.clamp_length_max(MOST_TURNED / fall.dt).as_dvec3();
    for ((n, s), p) in nodes.iter().zip(&shape).zip(&points) {
        let off = p.2 - middle - *s;
        let arm = further * (*s + off * f64::from(KEPT));
        state.positions[*n as usize] = (to + arm).as_vec3();
        state.velocities[*n as usize] = (kept.velocity.as_dvec3() + turning.cross(arm)).as_vec3();
    }
}

/// The motion that holds and contacts leave, by the least velocities number `which`.
fn solve(rigid: Rigid, start: Motion, rows: &mut [Row], which: usize) -> Motion {
    let mut motion = start;
    rows.iter_mut().for_each(|row| row.impulse = Vec3::ZERO);
    for _ in 0..ROUNDS {
        for row in rows.iter_mut() {
            let velocity = motion.velocity + motion.turning.cross(row.arm) - row.velocity;
            let before = row.impulse;
            if let Some(normal) = row.normal {
                let along = normal.dot(row.mobility * normal);
                let push = (row.impulse.dot(normal) + (row.least[which] - velocity.dot(normal)) / along).max(0.0);
                let across = row.mobility.x_axis.x + row.mobility.y_axis.y + row.mobility.z_axis.z - along;
                let slip = |v: Vec3| v - normal * v.dot(normal);
                let rub = (slip(row.impulse) - slip(velocity) / across).clamp_length_max(row.friction * push);
                row.impulse = normal * push + rub;
            } else {
                row.impulse -= row.mobility * (velocity + row.impulse * row.soft);
            }
            rigid.push(&mut motion, row.arm, row.impulse - before);
        }
    }
    motion
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::Momentum;
    use crate::beam::{GRAVITY, beam_material, block};
    use bevy_ecs::prelude::Entity;
    use keyhole_tetmesh::NodeId;
    use smallvec::smallvec;

    const DT: f32 = 1.0 / 60.0;

    fn crumb(extents_m: [f64; 3]) -> (Body, TissueState, Vec<u32>) {
        let mesh = block([2, 2, 2], extents_m);
        let body = Body::new(&mesh, &beam_material()).unwrap();
        let nodes = mesh.nodes().map(|n| n.0).collect();
        (body, TissueState::at_rest(&mesh), nodes)
    }

    fn momentum(body: &Body, state: &TissueState) -> Momentum {
        body.momentum(state)
    }

    /// Contacts with level ground at height `y` that goes up with `speed` m/s, seen a tick ahead.
    fn ground(state: &TissueState, y: f32, normal: Vec3, speed: f32, friction: f32) -> Vec<Contact> {
        let of = |(n, x): (usize, &Vec3)| {
            let depth_m = (y - x.y) * normal.y;
            (depth_m > -0.01).then(|| Contact {
                point: smallvec![(NodeId(n as u32), 1.0)],
                normal,
                depth_m,
                surface_m: Vec3::new(x.x, y, x.z),
                velocity_m_s: Vec3::Y * speed,
                friction,
                against: Obstacle::Anatomy(Entity::PLACEHOLDER),
                force_n: Vec3::ZERO,
            })
        };
        state.positions.iter().enumerate().filter_map(of).collect()
    }

    /// What touches nothing falls freely, spins as it did and keeps its shape.
    #[test]
    fn what_touches_nothing_falls_freely_and_spins_on() {
        let (body, mut state, nodes) = crumb([0.002, 0.002, 0.002]);
        let middle = state.positions.iter().sum::<Vec3>() / state.positions.len() as f32;
        for (x, v) in state.positions.iter().zip(&mut state.velocities) {
            *v = Vec3::new(0.3, 0.1, 0.0) + Vec3::new(2.0, 5.0, 1.0).cross(*x - middle);
        }
        let before = momentum(&body, &state);
        let about = |m: &Momentum, c: Vec3| m.angular - c.as_dvec3().cross(m.linear);
        let fall = Fall { gravity: GRAVITY, dt: DT, drag_1_s: 0.0 };
        for _ in 0..60 {
            step(&body, &nodes, &mut state, &[], &mut [], fall);
        }
        let after = momentum(&body, &state);
        let gained = (GRAVITY * 60.0 * DT).as_dvec3() * before.mass;
        assert!((after.linear - before.linear - gained).length() < 1e-5 * gained.length());
        let end = nodes.iter().map(|n| state.positions[*n as usize] * body.masses()[*n as usize]).sum::<Vec3>() / before.mass as f32;
        let (spin, spun) = (about(&before, middle), about(&after, end));
        assert!((spun - spin).length() < 0.07 * spin.length(), "{spun} of {spin}");
        for pair in nodes.windows(2) {
            let [a, b] = [pair[0] as usize, pair[1] as usize];
            let (rest, now) = (body.rest()[a].distance(body.rest()[b]), state.positions[a].distance(state.positions[b]));
            assert!((now / rest - 1.0).abs() < 1e-3, "{now} m of {rest} m");
        }
    }

    /// Dropped, it comes to rest on the ground, a tenth of its size inside at most, and the ground bears its weight; on a slope it stays or slides by Coulomb's law.
    #[test]
    fn it_comes_to_rest_and_is_borne() {
        let (body, mut state, nodes) = crumb([0.003, 0.002, 0.002]);
        state.positions.iter_mut().for_each(|x| x.y += 0.02);
        let fall = Fall { gravity: GRAVITY, dt: DT, drag_1_s: 0.0 };
        let mut borne = Vec3::ZERO;
        for _ in 0..120 {
            let mut contacts = ground(&state, 0.0, Vec3::Y, 0.0, 0.5);
            step(&body, &nodes, &mut state, &[], &mut contacts, fall);
            borne = contacts.iter().map(|c| c.force_n).sum();
        }
        let weight = momentum(&body, &state).mass as f32 * 9.81;
        assert!((borne - Vec3::Y * weight).length() < 0.01 * weight, "{borne} N of {weight} N");
        assert!(state.velocities.iter().all(|v| v.length() < 1e-3), "{:?}", state.velocities);
        let lowest = state.positions.iter().map(|x| x.y).fold(f32::INFINITY, f32::min);
        assert!((-0.0003..0.0).contains(&lowest), "{lowest} m");
        for (lean, mu) in [(0.25_f32, 0.3_f32), (0.4, 0.3)] {
            let (mut state, leaning) = (state.clone(), Fall { gravity: Vec3::new(lean.sin(), -lean.cos(), 0.0) * 9.81, ..fall });
            for _ in 0..60 {
                let mut contacts = ground(&state, 0.0, Vec3::Y, 0.0, mu);
                step(&body, &nodes, &mut state, &[], &mut contacts, leaning);
            }
            let speed = momentum(&body, &state).linear.x as f32 / momentum(&body, &state).mass as f32;
            let expected = (9.81 * (lean.sin() - mu * lean.cos())).max(0.0);
            assert!((speed - expected).abs() < 0.02 * expected + 1e-3, "{speed} m/s of {expected} m/s, leaning by {lean}");
        }
    }

    /// Crushed between two plates that close to nothing, begun out of shape and inside out, it is neither thrown nor stretched.
    #[test]
    fn nothing_throws_or_stretches_it() {
        let (body, mut state, nodes) = crumb([0.002, 0.002, 0.002]);
        for x in &mut state.positions {
            x.x *= -3.0;
        }
        let fall = Fall { gravity: GRAVITY, dt: DT, drag_1_s: 0.0 };
        let longest = |at: &[Vec3]| at.iter().flat_map(|a| at.iter().map(|b| a.distance(*b))).fold(0.0, f32::max);
        let rest = longest(body.rest());
        for tick in 0..60 {
            let before = longest(&state.positions);
            let close = 0.0002 * tick as f32;
            let mut contacts = ground(&state, close - 0.001, Vec3::Y, 0.012, 0.5);
            contacts.extend(ground(&state, 0.003 - close, Vec3::NEG_Y, -0.012, 0.5));
            step(&body, &nodes, &mut state, &[], &mut contacts, fall);
            let fastest = state.velocities.iter().map(|v| v.length()).fold(0.0, f32::max);
            assert!(fastest < 0.5, "{fastest} m/s in tick {tick}");
            let now = longest(&state.positions);
            assert!(now <= before.max(rest) * 1.0001, "{now} m, before {before} m, at rest {rest} m");
        }
    }
}
