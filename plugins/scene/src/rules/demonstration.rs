//! What must hold of keyframes.

use super::Rules;
use crate::format::*;

impl Rules {
    pub(super) fn demonstration(&mut self, scene: &Scene, demonstration: &Demonstration) {
        let seconds = demonstration.seconds;
        if !(f64::MIN_POSITIVE..=3600.0).contains(&seconds) {
            self.say("demonstration.seconds", format!("{seconds} is out of range: expected more than 0 and up to 3600 s"));
        }
        let mut hands = Vec::new();
        for (i, script) in demonstration.hands.iter().enumerate() {
            let path = format!("demonstration.hands[{i}]");
            let tool = scene.instruments.iter().find(|t| t.hand == script.hand);
            if tool.is_none() {
                let message =
                    format!("the hand {:?} holds no instrument: give it one in `instruments` or remove its keyframes", script.hand);
                self.say(&format!("{path}.hand"), message);
            }
            if hands.contains(&script.hand) {
                self.say(&format!("{path}.hand"), format!("the hand {:?} has keyframes already: put all of them in one list", script.hand));
            }
            hands.push(script.hand);
            self.times(&format!("{path}.keys"), seconds, script.keys.iter().map(|k| k.time_s));
            let port = tool.and_then(|t| scene.port(&t.port));
            for (k, key) in script.keys.iter().enumerate() {
                let path = format!("{path}.keys[{k}]");
                self.range(&format!("{path}.grip"), key.grip, 0.0, 1.0, " (open to closed)");
                self.finite(&format!("{path}.roll_deg"), &[key.roll_deg]);
                if self.finite(&format!("{path}.tip"), &key.tip)
                    && let (Some(port), Some(tool)) = (port, tool)
                {
                    let far = port.position.distance(key.tip.into());
                    let reach = tool.shaft_length_m + tool.blade_length().unwrap_or(0.0);
                    if far > reach {
                        let message =
                            format!("{far:.3} m from the port \"{}\", but the instrument reaches {reach:.3} m: bring it nearer", tool.port);
                        self.say(&format!("{path}.tip"), message);
                    }
                }
            }
        }
        if !demonstration.view.is_empty() {
            if scene.endoscope.is_none() {
                self.say("demonstration.view", "there is no endoscope to move: add `endoscope` or remove these keyframes");
            }
            self.times("demonstration.view", seconds, demonstration.view.iter().map(|k| k.time_s));
        }
        for (k, key) in demonstration.view.iter().enumerate() {
            self.finite(&format!("demonstration.view[{k}].target"), &key.target);
            self.positive(&format!("demonstration.view[{k}].distance_m"), key.distance_m, " m");
        }
    }

    fn times(&mut self, path: &str, seconds: f64, times: impl Iterator<Item = f64>) {
        let mut before = f64::NEG_INFINITY;
        let mut count = 0;
        for (k, time) in times.enumerate() {
            let path = format!("{path}[{k}].time_s");
            if !(0.0..=seconds).contains(&time) {
                self.say(&path, format!("{time} s is outside the demonstration: expected 0 to {seconds} s"));
            } else if time <= before {
                self.say(&path, format!("{time} s does not come after the keyframe before, {before} s: sort them by time"));
            }
            before = time;
            count = k + 1;
        }
        if count == 0 {
            self.say(path, "there are no keyframes: add one or remove the list");
        }
    }
}
