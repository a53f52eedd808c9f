//! What a task consists of.

use crate::metrics::MetricId;
use crate::score::Scale;
use bevy_ecs::prelude::*;
use bevy_math::DVec3;
use keyhole_whiteboard::Hand;

/// The task of the scene. Written by the app from the scene; by default there is none.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct Task {
    /// What is to be reached. The task is finished while every one is met.
    pub goals: Vec<Goal>,
    /// What costs time.
    pub penalties: Vec<Penalty>,
    /// Between which times the score lies; `None`: there is no score.
    pub scale: Option<Scale>,
}

/// One thing that is to be reached.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// Name for reading.
    pub name: String,
    /// What is to be.
    pub want: Want,
    /// Whether it is met for good once it has been met; otherwise it is met while it is.
    pub once: bool,
    /// The step of the guidance that it belongs to, from 0.
    pub step: Option<usize>,
}

/// A line's two ends, m, in the world.
pub type Span = [DVec3; 2];

/// A circle in an organ's rest shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Its middle, m.
    pub centre: DVec3,
    /// Unit vector across its plane.
    pub normal: DVec3,
    /// Its radius, m.
    pub radius_m: f64,
}

/// What can be looked for. Organs and materials are named as in the scene; pieces of an organ count as it where nothing else is said.
#[derive(Clone, Debug, PartialEq)]
pub enum Want {
    /// The jaws of these hands hold the organ, and no others.
    Held {
        /// The organ.
        organ: String,
        /// The hands.
        hands: Vec<Hand>,
        /// Whether anatomy must not push it meanwhile.
        in_air: bool,
    },
    /// The organ lies around one of these lines, let go of and at rest: see [`super::judge::is_round`].
    Round {
        /// The organ.
        organ: String,
        /// From end to end.
        pegs: Vec<Span>,
    },
    /// The middle of a part of the organ is in a box.
    Lies {
        /// The organ.
        organ: String,
        /// The part: lowest and highest corner of a box in the rest shape, m; `None`: the whole.
        part: Option<Span>,
        /// Lowest and highest corner of the box, m.
        inside: Span,
        /// Whether it must be let go of and at rest.
        at_rest: bool,
    },
    /// So many pieces have come free of the organ.
    CutThrough {
        /// The organ.
        organ: String,
        /// How many.
        pieces: usize,
    },
    /// Nothing of a material is left in what has not come free of the organ.
    Removed {
        /// The organ.
        organ: String,
        /// The material.
        material: String,
    },
    /// A piece has been cut out of the organ along a circle: see [`super::judge::off_circle_m`].
    CutOut {
        /// The organ.
        organ: String,
        /// The circle.
        circle: Circle,
        /// Largest distance from it that is good enough, m.
        within_m: f64,
    },
    /// So many clips close the whole of the organ's vessel.
    Clipped {
        /// The organ.
        organ: String,
        /// How many.
        clips: usize,
    },
    /// No more than this has been lost, ml.
    BloodBelow {
        /// ml.
        ml: f64,
    },
    /// One suture runs through all of these organs.
    Sutured {
        /// The organs.
        organs: Vec<String>,
    },
    /// A knot holds.
    Knotted {
        /// Throws at least.
        throws: usize,
        /// The difference of tension that it holds at least, N.
        hold_n: f64,
    },
}

/// What an error costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Penalty {
    /// The error.
    pub metric: MetricId,
    /// What a unit of it costs, s; figures of both hands are added.
    pub seconds: f64,
}

/// How a goal stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GoalStatus {
    /// Whether it is met.
    pub met: bool,
    /// Since when it has been, s since the scene began; that of the last time where it was met and is no longer.
    pub since_s: Option<f64>,
}

/// How the task stands. Written by assessment, ten times a second.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct TaskStatus {
    /// In the order of [`Task::goals`].
    pub goals: Vec<GoalStatus>,
    /// Since when all goals are met, s since the scene began; `None` while one is not.
    pub finished_s: Option<f64>,
    /// How often something was let go of and fell; `None` where there are no jaws.
    pub drops: Option<u32>,
    /// How far what was cut out is off its circle at most, m; `None` while nothing has been cut out, or there is no circle.
    pub off_circle_m: Option<f64>,
}

impl TaskStatus {
    /// Whether every goal of a step is met; `None` for a step without goals.
    #[must_use]
    pub fn step_done(&self, task: &Task, step: usize) -> Option<bool> {
        let mut of_step = task.goals.iter().zip(&self.goals).filter(|(goal, _)| goal.step == Some(step)).map(|(_, status)| status.met);
        let first = of_step.next()?;
        Some(of_step.fold(first, |all, met| all && met))
    }

    /// Takes what was found of each goal at a time (s since the scene began).
    pub(crate) fn take(&mut self, task: &Task, found: &[bool], now_s: f64) {
        self.goals.resize(task.goals.len(), GoalStatus::default());
        for ((goal, status), found) in task.goals.iter().zip(&mut self.goals).zip(found) {
            let met = *found || (goal.once && status.met);
            if met && !status.met {
                status.since_s = Some(now_s);
            }
            status.met = met;
        }
        let all = !self.goals.is_empty() && self.goals.iter().all(|g| g.met);
        self.finished_s = all.then(|| self.finished_s.unwrap_or(now_s));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A goal that must last, and one that is met for good; the task is finished since the last time at which both came to be met.
    #[test]
    fn goals_last_or_are_met_once() {
        let goal = |once, step| Goal { name: "g".into(), want: Want::BloodBelow { ml: 1.0 }, once, step };
        let task = Task { goals: vec![goal(false, Some(0)), goal(true, Some(1)), goal(true, Some(1))], ..Task::default() };
        let mut status = TaskStatus::default();
        let mut at = |now_s, found: [bool; 3]| {
            status.take(&task, &found, now_s);
            (status.goals.iter().map(|g| g.met).collect::<Vec<_>>(), status.finished_s, [0, 1, 2].map(|s| status.step_done(&task, s)))
        };
        assert_eq!(at(0.0, [false; 3]), (vec![false; 3], None, [Some(false), Some(false), None]));
        assert_eq!(at(1.0, [true, true, false]), (vec![true, true, false], None, [Some(true), Some(false), None]));
        assert_eq!(at(2.0, [true, false, true]), (vec![true; 3], Some(2.0), [Some(true), Some(true), None]));
        assert_eq!(at(3.0, [true, false, false]).1, Some(2.0));
        assert_eq!(at(4.0, [false; 3]), (vec![false, true, true], None, [Some(false), Some(true), None]));
        assert_eq!(at(5.0, [true; 3]).1, Some(5.0));
        assert_eq!(status.goals.iter().map(|g| g.since_s).collect::<Vec<_>>(), [Some(5.0), Some(1.0), Some(2.0)]);
    }
}
