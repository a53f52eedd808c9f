//! From what a scene says is to be reached to what assessment looks for.

use bevy::math::DVec3;
use bevy::prelude::*;
use keyhole_assessment::{Circle, Goal, MetricId, Penalty, Scale, Span, Standard, Task, Want};
use keyhole_scene::{Scene, SceneBox, SceneHand, SceneMishap, SceneScore, SceneSurface, SceneTask, SceneWant, Triple};

/// The task of a scene; none where it has none.
#[must_use]
pub fn task(scene: &Scene) -> Task {
    let Some(SceneTask { goals, penalties, score }) = &scene.task else { return Task::default() };
    Task {
        goals: goals
            .iter()
            .map(|goal| Goal {
                name: goal.name.clone(),
                want: want(scene, &goal.want),
                once: goal.once,
                step: goal.step.map(|line| line.saturating_sub(1)),
            })
            .collect(),
        penalties: penalties.iter().map(|p| Penalty { metric: metric(p.error), seconds: f64::from(p.seconds) }).collect(),
        scale: score.and_then(scale),
    }
}

fn place(triple: Triple) -> DVec3 {
    Vec3::from_array(triple).as_dvec3()
}

fn span(of: &SceneBox) -> Span {
    [place(of.min), place(of.max)]
}

fn want(scene: &Scene, want: &SceneWant) -> Want {
    match want.clone() {
        SceneWant::Held { organ, hands, in_air } => Want::Held { organ, hands: hands.into_iter().map(SceneHand::hand).collect(), in_air },
        SceneWant::Round { organ, pegs } => Want::Round { organ, pegs: pegs.iter().filter_map(|peg| axis(scene, peg)).collect() },
        SceneWant::Lies { organ, part, inside, at_rest } => {
            Want::Lies { organ, part: part.as_ref().map(span), inside: span(&inside), at_rest }
        }
        SceneWant::CutThrough { organ, pieces } => Want::CutThrough { organ, pieces },
        SceneWant::Removed { organ, material } => Want::Removed { organ, material },
        SceneWant::CutOut { organ, centre, normal, radius_mm, within_mm } => {
            let normal = place(normal).normalize_or(DVec3::Y);
            let circle = Circle { centre: place(centre), normal, radius_m: f64::from(radius_mm) * 1e-3 };
            Want::CutOut { organ, circle, within_m: f64::from(within_mm) * 1e-3 }
        }
        SceneWant::Clipped { organ, clips } => Want::Clipped { organ, clips },
        SceneWant::BloodBelow { ml } => Want::BloodBelow { ml: f64::from(ml) },
        SceneWant::Sutured { organs } => Want::Sutured { organs },
        SceneWant::Knotted { throws, hold_n } => Want::Knotted { throws, hold_n: f64::from(hold_n) },
    }
}

/// The axis of a cylinder, from end to end.
fn axis(scene: &Scene, name: &str) -> Option<Span> {
    let anatomy = scene.anatomy.iter().find(|a| a.name == name)?;
    let Some(SceneSurface::Cylinder { height, .. }) = anatomy.shape else { return None };
    Some([-0.5, 0.5].map(|end| anatomy.transform.apply(DVec3::Y * end * f64::from(height))))
}

fn metric(error: SceneMishap) -> MetricId {
    match error {
        SceneMishap::Dropped => MetricId::Dropped,
        SceneMishap::OffTheLine => MetricId::OffTheLine,
        SceneMishap::ToolCollisions => MetricId::ToolCollisions,
        SceneMishap::Overload => MetricId::Overload,
        SceneMishap::OutOfView => MetricId::OutOfView,
        SceneMishap::Bruised => MetricId::Bruised,
        SceneMishap::BloodLoss => MetricId::BloodLoss,
        SceneMishap::ClipErrors => MetricId::ClipErrors,
        SceneMishap::StitchesTorn => MetricId::StitchesTorn,
    }
}

fn scale(score: SceneScore) -> Option<Scale> {
    match score {
        SceneScore::Published { task, share } => Standard::of(task.id()).map(|standard| standard.scale(f64::from(share))),
        SceneScore::Own { cutoff_s, proficient_s } => Some(Scale::own(f64::from(cutoff_s), f64::from(proficient_s))),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use keyhole_scene::{ScenePublished, parse};

    #[test]
    fn every_published_task_has_its_times() {
        for task in ScenePublished::ALL {
            assert_eq!(scale(SceneScore::Published { task, share: 0.5 }).unwrap().task, task.id());
        }
    }

    #[test]
    fn a_peg_stands_where_its_cylinder_does() {
        let text = r#"(version: 1, name: "s", organs: [], anatomy: [
            (name: "peg", shape: Cylinder(radius: 0.003, height: 0.02), colour: (0, 0, 0), transform: (translation: (0.1, 0.0, 0.0), rotation_deg: (0, 0, 90)))])"#;
        let [from, to] = axis(&parse(text).unwrap(), "peg").unwrap();
        assert!(from.distance(DVec3::new(0.11, 0.0, 0.0)) < 1e-6 && to.distance(DVec3::new(0.09, 0.0, 0.0)) < 1e-6, "{from} {to}");
    }
}
