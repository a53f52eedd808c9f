//! A body that a blade cuts a hundred times while it is stepped: what comes off is a body of its own, as in the application.

use crate::study::contender::{Bout, Contender};
use bevy_math::Vec3;
use keyhole_cutting::{BatchCut, BladeSample};
use keyhole_tetmesh::{DVec3, NodeId, TetMesh, TopologyDelta};
use keyhole_tissue::Momentum;
use keyhole_tissue::adopt::adopt;
use keyhole_whiteboard::{CutSettings, OrganMaterials};

/// Samples of the blade in a tick.
const SAMPLES: usize = 3;

/// The blade's way and what it has cut off.
pub struct Carving {
    cut: BatchCut,
    strokes: Vec<BladeSample>,
    pieces: Vec<Bout>,
}

impl Carving {
    /// Before the first stroke through a mesh.
    #[must_use]
    pub fn new(mesh: &TetMesh) -> Self {
        Self { cut: BatchCut::new(mesh.clone(), CutSettings::default()), strokes: strokes(), pieces: Vec::new() }
    }

    /// The mesh as it is now.
    #[must_use]
    pub fn mesh(&self) -> &TetMesh {
        &self.cut.mesh
    }

    /// Moves the blade on, and the body and the pieces with it.
    pub fn advance(&mut self, bout: &mut Bout, contender: &Contender, materials: &OrganMaterials, drag_1_s: f32) {
        for _ in 0..SAMPLES {
            let Some(sample) = self.strokes.pop() else { break };
            let delta = self.cut.step(sample).delta;
            self.carry(bout, &delta);
            if sample.active {
                continue;
            }
            let held: Vec<NodeId> = self.cut.mesh.nodes().filter(|n| self.cut.mesh.rest(*n).x == 0.0).collect();
            let (pieces, delta) = self.cut.detach(&held);
            for piece in pieces {
                let Ok(mut own) = Bout::new(contender, &piece.mesh, materials, drag_1_s) else { continue };
                for (i, n) in piece.donor_nodes.iter().enumerate() {
                    own.state.positions[i] = bout.state.positions[n.index()];
                    own.state.velocities[i] = bout.state.velocities[n.index()];
                }
                self.pieces.push(own);
            }
            self.carry(bout, &delta);
        }
    }

    fn carry(&self, bout: &mut Bout, delta: &TopologyDelta) {
        if !delta.is_empty() {
            adopt(&mut bout.body, &mut bout.state, &self.cut.mesh, delta, |_| Momentum::default());
            bout.model.adopt(&bout.body, &self.cut.mesh, delta);
        }
    }

    /// Steps the pieces; whether all of them are finite.
    pub fn step_pieces(&mut self, gravity: Vec3, dt: f32) -> bool {
        for piece in &mut self.pieces {
            piece.tick(&[], gravity, dt);
        }
        self.pieces.iter().all(Bout::is_finite)
    }
}

/// A hundred strokes from above across the beam, 6 to 12 mm deep, at places that come again; the last first.
fn strokes() -> Vec<BladeSample> {
    let mut samples = Vec::new();
    for i in 0..100 {
        let x = 0.012 + 0.04 * (f64::from(i) * 0.618).fract();
        let depth = 0.006 + 0.006 * (f64::from(i) * 0.414).fract();
        let lean = 0.012 * ((f64::from(i) * 0.732).fract() - 0.5);
        let at = |z: f64, active: bool| BladeSample {
            t_s: f64::from(i),
            tip: DVec3::new(x + lean, 0.03 - depth, z),
            heel: DVec3::new(x, 0.04, z),
            active,
        };
        samples.extend([at(-0.002, true), at(0.015, true), at(0.032, true), at(0.032, false)]);
    }
    samples.reverse();
    samples
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use keyhole_tissue::beam;

    /// Mass is neither lost nor made: what is left of the beam and what came off it weigh what it did, and the first pieces fall.
    #[test]
    fn what_comes_off_is_not_lost() {
        let mesh = beam::beam(6, 3);
        let materials = beam::beam_material();
        let contender = Contender::default_of_the_simulator();
        let mut bout = Bout::new(&contender, &mesh, &materials, 6.0).unwrap();
        let mass = |bout: &Bout| bout.body.masses().iter().map(|m| f64::from(*m)).sum::<f64>();
        let (before, mut carving) = (mass(&bout), Carving::new(&mesh));
        for _ in 0..20 {
            carving.advance(&mut bout, &contender, &materials, 6.0);
            bout.tick(&beam::clamp(carving.mesh()), beam::GRAVITY, 1.0 / 60.0);
            assert!(bout.is_finite() && carving.step_pieces(beam::GRAVITY, 1.0 / 60.0));
        }
        let after = mass(&bout) + carving.pieces.iter().map(mass).sum::<f64>();
        assert!((after / before - 1.0).abs() < 1e-4, "{after} kg of {before}");
        assert!(carving.mesh().tet_count() > 2 * mesh.tet_count());
    }
}
