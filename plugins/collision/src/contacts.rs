//! From hits, touches and distances to contacts.

use crate::anatomy::SolidSurface;
use crate::depth::{Depths, Penetration, neighbours};
use crate::detect::{Body, Hit};
use crate::fresh::{FreshCuts, NodeOf, PARTED};
use crate::pad::Pad;
use crate::shape::{Role, Shape};
use crate::tool::{Motion, ToolPart};
use crate::touch::Touch;
use crate::walk::Deformed;
use crate::within::push_out;
use bevy_ecs::prelude::Entity;
use bevy_math::Vec3;
use keyhole_tetmesh::{NodeId, Topology};
use keyhole_whiteboard::{Contact, Obstacle, TissuePoint};
use smallvec::{SmallVec, smallvec};

/// How deep a body may be in itself for a contact, in edges of its mesh: with edges of 5 mm what folds at half a metre a second comes no further in a tick.
const DEEPEST_FOLD: f32 = 2.0;

/// An organ as contacts see it.
#[derive(Clone, Copy, Debug)]
pub struct Party<'a> {
    /// Its entity.
    pub organ: Entity,
    /// Its adjacency.
    pub topology: &'a Topology,
    /// Its tetrahedra and its surface.
    pub shape: &'a Shape,
    /// Deformed positions by node slot, m.
    pub positions: &'a [Vec3],
    /// Velocities by node slot, m/s.
    pub velocities: &'a [Vec3],
    /// Mean length of the edges of its tetrahedra in the rest shape, m.
    pub edge_m: f32,
    /// Coulomb's coefficient of its surface.
    pub friction: f32,
}

impl<'a> Party<'a> {
    /// What detection between bodies looks at.
    #[must_use]
    pub fn body(&self) -> Body<'a> {
        Body { shape: self.shape, positions: self.positions, self_collision: false }
    }

    fn deformed(&self) -> Deformed<'a> {
        Deformed { topology: self.topology, positions: self.positions }
    }
}

/// Coulomb's coefficient between two surfaces: the geometric mean.
#[must_use]
pub fn friction_between(a: f32, b: f32) -> f32 {
    (a * b).sqrt()
}

/// Takes the hits away that a fresh cut explains; returns the nodes of these, ascending.
pub fn exempt(hits: &mut Vec<Hit>, parties: &[Party], fresh: &FreshCuts) -> Vec<NodeOf> {
    let mut held = Vec::new();
    if fresh.is_empty() {
        return held;
    }
    hits.retain(|hit| {
        let node = (parties[usize::from(hit.node_body)].organ, hit.node);
        let body = &parties[usize::from(hit.tet_body)];
        let corners = body.topology.corners(hit.tet);
        let touches = |partner: NodeId| {
            body.topology.around_node(partner).iter().any(|t| body.topology.corners(*t).iter().any(|n| corners.contains(n)))
        };
        let explained = fresh.partners(node).any(|(organ, partner)| organ == body.organ && touches(partner));
        if explained {
            held.push(node);
        }
        !explained
    });
    held.dedup();
    held
}

/// Lets the pairs of fresh cuts go that have parted: none of the two is among `held` (ascending), and they are apart by [`PARTED`] of an edge.
pub fn part(fresh: &mut FreshCuts, parties: &[Party], held: &[NodeOf]) {
    let find = |organ: Entity| parties.iter().find(|p| p.organ == organ);
    let place = |(organ, node): NodeOf| find(organ).and_then(|p| p.positions.get(node.index()));
    fresh.part(|a, b| {
        let (Some(party), Some(at), Some(other)) = (find(a.0), place(a), place(b)) else { return true };
        let around = neighbours(party.deformed(), a.1);
        let mean = around.iter().map(|n| party.positions[n.index()].distance(*at)).sum::<f32>() / around.len() as f32;
        !held.contains(&a) && !held.contains(&b) && at.distance(*other) > PARTED * mean
    });
}

/// The contacts of tissue with tissue: `hits` in order of [`Hit::key`], a list of contacts for each party.
pub fn between_tissue(hits: &[Hit], parties: &[Party], depths: &mut Depths, contacts: &mut [&mut Vec<Contact>]) {
    for pair in hits.chunk_by(|a, b| (a.node_body, a.tet_body) == (b.node_body, b.tet_body)) {
        let [a, b] = [pair[0].node_body, pair[0].tet_body].map(usize::from);
        let (nodes, tets) = (&parties[a], &parties[b]);
        let friction = friction_between(nodes.friction, tets.friction);
        for p in depths.estimate(nodes.deformed(), tets.deformed(), pair) {
            // Inner nodes tell how deep the others are; out of the body they come with these.
            if nodes.shape.role(p.node) != Role::Surface {
                continue;
            }
            // A fold does not begin that deep: the node is in its own body because tetrahedra between are inverted, which is not for contacts to mend.
            if a == b && p.depth_m > DEEPEST_FOLD * nodes.edge_m {
                continue;
            }
            let inside = corners_of(p, tets);
            let own: TissuePoint = smallvec![(p.node, 1.0)];
            let at = nodes.positions[p.node.index()];
            let against = if a == b { Obstacle::Own(inside.clone()) } else { Obstacle::Organ { organ: tets.organ, point: inside.clone() } };
            let velocity: Vec3 = inside.iter().map(|(n, w)| *w * tets.velocities[n.index()]).sum();
            let way = p.direction * p.depth_m;
            contacts[a].push(Contact {
                point: own.clone(),
                normal: p.direction,
                depth_m: p.depth_m,
                surface_m: at + way,
                velocity_m_s: velocity,
                friction,
                against,
                force_n: Vec3::ZERO,
            });
            if a != b {
                contacts[b].push(Contact {
                    point: inside,
                    normal: -p.direction,
                    depth_m: p.depth_m,
                    surface_m: at - way,
                    velocity_m_s: nodes.velocities[p.node.index()],
                    friction,
                    against: Obstacle::Organ { organ: nodes.organ, point: own },
                    force_n: Vec3::ZERO,
                });
            }
        }
    }
}

fn corners_of(p: &Penetration, tets: &Party) -> TissuePoint {
    tets.topology.corners(p.tet).into_iter().zip(p.weights).collect()
}

/// The contacts of an organ's surface with anatomy: nodes that are inside, or that would get there within the tick of `dt_s` at their velocity, however fast. Nodes
/// deeper than `reach_m` are not found.
pub fn with_anatomy(organ: &Party, anatomy: (Entity, &SolidSurface), friction: f32, reach_m: f32, dt_s: f32, contacts: &mut Vec<Contact>) {
    let (entity, surface) = anatomy;
    for (node, role) in organ.shape.roles().iter().enumerate() {
        if *role != Role::Surface {
            continue;
        }
        let (at, velocity) = (organ.positions[node], organ.velocities[node]);
        let way = velocity * dt_s;
        let ahead = || if way.length() > reach_m { surface.entered(at, way) } else { None };
        let Some(nearest) = surface.nearest(at, reach_m).or_else(ahead) else { continue };
        if nearest.distance_m > 0.0 && nearest.distance_m > -way.dot(nearest.normal) {
            continue;
        }
        contacts.push(Contact {
            point: smallvec![(NodeId(node as u32), 1.0)],
            normal: nearest.normal,
            depth_m: -nearest.distance_m,
            surface_m: nearest.point,
            velocity_m_s: Vec3::ZERO,
            friction: friction_between(organ.friction, friction),
            against: Obstacle::Anatomy(entity),
            force_n: Vec3::ZERO,
        });
    }
}

/// A part of an instrument as contacts see it.
#[derive(Clone, Copy)]
pub struct MovedPart<'a> {
    /// The instrument.
    pub tool: Entity,
    /// Its part.
    pub part: &'a ToolPart,
    /// How the part moves.
    pub motion: &'a Motion,
    /// Coulomb's coefficient of its surface.
    pub friction: f32,
    /// Of a jaw that grips, the pad: what lies on it is no contact.
    pub pad: Option<Pad>,
}

/// The contacts of an organ's surface with parts of instruments, one part after the other; see [`ToolPart::touch`]. The surface moves on over the tick as it
/// does now. Gives the number of faces that were held against them, summed over the parts.
pub fn with_tools(organ: &Party, parts: &[MovedPart], near_m: f32, contacts: &mut Vec<Contact>) -> usize {
    let boxes: SmallVec<[(Vec3, Vec3); 8]> = parts.iter().map(|p| p.part.swept_box(p.motion, near_m)).collect();
    let way = |node: NodeId, dt_s: f32| organ.velocities[node.index()] * dt_s;
    // A walk over the surface is longer than all that is near a tool.
    let mut near: Vec<(usize, [NodeId; 3])> = Vec::new();
    let mut faces = 0;
    for nodes in organ.shape.triangles() {
        faces += parts.len();
        let [a, b, c] = nodes.map(|n| organ.positions[n.index()]);
        let (high, low) = (a.max(b).max(c), a.min(b).min(c));
        for (at, ((lowest, highest), moved)) in boxes.iter().zip(parts).enumerate() {
            let [u, v, w] = nodes.map(|n| way(n, moved.motion.dt_s));
            let (ahead, behind) = (u.max(v).max(w).max(Vec3::ZERO), u.min(v).min(w).min(Vec3::ZERO));
            let apart = (high + ahead).cmplt(*lowest).any() || (low + behind).cmpgt(*highest).any();
            if !apart && (a + b + c + u + v + w).is_finite() {
                near.push((at, nodes));
            }
        }
    }
    for (at, MovedPart { tool, part, motion, friction, pad }) in parts.iter().enumerate() {
        let swept = part.swept_bar(motion);
        for (_, nodes) in near.iter().filter(|(of, _)| *of == at) {
            let corners = nodes.map(|n| organ.positions[n.index()]);
            let then = std::array::from_fn(|i| corners[i] + way(nodes[i], motion.dt_s));
            if swept.misses(corners, then, near_m) {
                continue;
            }
            let Some(touch) = part.touch(motion, corners, then, near_m) else { continue };
            if pad.is_some_and(|pad| is_on_pad(&pad, motion, corners, &touch)) {
                continue;
            }
            contacts.push(Contact {
                point: nodes.iter().copied().zip(touch.weights).collect(),
                normal: touch.normal,
                depth_m: touch.depth_m,
                surface_m: touch.surface_m,
                velocity_m_s: touch.velocity_m_s,
                friction: friction_between(organ.friction, *friction),
                against: Obstacle::Instrument(*tool),
                force_n: Vec3::ZERO,
            });
        }
    }
    faces
}

/// Whether what a jaw touches of a triangle (m) lies on the jaw's pad, as both are when the tick begins.
fn is_on_pad(pad: &Pad, motion: &Motion, corners: [Vec3; 3], touch: &Touch) -> bool {
    let into = motion.from.inverse();
    let at = corners.iter().zip(touch.weights).map(|(c, w)| *c * w).sum::<Vec3>();
    let outward = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
    pad.bears(into * at, into.rotation * outward, into.rotation * touch.normal)
}

/// The contacts of an organ with a part of an instrument whose middle is in it; see [`push_out`]. `hits` are those of the part's spine in the organ.
pub fn with_tool_within(organ: &Party, moved: MovedPart, hits: &[Hit], last: &mut Option<Vec3>, contacts: &mut Vec<Contact>) {
    let MovedPart { tool, part, motion, friction, .. } = moved;
    for sunk in push_out(part, motion, organ.deformed(), hits, last) {
        contacts.push(Contact {
            point: organ.topology.corners(sunk.hit.tet).into_iter().zip(sunk.hit.weights).collect(),
            normal: sunk.normal,
            depth_m: sunk.depth_m,
            surface_m: sunk.at + sunk.normal * sunk.depth_m,
            velocity_m_s: sunk.velocity_m_s,
            friction: friction_between(organ.friction, friction),
            against: Obstacle::Instrument(tool),
            force_n: Vec3::ZERO,
        });
    }
}
