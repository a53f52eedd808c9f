//! What must hold of instruments, the endoscope and needles.

use super::Rules;
use crate::format::*;

/// Largest angle of a shaft from its port's inward direction, degrees.
const STEEPEST_DEG: f32 = 75.0;

impl Rules {
    pub(super) fn instruments(&mut self, scene: &Scene) {
        let (mut hands, mut taken) = (Vec::new(), Vec::new());
        for (i, tool) in scene.instruments.iter().enumerate() {
            let path = format!("instruments[{i}]");
            self.in_port(&path, scene, &tool.port, &mut taken);
            if hands.contains(&tool.hand) {
                self.say(&format!("{path}.hand"), format!("the hand {:?} holds an instrument already: use the other one", tool.hand));
            }
            hands.push(tool.hand);
            self.range(&format!("{path}.yaw_deg"), tool.yaw_deg, -STEEPEST_DEG, STEEPEST_DEG, " degrees");
            self.range(&format!("{path}.pitch_deg"), tool.pitch_deg, -STEEPEST_DEG, STEEPEST_DEG, " degrees");
            self.range(&format!("{path}.shaft_length_m"), tool.shaft_length_m, 0.05, 0.6, " m; instruments have about 0.33");
            self.range(&format!("{path}.shaft_radius_m"), tool.shaft_radius_m, 0.0005, 0.01, " m; 5 mm instruments have 0.0025");
            self.range(&format!("{path}.insertion_m"), tool.insertion_m, 0.01, 0.30, " m");
            self.friction(&path, tool.friction);
            self.blade(&path, tool);
            self.clips(&path, tool);
            self.suction(&path, tool);
        }
        if let Some(scope) = &scene.endoscope {
            self.in_port("endoscope", scene, &scope.port, &mut taken);
            self.range("endoscope.direction_of_view_deg", scope.direction_of_view_deg, 0.0, 90.0, " degrees; 0, 30, 45 and 70 are sold");
            self.range("endoscope.angle_of_view_deg", scope.angle_of_view_deg, 10.0, 140.0, " degrees; about 70 is usual");
            self.range("endoscope.yaw_deg", scope.yaw_deg, -STEEPEST_DEG, STEEPEST_DEG, " degrees");
            self.range("endoscope.pitch_deg", scope.pitch_deg, -STEEPEST_DEG, STEEPEST_DEG, " degrees");
            self.range("endoscope.insertion_m", scope.insertion_m, 0.01, 0.30, " m");
            let [k1, k2] = scope.distortion;
            self.range("endoscope.distortion", k1, -0.3, 1.0, ", the first coefficient");
            self.range("endoscope.distortion", k2, -0.15, 1.0, ", the second coefficient");
            self.range("endoscope.distortion", k1 + k2, 0.0, 1.0, ", both coefficients together");
            if let Some(seconds) = scope.fogs_in_s.filter(|s| !(*s > 0.0 && s.is_finite())) {
                self.say("endoscope.fogs_in_s", format!("{seconds} is out of range: expected a time above 0, or leave it out"));
            }
            if let Some(base) = scope.stereo_base_mm {
                self.range("endoscope.stereo_base_mm", base, 0.1, 10.0, " mm; 4 to 5 are usual");
            }
        }
    }

    fn clips(&mut self, path: &str, tool: &SceneInstrument) {
        let Some(clips) = tool.clips else { return };
        if tool.kind == SceneInstrumentKind::ClipApplier {
            self.below(&format!("{path}.clips"), clips.problems());
        } else {
            self.say(&format!("{path}.clips"), "only a ClipApplier has clips: remove this field or change `kind`");
        }
    }

    fn suction(&mut self, path: &str, tool: &SceneInstrument) {
        let Some(suction) = tool.suction else { return };
        if tool.kind == SceneInstrumentKind::Suction {
            self.below(&format!("{path}.suction"), suction.problems());
        } else {
            self.say(&format!("{path}.suction"), "only a Suction takes anything up: remove this field or change `kind`");
        }
    }

    fn blade(&mut self, path: &str, tool: &SceneInstrument) {
        let old = format!("{path}.blade_length_m");
        for (given, path) in [(tool.blade.is_some(), format!("{path}.blade")), (tool.blade_length_m.is_some(), old.clone())] {
            if given && !tool.kind.cuts() {
                self.say(&path, format!("a {} has no blade: remove this field", tool.kind.spoken()));
            }
        }
        if !tool.kind.cuts() {
            return;
        }
        if let Some(length) = tool.blade_length_m {
            self.range(&old, length, 0.001, 0.2, " m");
        }
        let Some(blade) = tool.blade else { return };
        if let Some(length) = blade.length_mm {
            self.range(&format!("{path}.blade.length_mm"), length, 1.0, 200.0, " mm");
            if tool.blade_length_m.is_some() {
                self.say(&old, "the length is given twice: keep `length_mm` in `blade` and remove this field");
            }
        }
        self.range(&format!("{path}.blade.kerf_mm"), blade.kerf_mm, 0.0, 3.0, " mm; 0 is a cold blade");
        if blade.trigger == Some(SceneTrigger::Closing) && !tool.kind.closes() {
            let message = format!("a {} has no jaws that could close: write Pedal or remove this field", tool.kind.spoken());
            self.say(&format!("{path}.blade.trigger"), message);
        }
    }

    pub(super) fn suture(&mut self, path: &str, suture: &SceneSuture, scene: &Scene) {
        self.placement(&format!("{path}.transform"), &suture.transform);
        self.range(&format!("{path}.needle_mm"), suture.needle_mm, 3.0, 100.0, " mm along the wire; 26 is usual");
        self.range(&format!("{path}.arc_deg"), suture.arc_deg, 60.0, 300.0, " degrees; a half circle has 180");
        self.range(&format!("{path}.wire_mm"), suture.wire_mm, 0.05, 2.0, " mm across; a needle of 26 mm has about 0.66");
        self.range(&format!("{path}.thread_mm"), suture.thread_mm, 0.01, 1.0, " mm across; gauge 2-0 has 0.3");
        // Shorter than that it is no chain: its points lie a few millimetres apart.
        self.range(&format!("{path}.thread_m"), suture.thread_m, 0.02, 1.5, " m");
        self.direction(&format!("{path}.towards"), suture.towards);
        let Some(hand) = suture.held_by else { return };
        match scene.instruments.iter().find(|t| t.hand == hand) {
            None => self.say(&format!("{path}.held_by"), format!("the hand {hand:?} holds no instrument: give it one in `instruments`")),
            Some(tool) if !tool.kind.holds() => {
                self.say(&format!("{path}.held_by"), format!("a {} holds no needle: use a NeedleHolder or a Grasper", tool.kind.spoken()));
            }
            Some(_) if scene.sutures.iter().take_while(|s| !std::ptr::eq(*s, suture)).any(|s| s.held_by == Some(hand)) => {
                self.say(&format!("{path}.held_by"), format!("the hand {hand:?} has a needle already: one is enough"));
            }
            Some(_) => {}
        }
    }

    fn in_port<'a>(&mut self, path: &str, scene: &Scene, port: &'a str, taken: &mut Vec<&'a str>) {
        let path = format!("{path}.port");
        if scene.ports.iter().all(|p| p.name != port) {
            let names: Vec<&str> = scene.ports.iter().map(|p| p.name.as_str()).collect();
            let known = if names.is_empty() { "there are no ports: add one".into() } else { format!("there are {}", names.join(", ")) };
            self.say(&path, format!("no port \"{port}\": {known}"));
        } else if taken.contains(&port) {
            self.say(&path, format!("the port \"{port}\" is in use already: each instrument and the endoscope need their own"));
        }
        taken.push(port);
    }
}
