//! A grid seen through the endoscope: the crossings of its lines are where the mapping of the lens says, pixel by pixel.
//!
//! The pictures are kept in the folder that `KEYHOLE_OPTICS` names, where it is set.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::image::{CompressedImageFormats, Image, ImageSampler, ImageType};
use bevy::log::LogPlugin;
use bevy::math::Isometry3d;
use bevy::prelude::*;
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use keyhole_view::optics::{Lens, MASK_DIAMETER};
use keyhole_view::{PictureOf, PictureRequest, ScopeFog, ViewPlugin, adapter_available, take_pictures};
use keyhole_whiteboard::{Anatomy, Endoscope, PartMesh, ScopeOptics, ViewMode, WhiteboardPlugin};
use std::path::{Path, PathBuf};

const SIZE: UVec2 = UVec2::new(640, 360);
/// From the tip of the endoscope to the grid, m: one of the two distances at which endoscopes are tested.
const DISTANCE_M: f32 = 0.1;
/// Between two lines of the grid, m.
const PITCH_M: f32 = 0.01;
/// Half the width of a line, m.
const HALF_LINE_M: f32 = 0.0012;
/// Half the number of lines each way.
const LINES: i32 = 8;

/// White lines, with nothing between them, in the plane z = 0.
fn grid() -> PartMesh {
    let mut mesh = PartMesh::default();
    let long = LINES as f32 * PITCH_M;
    let mut strip = |low: Vec2, high: Vec2| {
        let at = mesh.vertices.len() as u32;
        mesh.vertices.extend([[low.x, low.y, 0.0], [high.x, low.y, 0.0], [high.x, high.y, 0.0], [low.x, high.y, 0.0]]);
        mesh.normals.extend([[0.0, 0.0, 1.0]; 4]);
        mesh.indices.extend([0, 1, 2, 0, 2, 3].map(|i| at + i));
    };
    for line in -LINES..=LINES {
        let at = line as f32 * PITCH_M;
        strip(Vec2::new(at - HALF_LINE_M, -long), Vec2::new(at + HALF_LINE_M, long));
        strip(Vec2::new(-long, at - HALF_LINE_M), Vec2::new(long, at + HALF_LINE_M));
    }
    mesh
}

fn app() -> App {
    let mut app = App::new();
    let nothing = WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() };
    let engine = DefaultPlugins.build().disable::<LogPlugin>().set(nothing).disable::<WinitPlugin>().disable::<PipelinedRenderingPlugin>();
    app.add_plugins((engine, WhiteboardPlugin, ViewPlugin { picture_size: SIZE }));
    app.world_mut().spawn((Anatomy { name: "grid".into(), surface: grid(), colour: [0.9; 3] }, Transform::IDENTITY));
    app.finish();
    app.cleanup();
    app.update();
    app
}

/// The picture of the grid through an endoscope that looks straight at it, as brightnesses, row by row.
fn picture(app: &mut App, scope: Endoscope, optics: ScopeOptics, path: &Path) -> Vec<f32> {
    let world = app.world_mut();
    let old: Vec<Entity> = world.query_filtered::<Entity, With<Endoscope>>().iter(world).collect();
    for entity in old {
        world.despawn(entity);
    }
    world.spawn((scope, optics));
    take_pictures(app, [PictureRequest { path: path.into(), of: PictureOf::View(ViewMode::Laparoscopic) }]).unwrap();
    brightness(path)
}

/// The brightness of every pixel of a picture, row by row.
fn brightness(path: &Path) -> Vec<f32> {
    let bytes = std::fs::read(path).unwrap();
    let (kind, formats) = (ImageType::Extension("png"), CompressedImageFormats::NONE);
    let image = Image::from_buffer(&bytes, kind, formats, false, ImageSampler::Default, default()).unwrap();
    image.data.unwrap().chunks_exact(4).map(|p| p[..3].iter().map(|c| f32::from(*c) / 765.0).sum()).collect()
}

/// An endoscope whose view meets the middle of the grid at right angles, whatever its direction of view and its rolls.
fn scope(view_deg: f32, roll_rad: f32, head_roll_rad: f32) -> Endoscope {
    let mut scope = Endoscope {
        pose: Isometry3d::IDENTITY,
        direction_of_view_rad: view_deg.to_radians(),
        angle_of_view_rad: 70_f32.to_radians(),
        roll_rad,
        head_roll_rad: 0.0,
    };
    scope.pose = Isometry3d::from_rotation(scope.eye_pose().rotation.inverse());
    scope.pose.translation = Vec3::new(0.0, 0.0, DISTANCE_M).into();
    Endoscope { head_roll_rad, ..scope }
}

/// Where a point of the grid's plane is in the picture: the pinhole, the inverse of the lens, and the picture turned against the camera head.
fn pixel(point: Vec2, scope: &Endoscope, lens: &Lens) -> Option<Vec2> {
    let tangent = point.length() / DISTANCE_M / (scope.angle_of_view_rad / 2.0).tan();
    (tangent < 0.93).then(|| {
        let rim = 0.5 * MASK_DIAMETER * SIZE.y as f32;
        let turned = Vec2::from_angle(-scope.head_roll_rad).rotate(point.normalize_or_zero());
        SIZE.as_vec2() / 2.0 + rim * lens.distorted(tangent) * turned * Vec2::new(1.0, -1.0)
    })
}

fn at(picture: &[f32], pixel: Vec2) -> f32 {
    picture[pixel.y as usize * SIZE.x as usize + pixel.x as usize]
}

/// For every angle of scope, and for lenses from none to strong distortion, crossings are white and the middles of the meshes dark where the mapping says;
/// where a lens without distortion would have them they are not.
#[test]
fn a_grid_through_the_endoscope_is_where_the_lens_says() {
    match adapter_available() {
        Ok(adapter) => println!("drawing with {adapter}"),
        Err(why) => return println!("nothing is drawn here: {why}"),
    }
    let temporary = tempfile::tempdir().unwrap();
    let folder = std::env::var_os("KEYHOLE_OPTICS").map_or_else(|| temporary.path().to_owned(), PathBuf::from);
    let mut app = app();
    let strong = ScopeOptics::one_coefficient(0.23);
    let cases = [
        ("none", scope(0.0, 0.0, 0.0), [0.0, 0.0]),
        ("usual", scope(0.0, 0.0, 0.0), ScopeOptics::default().distortion),
        ("strong", scope(0.0, 0.0, 0.0), strong),
        ("moustache", scope(0.0, 0.0, 0.0), [0.35, -0.12]),
        ("30_degrees_rolled", scope(30.0, 0.6, 0.0), strong),
        ("45_degrees_head_rolled", scope(45.0, -0.4, 0.5), strong),
    ];
    for (name, scope, distortion) in cases {
        let optics = ScopeOptics { distortion, ..default() };
        let lens = Lens::of(&scope, &optics);
        let picture = picture(&mut app, scope, optics, &folder.join(format!("grid_{name}.png")));
        let (mut crossings, mut meshes, mut seen) = (f32::INFINITY, 0_f32, 0);
        for (i, j) in (-LINES..LINES).flat_map(|i| (-LINES..LINES).map(move |j| (i, j))) {
            let corner = PITCH_M * Vec2::new(i as f32, j as f32);
            if let Some(pixel) = pixel(corner, &scope, &lens) {
                crossings = crossings.min(at(&picture, pixel));
                seen += 1;
            }
            if let Some(pixel) = pixel(corner + PITCH_M / 2.0, &scope, &lens) {
                meshes = meshes.max(at(&picture, pixel));
            }
        }
        println!("{name}: {seen} crossings, the darkest {crossings:.3}, the brightest mesh {meshes:.3}");
        assert!(seen > 100 && crossings > 2.0 * meshes, "{name}: crossings {crossings}, meshes {meshes}");
        if name == "strong" {
            let pinhole = Lens { k1: 0.0, k2: 0.0, ..lens };
            let off = [4, 5, 6].map(|i| pixel(Vec2::new(i as f32 * PITCH_M, PITCH_M / 2.0), &scope, &pinhole).unwrap());
            assert!(off.iter().any(|p| at(&picture, *p) < 1.5 * meshes), "the lens does nothing");
        }
    }
    // Fog takes most of the contrast between lines and meshes, and not all.
    let usual = scope(0.0, 0.0, 0.0);
    let contrast = |picture: &[f32]| {
        let lens = Lens::of(&usual, &ScopeOptics::default());
        let [line, mesh] = [Vec2::ZERO, Vec2::splat(PITCH_M / 2.0)].map(|point| at(picture, pixel(point, &usual, &lens).unwrap()));
        line - mesh
    };
    let clear = contrast(&picture(&mut app, usual, ScopeOptics::default(), &folder.join("clear.png")));
    // A new endoscope is clean; this one is there already.
    app.update();
    app.insert_resource(ScopeFog(1.0));
    let path = folder.join("fogged.png");
    take_pictures(&mut app, [PictureRequest { path: path.clone(), of: PictureOf::View(ViewMode::Laparoscopic) }]).unwrap();
    let fogged = contrast(&brightness(&path));
    println!("contrast {clear:.3}, through fog {fogged:.3}");
    assert!(clear > 0.3 && fogged > 0.02 * clear && fogged < 0.5 * clear);
}
