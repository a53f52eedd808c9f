//! The paper's figure 4: the same moment of the same cut by the three methods side by side.
//!
//! The rest shape's two sides of a cut lie on each other, so they are moved apart for the eye: nodes of the cut's faces go into their own side, other
//! nodes of the surface follow their neighbours, less with distance. What is seen open is open in the mesh; how wide is not a result.

use crate::study::StudyError;
use crate::study::plan::{Combination, Plan, method_name};
use crate::study::strokes::Stage;
use crate::study::svg::{Canvas, Drawing, Drawn, FONT, svg};
use keyhole_cutting::{BatchCut, BladeSample};
use keyhole_tetmesh::{Boundary, DVec3, NodeId};
use plotters::prelude::*;
use rustc_hash::FxHashMap;

/// Size of a panel, pixels: large, for coordinates are whole ones.
const PANEL: (u32, u32) = (1400, 1400);
/// Height of a panel's title, pixels.
const HEAD: u32 = 130;
/// White around a panel, pixels.
const MARGIN: f64 = 14.0;
/// By how much each side is moved, as a part of the mean edge.
const GAP: f64 = 0.3;
/// What a node takes over of its neighbours' way, a ring.
const FOLLOW: f64 = 0.8;
/// Rings that follow.
const RINGS: usize = 12;
/// Largest half width that is shown, mean edges: what happens at the blade is to be seen.
const REACH: f64 = 4.5;
/// Where the blade stands right of the middle, mean edges: the wound is behind it.
const BEHIND: f64 = 1.5;
const SURFACE: DVec3 = DVec3::new(205.0, 150.0, 130.0);
const CUT: DVec3 = DVec3::new(250.0, 205.0, 70.0);

/// A triangle that may be seen.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Triangle {
    points: [DVec3; 3],
    is_cut: bool,
}

/// One method at one moment.
#[derive(Clone, Debug)]
pub struct Moment {
    method: &'static str,
    triangles: Vec<Triangle>,
    blade: BladeSample,
    /// Where the blade goes through the surface.
    surface_points: Vec<DVec3>,
    /// Where its upper one of these points has been so far.
    trail: Vec<DVec3>,
    lag_mm: f64,
    mean_edge_m: f64,
    box_m: [DVec3; 2],
    stage: Stage,
}

impl Moment {
    /// Cuts up to a part of the path.
    #[must_use]
    pub fn of(plan: &Plan, combination: &Combination, progress: f64) -> Self {
        let mut cut = BatchCut::new(plan.meshes[combination.mesh].mesh.clone(), combination.settings());
        let stage = Stage::of(&cut.mesh, plan.seed);
        let mean_edge_m = cut.mean_edge_m();
        let path = stage.path(combination.stroke, combination.rate * mean_edge_m);
        let last = ((path.len() - 1) as f64 * progress).round() as usize;
        let (mut surface_points, mut trail) = (Vec::new(), Vec::new());
        for sample in &path[..=last] {
            cut.step(*sample);
            surface_points = cut.surface_points();
            let nearest = |a: &&DVec3, b: &&DVec3| a.distance(sample.heel).total_cmp(&b.distance(sample.heel));
            trail.extend(surface_points.iter().min_by(nearest).copied());
        }
        let mesh = &cut.mesh;
        let bounds = mesh.nodes().map(|n| mesh.rest(n)).fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[a, b], p| [a.min(p), b.max(p)]);
        let boundary = Boundary::of(mesh);
        let corners: Vec<[DVec3; 3]> = boundary.triangles.iter().map(|t| t.map(|n| mesh.rest(n))).collect();
        Self {
            method: method_name(combination.method),
            triangles: opened(&boundary.triangles, &corners, GAP * mean_edge_m),
            blade: path[last],
            surface_points,
            trail,
            lag_mm: cut.lag_m() * 1e3,
            mean_edge_m,
            box_m: bounds,
            stage,
        }
    }
}

/// The surface with the two sides of its cuts moved apart by `gap` each, m. Faces of a cut are those that lie on another one.
fn opened(triangles: &[[NodeId; 3]], corners: &[[DVec3; 3]], gap: f64) -> Vec<Triangle> {
    let place = |c: &[DVec3; 3]| {
        let mut key = c.map(|p| p.to_array().map(|x| (x + 0.0).to_bits()));
        key.sort_unstable();
        key
    };
    let mut count: FxHashMap<_, u32> = FxHashMap::default();
    for c in corners {
        *count.entry(place(c)).or_insert(0) += 1;
    }
    let is_cut: Vec<bool> = corners.iter().map(|c| count[&place(c)] > 1).collect();
    let slots = triangles.iter().flatten().map(|n| n.index() + 1).max().unwrap_or(0);
    // Normals of cut faces by node: those of the front have both sides' and stay.
    let (mut normals, mut areas) = (vec![DVec3::ZERO; slots], vec![0.0; slots]);
    for ((t, [a, b, c]), _) in triangles.iter().zip(corners).zip(&is_cut).filter(|(_, cut)| **cut) {
        let normal = (*b - *a).cross(*c - *a);
        for n in t {
            normals[n.index()] += normal;
            areas[n.index()] += normal.length();
        }
    }
    let mut moved: Vec<DVec3> = normals.iter().zip(&areas).map(|(n, a)| if *a > 0.0 { -gap * *n / *a } else { DVec3::ZERO }).collect();
    for _ in 0..RINGS {
        let (mut sums, mut counts) = (vec![DVec3::ZERO; slots], vec![0.0; slots]);
        for t in triangles {
            for (n, m) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                sums[n.index()] += moved[m.index()];
                counts[n.index()] += 1.0;
            }
        }
        for i in 0..slots {
            if areas[i] == 0.0 && counts[i] > 0.0 {
                moved[i] = FOLLOW * sums[i] / counts[i];
            }
        }
    }
    let place = |t: &[NodeId; 3], c: &[DVec3; 3]| std::array::from_fn(|k| c[k] + moved[t[k].index()]);
    triangles.iter().zip(corners).zip(is_cut).map(|((t, c), is_cut)| Triangle { points: place(t, c), is_cut }).collect()
}

/// An orthographic camera.
struct Camera {
    right: DVec3,
    up: DVec3,
    /// From the scene towards the eye.
    eye: DVec3,
    middle: DVec3,
    pixels_a_metre: f64,
}

impl Camera {
    /// From the heel's side, somewhat from across.
    fn new(stage: &Stage, middle: DVec3, half_m: f64) -> Self {
        let [along, across, depth] = stage.directions();
        let across = if along.cross(across).dot(depth) < 0.0 { -across } else { across };
        let eye = (depth - 0.55 * across + 0.25 * along).normalize();
        let right = (along - eye * along.dot(eye)).normalize();
        let room = f64::from(PANEL.0.min(PANEL.1 - HEAD)) / 2.0;
        Self { right, up: eye.cross(right), eye, middle, pixels_a_metre: 0.96 * room / half_m }
    }

    /// Pixels in the panel.
    fn project(&self, p: DVec3) -> [f64; 2] {
        let q = (p - self.middle) * self.pixels_a_metre;
        [f64::from(PANEL.0) / 2.0 + q.dot(self.right), f64::from(PANEL.1 + HEAD) / 2.0 - q.dot(self.up)]
    }
}

/// Left and upper, right and lower edge of what is shown in a panel, pixels.
fn window() -> [[f64; 2]; 2] {
    [[MARGIN, f64::from(HEAD)], [f64::from(PANEL.0) - MARGIN, f64::from(PANEL.1) - MARGIN]]
}

/// The part of a convex polygon within the window (Sutherland and Hodgman 1974).
fn clip(polygon: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let [low, high] = window();
    let sides = [(0, low[0], 1.0), (0, high[0], -1.0), (1, low[1], 1.0), (1, high[1], -1.0)];
    sides.iter().fold(polygon.to_vec(), |points, &(axis, at, sign)| {
        let inside = |p: &[f64; 2]| sign * (p[axis] - at);
        let mut kept = Vec::with_capacity(points.len() + 1);
        for (i, q) in points.iter().enumerate() {
            let p = &points[(i + points.len() - 1) % points.len()];
            let (a, b) = (inside(p), inside(q));
            if (a < 0.0) != (b < 0.0) {
                let s = a / (a - b);
                kept.push([p[0] + s * (q[0] - p[0]), p[1] + s * (q[1] - p[1])]);
            }
            if b >= 0.0 {
                kept.push(*q);
            }
        }
        kept
    })
}

fn pixels(points: &[[f64; 2]]) -> Vec<(i32, i32)> {
    points.iter().map(|p| (p[0].round() as i32, p[1].round() as i32)).collect()
}

/// The three side by side.
///
/// # Errors
/// What the drawing library says.
pub fn draw(name: &str, mesh: &str, moments: &[Moment; 3]) -> Result<Drawing, StudyError> {
    let text = svg(name, (3 * PANEL.0, PANEL.1), |canvas| {
        for (panel, moment) in canvas.split_evenly((1, 3)).iter().zip(moments) {
            draw_moment(panel, moment)?;
        }
        Ok(())
    })?;
    let lags = moments.iter().map(|m| format!("{} {:.1} mm", m.method, m.lag_mm)).collect::<Vec<_>>().join(", ");
    let caption = format!(
        "{mesh}, minimal patterns, {:.0} % through. Blue: the blade, dashed where it is inside; its way over the surface so far is dotted. Yellow: faces of the cut. The \
         two sides of the cut are moved apart for the eye ({GAP} of an edge each): in the rest shape they lie on each other. Lag of the wound \
         behind the blade: {lags}.",
        super::PICTURED * 100.0
    );
    Ok(Drawing { name: name.into(), caption, svg: text })
}

fn draw_moment(panel: &Canvas, moment: &Moment) -> Drawn {
    let [low, high] = moment.box_m;
    let whole = (high - low).length() / 2.0;
    let reach = REACH * moment.mean_edge_m;
    let (middle, half) = if whole <= reach {
        ((low + high) / 2.0, whole)
    } else {
        let behind = BEHIND * moment.mean_edge_m * moment.stage.directions()[0];
        (moment.trail.last().map_or((low + high) / 2.0, |p| *p - behind), reach)
    };
    let camera = Camera::new(&moment.stage, middle, half);
    let mut seen: Vec<(f64, &Triangle, f64)> = moment
        .triangles
        .iter()
        .filter_map(|t| {
            let [a, b, c] = t.points;
            let facing = (b - a).cross(c - a).normalize_or_zero().dot(camera.eye);
            (facing > 0.0).then(|| ((a + b + c).dot(camera.eye), t, facing))
        })
        .collect();
    seen.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (_, triangle, facing) in seen {
        let inside = clip(&triangle.points.map(|p| camera.project(p)));
        if inside.len() < 3 {
            continue;
        }
        let points = pixels(&inside);
        let colour = if triangle.is_cut { CUT } else { SURFACE } * (0.45 + 0.55 * facing);
        let [r, g, b] = colour.to_array().map(|c| c.clamp(0.0, 255.0) as u8);
        panel.draw(&Polygon::new(points.clone(), RGBColor(r, g, b).filled()))?;
        let outline = points.iter().chain(points.first()).copied().collect::<Vec<_>>();
        panel.draw(&PathElement::new(outline, RGBColor(90, 60, 50).stroke_width(2)))?;
    }
    draw_blade(panel, moment, &camera)?;
    let [low, high] = window().map(|p| (p[0] as i32, p[1] as i32));
    panel.draw(&Rectangle::new([low, high], RGBColor(150, 150, 150).stroke_width(3)))?;
    let text = |size: u32| (FONT, size).into_font();
    panel.draw(&Text::new(moment.method, (40, 20), text(64)))?;
    panel.draw(&Text::new(
        format!("lag {:.1} mm ({:.2} edges)", moment.lag_mm, moment.lag_mm * 1e-3 / moment.mean_edge_m),
        (620, 34),
        text(46),
    ))?;
    Ok(())
}

fn draw_blade(panel: &Canvas, moment: &Moment, camera: &Camera) -> Drawn {
    let blue = RGBColor(20, 60, 160);
    let trail: Vec<[f64; 2]> = moment.trail.iter().map(|p| camera.project(*p)).collect();
    for p in trail.iter().filter(|p| !clip(&[**p]).is_empty()) {
        panel.draw(&Circle::new((p[0] as i32, p[1] as i32), 7, blue.filled()))?;
    }
    // Parts of the line between where it goes through the surface are inside in turn; the heel is outside.
    let (heel, tip) = (moment.blade.heel, moment.blade.tip);
    let mut cuts: Vec<DVec3> = moment.surface_points.clone();
    cuts.sort_by(|a, b| a.distance(heel).total_cmp(&b.distance(heel)));
    let mut points = vec![heel];
    points.extend(cuts);
    points.push(tip);
    for (i, pair) in points.windows(2).enumerate() {
        let ends = [camera.project(pair[0]), camera.project(pair[1])];
        let pieces = if i % 2 == 0 { 1 } else { 12 };
        for k in (0..2 * pieces).step_by(if pieces == 1 { 1 } else { 2 }) {
            let at = |j: usize| {
                let s = j as f64 / (2 * pieces) as f64;
                [ends[0][0] + s * (ends[1][0] - ends[0][0]), ends[0][1] + s * (ends[1][1] - ends[0][1])]
            };
            let piece = clip(&[at(k), at(k + 1)]);
            if piece.len() >= 2 {
                panel.draw(&PathElement::new(pixels(&piece), blue.stroke_width(if pieces == 1 { 14 } else { 8 })))?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polygon_is_clipped_to_the_panel() {
        let [low, high] = window();
        let within = [[10.0, 500.0], [20.0, 500.0], [10.0, 520.0]];
        assert_eq!(clip(&within).len(), 3);
        assert!(clip(&[[-5.0, 500.0], [-1.0, 500.0], [-5.0, 520.0]]).is_empty());
        let area = |p: &[[f64; 2]]| {
            let twice: f64 = (0..p.len()).map(|i| p[i][0] * p[(i + 1) % p.len()][1] - p[(i + 1) % p.len()][0] * p[i][1]).sum();
            twice.abs() / 2.0
        };
        // Far larger than the panel on all sides: what is left is the panel.
        let all = clip(&[[-1e4, -1e4], [1e5, -1e4], [-1e4, 1e5]]);
        let whole = (high[0] - low[0]) * (high[1] - low[1]);
        assert!((area(&all) - whole).abs() < 1e-9 * whole);
        assert!(clip(&[[-5.0, 500.0]]).is_empty() && clip(&[[50.0, 500.0]]).len() == 1);
    }

    #[test]
    fn sides_of_a_cut_go_apart_and_its_front_stays() {
        // Two faces on each other, back to back, that share the node 0 as a front does; a face of the surface hangs on node 1.
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X, DVec3::Y, DVec3::new(2.0, 1.0, 0.0)];
        let triangles = [[0, 1, 2], [0, 4, 3], [1, 5, 2]].map(|t| t.map(NodeId));
        let corners = triangles.map(|t| t.map(|n| p[n.index()]));
        let moved = opened(&triangles, &corners, 0.1);
        assert_eq!(moved.iter().map(|t| t.is_cut).collect::<Vec<_>>(), [true, true, false]);
        assert_eq!(moved[0].points, [DVec3::ZERO, DVec3::new(1.0, 0.0, -0.1), DVec3::new(0.0, 1.0, -0.1)]);
        assert_eq!(moved[1].points, [DVec3::ZERO, DVec3::new(0.0, 1.0, 0.1), DVec3::new(1.0, 0.0, 0.1)]);
        assert!(moved[2].points[1].z < 0.0, "a neighbour follows");
    }
}
