//! The figures that the HUD shows, gathered from the whiteboard.

use bevy::prelude::*;
use keyhole_whiteboard::{FreedFrom, Organ, TickCost, TickSystems, TissueMesh};
use std::time::Duration;

/// Cost of one stage, ms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageFigures {
    /// The stage.
    pub stage: TickSystems,
    /// In the last tick.
    pub last_ms: f64,
    /// Over all ticks.
    pub mean_ms: f64,
    /// Largest of any tick.
    pub max_ms: f64,
}

/// Cost of the stages that have cost anything to speak of, in order.
#[must_use]
pub fn stages(cost: &TickCost) -> Vec<StageFigures> {
    TickSystems::ALL
        .into_iter()
        .enumerate()
        .map(|(i, stage)| StageFigures {
            stage,
            last_ms: milliseconds(cost.last[i]),
            mean_ms: milliseconds(cost.total[i]) / cost.ticks.max(1) as f64,
            max_ms: milliseconds(cost.max[i]),
        })
        // A stage without a system costs less than a microsecond.
        .filter(|figures| figures.max_ms >= 0.002)
        .collect()
}

/// A duration in ms.
#[must_use]
pub fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// Size of everything soft.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshFigures {
    /// Organs that are no fragments.
    pub organs: usize,
    /// Fragments.
    pub fragments: usize,
    /// Tetrahedra of all.
    pub tets: usize,
    /// Nodes of all.
    pub nodes: usize,
}

/// Counts again.
pub fn count(mut figures: ResMut<MeshFigures>, organs: Query<(&TissueMesh, Has<FreedFrom>), With<Organ>>) {
    let mut now = MeshFigures::default();
    for (mesh, freed) in &organs {
        *(if freed { &mut now.fragments } else { &mut now.organs }) += 1;
        now.tets += mesh.0.tet_count();
        now.nodes += mesh.0.node_count();
    }
    figures.set_if_neq(now);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_over_all_ticks_and_idle_stages_are_left_out() {
        let mut cost = TickCost::default();
        cost.ticks = 4;
        cost.last[5] = Duration::from_micros(3000);
        cost.total[5] = Duration::from_micros(8000);
        cost.max[5] = Duration::from_micros(5000);
        cost.total[6] = Duration::from_nanos(800);
        cost.max[6] = Duration::from_nanos(300);
        assert_eq!(stages(&cost), [StageFigures { stage: TickSystems::Tissue, last_ms: 3.0, mean_ms: 2.0, max_ms: 5.0 }]);
        assert!(stages(&TickCost::default()).is_empty());
    }
}
