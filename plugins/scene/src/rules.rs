//! What must hold of the values of a scene. Each broken rule is reported with the path of its value.

use crate::format::*;
use crate::load::version_problem;
use crate::surface;
use keyhole_tetmesh::TetMesh;
use std::collections::BTreeSet;
use std::path::Path;

/// The path of a value, and what is wrong with it.
type Found = Vec<(String, String)>;

/// Largest angle of a shaft from its port's inward direction, degrees.
const STEEPEST_DEG: f32 = 75.0;

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

    fn organ(&mut self, path: &str, organ: &SceneOrgan, folder: &Path) {
        self.placement(&format!("{path}.transform"), &organ.transform);
        if organ.materials.is_empty() {
            self.say(&format!("{path}.materials"), "there is no material: give one for each material of the mesh");
        }
        self.unique(&format!("{path}.materials"), organ.materials.iter().map(|m| m.name.as_str()));
        for (i, m) in organ.materials.iter().enumerate() {
            let path = format!("{path}.materials[{i}]");
            self.positive(&format!("{path}.young_modulus_pa"), m.young_modulus_pa, " Pa; kidney has about 15000");
            self.range(&format!("{path}.poisson_ratio"), m.poisson_ratio, 0.0, 0.499, "; soft tissue has about 0.45");
            self.positive(&format!("{path}.density_kg_m3"), m.density_kg_m3, " kg/m3; soft tissue has about 1050");
            self.colour(&format!("{path}.inside"), m.inside);
            self.colour(&format!("{path}.surface"), m.surface);
        }
        for (i, hold) in organ.attachments.iter().enumerate() {
            let path = format!("{path}.attachments[{i}]");
            self.region(&format!("{path}.region"), &hold.region);
            self.range(&format!("{path}.compliance_m_n"), hold.compliance_m_n, 0.0, 1e3, " m/N");
            if let Some(until_s) = hold.until_s {
                self.positive(&format!("{path}.until_s"), until_s, " s since the scene started");
            }
        }
        self.friction(path, organ.friction);
        if let Some(vessel) = &organ.vessel {
            self.below(&format!("{path}.vessel"), vessel.problems());
        }
        if let Some(value) = organ.tear_n_m {
            self.positive(&format!("{path}.tear_n_m"), value, " N/m; soft parenchyma has about 300");
        }
        if let Some(value) = organ.bruise_pa {
            self.positive(&format!("{path}.bruise_pa"), value, " Pa; bowel has about 250000");
        }
        match (&organ.mesh, &organ.shape) {
            (Some(mesh), None) => {
                let (path_of_mesh, file) = (format!("{path}.mesh"), folder.join(mesh));
                if self.asset(&path_of_mesh, &file, &["vtu", "vtk"]) {
                    match keyhole_tetmesh::vtu::read(&file) {
                        Ok(mesh) => self.mesh(path, organ, &organ.placed(&mesh)),
                        Err(e) => self.say(&path_of_mesh, e.to_string()),
                    }
                }
            }
            (None, Some(shape)) => {
                if self.solid(&format!("{path}.shape"), shape) {
                    self.mesh(path, organ, &organ.placed(&shape.mesh()));
                }
            }
            (Some(_), Some(_)) => self.say(&format!("{path}.shape"), "there is a `mesh` as well: keep one of them"),
            (None, None) => self.say(path, "it has neither `mesh` nor `shape`: give one of them"),
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

    /// Whether the shape can be made.
    fn solid(&mut self, path: &str, shape: &SceneSolid) -> bool {
        let before = self.0.len();
        let cells = match *shape {
            SceneSolid::Block { size, cells } => {
                for (k, side) in size.into_iter().enumerate() {
                    self.positive(&format!("{path}.size[{k}]"), side, " m");
                }
                cells
            }
            SceneSolid::Tube { length, outer_radius, inner_radius, cells } => {
                self.positive(&format!("{path}.length"), length, " m");
                self.positive(&format!("{path}.inner_radius"), inner_radius, " m");
                if self.finite(&format!("{path}.outer_radius"), &[outer_radius]) && outer_radius <= inner_radius {
                    self.say(
                        &format!("{path}.outer_radius"),
                        "the hole is as wide as the tube: make `outer_radius` larger than `inner_radius`",
                    );
                }
                if cells[1] < 3 {
                    self.say(&format!("{path}.cells[1]"), format!("{} cells around are no ring: expected 3 to 200", cells[1]));
                }
                cells
            }
        };
        for (k, n) in cells.into_iter().enumerate().filter(|(_, n)| !(1..=200).contains(n)) {
            self.say(&format!("{path}.cells[{k}]"), format!("{n} is out of range: expected 1 to 200"));
        }
        if cells.iter().map(|n| u64::from(*n)).product::<u64>() > 200_000 {
            self.say(&format!("{path}.cells"), "more than 200 000 cells: fewer are enough, there are six tetrahedra in each");
        }
        self.0.len() == before
    }

    fn mesh(&mut self, path: &str, organ: &SceneOrgan, mesh: &TetMesh) {
        let needed = mesh.iter().map(|(t, _)| usize::from(mesh.tet(t).material.0) + 1).max().unwrap_or(0);
        if (1..needed).contains(&organ.materials.len()) {
            let message =
                format!("{} given, but the mesh uses material ids up to {}: add the missing ones", organ.materials.len(), needed - 1);
            self.say(&format!("{path}.materials"), message);
        }
        for (i, hold) in organ.attachments.iter().enumerate() {
            if !mesh.nodes().any(|n| hold.region.contains(mesh.rest(n))) {
                let message = "no node of the organ is in this region: regions are in the world, after the organ's transform";
                self.say(&format!("{path}.attachments[{i}].region"), message);
            }
        }
    }

    fn region(&mut self, path: &str, region: &Region) {
        match region {
            Region::Sphere { centre, radius } => {
                self.finite(&format!("{path}.centre"), centre);
                self.positive(&format!("{path}.radius"), *radius, " m");
            }
            Region::HalfSpace { point, normal } => {
                self.finite(&format!("{path}.point"), point);
                self.direction(&format!("{path}.normal"), *normal);
            }
            Region::Box { min, max } => {
                let finite = self.finite(&format!("{path}.min"), min) && self.finite(&format!("{path}.max"), max);
                if finite && (0..3).any(|k| min[k] > max[k]) {
                    self.say(&format!("{path}.max"), "is below `min`: exchange them, axis by axis");
                }
            }
        }
    }

    fn anatomy(&mut self, path: &str, anatomy: &SceneAnatomy, folder: &Path) {
        self.colour(&format!("{path}.colour"), anatomy.colour);
        self.placement(&format!("{path}.transform"), &anatomy.transform);
        self.friction(path, anatomy.friction);
        match (&anatomy.path, &anatomy.shape) {
            (Some(file), None) => {
                let (path_of_file, file) = (format!("{path}.path"), folder.join(file));
                if self.asset(&path_of_file, &file, &["glb", "gltf"]) {
                    match surface::read(&file) {
                        Ok(mesh) if anatomy.solid => {
                            if let Err(open) = surface::solid(&mesh, &anatomy.transform) {
                                self.say(&format!("{path}.solid"), open.to_string());
                            }
                        }
                        Ok(_) => {}
                        Err(error) => self.say(&path_of_file, error.to_string()),
                    }
                }
            }
            (None, Some(shape)) => {
                let path = format!("{path}.shape");
                match *shape {
                    SceneSurface::Box { size } => {
                        for (k, side) in size.into_iter().enumerate() {
                            self.positive(&format!("{path}.size[{k}]"), side, " m");
                        }
                    }
                    SceneSurface::Cylinder { radius, height } => {
                        self.positive(&format!("{path}.radius"), radius, " m");
                        self.positive(&format!("{path}.height"), height, " m");
                    }
                    SceneSurface::Sphere { radius } => self.positive(&format!("{path}.radius"), radius, " m"),
                }
            }
            (Some(_), Some(_)) => self.say(&format!("{path}.shape"), "there is a `path` as well: keep one of them"),
            (None, None) => self.say(path, "it has neither `path` nor `shape`: give one of them"),
        }
    }

    fn instruments(&mut self, scene: &Scene) {
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

    fn suture(&mut self, path: &str, suture: &SceneSuture, scene: &Scene) {
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

    fn demonstration(&mut self, scene: &Scene, demonstration: &Demonstration) {
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
