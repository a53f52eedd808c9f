//! One contact as the implicit solver has it: a force between a point of tissue and an obstacle that is a function of where the point ends up.
//!
//! With `s` the way of the point past the obstacle in a stage of `l` s, `n` the normal, `g' = min(g, 0)` where `g` is the gap where the stage begins,
//! the obstacle pushes with
//!
//! `F n = max(0, k (-(g + s . n)) - c (g + s . n - g') / l)`,
//!
//! a spring that is twice as stiff as the tissue at the point, with a damper: `c = k T + 4 m / l`, `m` the mass at the point. Nothing in it is an
//! absolute number but `T`. What follows:
//!
//! - At rest the point is `F / k` inside, whatever the step: less than the tissue around gives way by. A point that rests stays inside, so
//!   that it is found again in the next tick.
//! - What hits an obstacle stops within the stage and is not thrown back: the damper takes the spring's energy.
//! - A point that begins deep inside comes out by the part `l / (l + T)` of the way in a stage, slower and slower, however stiff the spring is; the force ends
//!   where that is reached. What it is pushed out with is lost to the damper.
//!
//! Friction is a spring of the same stiffness along the obstacle that begins where the force of the stage before left it, and slips where it pulls with more
//! than Coulomb's part of `F'`: `t = w min(1, mu F' / |w|)`, `w = t' - k s_t`, `F'` the push that was found with the last cap. What sticks stays where it is for ever,
//! for the spring keeps its force.
//!
//! Both are gradients of convex functions of the point, so that a stage stays a minimum.

use bevy_math::{Mat3A, Vec3A};
use smallvec::SmallVec;

/// Stiffness of the spring in multiples of that of the tissue at the point.
const FIRM: f32 = 2.0;

/// `T`, s: how slowly a point that is inside comes out. Two ticks: what comes out of 5 mm goes at 0.17 m/s at most.
pub(crate) const SLOW_S: f32 = 0.03;

/// Damping by inertia, in multiples of what stops the mass at the point in a stage.
const STOP: f32 = 4.0;

/// A node that takes part, with its weight: negative on the obstacle's side.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Arm {
    /// Which of the bodies that are solved together.
    pub part: u32,
    /// Its node.
    pub node: u32,
    /// Weight.
    pub weight: f32,
}

/// The contact in a stage.
#[derive(Clone, Copy, Debug, Default)]
struct Stage {
    /// Where the way begins: the sum of weight times position, m.
    base: Vec3A,
    /// How far the obstacle goes meanwhile, m.
    moved: Vec3A,
    /// Part of the way to where forces are taken that is gone by the end of the stage.
    ratio: f32,
    /// `g`, m.
    gap: f32,
    /// Force is `stiffness (level - gap at the end)` where that is positive: N/m and m.
    stiffness: f32,
    level: f32,
}

/// The contact where a step of Newton's method looks at it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Answer {
    /// Force on the tissue, N.
    pub force: Vec3A,
    /// Its part along the normal, N: below zero only where it is about to touch.
    pub push: f32,
    /// Whether it is in touch.
    pub touches: bool,
    /// How it falls with the point where forces are taken, N/m.
    pub block: Mat3A,
}

/// A contact of bodies that are solved together.
#[derive(Clone, Debug, Default)]
pub(crate) struct Touch {
    /// Its nodes.
    pub arms: SmallVec<[Arm; 8]>,
    /// The way out.
    pub normal: Vec3A,
    /// Coulomb's coefficient.
    pub friction: f32,
    /// Velocity of an obstacle that is not one of the bodies, m/s.
    pub velocity: Vec3A,
    /// `k`, N/m.
    pub spring: f32,
    /// `m`, kg.
    pub mass: f32,
    /// Gap and sum of weight times position when the tick began, m.
    pub gap: f32,
    pub begun: Vec3A,
    /// `t'`: friction at the end of the stage before, N.
    pub grip: Vec3A,
    /// The push then, N.
    pub pushed: f32,
    stage: Stage,
    line: (Vec3A, Vec3A),
    /// What it says now.
    pub now: Answer,
    /// Sum of force times time in this tick, N s.
    pub impulse: Vec3A,
}

impl Touch {
    /// Makes the spring one of the tissue that resists by `around` N/m.
    pub(crate) fn set_stiffness(&mut self, around: f32) {
        self.spring = FIRM * around;
    }

    /// Whether it joins tissue to tissue.
    pub(crate) fn joins(&self) -> bool {
        self.arms.iter().any(|a| a.weight < 0.0)
    }

    /// The gap where the sum of weight times position is `place`, `time_s` after the tick began, m.
    pub(crate) fn gap_at(&self, place: Vec3A, time_s: f32) -> f32 {
        self.gap + (place - self.begun - self.velocity * time_s).dot(self.normal)
    }

    /// Sets out on a stage of `length` s that begins at `base`, `time_s` after the tick began; forces are taken `reach` s from there.
    pub(crate) fn begin(&mut self, base: Vec3A, time_s: f32, length: f32, reach: f32) {
        let gap = self.gap_at(base, time_s);
        let damper = self.spring * SLOW_S / length + STOP * self.mass / (length * length);
        let stiffness = self.spring + damper;
        let level = if stiffness > 0.0 { gap.min(0.0) * damper / stiffness } else { 0.0 };
        self.stage = Stage { base, moved: self.velocity * length, ratio: length / reach, gap, stiffness, level };
        self.now = Answer::default();
    }

    /// Looks at it where the sum of weight times position is `place`, where forces are taken.
    pub(crate) fn look(&mut self, place: Vec3A) {
        let push = self.push_at(place);
        self.now = self.answer(place, push > 0.0);
    }

    /// Looks at it for the first step of a stage: what would push where inertia leads, at `target`, is taken to be in touch.
    pub(crate) fn look_ahead(&mut self, place: Vec3A, target: Vec3A) {
        let push = self.push_at(place);
        self.now = self.answer(place, push.max(self.push_at(target)) > 0.0);
    }

    fn push_at(&self, place: Vec3A) -> f32 {
        self.stage.stiffness * (self.stage.level - self.stage.gap - self.way(place).dot(self.normal))
    }

    fn way(&self, place: Vec3A) -> Vec3A {
        (place - self.stage.base) * self.stage.ratio - self.stage.moved
    }

    fn stick_at(&self, place: Vec3A) -> Vec3A {
        along(self.grip - self.way(place) * self.spring, self.normal)
    }

    /// The force at `place`, N.
    fn force_at(&self, place: Vec3A) -> Vec3A {
        let push = self.push_at(place).max(0.0);
        let stick = self.stick_at(place);
        let (cap, size) = (self.friction * self.pushed, stick.length());
        if push <= 0.0 {
            return Vec3A::ZERO;
        }
        self.normal * push + if size > cap { stick * (cap / size) } else { stick }
    }

    /// Makes ready to look along a line from `place` in the direction `change`; what its force does along there by the last look, and how that falls.
    pub(crate) fn set_line(&mut self, place: Vec3A, change: Vec3A) -> (f64, f64) {
        self.line = (place, change);
        (f64::from(self.now.force.dot(change)), f64::from((self.now.block * change).dot(change)))
    }

    /// Looks at it where its nodes are `shift` further along than in the last look, which was at `place`: force and how it falls.
    pub(crate) fn shifted(&self, place: Vec3A, shift: Vec3A) -> (Vec3A, Mat3A) {
        let sum: f32 = self.arms.iter().map(|a| a.weight).sum();
        let at = place + shift * sum;
        let answer = self.answer(at, self.push_at(at) > 0.0);
        (answer.force * sum, answer.block * (sum * sum))
    }

    /// What the force does along the line where `part` of it is gone.
    pub(crate) fn along_line(&self, part: f32) -> f64 {
        let (place, change) = self.line;
        f64::from(self.force_at(place + change * part).dot(change))
    }

    fn answer(&self, place: Vec3A, touches: bool) -> Answer {
        if !touches {
            return Answer::default();
        }
        let Stage { ratio, stiffness, .. } = self.stage;
        let n = self.normal;
        let push = self.push_at(place);
        let outer = |v: Vec3A| Mat3A::from_cols(v * v.x, v * v.y, v * v.z);
        let mut block = outer(n) * (stiffness * ratio);
        let mut force = n * push;
        let cap = self.friction * self.pushed;
        if cap > 0.0 {
            let stick = self.stick_at(place);
            let size = stick.length();
            let held = if size > cap { cap / size } else { 1.0 };
            force += stick * held;
            // Of what slides the least convex function above that has no kink: it never goes too far.
            let slope = Mat3A::IDENTITY - outer(n);
            block += slope * (self.spring * ratio * held);
        }
        Answer { force, push, block, touches }
    }

    /// The most that the force falls with the point anywhere, N/m.
    pub(crate) fn most_against(&self, place: Vec3A) -> Mat3A {
        self.answer(place, true).block
    }

    /// Vectors the squares of which are together [`Answer::block`], (N/m)^1/2: along the normal, then along the obstacle.
    pub(crate) fn rows(&self) -> [Vec3A; 3] {
        let (n, block) = (self.normal, self.now.block);
        let along = n.any_orthonormal_vector();
        let root = |v: Vec3A| v * (block * v).dot(v).max(0.0).sqrt();
        [root(n), root(along), root(n.cross(along))]
    }

    /// What the force is the gradient of, J.
    pub(crate) fn energy(&self, place: Vec3A) -> f64 {
        let Stage { ratio, gap, stiffness, level, .. } = self.stage;
        let way = self.way(place);
        let inside = (level - gap - way.dot(self.normal)).max(0.0);
        let cap = if inside > 0.0 { self.friction * self.pushed } else { 0.0 };
        let size = self.stick_at(place).length();
        // Huber's function.
        let rubbed = if self.spring <= 0.0 {
            0.0
        } else if size > cap {
            cap * (size - cap / 2.0) / self.spring
        } else {
            size * size / (2.0 * self.spring)
        };
        f64::from(stiffness * inside * inside / 2.0 + rubbed) / f64::from(ratio)
    }

    /// Ends a stage of `length` s: friction goes on from here.
    pub(crate) fn finish(&mut self, length: f32) {
        self.grip = along(self.now.force, self.normal);
        self.pushed = self.now.push.max(0.0);
        self.impulse += self.now.force * length;
    }

    /// What obstacles that move, and the spring of a point that is inside, may give the tissue in a stage of `length` s, J.
    pub(crate) fn work(&self, length: f32) -> f64 {
        let inside = (-self.stage.gap).max(0.0);
        f64::from(self.now.force.dot(self.velocity).abs() * length + self.spring * inside * inside / 2.0)
    }
}

/// The part of a vector that is at right angles to a unit vector.
pub(crate) fn along(v: Vec3A, normal: Vec3A) -> Vec3A {
    v - normal * v.dot(normal)
}
