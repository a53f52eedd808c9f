//! One step of a blade: what its strip meets is taken into the stroke, what the policy lets go is released, the mesh is refined. And the end of a
//! stroke, when children become base tetrahedra.

use crate::course::{BladeId, distance};
use crate::cutter::{Cutter, StepReport};
use crate::sheet::Strip;
use crate::sides::Conflict;
use crate::stroke::starting_strip;
use keyhole_tetmesh::{DVec3, FaceKey, NodeId, TetId, TetMesh};

/// The blade's line is moved off special positions by this part of an edge, by an amount of its own for each point, so that it does
/// not run exactly through nodes of a regular mesh. Far below any length that matters, far above rounding.
const GENERIC: f64 = 1e-7;

/// A blade that another one keeps waiting for this many lines waits no longer.
const LONGEST_WAIT: usize = 600;

/// How a blade takes a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// It waits where another blade is cutting.
    Polite,
    /// It waits for none.
    Forced,
    /// It goes over the last part of its way once more, where it is known to run along its own cut.
    Again,
}

impl Cutter {
    /// One step of an active blade: its line now, in the rest shape (m, tip first, the same number of points at each step of a stroke).
    ///
    /// A step should move the line by less than a quarter of an edge. A blade that begins within an edge of where it stopped goes on with its cut.
    /// The changes are in the mesh's delta.
    pub fn advance(&mut self, mesh: &mut TetMesh, blade: BladeId, line: &[DVec3]) -> StepReport {
        self.before.grow(mesh.tet_slots());
        let counted = self.operations;
        let line = self.generic(line);
        let course = self.course(blade);
        self.courses[course].waiting.push_back(line);
        let waits_long = self.courses[course].waiting.len() > LONGEST_WAIT;
        let swept_m2 = self.catch_up(mesh, course, if waits_long { Mode::Forced } else { Mode::Polite });
        StepReport { operations: self.operations.since(counted), swept_m2 }
    }

    /// Takes a blade along the lines that it has yet to go to, as far as no other is in its way. Returns the area that it sweeps, m2.
    fn catch_up(&mut self, mesh: &mut TetMesh, course: usize, mode: Mode) -> f64 {
        let mut swept_m2 = 0.0;
        while let Some(line) = self.courses[course].waiting.pop_front() {
            match self.step(mesh, course, line.clone(), mode) {
                Some(area) => swept_m2 += area,
                None => {
                    self.courses[course].waiting.push_front(line);
                    break;
                }
            }
        }
        swept_m2
    }

    /// Takes a blade to a line. Returns the area that it sweeps inside the tissue, m2, or `None` when it has to wait for another blade.
    fn step(&mut self, mesh: &mut TetMesh, course: usize, line: Vec<DVec3>, mode: Mode) -> Option<f64> {
        let mean_edge_m = self.mean_edge_m();
        if mode != Mode::Again && self.courses[course].line.len() != line.len() {
            if self.courses[course].is_in() {
                self.commit(mesh);
            }
            self.courses[course].line.clear();
            for old in self.courses[course].resumed(&line, mean_edge_m) {
                self.step(mesh, course, old, Mode::Again);
            }
        }
        let mut strip = self.strip(course, &line);
        if strip.is_still() && !self.courses[course].line.is_empty() {
            return Some(0.0);
        }
        let mut meeting = self.meet(mesh, course, &strip);
        let conflict = if mode == Mode::Again { Conflict::None } else { self.conflict(course, &meeting.hits) };
        if conflict == Conflict::WithBlade && mode == Mode::Polite {
            return None;
        }
        if !self.courses[course].line.is_empty() {
            let moved_m = distance(&self.courses[course].line, &line);
            self.courses[course].travel(moved_m);
        }
        if conflict != Conflict::None {
            // From here on, what this stroke has cut is an earlier cut.
            let trail = self.courses[course].take_trail();
            self.commit(mesh);
            for old in trail {
                self.step(mesh, course, old, Mode::Again);
            }
            strip = self.strip(course, &line);
            meeting = self.meet(mesh, course, &strip);
        }
        self.note_visit(course, &meeting.near);
        if self.courses[course].line.is_empty() {
            meeting.border.extend(meeting.front.iter().map(|(f, w)| (*f, *w)));
        }
        let touches = self.courses[course].is_in() || !meeting.near.is_empty();
        // Faces that a line or its ends pierce or pierced, and tetrahedra that the line has entered or left.
        let faces: Vec<FaceKey> =
            [&self.courses[course].front, &meeting.front, &meeting.border].into_iter().flat_map(|f| f.keys().copied()).collect();
        let (was, is) = (&self.courses[course].occupied.tets, &meeting.occupied.tets);
        let mut candidates: Vec<TetId> = was.symmetric_difference(is).copied().collect();
        self.add_those_across(mesh, &mut candidates);
        self.stick(mesh, &meeting, &mut candidates);
        self.record_hits(mesh, meeting.hits, &mut candidates);
        self.stroke.border.extend(meeting.border);
        let here = &mut self.courses[course];
        here.front = meeting.front;
        here.occupied = meeting.occupied;
        here.note(&line, mean_edge_m);
        here.line = line;
        self.note_reach(mesh, course);
        self.lead_past_nodes(mesh, &mut candidates);
        self.settle_and_release(mesh, &mut candidates);
        self.refine(mesh, candidates, &faces);
        if !self.courses[course].is_in() {
            if touches {
                self.courses[course].forget_trail();
            }
            let others_are_in = self.courses.iter().any(|c| c.is_in());
            if !self.stroke.crossings.is_empty() && if others_are_in { touches } else { self.stroke.unsettled.is_empty() } {
                // The blade has left: children become base tetrahedra. It keeps its line, for the strip to the next one.
                let line = std::mem::take(&mut self.courses[course].line);
                self.commit(mesh);
                self.courses[course].line = line;
            }
        }
        Some(meeting.area)
    }

    /// Notes where the blade is; where it has come back to it is known already.
    fn note_visit(&mut self, course: usize, near: &[NodeId]) {
        let mean_edge_m = self.mean_edge_m();
        let (visits, course) = (&mut self.stroke.visits, &self.courses[course]);
        for node in near {
            if !visits.is_return(course, *node, mean_edge_m) {
                visits.note(course, *node);
            }
        }
    }

    fn strip(&self, course: usize, line: &[DVec3]) -> Strip {
        let last = &self.courses[course].line;
        if last.len() == line.len() { Strip::between(last, line) } else { starting_strip(line) }
    }

    /// Ends the stroke of all blades: everything settles, children become base tetrahedra. The changes are in the mesh's delta.
    pub fn end_stroke(&mut self, mesh: &mut TetMesh) -> StepReport {
        let counted = self.operations;
        let swept_m2 = (0..self.courses.len()).map(|course| self.catch_up(mesh, course, Mode::Forced)).sum();
        self.commit(mesh);
        StepReport { operations: self.operations.since(counted), swept_m2 }
    }

    /// Settles and releases everything, then makes the children base tetrahedra. Blades that are in the tissue begin anew with their next step.
    fn commit(&mut self, mesh: &mut TetMesh) {
        let mut candidates: Vec<TetId> = Vec::new();
        let mut faces: Vec<FaceKey> = Vec::new();
        for course in &mut self.courses {
            candidates.extend(course.occupied.tets.iter().copied());
            // What the present line has reached is where the cut ends if it does not go on.
            faces.extend(course.front.keys().copied());
            self.stroke.border.extend(course.front.drain());
            course.stop();
        }
        self.add_those_across(mesh, &mut candidates);
        self.lead_past_nodes(mesh, &mut candidates);
        self.settle_and_release(mesh, &mut candidates);
        self.refine(mesh, candidates, &faces);
        self.committed_area_m2 += self.stroke_area(mesh);

        let boxes = (0..self.before.touched().len()).map(|place| self.before.place_corners(place).map(|n| mesh.rest(n)));
        self.grid.remove_all(boxes, |t| self.before.place(t).is_none());
        for &base in self.before.touched() {
            mesh.release_tet(base);
        }
        self.removed_m3 += self.draw_back(mesh);
        self.has_cut |= !self.stroke.touched.is_empty();
        self.renew_hull(mesh);
        for mut touched in self.stroke.touched.drain(..) {
            for id in touched.children.drain(..).filter_map(|c| c.id) {
                self.before.disown(id);
                self.grid.insert(id, mesh.points(id));
            }
            self.spare.push(touched.children);
        }
        self.before.forget();
        self.stroke.clear();
    }

    /// Renews surface and hull marks along the cut.
    fn renew_hull(&mut self, mesh: &mut TetMesh) {
        self.on_surface.resize(mesh.node_slots(), false);
        self.on_wound.resize(mesh.node_slots(), false);
        let mut changed: Vec<NodeId> = Vec::new();
        for node in self.stroke.sides.values().flatten().map(|s| s.node) {
            let now = mesh.topology().is_boundary_node(node);
            self.on_wound[node.index()] = true;
            if now != std::mem::replace(&mut self.on_surface[node.index()], now) {
                changed.push(node);
            }
        }
        let mut tets: Vec<TetId> = changed.iter().flat_map(|n| mesh.topology().around_node(*n)).copied().collect();
        tets.extend(self.stroke.touched.iter().flat_map(|t| &t.children).filter_map(|c| c.id));
        tets.sort_unstable();
        tets.dedup();
        for tet in tets {
            let hull = mesh.corners(tet).iter().any(|n| self.on_surface[n.index()]);
            mesh.set_hull(tet, hull);
        }
    }

    /// The line moved off special positions.
    fn generic(&self, line: &[DVec3]) -> Vec<DVec3> {
        let size = self.mean_edge_m() * GENERIC;
        line.iter()
            .enumerate()
            .map(|(i, p)| {
                let i = i as f64 + 1.0;
                *p + DVec3::new((i * 12.9898).sin(), (i * 78.233).sin(), (i * 37.719).sin()) * size
            })
            .collect()
    }
}
