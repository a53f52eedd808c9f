//! Tasks: what a scene says is to be reached, what counts as an error, and between which times its score lies.

use crate::format::{Scene, SceneHand, SceneSurface, Triple};
use serde::{Deserialize, Serialize};

/// What the trainee is to reach. It is finished while every goal is met.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneTask {
    /// What is to be reached, one at least.
    pub goals: Vec<SceneGoal>,
    /// What costs time. Default nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub penalties: Vec<ScenePenalty>,
    /// Between which times the score lies. Default none: then there is no score.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub score: Option<SceneScore>,
}

/// One thing that is to be reached.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneGoal {
    /// As it stands among the results.
    pub name: String,
    /// What is to be.
    pub want: SceneWant,
    /// Whether it is met for good once it has been met; otherwise it is met while it is. Default no.
    #[serde(default)]
    pub once: bool,
    /// The line of `guidance` that is ticked off when it is met, from 1. Default none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step: Option<usize>,
}

/// What can be looked for. A piece that comes free of an organ counts as it where nothing else is said.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum SceneWant {
    /// The jaws of these hands hold the organ between them, and no others.
    Held {
        /// The organ.
        organ: String,
        /// The hands.
        hands: Vec<SceneHand>,
        /// Whether it must touch no anatomy meanwhile. Default no.
        #[serde(default)]
        in_air: bool,
    },
    /// The organ lies around one of these pegs, let go of and at rest.
    Round {
        /// The organ: a ring.
        organ: String,
        /// Names of anatomy with the shape of a Cylinder.
        pegs: Vec<String>,
    },
    /// The middle of the organ, or of a part of it, is in a box.
    Lies {
        /// The organ.
        organ: String,
        /// The part: a box in the world, as the organ is at first. Default the whole.
        #[serde(default)]
        part: Option<SceneBox>,
        /// The box.
        inside: SceneBox,
        /// Whether it must be let go of and at rest. Default yes.
        #[serde(default = "default_at_rest")]
        at_rest: bool,
    },
    /// Pieces have come free of the organ.
    CutThrough {
        /// The organ.
        organ: String,
        /// How many at least. Default 1.
        #[serde(default = "default_pieces")]
        pieces: usize,
    },
    /// Nothing of a material is left in what has not come free of the organ.
    Removed {
        /// The organ.
        organ: String,
        /// One of its materials.
        material: String,
    },
    /// A piece has come free that was cut along a circle.
    CutOut {
        /// The organ.
        organ: String,
        /// The middle of the circle, m, in the world, as the organ is at first.
        centre: Triple,
        /// Across its plane; any length but 0.
        normal: Triple,
        /// Its radius, mm; above 0.
        radius_mm: f32,
        /// Largest distance of the cut from it, mm; above 0.
        within_mm: f32,
    },
    /// Clips close the whole of the organ's vessel.
    Clipped {
        /// The organ.
        organ: String,
        /// How many at least.
        clips: usize,
    },
    /// No more than this has been lost.
    BloodBelow {
        /// ml; 0 or more.
        ml: f32,
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
        /// The difference of tension that it holds at least, N; 0 or more.
        hold_n: f32,
    },
}

/// A box along the axes of the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneBox {
    /// Lowest corner, m.
    pub min: Triple,
    /// Highest corner, m.
    pub max: Triple,
}

/// What can go wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneMishap {
    /// Something was let go of and fell by more than 10 mm.
    Dropped,
    /// Millimetres by which the cut of a goal CutOut is off its circle at most.
    OffTheLine,
    /// Two instruments began to touch.
    ToolCollisions,
    /// Newton seconds of grip beyond what does harm.
    Overload,
    /// Seconds in which a tip was out of view.
    OutOfView,
    /// Square millimetres of tissue bruised.
    Bruised,
    /// Millilitres of blood.
    BloodLoss,
    /// Clips misplaced, dropped or slipped.
    ClipErrors,
    /// Bites torn out.
    StitchesTorn,
}

/// What an error costs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenePenalty {
    /// The error.
    pub error: SceneMishap,
    /// What a unit of it costs, s; above 0.
    pub seconds: f32,
}

/// Between which times a score lies: from 100 for one who is proficient to 0 at the cutoff.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum SceneScore {
    /// The times of a task of the Fundamentals of Laparoscopic Surgery.
    Published {
        /// Which.
        task: ScenePublished,
        /// The part of the task that the scene has, above 0 and at most 1: its times are taken by this. Default 1.
        #[serde(default = "default_share")]
        share: f32,
    },
    /// Times of the author's own.
    Own {
        /// Time after which the score is 0, s.
        cutoff_s: f32,
        /// Time of one who is proficient, s; above 0 and below the cutoff.
        proficient_s: f32,
    },
}

/// A task with published proficiency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScenePublished {
    /// Six objects there and back: 300 s, 48 s.
    PegTransfer,
    /// A circle out of gauze: 300 s, 98 s.
    PatternCut,
    /// A loop around an appendage: 180 s, 53 s.
    LigatingLoop,
    /// A stitch with its knot tied outside: 420 s, 136 s.
    ExtracorporealKnot,
    /// A stitch with its knot tied inside: 600 s, 112 s.
    IntracorporealKnot,
}

impl ScenePublished {
    /// All.
    pub const ALL: [Self; 5] =
        [Self::PegTransfer, Self::PatternCut, Self::LigatingLoop, Self::ExtracorporealKnot, Self::IntracorporealKnot];

    /// Its name in files of results.
    #[must_use]
    pub fn id(self) -> &'static str {
        match self {
            Self::PegTransfer => "peg_transfer",
            Self::PatternCut => "pattern_cut",
            Self::LigatingLoop => "ligating_loop",
            Self::ExtracorporealKnot => "extracorporeal_knot",
            Self::IntracorporealKnot => "intracorporeal_knot",
        }
    }
}

fn default_pieces() -> usize {
    1
}

fn default_at_rest() -> bool {
    true
}

fn default_share() -> f32 {
    1.0
}

/// The paths of values below a task, and what is wrong with each.
#[derive(Default)]
struct Found(Vec<(String, String)>);

impl Found {
    fn say(&mut self, path: String, message: impl Into<String>) {
        self.0.push((path, message.into()));
    }

    fn least(&mut self, path: String, value: f32, unit: &str, zero_too: bool) {
        if !(value.is_finite() && (value > 0.0 || (zero_too && value == 0.0))) {
            let least = if zero_too { "0 or more" } else { "more than 0" };
            self.say(path, format!("{value} is out of range: expected {least}{unit}"));
        }
    }

    fn known<'a>(&mut self, path: String, what: &str, name: &str, there: impl Iterator<Item = &'a str>) {
        let there: Vec<&str> = there.collect();
        if !there.contains(&name) {
            let known = if there.is_empty() { "there is none".to_owned() } else { format!("there are {}", there.join(", ")) };
            self.say(path, format!("no {what} \"{name}\": {known}"));
        }
    }

    fn organ(&mut self, path: String, name: &str, scene: &Scene) {
        self.known(path, "organ", name, scene.organs.iter().map(|o| o.name.as_str()));
    }

    fn span(&mut self, path: &str, of: &SceneBox) {
        if (0..3).any(|k| of.min[k] > of.max[k] || !of.min[k].is_finite() || !of.max[k].is_finite()) {
            self.say(format!("{path}.max"), "is below `min`, or not a number: exchange them, axis by axis");
        }
    }
}

impl SceneTask {
    /// What is wrong with it in its scene: the path below the task, and what to do.
    pub(crate) fn problems(&self, scene: &Scene) -> Vec<(String, String)> {
        let mut found = Found::default();
        if self.goals.is_empty() {
            found.say("goals".into(), "there is no goal: add one or remove `task`");
        }
        for (i, goal) in self.goals.iter().enumerate() {
            let path = format!("goals[{i}]");
            if goal.name.trim().is_empty() {
                found.say(format!("{path}.name"), "the name is empty: say what is to be reached");
            }
            if let Some(step) = goal.step.filter(|step| !(1..=scene.guidance.len()).contains(step)) {
                found.say(
                    format!("{path}.step"),
                    format!("there is no line {step} of `guidance`: it has {}, counted from 1", scene.guidance.len()),
                );
            }
            goal.want.problems(&format!("{path}.want"), scene, &mut found);
        }
        for (i, penalty) in self.penalties.iter().enumerate() {
            found.least(format!("penalties[{i}].seconds"), penalty.seconds, " s", false);
            if self.penalties[..i].iter().any(|before| before.error == penalty.error) {
                found.say(format!("penalties[{i}].error"), format!("{:?} has a price already: keep one", penalty.error));
            }
            if penalty.error == SceneMishap::OffTheLine && !self.goals.iter().any(|g| matches!(g.want, SceneWant::CutOut { .. })) {
                found.say(format!("penalties[{i}].error"), "there is no line: add a goal CutOut or remove this penalty");
            }
        }
        match self.score {
            Some(SceneScore::Published { share, .. }) if !(share > 0.0 && share <= 1.0) => {
                found.say("score.share".into(), format!("{share} is out of range: expected more than 0 and up to 1"));
            }
            Some(SceneScore::Own { cutoff_s, proficient_s }) => {
                found.least("score.proficient_s".into(), proficient_s, " s", false);
                if !(cutoff_s.is_finite() && cutoff_s > proficient_s) {
                    found.say(
                        "score.cutoff_s".into(),
                        format!("{cutoff_s} s leaves no time to be slow in: expected more than `proficient_s`, {proficient_s} s"),
                    );
                }
            }
            _ => {}
        }
        found.0
    }
}

impl SceneWant {
    fn problems(&self, path: &str, scene: &Scene, found: &mut Found) {
        let organ_at = format!("{path}.organ");
        match self {
            Self::Held { organ, hands, .. } => {
                found.organ(organ_at, organ, scene);
                if hands.is_empty() {
                    found.say(format!("{path}.hands"), "there is no hand: write Left, Right or both");
                }
                for (i, hand) in hands.iter().enumerate() {
                    let holds = |tool: &crate::SceneInstrument| std::iter::once(&tool.kind).chain(&tool.exchange).any(|kind| kind.holds());
                    if !scene.instruments.iter().any(|tool| tool.hand == *hand && holds(tool)) {
                        found.say(
                            format!("{path}.hands[{i}]"),
                            format!("the hand {hand:?} has nothing that holds: give it a Grasper or a NeedleHolder"),
                        );
                    }
                }
            }
            Self::Round { organ, pegs } => {
                found.organ(organ_at, organ, scene);
                if pegs.is_empty() {
                    found.say(format!("{path}.pegs"), "there is no peg: name anatomy with the shape of a Cylinder");
                }
                for (i, peg) in pegs.iter().enumerate() {
                    let cylinders = scene.anatomy.iter().filter(|a| matches!(a.shape, Some(SceneSurface::Cylinder { .. })));
                    found.known(
                        format!("{path}.pegs[{i}]"),
                        "anatomy with the shape of a Cylinder",
                        peg,
                        cylinders.map(|a| a.name.as_str()),
                    );
                }
            }
            Self::Lies { organ, part, inside, .. } => {
                found.organ(organ_at, organ, scene);
                found.span(&format!("{path}.inside"), inside);
                if let Some(part) = part {
                    found.span(&format!("{path}.part"), part);
                }
            }
            Self::CutThrough { organ, pieces } => {
                found.organ(organ_at, organ, scene);
                if *pieces == 0 {
                    found.say(format!("{path}.pieces"), "0 pieces are no goal: expected 1 or more");
                }
            }
            Self::Removed { organ, material } => {
                found.organ(organ_at, organ, scene);
                if let Some(organ) = scene.organs.iter().find(|o| o.name == *organ) {
                    found.known(format!("{path}.material"), "material", material, organ.materials.iter().map(|m| m.name.as_str()));
                }
            }
            Self::CutOut { organ, centre, normal, radius_mm, within_mm } => {
                found.organ(organ_at, organ, scene);
                if !centre.iter().all(|v| v.is_finite()) {
                    found.say(format!("{path}.centre"), "is not a place: write three numbers, m");
                }
                if !normal.iter().all(|v| v.is_finite()) || *normal == [0.0; 3] {
                    found.say(format!("{path}.normal"), "a direction cannot be zero: write one, of any length");
                }
                found.least(format!("{path}.radius_mm"), *radius_mm, " mm", false);
                found.least(format!("{path}.within_mm"), *within_mm, " mm", false);
            }
            Self::Clipped { organ, clips } => {
                found.organ(organ_at.clone(), organ, scene);
                if scene.organs.iter().any(|o| o.name == *organ && o.vessel.is_none()) {
                    found.say(organ_at, format!("\"{organ}\" has no vessel that a clip could close: give it a `vessel`"));
                }
                if *clips == 0 {
                    found.say(format!("{path}.clips"), "0 clips are no goal: expected 1 or more");
                }
            }
            Self::BloodBelow { ml } => found.least(format!("{path}.ml"), *ml, " ml", true),
            Self::Sutured { organs } => {
                organs.iter().enumerate().for_each(|(i, organ)| found.organ(format!("{path}.organs[{i}]"), organ, scene));
                if organs.is_empty() {
                    found.say(format!("{path}.organs"), "there is no organ: name what the thread is to run through");
                }
                if scene.sutures.is_empty() {
                    found.say(path.into(), "there is no needle: add one to `sutures`");
                }
            }
            Self::Knotted { throws, hold_n } => {
                if *throws == 0 {
                    found.say(format!("{path}.throws"), "0 throws are no knot: expected 1 or more");
                }
                found.least(format!("{path}.hold_n"), *hold_n, " N", true);
                if scene.sutures.is_empty() {
                    found.say(path.into(), "there is no thread: add one to `sutures`");
                }
            }
        }
        let cuts = matches!(self, Self::CutThrough { .. } | Self::Removed { .. } | Self::CutOut { .. });
        if cuts && !scene.requirements().cutting {
            found.say(path.into(), "nothing cuts in this scene: give a hand an instrument with a blade");
        }
    }
}
