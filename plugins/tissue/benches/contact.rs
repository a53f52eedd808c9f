//! What contacts cost the tick of the default scene's kidney, one thread: held at one end and hanging, the same with a tool pressed into it, and lying free
//! on the ground. Beside it what the answer is worth: how deep the tissue lies in what it touches, and the weight that the ground says it carries.

#![expect(clippy::unwrap_used, reason = "the mesh is known to be sound")]

use bevy_ecs::prelude::Entity;
use bevy_math::Vec3;
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_tissue::beam::{GRAVITY, fix};
use keyhole_tissue::{Body, Hold, Member, TissueSettings, island};
use keyhole_whiteboard::{Contact, Obstacle, OrganMaterials, TissueState};
use smallvec::smallvec;
use std::time::Instant;

const DT: f32 = 1.0 / 60.0;

/// A disc that moves along its normal: what is behind it within its radius is inside.
#[derive(Clone, Copy)]
struct Disc {
    middle: Vec3,
    normal: Vec3,
    radius: f32,
    speed: f32,
}

impl Disc {
    fn find(&self, state: &TissueState, contacts: &mut Vec<Contact>) {
        contacts.clear();
        let velocity_m_s = self.normal * self.speed;
        for (i, (x, v)) in state.positions.iter().zip(&state.velocities).enumerate() {
            let gap = (*x - self.middle).dot(self.normal);
            let beside = (*x - self.middle - self.normal * gap).length() > self.radius;
            // What is inside, or will be by the end of the tick.
            if !beside && gap <= ((velocity_m_s - *v).dot(self.normal) * DT).max(0.0) && gap > -0.01 {
                contacts.push(Contact {
                    point: smallvec![(NodeId(i as u32), 1.0)],
                    normal: self.normal,
                    depth_m: -gap,
                    surface_m: *x - self.normal * gap,
                    velocity_m_s,
                    friction: 0.3,
                    against: Obstacle::Anatomy(Entity::PLACEHOLDER),
                    force_n: Vec3::ZERO,
                });
            }
        }
    }
}

/// Ticks of the body with what it touches, if anything; `seconds` are timed after one that is not.
fn run(name: &str, mesh: &TetMesh, holds: &[Hold], mut disc: Option<Disc>, seconds: usize) {
    let mut body = Body::new(mesh, &OrganMaterials::default()).unwrap();
    let mut state = TissueState::at_rest(mesh);
    let settings = TissueSettings { sleep: false, ..Default::default() };
    let mut contacts = Vec::new();
    for second in 0..=seconds {
        let (mut iterations, mut touching, mut worst) = (0, 0, 0.0_f64);
        let (mut cost, mut deepest, mut lifted) = (0.0, 0.0_f32, Vec3::ZERO);
        for _ in 0..60 {
            if let Some(disc) = &mut disc {
                disc.find(&state, &mut contacts);
                disc.middle += disc.normal * (disc.speed * DT);
            }
            let start = Instant::now();
            let member = Member {
                organ: Entity::PLACEHOLDER,
                body: &mut body,
                membrane: None,
                state: &mut state,
                holds,
                contacts: &mut contacts,
                light: &mut [],
                crumb: false,
            };
            island::step(&mut [member], GRAVITY, DT, &settings);
            let ms = start.elapsed().as_secs_f64() * 1e3;
            (cost, worst) = (cost + ms / 60.0, worst.max(ms));
            iterations += body.solver_report().0;
            touching += contacts.iter().filter(|c| c.force_n != Vec3::ZERO).count();
            deepest = contacts.iter().filter(|c| c.force_n != Vec3::ZERO).fold(0.0, |d, c| d.max(c.depth_m));
            lifted = contacts.iter().map(|c| c.force_n).sum();
        }
        let weight = body.masses().iter().sum::<f32>() * 9.81;
        println!(
            "{name:18} second {second}: {cost:6.2} ms a tick (worst {worst:5.1}), {:5.1} iterations, {:5.1} contacts; at its end {:.3} mm deep, carries {:.4} of its weight",
            f64::from(iterations) / 60.0,
            touching as f64 / 60.0,
            deepest * 1e3,
            lifted.y / weight,
        );
    }
}

fn main() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/kidney.vtu");
    let mesh = keyhole_tetmesh::vtu::read(std::path::Path::new(path)).unwrap();
    let rest: Vec<(NodeId, Vec3)> = mesh.nodes().map(|n| (n, mesh.rest(n).as_vec3())).collect();
    let (low, high) = rest.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), (_, x)| (l.min(*x), h.max(*x)));
    let end = low.x + 0.1 * (high.x - low.x);
    let holds: Vec<Hold> = rest.iter().filter(|(_, x)| x.x < end).map(|(n, x)| fix(*n, *x)).collect();
    println!("{} tetrahedra, one thread; the first second is its fall", mesh.tet_count());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let middle = (low + high) / 2.0;
    // From the side, where the kidney does not go by itself.
    let side =
        rest.iter().filter(|(_, x)| (x.x - middle.x).abs() < 0.004 && (x.y - middle.y).abs() < 0.004).fold(low.z, |z, (_, x)| z.max(x.z));
    let tool = Disc { middle: Vec3::new(middle.x, middle.y - 0.003, side + 0.001), normal: Vec3::NEG_Z, radius: 0.006, speed: 0.002 };
    let ground = Disc { middle: Vec3::new(middle.x, low.y - 0.002, middle.z), normal: Vec3::Y, radius: 1.0, speed: 0.0 };
    pool.install(|| {
        run("hangs", &mesh, &holds, None, 2);
        run("hangs, pressed", &mesh, &holds, Some(tool), 3);
        run("lies on the ground", &mesh, &[], Some(ground), 3);
    });
}
