//! What is in the abdomen, where, and how dense.
//!
//! Sizes are those of an adult in round numbers: kidney 11 cm, aorta 20 mm, renal artery 6 mm, ureter 5 mm wide (drawn a little wide so
//! that a CT of ordinary resolution holds it), vertebrae 35 mm high.

use super::shape::{Difference, Ellipsoid, Kidney, Shape, Tube, Union};
use glam::{DQuat, DVec3};

/// Centre of the left kidney seen from the middle of the abdomen, mm LPS: the origin of the phantom.
const ORIGIN: DVec3 = DVec3::new(62.0, 35.0, 10.0);

/// A structure of the phantom: a segment of its DICOM-SEG.
pub struct Structure {
    /// Segment number, from 1.
    pub number: u8,
    /// Segment label.
    pub name: &'static str,
    /// Density in the CT, Hounsfield units (contrast phase).
    pub hu: f64,
    /// Colour for drawing, linear RGB.
    pub colour: [f32; 3],
    /// The shape, in the phantom's frame.
    pub shape: Box<dyn Shape>,
}

/// All structures. Where two overlap, the one with the smaller number has the voxel in the CT; the body encloses them all.
#[must_use]
pub fn abdomen() -> Vec<Structure> {
    let left = left_kidney();
    let right = Kidney { centre: at(-64.0, 36.0, -6.0), radii: DVec3::new(27.0, 23.0, 54.0), medial: 1.0, bend: 9.0 };
    let structure = |number, name, hu, colour, shape| Structure { number, name, hu, colour, shape };
    vec![
        structure(1, "kidney_left", 160.0, [0.45, 0.13, 0.09], Box::new(without_tumour(left)) as Box<dyn Shape>),
        structure(2, "tumour", 85.0, [0.62, 0.47, 0.30], Box::new(tumour())),
        structure(3, "kidney_right", 160.0, [0.45, 0.13, 0.09], Box::new(right)),
        structure(4, "arteries", 300.0, [0.70, 0.04, 0.03], Box::new(arteries(&left, &right))),
        structure(5, "veins", 180.0, [0.10, 0.14, 0.45], Box::new(veins(&left, &right))),
        structure(6, "ureters", 20.0, [0.80, 0.68, 0.42], Box::new(ureters(&left, &right))),
        structure(7, "ribs", 450.0, [0.80, 0.74, 0.60], Box::new(ribs())),
        structure(8, "spine", 400.0, [0.80, 0.74, 0.60], Box::new(spine())),
        structure(9, "coronaries", 320.0, [0.70, 0.04, 0.03], Box::new(coronaries())),
        structure(10, "heart", 120.0, [0.50, 0.08, 0.07], Box::new(heart())),
        structure(11, "abdominal_wall", 55.0, [0.62, 0.24, 0.18], Box::new(abdominal_wall())),
        structure(12, "body", -80.0, [0.85, 0.62, 0.50], Box::new(body())),
    ]
}

/// The left kidney before the tumour is taken out of it.
#[must_use]
pub fn left_kidney() -> Kidney {
    Kidney { centre: DVec3::ZERO, radii: DVec3::new(27.0, 23.0, 55.0), medial: -1.0, bend: 9.0 }
}

/// The tumour: a ball of 30 mm, half of it outside the kidney, on its outer front side below the middle.
#[must_use]
pub fn tumour() -> Ellipsoid {
    Ellipsoid::new(DVec3::new(17.0, -17.5, -14.0), DVec3::splat(15.0))
}

fn without_tumour(kidney: Kidney) -> impl Shape {
    Difference { of: kidney, without: tumour(), blend: 1e-3 }
}

/// A point given from the middle of the abdomen.
fn at(l: f64, p: f64, s: f64) -> DVec3 {
    DVec3::new(l, p, s) - ORIGIN
}

fn union(shapes: Vec<Box<dyn Shape>>, blend: f64) -> Union {
    Union::new(shapes, blend)
}

fn tube(control: &[(DVec3, f64)]) -> Box<dyn Shape> {
    Box::new(Tube::through(control, 6))
}

fn arteries(left: &Kidney, right: &Kidney) -> Union {
    let aorta = [
        (at(16.0, 30.0, 215.0), 11.0),
        (at(12.0, 28.0, 120.0), 10.5),
        (at(8.0, 18.0, 30.0), 9.5),
        (at(6.0, 14.0, -70.0), 8.5),
        (at(5.0, 15.0, -100.0), 8.0),
    ];
    let iliac = |side: f64| [(at(5.0, 15.0, -98.0), 6.0), (at(5.0 + side * 18.0, 18.0, -125.0), 5.0)];
    let renal = |k: &Kidney, side: f64, z: f64| {
        let hilum = k.hilum();
        let root = at(8.0 + side * 8.0, 18.0, z);
        let near = hilum - DVec3::X * side * 14.0;
        [(root, 4.0), ((root + near) / 2.0 + DVec3::new(0.0, 6.0, 2.0), 3.4), (near, 3.2), (hilum + DVec3::new(0.0, 0.0, 3.0), 2.8)]
    };
    let branch = |k: &Kidney, side: f64| {
        let near = k.hilum() - DVec3::X * side * 14.0;
        [(near, 2.6), (k.hilum() + DVec3::new(side * 2.0, 2.0, -9.0), 2.2)]
    };
    union(
        vec![
            tube(&aorta),
            tube(&iliac(1.0)),
            tube(&iliac(-1.0)),
            tube(&renal(left, 1.0, 22.0)),
            tube(&branch(left, 1.0)),
            tube(&renal(right, -1.0, 16.0)),
            tube(&branch(right, -1.0)),
        ],
        3.0,
    )
}

fn veins(left: &Kidney, right: &Kidney) -> Union {
    let cava = [
        (at(-22.0, 8.0, 175.0), 12.0),
        (at(-22.0, 14.0, 110.0), 11.5),
        (at(-19.0, 16.0, 20.0), 10.5),
        (at(-15.0, 16.0, -80.0), 10.0),
        (at(-12.0, 20.0, -100.0), 9.5),
    ];
    let hilum = |k: &Kidney| k.hilum() + DVec3::new(0.0, -8.0, -4.0);
    // The left one crosses in front of the aorta.
    let left = [
        (at(-16.0, 10.0, 8.0), 5.0),
        (at(8.0, 2.0, 9.0), 4.6),
        (at(24.0, 12.0, 7.0), 5.0),
        (hilum(left) - DVec3::X * 8.0, 4.6),
        (hilum(left) + DVec3::X * 3.0, 3.6),
    ];
    let right = [(at(-20.0, 14.0, 2.0), 5.0), (hilum(right) + DVec3::X * 8.0, 4.6), (hilum(right) - DVec3::X * 3.0, 3.6)];
    let iliac = |side: f64| [(at(-12.0, 20.0, -98.0), 7.0), (at(-12.0 + side * 16.0, 26.0, -125.0), 6.0)];
    union(vec![tube(&cava), tube(&left), tube(&right), tube(&iliac(1.0)), tube(&iliac(-1.0))], 3.0)
}

fn ureters(left: &Kidney, right: &Kidney) -> Union {
    let ureter = |k: &Kidney, side: f64| {
        let pelvis = k.hilum() + DVec3::new(-side * 1.0, 8.0, -12.0);
        let x = ORIGIN.x.mul_add(side, 0.0);
        tube(&[
            (pelvis, 4.5),
            (pelvis + DVec3::new(-side * 8.0, 2.0, -16.0), 3.0),
            (at(x - side * 24.0, 38.0, -55.0), 2.6),
            (at(x - side * 30.0, 32.0, -90.0), 2.6),
            (at(x - side * 27.0, 34.0, -125.0), 2.6),
        ])
    };
    union(vec![ureter(left, 1.0), ureter(right, -1.0)], 1.0)
}

/// Six pairs of ribs on half ellipses that sink towards the front; the last two end free.
fn ribs() -> Union {
    let mut shapes = Vec::new();
    for i in 0..6 {
        let top = 205.0 - 30.0 * f64::from(i);
        let free = i >= 4;
        let reach = if free { 0.45 + 0.10 * f64::from(5 - i) } else { 0.88 };
        for side in [-1.0, 1.0] {
            let control: Vec<(DVec3, f64)> = (0..=10)
                .map(|k| {
                    let angle = (0.12 + reach * f64::from(k) / 10.0) * std::f64::consts::PI;
                    let (s, c) = angle.sin_cos();
                    let wide = 138.0 - 3.0 * f64::from(i);
                    (at(side * wide * s, 5.0 + 88.0 * c, top - 62.0 * f64::from(k) / 10.0 * reach), 5.0)
                })
                .collect();
            shapes.push(Box::new(Tube::through(&control, 4)) as Box<dyn Shape>);
        }
    }
    union(shapes, 1.0)
}

/// Vertebral bodies with discs between them left out, pedicles and spinous processes.
fn spine() -> Union {
    let mut shapes: Vec<Box<dyn Shape>> = Vec::new();
    for i in 0..10 {
        let z = 205.0 - 35.0 * f64::from(i);
        // Lordosis: the lower spine lies further in front.
        let y = 62.0 - 8.0 * (1.0 - (z / 200.0).powi(2)).max(0.0);
        let core = at(0.0, y, z);
        shapes.push(Box::new(Tube { points: vec![(core - DVec3::Z * 3.5, 17.0 - 3.0), (core + DVec3::Z * 3.5, 17.0 - 3.0)] }));
        shapes.push(Box::new(Ellipsoid::new(core, DVec3::new(23.0, 17.0, 15.0))));
        for side in [-1.0, 1.0] {
            shapes.push(tube(&[(core + DVec3::new(side * 9.0, 12.0, 2.0), 5.0), (core + DVec3::new(side * 11.0, 26.0, 0.0), 5.0)]));
            shapes.push(tube(&[(core + DVec3::new(side * 11.0, 26.0, 0.0), 4.5), (core + DVec3::new(side * 34.0, 28.0, 0.0), 3.5)]));
            shapes.push(tube(&[(core + DVec3::new(side * 11.0, 26.0, 0.0), 4.0), (core + DVec3::new(0.0, 33.0, -4.0), 4.5)]));
        }
        shapes.push(tube(&[(core + DVec3::new(0.0, 33.0, -4.0), 4.5), (core + DVec3::new(0.0, 50.0, -14.0), 3.5)]));
    }
    union(shapes, 2.0)
}

/// Axes of the heart's main chamber: its tip points left, forward and down.
fn heart_body() -> Ellipsoid {
    let tip = DVec3::new(0.62, -0.55, -0.56).normalize();
    Ellipsoid { centre: at(22.0, -32.0, 178.0), radii: DVec3::new(37.0, 34.0, 52.0), turn: DQuat::from_rotation_arc(DVec3::NEG_Z, tip) }
}

fn heart() -> Union {
    let body = heart_body();
    let base = body.turn * DVec3::Z;
    union(
        vec![
            Box::new(body),
            Box::new(Ellipsoid::new(body.centre + base * 30.0 + DVec3::new(-20.0, 2.0, -2.0), DVec3::splat(23.0))),
            Box::new(Ellipsoid::new(body.centre + base * 34.0 + DVec3::new(10.0, 14.0, 4.0), DVec3::splat(21.0))),
        ],
        12.0,
    )
}

/// Three arteries on the heart's surface with their branches, each point laid onto the surface along the ray from the heart's middle.
fn coronaries() -> Union {
    let (heart, body) = (heart(), heart_body());
    let on_surface = |along: f64, around: f64| {
        let (s, c) = around.to_radians().sin_cos();
        let (height, ring) = (along.to_radians().cos(), along.to_radians().sin());
        let direction = body.turn * DVec3::new(c * ring, s * ring, height);
        let (mut near, mut far) = (0.0, 120.0);
        for _ in 0..40 {
            let middle = (near + far) / 2.0;
            if heart.distance(body.centre + direction * middle) < 0.0 { near = middle } else { far = middle }
        }
        body.centre + direction * near
    };
    // Angle from the base (degrees), angle around the long axis (degrees), radius (mm).
    let paths: [&[(f64, f64, f64)]; 7] = [
        &[(42.0, -80.0, 2.6), (62.0, -86.0, 2.5), (90.0, -88.0, 2.3), (120.0, -84.0, 2.1), (150.0, -80.0, 1.9)],
        &[(42.0, -80.0, 2.6), (56.0, -40.0, 2.4), (64.0, 0.0, 2.3), (70.0, 40.0, 2.1), (84.0, 68.0, 1.9)],
        &[(46.0, -130.0, 2.5), (62.0, -160.0, 2.4), (72.0, 170.0, 2.2), (92.0, 130.0, 2.0), (122.0, 112.0, 1.9)],
        &[(76.0, -87.0, 2.2), (100.0, -62.0, 2.0), (126.0, -48.0, 1.8)],
        &[(98.0, -88.0, 2.1), (122.0, -66.0, 1.9), (142.0, -52.0, 1.8)],
        &[(64.0, 0.0, 2.2), (92.0, 0.0, 2.0), (120.0, -8.0, 1.8)],
        &[(64.0, -162.0, 2.2), (90.0, -150.0, 2.0), (114.0, -138.0, 1.8)],
    ];
    let tubes = paths.iter().map(|path| {
        // Points between are laid onto the surface too, for a straight piece would dive into the muscle.
        let fine: Vec<(DVec3, f64)> = path
            .windows(2)
            .flat_map(|w| (0..4).map(move |k| (w[0], w[1], f64::from(k) / 4.0)))
            .map(|(a, b, t)| {
                let turn = (b.1 - a.1 + 540.0).rem_euclid(360.0) - 180.0;
                (on_surface(a.0 + (b.0 - a.0) * t, a.1 + turn * t), a.2 + (b.2 - a.2) * t)
            })
            .chain(path.last().map(|e| (on_surface(e.0, e.1), e.2)))
            .collect();
        tube(&fine)
    });
    union(tubes.collect(), 1.0)
}

/// The wall of the peritoneal cavity below the left kidney of somebody who sits and leans forward: an ellipsoidal shell of 12 mm, cut off level.
fn abdominal_wall() -> impl Shape {
    let (centre, inner) = (DVec3::new(9.0, -32.0, 1.0), DVec3::new(100.0, 85.0, 115.0));
    let shell = Difference { of: Ellipsoid::new(centre, inner + 12.0), without: Ellipsoid::new(centre, inner), blend: 1e-3 };
    Below { of: shell, down: DVec3::new(0.299, -0.576, -0.761).normalize(), level: 65.0 }
}

/// What of a shape lies below a level, mm along a unit vector.
struct Below<S> {
    of: S,
    down: DVec3,
    level: f64,
}

impl<S: Shape> Shape for Below<S> {
    fn distance(&self, p: DVec3) -> f64 {
        self.of.distance(p).max(self.level - self.down.dot(p))
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        self.of.bounds()
    }
}

/// The skin: an oval trunk.
fn body() -> impl Shape {
    Trunk
}

/// The trunk between the lower edge of the scan and its upper one.
struct Trunk;

impl Shape for Trunk {
    fn distance(&self, p: DVec3) -> f64 {
        let q = p + ORIGIN;
        let radii = DVec3::new(165.0, 112.0, f64::INFINITY);
        let unit = ((q.x / radii.x).powi(4) + (q.y / radii.y).powi(4)).powf(0.25);
        ((unit - 1.0) * radii.y).max(q.z.abs() - 1e3)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        (at(-165.0, -112.0, -1e3), at(165.0, 112.0, 1e3))
    }
}
