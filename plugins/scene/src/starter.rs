//! The starter: a commented scene, made for a mesh, that plays at once and whose demonstration resects the tumour.
//!
//! The organ is laid so that the piece to be freed hangs below its body and towards the viewer, under a plane that leans by
//! [`LEAN_DEG`]; it is held by its hilum, or by as much of that side as the cut leaves alone, and lies softly in its fat. The port of the
//! blade lies in the plane of the cut, so a blade on the shaft's axis sweeps that plane and nothing else while the shaft turns about its
//! port. The freed piece falls away from the organ without a push.

use crate::ellipsoid::ellipsoid;
use crate::error::SceneError;
use crate::format::Placement;
use crate::hilum::hilum;
use crate::section::{Fan, Plane, resection_plane, section};
use bevy_math::{DMat3, DQuat, DVec3};
use keyhole_tetmesh::TetMesh;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Component, Path, PathBuf};

/// Angle of the cut's plane from the horizontal, towards the viewer, degrees: enough for the endoscope to look into the cut, and flat
/// enough that the piece falls clear.
pub const LEAN_DEG: f64 = 25.0;

/// From the port to the middle of the cut, m.
const PORT_DISTANCE_M: f64 = 0.15;
/// How far the blade reaches beyond the section on each side, m: the organ sags by a few millimetres.
const OVERREACH_M: f64 = 0.012;
/// Speed of the blade's middle through the organ, m/s.
const SWEEP_M_S: f64 = 0.016;
/// Share of the sweep at that speed; the piece hangs by what is left.
const SLOW: f64 = 0.7;
/// How much faster the rest is cut, before the piece swings out of the plane.
const FINISH: f64 = 2.5;
/// Share of the nodes that is held.
const HELD: f64 = 0.2;
/// Distance of what is held from the plane of the cut, m: as the tumour's margin, and the tenths of a millimetre of the scene's text.
const CLEAR_M: f64 = 0.006;
/// Share of the nodes that suffices where the cut is near.
const LEAST_HELD: f64 = 0.12;
/// Steps by which what is held moves from the hilum away from the cut, and their length, m.
const HOLD_STEPS: u32 = 30;
const HOLD_STEP_M: f64 = 0.002;
/// Share of the piece's nodes, farthest from the cut, that an assistant holds until the cut is through.
const SUPPORTED: f64 = 0.6;
/// How far the organ would sink into the fat in which it lies if nothing else held it, m. Held by the hilum alone, two of four kidneys swung
/// past the blade and stayed in one piece.
const SINKS_M: f64 = 0.001;
/// How far the piece sags in the assistant's hands once it is free, m: the cut opens that far. With 4 mm a kidney in cells of 7 mm stayed in
/// one piece.
const SAG_M: f64 = 0.001;
/// Time that the piece is seen falling at the end, s: about 12 cm.
const FALLS_S: f64 = 0.15;
/// Time between the end of the cut and the assistant's letting go, s.
const LETS_GO_S: f64 = 0.6;
/// Keyframes of the sweep.
const SWEEP_KEYS: u32 = 9;

/// What a starter is made of, in the world.
struct Plan {
    mesh: String,
    placement: Placement,
    fan: Fan,
    /// The region that is held, as the scene writes it.
    hold: String,
    hold_note: &'static str,
    bed_point: DVec3,
    bed_compliance: f64,
    support_point: DVec3,
    support_normal: DVec3,
    support_compliance: f64,
    blade_m: f64,
    /// Insertion at which the blade spans the section, m.
    insertion_m: f64,
    tip_radius_m: f64,
    /// Angles of the fan at which the sweep starts and ends, rad.
    sweep: (f64, f64),
    /// Lowest and highest corner of the placed organ, m.
    box_: (DVec3, DVec3),
    materials: usize,
}

/// Writes a starter scene to `out` for the mesh of an organ (VTU; material 1 is the tumour). Without a mesh an ellipsoid with a tumour is
/// written beside it, named as the scene with `.vtu`. Returns the files written. Nothing is ever overwritten.
///
/// # Errors
/// [`SceneError::Exists`], [`SceneError::Write`], [`SceneError::Mesh`] for a mesh that cannot be read, [`SceneError::Unsuited`] for one
/// through which no cut can be planned.
pub fn new_scene(organ_mesh: Option<&Path>, out: &Path) -> Result<Vec<PathBuf>, SceneError> {
    refuse_existing(out)?;
    let mut written = Vec::new();
    let file = match organ_mesh {
        Some(file) => file.to_owned(),
        None => {
            let file = out.with_file_name(format!("{}.vtu", stem(out)));
            refuse_existing(&file)?;
            let write =
                |e: keyhole_tetmesh::vtu::VtuError| SceneError::Write { path: file.clone(), source: std::io::Error::other(e.to_string()) };
            keyhole_tetmesh::vtu::write(&file, &ellipsoid(), &[]).map_err(write)?;
            written.push(file.clone());
            file
        }
    };
    let mesh = keyhole_tetmesh::vtu::read(&file).map_err(|e| SceneError::Mesh { organ: "organ".into(), what: e.to_string() })?;
    let text = starter(&mesh, &file, &relative(&file, out), &stem(out))?;
    write_new(out, &text)?;
    written.push(out.to_owned());
    Ok(written)
}

/// The text of a starter for a mesh that was read from `file` and that the scene calls `mesh_path`.
///
/// # Errors
/// [`SceneError::Unsuited`] when no cut can be planned.
pub fn starter(mesh: &TetMesh, file: &Path, mesh_path: &str, name: &str) -> Result<String, SceneError> {
    let unsuited = || SceneError::Unsuited {
        path: file.into(),
        what: format!(
            "no cut that frees a piece can be planned: expected an organ up to {:.0} cm across whose tumour, if there is one, is not at its middle; check that the mesh is in metres, or write the scene by hand",
            200.0 * PORT_DISTANCE_M
        ),
    };
    let plan = plan(mesh, mesh_path).ok_or_else(unsuited)?;
    Ok(text(&plan, name))
}

fn plan(mesh: &TetMesh, mesh_path: &str) -> Option<Plan> {
    let plane = resection_plane(mesh)?;
    let local = Fan::of(&section(mesh, &plane), plane.normal, PORT_DISTANCE_M)?;
    let (rotation, normal) = lay(&plane, &local);
    let placement = rounded(Placement::new(rotation, -(rotation * local.centre)));
    // Everything below is measured on the placed organ, so that the rounding of the placement does not matter.
    let (rotation, place) = (placement.rotation(), |p: DVec3| placement.apply(p));
    let fan = Fan { centre: place(local.centre), blade: rotation * local.blade, sweep: rotation * local.sweep, ..local };
    let placed: Vec<DVec3> = mesh.nodes().map(|n| place(mesh.rest(n))).collect();
    let box_ = placed.iter().map(|p| (*p, *p)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
    let (hold, hold_note) = hold(mesh, &plane, &placement, &placed, normal)?;
    let mut below: Vec<f64> = placed.iter().map(|p| normal.dot(*p)).filter(|d| *d > 0.0).collect();
    below.sort_by(|a, b| b.total_cmp(a));
    let supports = (SUPPORTED * below.len() as f64) as usize;
    let supported = *below.get(supports)?;
    // Nodes stand for equal shares of the weight.
    let node_n = 9.81 * 1050.0 * mesh.total_volume() / placed.len() as f64;
    let weight_n = node_n * below.len() as f64;
    let margin = OVERREACH_M / PORT_DISTANCE_M;
    Some(Plan {
        mesh: mesh_path.into(),
        placement,
        hold,
        hold_note,
        support_point: normal * supported,
        support_normal: normal,
        bed_point: -normal * CLEAR_M,
        bed_compliance: SINKS_M / node_n,
        support_compliance: SAG_M * supports as f64 / weight_n,
        blade_m: fan.radius.1 - fan.radius.0 + 2.0 * OVERREACH_M,
        insertion_m: fan.radius.0 - OVERREACH_M,
        tip_radius_m: fan.radius.1 + OVERREACH_M,
        sweep: (fan.angle.0 - margin, fan.angle.1 + margin),
        box_,
        materials: mesh.iter().map(|(t, _)| usize::from(mesh.tet(t).material.0) + 1).max().unwrap_or(1),
        fan,
    })
}

/// The part of the placed organ that is held, as the scene writes it, and what it is.
///
/// A ball about the hilum, as large as a share of the nodes needs and the cut allows. Where that is too small the ball moves away from the
/// cut, step by step. An organ without a hollow is held at the end farthest from the piece. `normal` is that of the cut's plane in the
/// world, which goes through the origin.
fn hold(mesh: &TetMesh, plane: &Plane, placement: &Placement, placed: &[DVec3], normal: DVec3) -> Option<(String, &'static str)> {
    let share = |distances: &mut Vec<f64>| {
        distances.sort_by(f64::total_cmp);
        distances.get((HELD * distances.len() as f64) as usize).copied()
    };
    if let Some(hilum) = hilum(mesh, |p| plane.distance(p) < -CLEAR_M) {
        let hilum = placement.apply(hilum.point);
        for step in 0..HOLD_STEPS {
            let centre = hilum - normal * f64::from(step) * HOLD_STEP_M;
            let mut distances: Vec<f64> = placed.iter().map(|p| p.distance(centre)).collect();
            let wanted = share(&mut distances)?;
            let radius = wanted.min(-normal.dot(centre) - CLEAR_M);
            if distances.partition_point(|d| *d <= radius) as f64 >= LEAST_HELD * distances.len() as f64 {
                let note = if step == 0 { "about the hilum" } else { "on the side of the hilum that the cut leaves alone" };
                return Some((format!("Sphere(centre: {}, radius: {radius:.4})", point(centre)), note));
            }
        }
    }
    let far = share(&mut placed.iter().map(|p| normal.dot(*p)).collect())?;
    Some((format!("HalfSpace(point: {}, normal: {})", point(normal * far), point(-normal)), "farthest from the cut"))
}

/// The rotation that lays an organ for its cut: the piece down and to the viewer, the blade's port to the right, above, in front. With it
/// the plane's normal in the world.
fn lay(plane: &Plane, fan: &Fan) -> (DQuat, DVec3) {
    let (sin, cos) = LEAN_DEG.to_radians().sin_cos();
    let normal = DVec3::new(0.0, -cos, sin);
    let uphill = DVec3::new(0.0, sin, cos);
    let blade = -(0.8 * DVec3::X + 0.6 * uphill);
    let world = DMat3::from_cols(normal, blade, normal.cross(blade));
    let mesh = DMat3::from_cols(plane.normal, fan.blade, plane.normal.cross(fan.blade));
    (DQuat::from_mat3(&(world * mesh.transpose())), normal)
}

/// As it will be read back: micrometres and ten thousandths of a degree.
fn rounded(p: Placement) -> Placement {
    Placement { translation: p.translation.map(|x| (x * 1e6).round() / 1e6), rotation_deg: p.rotation_deg.map(|x| (x * 1e4).round() / 1e4) }
}

fn text(plan: &Plan, name: &str) -> String {
    let Plan { fan, box_, .. } = plan;
    let centre = fan.centre;
    let port = fan.port();
    // The left hand and the endoscope come from the other side and from between the hands.
    let left_port = centre + 0.15 * DVec3::new(-0.72, 0.38, 0.58).normalize();
    let scope_port = centre + 0.16 * DVec3::new(0.02, 0.42, 0.9).normalize();
    let rest = DVec3::new(box_.0.x - 0.015, centre.y + 0.01, box_.1.z + 0.005);
    let mut hook = String::new();
    let sweep_s = (plan.sweep.1 - plan.sweep.0) * fan.port_distance / SWEEP_M_S;
    let time_at = |f: f64| 2.0 + sweep_s * (f.min(SLOW) + (f - SLOW).max(0.0) / FINISH);
    let sweep_end = time_at(1.0);
    let mut key = |time: f64, tip: DVec3, active: bool, note: &str| {
        let pedal = if active { ", active: true" } else { "" };
        let _ = writeln!(hook, "                    (time_s: {time:.2}, tip: {}{pedal}),{note}", point(tip));
    };
    key(0.0, fan.at(plan.insertion_m, plan.sweep.0 - 0.12), false, " // waits beside the organ");
    key(1.4, fan.at(plan.tip_radius_m, plan.sweep.0), false, " // reaches behind it");
    for k in 0..SWEEP_KEYS {
        let f = f64::from(k) / f64::from(SWEEP_KEYS - 1);
        let (time, angle) = (time_at(f), plan.sweep.0 + f * (plan.sweep.1 - plan.sweep.0));
        let note = if k == 0 {
            " // cuts"
        } else if k + 1 == SWEEP_KEYS {
            " // has left"
        } else {
            ""
        };
        key(time, fan.at(plan.tip_radius_m, angle), k + 1 < SWEEP_KEYS, note);
    }
    key(sweep_end + 0.7, fan.at(plan.tip_radius_m, plan.sweep.1 + 0.05), false, "");
    let until_s = sweep_end + LETS_GO_S;
    let seconds = until_s + FALLS_S;
    let (support_point, support_normal, support_compliance) =
        (point(plan.support_point), point(plan.support_normal), plan.support_compliance);
    let materials = materials(plan.materials);
    let [tx, ty, tz] = plan.placement.translation;
    let [rx, ry, rz] = plan.placement.rotation_deg;
    let (translation, rotation) = (format!("({tx:.6}, {ty:.6}, {tz:.6})"), format!("({rx:.4}, {ry:.4}, {rz:.4})"));
    let eye = centre + DVec3::new(0.06, 0.13, 0.42);
    format!(
        r#"// A scene of Keyhole. `keyhole scene check` finds mistakes; `keyhole play` shows it; `keyhole run` performs the demonstration.
// Lengths are metres, angles degrees, the world is right-handed with Y up. Paths are relative to this file.
(
    version: 1,
    name: "{name}",
    description: "Resection of the tumour in one sweep of the blade.",
    // What the trainee is told, and what the program looks for: docs/scenes.md has all that can be wanted. The times of the score are a guess: make them yours.
    guidance: ["Sweep the hook through the organ, pedal down, until the piece falls."],
    task: (
        goals: [(name: "A piece has come free", want: CutThrough(organ: "kidney"), step: 1)],
        penalties: [(error: ToolCollisions, seconds: 2)],
        score: Own(cutoff_s: 120, proficient_s: 20),
    ),
    gravity: (0.0, -9.81, 0.0), // m/s2

    organs: [
        (
            name: "kidney",
            mesh: "{mesh}",
            // One entry for each material of the mesh, in order. Colours are linear RGB.
            materials: [
{materials}            ],
            // Baked into the rest shape. The piece to be freed lies below the organ's body, leaning to the viewer, so that it falls clear.
            transform: (translation: {translation}, rotation_deg: {rotation}),
            // What holds the organ: an eighth to a fifth of its nodes, {hold_note}. Compliance in m/N; 0 holds rigidly.
            // The rest of the body lies softly in its fat, and the piece in an assistant's hands until the cut is through: then it falls.
            attachments: [
                (region: {hold}, compliance_m_n: 0.0),
                (region: HalfSpace(point: {bed_point}, normal: {bed_normal}), compliance_m_n: {bed_compliance:.2}),
                (region: HalfSpace(point: {support_point}, normal: {support_normal}), compliance_m_n: {support_compliance:.2}, until_s: {until_s:.2}),
            ],
        ),
    ],

    // Surfaces that cannot deform, from a file or of a simple shape: Box(size), Cylinder(radius, height), Sphere(radius). What is solid can be touched.
    // (name: "bone", path: "bone.glb", colour: (0.8, 0.75, 0.6)),
    // (name: "table", shape: Box(size: (0.4, 0.02, 0.4)), colour: (0.2, 0.4, 0.5), transform: (translation: (0, -0.12, 0)), solid: true),
    anatomy: [],

    ports: [
        // In the plane of the cut: turning about it, the shaft keeps the blade in that plane.
        (name: "right", position: {port}, inward: {inward}),
        (name: "left", position: {left_port}, inward: {left_inward}),
        (name: "optic", position: {scope_port}, inward: {scope_inward}),
    ],
    instruments: [
        // kind: Grasper, Scissors, Hook, Scalpel, ClipApplier, NeedleHolder or Suction. What about it cuts may be chosen: blade: (length_mm, trigger, kerf_mm). The trigger is
        // Closing (scissors) or Pedal; kerf_mm is the thickness of tissue that the edge takes away, 0 to 3, where 0 is a cold blade.
        // This blade is longer than the organ is thick where it cuts: one sweep goes right through.
        (kind: Hook, hand: Right, port: "right", insertion_m: {insertion:.4}, blade: (length_mm: {blade:.1}, trigger: Pedal, kerf_mm: 0.0)),
        (kind: Grasper, hand: Left, port: "left", insertion_m: 0.06),
    ],
    endoscope: (port: "optic", direction_of_view_deg: 30.0, angle_of_view_deg: 70.0, insertion_m: 0.05),

    cut: (method: Hybrid, hull: Minimal, core: Minimal, snap: 0.2),
    tissue: (model: Implicit),

    demonstration: (
        seconds: {seconds:.2},
        hands: [
            (
                hand: Right,
                keys: [
{hook}                ],
            ),
            (
                hand: Left,
                keys: [
                    (time_s: 0.00, tip: {rest}),
                    (time_s: 2.00, tip: {near}),
                    (time_s: 3.00, tip: {near}, grip: 1.0),
                ],
            ),
        ],
        view: [
            (time_s: 0.00, target: {centre}, distance_m: 0.1150),
            (time_s: {sweep_end:.2}, target: {below}, distance_m: 0.1000),
        ],
    ),
    views: (global: (eye: {eye}, target: {centre})),
)
"#,
        bed_point = point(plan.bed_point),
        bed_normal = point(-plan.support_normal),
        bed_compliance = plan.bed_compliance,
        hold = plan.hold,
        hold_note = plan.hold_note,
        mesh = plan.mesh.escape_default(),
        name = name.escape_default(),
        port = point(port),
        inward = point(fan.blade),
        left_port = point(left_port),
        left_inward = point((centre - left_port).normalize()),
        scope_port = point(scope_port),
        scope_inward = point((centre - scope_port).normalize()),
        insertion = plan.insertion_m,
        blade = 1000.0 * plan.blade_m,
        rest = point(rest + DVec3::new(-0.015, 0.0, 0.015)),
        near = point(rest),
        centre = point(centre),
        below = point(centre + DVec3::new(0.0, -0.008, 0.0)),
        eye = point(eye),
    )
}

/// A point as the scene writes it.
fn point(p: DVec3) -> String {
    format!("({:.4}, {:.4}, {:.4})", clean(p.x), clean(p.y), clean(p.z))
}

/// No negative zero in the text.
fn clean(x: f64) -> f64 {
    (x * 1e4).round() / 1e4 + 0.0
}

/// Kidney after magnetic resonance elastography (14.7 kPa, doi 10.1002/jmri.22670); a tumour is several times stiffer.
fn materials(count: usize) -> String {
    let mut text = String::new();
    for id in 0..count {
        let (name, young, inside, surface) = match id {
            0 => ("kidney".into(), 14_700, "(0.55, 0.10, 0.08)", "(0.45, 0.13, 0.10)"),
            1 => ("tumour".into(), 40_000, "(0.80, 0.62, 0.36)", "(0.72, 0.50, 0.30)"),
            _ => (format!("material {id}"), 14_700, "(0.60, 0.30, 0.25)", "(0.50, 0.30, 0.25)"),
        };
        let _ = writeln!(text, "                (");
        let _ = writeln!(text, "                    name: \"{name}\",");
        let _ = writeln!(text, "                    young_modulus_pa: {young}.0, poisson_ratio: 0.45, density_kg_m3: 1050.0,");
        let _ = writeln!(text, "                    inside: {inside}, surface: {surface},");
        let _ = writeln!(text, "                ),");
    }
    text
}

/// The file's name without `.scene.ron` or `.ron`.
fn stem(path: &Path) -> String {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.strip_suffix(".ron").unwrap_or(&name);
    stem.strip_suffix(".scene").unwrap_or(stem).to_owned()
}

/// How a scene at `scene` names the file `asset`: relative to its folder where both can be resolved.
fn relative(asset: &Path, scene: &Path) -> String {
    let folder = scene.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let (Ok(asset_full), Ok(folder)) = (asset.canonicalize(), folder.canonicalize()) else {
        return asset.to_string_lossy().into_owned();
    };
    let (to, from): (Vec<Component>, Vec<Component>) = (asset_full.components().collect(), folder.components().collect());
    let common = to.iter().zip(&from).take_while(|(a, b)| a == b).count();
    let up = std::iter::repeat_n("..".to_owned(), from.len() - common);
    let down = to[common..].iter().map(|c| c.as_os_str().to_string_lossy().into_owned());
    up.chain(down).collect::<Vec<_>>().join("/")
}

fn refuse_existing(path: &Path) -> Result<(), SceneError> {
    if path.symlink_metadata().is_ok() { Err(SceneError::Exists { path: path.into() }) } else { Ok(()) }
}

fn write_new(path: &Path, text: &str) -> Result<(), SceneError> {
    let write = |source| SceneError::Write { path: path.into(), source };
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tempfile::Builder::new().prefix(".keyhole-").tempfile_in(folder).map_err(write)?;
    file.write_all(text.as_bytes()).map_err(write)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.as_file().set_permissions(std::fs::Permissions::from_mode(0o644)).map_err(write)?;
    }
    file.persist_noclobber(path).map(|_| ()).map_err(|e| match e.error.kind() {
        std::io::ErrorKind::AlreadyExists => SceneError::Exists { path: path.into() },
        _ => write(e.error),
    })
}
