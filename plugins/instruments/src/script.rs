//! The scripted demonstration: keyframes of the hands and of the view, sampled at simulated time.
//!
//! Between keyframes a point follows a cubic Hermite curve with Catmull-Rom tangents for uneven times (Catmull & Rom 1974), in
//! f64. The tangent is zero at the ends and beside a segment that stands still, so a keyframe said twice is a stop without overshoot.
//! Points of a plane stay in that plane.

use crate::error::{ScriptError, track_name};
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use keyhole_whiteboard::Hand;

/// A keyframe of a hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandKey {
    /// Time from the start, s.
    pub time_s: f64,
    /// Where the tip of the tool is (the blade's tip, the middle of the jaws), world, m.
    pub tip: Vec3,
    /// Roll about the shaft, rad.
    pub roll_rad: f32,
    /// 0 open to 1 closed.
    pub grip: f32,
    /// Whether the pedal is down from here to the next keyframe.
    pub active: bool,
}

/// A keyframe of the endoscope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewKey {
    /// Time from the start, s.
    pub time_s: f64,
    /// What is in the middle of the picture, world, m.
    pub target: Vec3,
    /// From the tip of the endoscope to the target, m.
    pub distance_m: f32,
}

/// The keyframes of one hand.
#[derive(Clone, Debug, PartialEq)]
pub struct HandTrack {
    /// Whose.
    pub hand: Hand,
    /// In order of time.
    pub keys: Vec<HandKey>,
}

/// A demonstration. Written by the app from the scene, or from a script file.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct Script {
    hands: Vec<HandTrack>,
    view: Vec<ViewKey>,
    end_s: f64,
}

impl Script {
    /// A script of hand tracks and keyframes of the view.
    ///
    /// # Errors
    /// [`ScriptError::Order`] when times do not ascend strictly, [`ScriptError::NotFinite`] for NaN or infinity.
    pub fn new(hands: Vec<HandTrack>, view: Vec<ViewKey>) -> Result<Self, ScriptError> {
        for track in &hands {
            let finite = |k: &HandKey| k.tip.is_finite() && k.roll_rad.is_finite() && k.grip.is_finite();
            check(&track_name(track.hand), &track.keys, |k| k.time_s, finite)?;
        }
        check("view", &view, |k| k.time_s, |k| k.target.is_finite() && k.distance_m.is_finite())?;
        let ends = hands.iter().filter_map(|t| t.keys.last().map(|k| k.time_s)).chain(view.last().map(|k| k.time_s));
        let end_s = ends.fold(0.0, f64::max);
        Ok(Self { hands, view, end_s })
    }

    /// Time of the last keyframe, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.end_s
    }

    /// Whether there is no keyframe at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.view.is_empty() && self.hands.iter().all(|t| t.keys.is_empty())
    }

    /// A hand at a time (s); before its first keyframe it is there, after its last it stays. `None` for a hand without keyframes.
    #[must_use]
    pub fn hand(&self, hand: Hand, time_s: f64) -> Option<HandKey> {
        let keys = &self.hands.iter().find(|t| t.hand == hand)?.keys;
        let at = Place::of(keys.len(), |i| keys[i].time_s, time_s)?;
        let point = |i: usize| keys[i].tip.as_dvec3();
        let (a, b) = (keys[at.segment], keys[at.next]);
        Some(HandKey {
            time_s,
            tip: at.curve(keys.len(), |i| keys[i].time_s, point).as_vec3(),
            roll_rad: at.linear(a.roll_rad, b.roll_rad),
            grip: at.linear(a.grip, b.grip),
            active: if at.fraction < 1.0 { a.active } else { b.active },
        })
    }

    /// The view at a time (s), as [`Script::hand`].
    #[must_use]
    pub fn view(&self, time_s: f64) -> Option<ViewKey> {
        let keys = &self.view;
        let at = Place::of(keys.len(), |i| keys[i].time_s, time_s)?;
        let target = at.curve(keys.len(), |i| keys[i].time_s, |i| keys[i].target.as_dvec3()).as_vec3();
        Some(ViewKey { time_s, target, distance_m: at.linear(keys[at.segment].distance_m, keys[at.next].distance_m) })
    }

    /// A script from CSV with the header `time_s,hand,tip_x,tip_y,tip_z,roll_rad,grip,active`: metres, `hand` is `left` or `right`,
    /// `active` 0 or 1; the lines of each hand in order of time. The view of `self` stays.
    ///
    /// # Errors
    /// [`ScriptError::Line`] with the line and what was expected, else as [`Script::new`].
    pub fn with_hands_from_csv(&self, reader: impl std::io::Read) -> Result<Self, ScriptError> {
        let mut tracks = [Hand::Left, Hand::Right].map(|hand| HandTrack { hand, keys: Vec::new() });
        let mut csv = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(reader);
        for row in csv.deserialize::<Row>() {
            let row = row.map_err(|e| {
                let line = e.position().map_or(1, csv::Position::line);
                ScriptError::Line { line, what: format!("expected time_s,hand,tip_x,tip_y,tip_z,roll_rad,grip,active: {e}") }
            })?;
            let track = usize::from(row.hand == RowHand::Right);
            tracks[track].keys.push(HandKey {
                time_s: row.time_s,
                tip: Vec3::new(row.tip_x, row.tip_y, row.tip_z),
                roll_rad: row.roll_rad,
                grip: row.grip,
                active: row.active != 0,
            });
        }
        Self::new(tracks.into_iter().filter(|t| !t.keys.is_empty()).collect(), self.view.clone())
    }
}

#[derive(serde::Deserialize)]
struct Row {
    time_s: f64,
    hand: RowHand,
    tip_x: f32,
    tip_y: f32,
    tip_z: f32,
    roll_rad: f32,
    grip: f32,
    active: u8,
}

#[derive(serde::Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
enum RowHand {
    Left,
    Right,
}

fn check<K>(track: &str, keys: &[K], time: impl Fn(&K) -> f64, finite: impl Fn(&K) -> bool) -> Result<(), ScriptError> {
    for (index, key) in keys.iter().enumerate() {
        if !finite(key) || !time(key).is_finite() {
            return Err(ScriptError::NotFinite { track: track.into(), index });
        }
        if index > 0 && time(key) <= time(&keys[index - 1]) {
            return Err(ScriptError::Order { track: track.into(), index, time_s: time(key), before_s: time(&keys[index - 1]) });
        }
    }
    Ok(())
}

/// A time's place among keyframes: the segment from `segment` to `next`, and the fraction of it.
struct Place {
    segment: usize,
    next: usize,
    fraction: f64,
}

impl Place {
    fn of(len: usize, time: impl Fn(usize) -> f64, t: f64) -> Option<Self> {
        let last = len.checked_sub(1)?;
        let after = (0..len).position(|i| time(i) > t);
        Some(match after {
            Some(0) => Self { segment: 0, next: 0, fraction: 0.0 },
            None => Self { segment: last, next: last, fraction: 0.0 },
            Some(next) => {
                let (a, b) = (time(next - 1), time(next));
                Self { segment: next - 1, next, fraction: (t - a) / (b - a) }
            }
        })
    }

    fn linear(&self, a: f32, b: f32) -> f32 {
        a + (b - a) * self.fraction as f32
    }

    fn curve(&self, len: usize, time: impl Fn(usize) -> f64, point: impl Fn(usize) -> bevy_math::DVec3) -> bevy_math::DVec3 {
        let (i, j, u) = (self.segment, self.next, self.fraction);
        if i == j {
            return point(i);
        }
        let tangent = |k: usize| {
            if k == 0 || k + 1 == len || point(k - 1) == point(k) || point(k + 1) == point(k) {
                return bevy_math::DVec3::ZERO;
            }
            (point(k + 1) - point(k - 1)) / (time(k + 1) - time(k - 1))
        };
        let h = time(j) - time(i);
        let (u2, u3) = (u * u, u * u * u);
        point(i) * (2.0 * u3 - 3.0 * u2 + 1.0)
            + tangent(i) * (h * (u3 - 2.0 * u2 + u))
            + point(j) * (3.0 * u2 - 2.0 * u3)
            + tangent(j) * (h * (u3 - u2))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    fn key(time_s: f64, tip: Vec3, active: bool) -> HandKey {
        HandKey { time_s, tip, roll_rad: 0.0, grip: 0.0, active }
    }

    fn right(keys: Vec<HandKey>) -> Result<Script, ScriptError> {
        Script::new(vec![HandTrack { hand: Hand::Right, keys }], Vec::new())
    }

    #[test]
    fn passes_its_keyframes_and_stays_in_their_plane() {
        let n = Vec3::new(1.0, 2.0, -0.5).normalize();
        let in_plane = |x: f32, y: f32, z: f32| Vec3::new(x, y, z).reject_from_normalized(n);
        let points = [in_plane(0.1, 0.0, 0.2), in_plane(0.0, 0.1, 0.0), in_plane(-0.1, 0.2, 0.05), in_plane(0.3, 0.1, 0.1)];
        let times = [0.0, 0.5, 2.0, 2.25];
        let script = right((0..4).map(|i| key(times[i], points[i], false)).collect()).unwrap();
        for i in 0..4 {
            assert!(script.hand(Hand::Right, times[i]).unwrap().tip.distance(points[i]) < 1e-6);
        }
        for k in 0..100 {
            let tip = script.hand(Hand::Right, f64::from(k) * 0.0225).unwrap().tip;
            assert!(tip.dot(n).abs() < 1e-6);
        }
        assert_eq!(script.hand(Hand::Left, 1.0), None);
        assert_eq!(script.end_s(), 2.25);
    }

    #[test]
    fn a_keyframe_said_twice_is_a_stop() {
        let keys = [(0.0, Vec3::ZERO), (1.0, Vec3::X), (2.0, Vec3::X), (3.0, Vec3::Y)].map(|(t, p)| key(t, p, t == 1.0));
        let script = right(keys.to_vec()).unwrap();
        for k in 0..=10 {
            assert_eq!(script.hand(Hand::Right, 1.0 + 0.1 * f64::from(k)).unwrap().tip, Vec3::X);
        }
        assert!(script.hand(Hand::Right, 1.5).unwrap().active);
        assert!(!script.hand(Hand::Right, 0.9).unwrap().active);
        assert!(!script.hand(Hand::Right, 2.0).unwrap().active);
    }

    #[test]
    fn times_must_ascend_and_numbers_be_finite() {
        let twice = right(vec![key(1.0, Vec3::ZERO, false), key(1.0, Vec3::X, false)]);
        assert!(matches!(twice, Err(ScriptError::Order { index: 1, .. })));
        assert!(matches!(right(vec![key(0.0, Vec3::NAN, false)]), Err(ScriptError::NotFinite { index: 0, .. })));
    }

    #[test]
    fn reads_csv_and_names_the_line() {
        let good =
            "time_s,hand,tip_x,tip_y,tip_z,roll_rad,grip,active\n0,left,0,0,0,0,0,0\n0,right,0.1,0,0,0,1,1\n1, right,0.2,0,0,0,1,1\n";
        let script = Script::default().with_hands_from_csv(good.as_bytes()).unwrap();
        assert_eq!(script.hand(Hand::Right, 0.5).unwrap().tip, Vec3::new(0.15, 0.0, 0.0));
        let bad = good.replace("0.2,0", "x,0");
        let Err(ScriptError::Line { line, .. }) = Script::default().with_hands_from_csv(bad.as_bytes()) else { panic!("must fail") };
        assert_eq!(line, 4);
    }
}
