//! What a stage leaves at single nodes, and in scraps.
//!
//! Conjugate gradients stop when the residual is small beside all that the bodies do. Where much touches at once, what is left may be nothing to an organ and throw a node
//! of some micrograms out of it, or a scrap of a dozen nodes out of all shape; and a node that is far out is hardly brought back by Newton's method, whose
//! tangent there is stiff in all directions but that one. So nodes that what is left would move by a part of their own edges are each taken to where the energy
//! of the stage is least while all others stay, and then those around them, until none would move far. The elastic energy is quadratic in one node (Chen, Liu, Yang, Yuksel
//! 2024, arXiv:2403.06321) and the contacts lie below a quadratic function: no step raises the energy, whatever the state.

use crate::newton::Part;
use crate::touches::Touches;
use bevy_math::{Mat3, Mat3A, Vec3, Vec3A};

/// Part of the mean length of its edges that a node must be off by to be taken care of.
const OFF: f32 = 0.5;

/// The same that is left.
const LEFT: f32 = 0.02;

/// The same of an edge of the mean length in the whole body below which nobody looks closer.
const NOTHING: f32 = 0.01;

/// Most passes over the nodes that are off, and most steps of nodes, of a stage.
const PASSES: u32 = 100;
const STEPS: usize = 20_000;

/// A node: its body and its index.
type Place = (u32, u32);

/// Takes nodes that are far from where they belong there, in a stage of `inertia` (1/s2). The residuals are those where the bodies are, the contacts looked at there; the
/// residuals are not kept.
pub(crate) fn relax(parts: &mut [Part<'_>], touches: &mut Touches, inertia: f32) {
    let mut active: Vec<Place> = (0..parts.len()).flat_map(|part| off(part, &parts[part])).collect();
    if active.is_empty() {
        return;
    }
    let of_nodes = touches.of_nodes();
    let contacts = |place: Place| {
        let from = of_nodes.partition_point(|(p, _)| *p < place);
        of_nodes[from..].iter().take_while(move |(p, _)| *p == place).map(|(_, contact)| *contact)
    };
    let (mut most, mut steps) = (OFF, 0);
    for _ in 0..PASSES {
        let mut next = Vec::new();
        for place in active.drain(..) {
            let (part, node) = (place.0 as usize, place.1 as usize);
            let (mut force, mut against) = alone(&parts[part], node, inertia);
            for contact in contacts(place) {
                let (push, block) = touches.on_node(contact, place, parts);
                force += push;
                against += block;
            }
            let reach = reach(&parts[part], node);
            let step = (Mat3::from(against).as_dmat3().inverse() * force.as_dvec3()).as_vec3a().clamp_length_max(reach);
            if !step.is_finite() || step.length() <= most * edge(&parts[part], node) {
                continue;
            }
            parts[part].newton.x[node] += step;
            steps += 1;
            next.push(place);
            next.extend(parts[part].newton.rows.neighbours(node).iter().map(|n| (place.0, *n)));
            for contact in contacts(place) {
                next.extend(touches.look_at(contact, parts));
            }
        }
        next.sort_unstable();
        next.dedup();
        next.retain(|(part, node)| parts[*part as usize].newton.free[*node as usize]);
        active = next;
        most = LEFT;
        if active.is_empty() || steps > STEPS {
            break;
        }
    }
}

/// The nodes of a body that the residual may move by more than [`OFF`].
fn off<'a>(part: usize, of: &'a Part<'_>) -> impl Iterator<Item = Place> + 'a {
    let newton = &*of.newton;
    let usual = of.tissue.body.usual_edge();
    let may = move |node: usize| newton.gradients.residual[node].length() / (newton.rows.shear(node) + newton.added[node]);
    let far = move |node: &usize| {
        let way = may(*node);
        way > NOTHING * usual && way > OFF * edge(of, *node)
    };
    (0..newton.x.len()).filter(|node| newton.free[*node]).filter(far).map(move |node| (part as u32, node as u32))
}

/// Mean length of the edges of a node at rest, m.
fn edge(of: &Part<'_>, node: usize) -> f32 {
    let rest = of.tissue.body.rest();
    let around = of.newton.rows.neighbours(node);
    around.iter().map(|n| rest[*n as usize].distance(rest[node])).sum::<f32>() / around.len().max(1) as f32
}

/// How far a node may go at once, m: twice as far as its neighbours are. It belongs among them; what is stiff in one direction and soft in another is not solved to the last digit.
fn reach(of: &Part<'_>, node: usize) -> f32 {
    let newton = &*of.newton;
    let around = newton.rows.neighbours(node);
    2.0 * around.iter().map(|n| newton.x[*n as usize].distance(newton.x[node])).fold(0.0, f32::max)
}

/// Force on a node without contacts, N, and a bound of how it falls with its place, N/m.
fn alone(of: &Part<'_>, node: usize, inertia: f32) -> (Vec3A, Mat3A) {
    let newton = &*of.newton;
    let (mut force, mut against) = newton.rows.node(node, &newton.x);
    force += (newton.target[node] - newton.x[node]) * (of.tissue.body.masses[node] * inertia);
    // Inertia and springs.
    against += Mat3A::from_diagonal(Vec3::splat(newton.added[node]));
    for spring in &newton.springs {
        for (_, weight) in spring.point.iter().filter(|(n, _)| n.index() == node) {
            force -= spring.gap(&newton.x) * (spring.stiffness * weight);
        }
    }
    for (triangle, corner) in of.tissue.membrane.iter().flat_map(|m| m.around(node)) {
        let (pull, stiffness) = triangle.at_node(triangle.nodes.map(|n| newton.x[n as usize].as_dvec3()), corner);
        force += pull.as_vec3a();
        against += Mat3A::from(stiffness.as_mat3());
    }
    (force, against)
}
