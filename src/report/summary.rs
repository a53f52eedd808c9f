//! What stands in `summary.json`, and the same for reading in `summary.md`.

use crate::report::bleeding::Bleeding;
use crate::report::cost::{Cost, Costs};
use keyhole_whiteboard::CutSettings;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// How a performance went. Lengths are metres, masses kilograms, times seconds unless a name says otherwise.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Summary {
    /// Name of the scene.
    pub scene: String,
    /// Ticks performed.
    pub ticks: u64,
    /// Simulated time, s.
    pub simulated_s: f64,
    /// Settings of cutting.
    pub cutting: Cutting,
    /// Size of the meshes of all organs.
    pub mesh: MeshSize,
    /// What was cut.
    pub cut: Cut,
    /// What came free, in the order it did.
    pub fragments: Vec<Fragment>,
    /// Clips and blood; left out where there are neither vessels nor clips.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bleeding: Option<Bleeding>,
    /// What topology changes did to linear momentum.
    pub momentum: MomentumChange,
    /// Cost of the whole tick, ms.
    pub tick_cost_ms: Cost,
    /// Cost of each stage, ms.
    pub stage_cost_ms: BTreeMap<String, Cost>,
    /// Organs that left the finite numbers and were frozen, by name.
    pub quarantined: Vec<String>,
    /// Digest of the final state: see [`crate::report::digest`].
    pub digest: String,
    /// What the pictures were drawn with, or why there are none.
    pub pictures: String,
}

/// Settings of cutting by name.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Cutting {
    /// Release policy.
    pub method: String,
    /// Pattern in the hull.
    pub hull: String,
    /// Pattern in the core.
    pub core: String,
    /// Snapping, as a part of an edge.
    pub snap: f64,
}

impl From<&CutSettings> for Cutting {
    fn from(s: &CutSettings) -> Self {
        Self { method: format!("{:?}", s.method), hull: format!("{:?}", s.hull), core: format!("{:?}", s.core), snap: s.snap }
    }
}

/// Tetrahedra and nodes of all organs before the first tick and after the last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MeshSize {
    /// Tetrahedra before.
    pub tets_before: usize,
    /// Tetrahedra after.
    pub tets_after: usize,
    /// Nodes before.
    pub nodes_before: usize,
    /// Nodes after.
    pub nodes_after: usize,
}

/// Operations on tetrahedra, as [`keyhole_whiteboard::CutStatus`] counts them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Cut {
    /// Removed.
    pub deleted: u64,
    /// Created.
    pub created: u64,
    /// Changed in place.
    pub updated: u64,
    /// Events taken back.
    pub deferred: u64,
    /// Strokes that ended.
    pub strokes: u32,
    /// Pieces that came free.
    pub fragments: u32,
}

/// A piece that came free.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Fragment {
    /// Its name.
    pub name: String,
    /// When it came free, s.
    pub freed_at_s: f64,
    /// Its mass, kg.
    pub mass_kg: f64,
    /// Whether something holds it to the end.
    pub held: bool,
    /// How far its centre of mass has moved along gravity since nothing holds it, m.
    pub fallen_m: f64,
    /// Largest distance of its centre of mass from `c + v t + g t2 / 2` with `c` and `v` of the tick since which nothing
    /// holds it, until something touches it, m; `null` while something holds it.
    pub off_free_fall_m: Option<f64>,
    /// When something first pushed it since nothing holds it, s; `null` until then.
    pub touched_at_s: Option<f64>,
    /// Speed of its centre of mass at the end, m/s.
    pub speed_m_s: f64,
    /// Its centre of mass over time, ten times a second: time since the start (s), x, y, z (m).
    pub centre_of_mass: Vec<[f64; 4]>,
}

/// Relative changes of linear momentum at topology changes: the largest of all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct MomentumChange {
    /// What lumping the masses anew would have changed.
    pub largest_jump: f64,
    /// What was left after it had been given back.
    pub largest_error: f64,
}

impl Summary {
    /// Takes the costs over.
    pub fn set_costs(&mut self, costs: &Costs) {
        self.tick_cost_ms = costs.tick();
        self.stage_cost_ms = costs.by_stage();
    }

    /// For reading: a page of Markdown.
    #[must_use]
    pub fn markdown(&self, costs: &Costs) -> String {
        let mut page = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_markdown(&mut page, costs);
        page
    }

    fn write_markdown(&self, w: &mut String, costs: &Costs) -> std::fmt::Result {
        let Self { mesh, cut, cutting, momentum, .. } = self;
        writeln!(w, "# {}\n", self.scene)?;
        writeln!(w, "{} ticks, {:.2} s simulated.\n", self.ticks, self.simulated_s)?;
        writeln!(w, "| | before | after |\n|---|---:|---:|")?;
        writeln!(
            w,
            "| tetrahedra | {} | {} |\n| nodes | {} | {} |\n",
            mesh.tets_before, mesh.tets_after, mesh.nodes_before, mesh.nodes_after
        )?;
        writeln!(
            w,
            "Cutting: {}, patterns {} (hull) and {} (core), snap {}. {} strokes; {} tetrahedra deleted, {} created, {} updated, {} events \
             deferred; {} pieces came free.\n",
            cutting.method,
            cutting.hull,
            cutting.core,
            cutting.snap,
            cut.strokes,
            cut.deleted,
            cut.created,
            cut.updated,
            cut.deferred,
            cut.fragments
        )?;
        if !self.fragments.is_empty() {
            writeln!(
                w,
                "| fragment | freed at / s | mass / g | fallen / mm | off free fall / mm | touched at / s | speed at the end / m/s |\n|---|---:|---:|---:|---:|---:|---:|"
            )?;
            for f in &self.fragments {
                let off = f.off_free_fall_m.map_or("held".into(), |m| format!("{:.3}", m * 1e3));
                let touched = f.touched_at_s.map_or("never".into(), |s| format!("{s:.3}"));
                writeln!(
                    w,
                    "| {} | {:.3} | {:.3} | {:.2} | {off} | {touched} | {:.4} |",
                    f.name,
                    f.freed_at_s,
                    f.mass_kg * 1e3,
                    f.fallen_m * 1e3,
                    f.speed_m_s
                )?;
            }
            writeln!(w)?;
        }
        if let Some(bleeding) = &self.bleeding {
            writeln!(w, "{}\n", bleeding.sentence())?;
        }
        writeln!(
            w,
            "Momentum: topology changes would have changed it by up to {:.2e} of itself; given back, {:.2e} is left.\n",
            momentum.largest_jump, momentum.largest_error
        )?;
        writeln!(w, "| stage / ms | mean | p50 | p99 | max |\n|---|---:|---:|---:|---:|")?;
        for (stage, c) in costs.stages().into_iter().chain([("whole tick".into(), costs.tick())]) {
            writeln!(w, "| {stage} | {:.3} | {:.3} | {:.3} | {:.3} |", c.mean, c.p50, c.p99, c.max)?;
        }
        for organ in &self.quarantined {
            writeln!(w, "\n**{organ} left the finite numbers and was frozen.**")?;
        }
        writeln!(w, "\nDigest of the final state: `{}`\n\nPictures: {}", self.digest, self.pictures)
    }
}
