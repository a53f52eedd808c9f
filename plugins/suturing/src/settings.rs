//! What thread, needle, tissue and knots are like.

use crate::chain::ThreadLaw;
use crate::knots::KnotLaw;
use bevy_ecs::prelude::*;
use bevy_math::DVec3;

/// What thread, needle, tissue and knots are like.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct SutureSettings {
    /// The thread. Default braided silk 2-0 of 0.3 mm: a modulus of 8.7 GPa (Naleway et al. 2015, doi 10.1002/jbm.b.33171) gives 615 N per strain, 1.3 g/cm3 a mass of
    /// 92 mg/m. How it bends is assumed: 5e-9 N m2, so that 3 cm of it droop under their weight.
    pub thread: ThreadLaw,
    /// Length of thread between two of its points, m. Default 2.5 mm.
    pub segment_m: f32,
    /// Substeps of the thread in a tick. Default 4.
    pub substeps: u32,
    /// Compliance of tissue around a hole, m/N. Default 1e-3: beyond what the mesh resolves.
    pub compliance_m_n: f32,
    /// Drag of a hole on the wire of the needle, N. Default 0.15, assumed.
    pub needle_drag_n: f32,
    /// Drag of a hole on the thread, N. Default 0.05, assumed.
    pub thread_drag_n: f32,
    /// Coulomb's coefficient of the thread on tissue, where it turns. Default 0.2, assumed.
    pub friction: f32,
    /// Force at which a bite tears out, per length of tissue between it and the surface in the direction of the pull, N/m. What tears out a suture grows with the size of the bite and the thickness of the tissue,
    /// not with the thread (PMID 2530644, linea alba); that it is proportional is assumed, as is the default for soft parenchyma: 300 N/m, 1.5 N for 5 mm.
    pub tear_n_m: f32,
    /// The knot. Default: polyfilament 2-0, loops of which hold 10 N with two turns and 18 N with three (doi 10.3390/jcm12196418); one turn by the same law 4.2 N.
    pub knot: KnotLaw,
    /// Tension of both strands at which a loop is being pulled tight, N. Default 0.05.
    pub tighten_n: f32,
    /// Tension at which jaws lose the thread, N. Default 14: it would break in its knot (USP, 2-0 silk).
    pub grip_n: f32,
}

impl Default for SutureSettings {
    fn default() -> Self {
        let thread = ThreadLaw {
            line_density_kg_m: 9.2e-5,
            stretch_n: 615.0,
            bending_n_m2: 5e-9,
            damping_1_s: 10.0,
            gravity: DVec3::ZERO,
            end_mass_kg: 0.0,
        };
        Self {
            thread,
            segment_m: 0.0025,
            substeps: 4,
            compliance_m_n: 1e-3,
            needle_drag_n: 0.15,
            thread_drag_n: 0.05,
            friction: 0.2,
            tear_n_m: 300.0,
            knot: KnotLaw { scale_n: 5.53, growth: 1.38, run_n: 0.05 },
            tighten_n: 0.05,
            grip_n: 14.0,
        }
    }
}
