//! What must hold of the values of a scene. Each broken rule is reported with the path of its value.

mod demonstration;
mod tissue;
mod tools;

use crate::format::*;
use crate::load::version_problem;
use std::collections::BTreeSet;
use std::path::Path;

/// The path of a value, and what is wrong with it.
type Found = Vec<(String, String)>;

/// Every broken rule; `folder` is that of the scene's file.
pub(crate) fn problems(scene: &Scene, folder: &Path) -> Found {
    let mut rules = Rules(Vec::new());
    rules.whole(scene);
    rules.unique("organs", scene.organs.iter().map(|o| o.name.as_str()));
    for (i, organ) in scene.organs.iter().enumerate() {
        rules.organ(&format!("organs[{i}]"), organ, folder);
    }
    rules.unique("anatomy", scene.anatomy.iter().map(|a| a.name.as_str()));
    for (i, anatomy) in scene.anatomy.iter().enumerate() {
        rules.anatomy(&format!("anatomy[{i}]"), anatomy, folder);
    }
    rules.unique("ports", scene.ports.iter().map(|p| p.name.as_str()));
    for (i, port) in scene.ports.iter().enumerate() {
        rules.finite(&format!("ports[{i}].position"), &port.position);
        rules.direction(&format!("ports[{i}].inward"), port.inward);
    }
    rules.instruments(scene);
    for (i, suture) in scene.sutures.iter().enumerate() {
        rules.suture(&format!("sutures[{i}]"), suture, scene);
    }
    if let Some(task) = &scene.task {
        rules.below("task", task.problems(scene));
    }
    if let Some(demonstration) = &scene.demonstration {
        rules.demonstration(scene, demonstration);
    }
    rules.0
}

struct Rules(Found);

impl Rules {
    fn say(&mut self, path: &str, message: impl Into<String>) {
        self.0.push((path.to_owned(), message.into()));
    }

    fn finite(&mut self, path: &str, values: &[f32]) -> bool {
        let bad = values.iter().position(|v| !v.is_finite());
        if let Some(i) = bad {
            let path = if values.len() > 1 { format!("{path}[{i}]") } else { path.to_owned() };
            self.say(&path, format!("{} is not a finite number: write one", values[i]));
        }
        bad.is_none()
    }

    fn range(&mut self, path: &str, value: f32, low: f32, high: f32, unit: &str) {
        if self.finite(path, &[value]) && !(low..=high).contains(&value) {
            self.say(path, format!("{value} is out of range: expected {low} to {high}{unit}"));
        }
    }

    fn positive(&mut self, path: &str, value: f32, unit: &str) {
        if self.finite(path, &[value]) && value <= 0.0 {
            self.say(path, format!("{value} is out of range: expected more than 0{unit}"));
        }
    }

    fn direction(&mut self, path: &str, value: Triple) {
        if self.finite(path, &value) && value == [0.0; 3] {
            self.say(path, "a direction cannot be zero: write one, of any length");
        }
    }

    fn colour(&mut self, path: &str, colour: Triple) {
        for (i, c) in colour.into_iter().enumerate() {
            self.range(&format!("{path}[{i}]"), c, 0.0, 1.0, " (linear RGB)");
        }
    }

    fn placement(&mut self, path: &str, placement: &Placement) {
        self.finite(&format!("{path}.translation"), &placement.translation);
        self.finite(&format!("{path}.rotation_deg"), &placement.rotation_deg);
    }

    fn unique<'a>(&mut self, list: &str, names: impl Iterator<Item = &'a str>) {
        let mut seen = BTreeSet::new();
        for (i, name) in names.enumerate() {
            let path = format!("{list}[{i}].name");
            if name.trim().is_empty() {
                self.say(&path, "the name is empty: give one");
            } else if !seen.insert(name) {
                self.say(&path, format!("the name \"{name}\" is taken by another entry of `{list}`: rename one"));
            }
        }
    }

    fn asset(&mut self, path: &str, file: &Path, extensions: &[&str]) -> bool {
        let known = file.extension().and_then(|e| e.to_str()).is_some_and(|e| extensions.contains(&e.to_ascii_lowercase().as_str()));
        if !known {
            self.say(path, format!("\"{}\" is not a .{} file: name one", file.display(), extensions.join(" or .")));
        } else if !file.is_file() {
            self.say(
                path,
                format!("no file \"{}\": paths are relative to the scene's file; correct it or put the file there", file.display()),
            );
        }
        known && file.is_file()
    }

    fn whole(&mut self, scene: &Scene) {
        if scene.version != VERSION {
            self.say("version", version_problem(scene.version));
        }
        if scene.name.trim().is_empty() {
            self.say("name", "the scene's name is empty: give one");
        }
        self.finite("gravity", &scene.gravity);
        if scene.organs.is_empty() {
            self.say("organs", "there is no organ: add one with a `mesh`");
        }
        if !scene.cut.snap.is_finite() || !(0.0..=0.4).contains(&scene.cut.snap) {
            self.say("cut.snap", format!("{} is out of range: expected 0 (never) to 0.4", scene.cut.snap));
        }
        if let Some(substeps) = scene.tissue.substeps.filter(|n| !(1..=1000).contains(n)) {
            self.say("tissue.substeps", format!("{substeps} is out of range: expected 1 to 1000"));
        }
        if let Some(capsule) = scene.tissue.capsule {
            for (what, value) in [("young_modulus_pa", capsule.young_modulus_pa), ("thickness_mm", capsule.thickness_mm)] {
                if !(value > 0.0 && value.is_finite()) {
                    self.say(&format!("tissue.capsule.{what}"), format!("{value} is out of range: expected more than 0"));
                }
            }
            if !(0.0..=0.5).contains(&capsule.poisson_ratio) {
                self.say("tissue.capsule.poisson_ratio", format!("{} is out of range: expected 0 to 0.5", capsule.poisson_ratio));
            }
        }
        if let Some(Camera { eye, target }) = scene.views.global
            && self.finite("views.global.eye", &eye)
            && self.finite("views.global.target", &target)
            && eye == target
        {
            self.say("views.global.target", "the camera looks at its own place: move `eye` or `target`");
        }
    }

    fn below(&mut self, path: &str, found: Found) {
        self.0.extend(found.into_iter().map(|(at, message)| (format!("{path}.{at}"), message)));
    }

    fn friction(&mut self, path: &str, friction: Option<f32>) {
        if let Some(value) = friction {
            self.range(&format!("{path}.friction"), value, 0.0, 2.0, " (Coulomb's coefficient)");
        }
    }
}
