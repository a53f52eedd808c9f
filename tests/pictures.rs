//! Pictures show something. Drawn here where there is a graphics adapter, and read from `KEYHOLE_PICTURES` (files and folders, separated
//! by colons) where that is set.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::asset::RenderAssetUsages;
use bevy::image::{CompressedImageFormats, Image, ImageSampler, ImageType};
use keyhole::Theatre;
use keyhole::perform::{MARGIN, Performance, perform};
use keyhole_assessment::results::plots::margin_colour;
use keyhole_view::adapter_available;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The colours of a PNG, RGBA.
fn pixels(path: &Path) -> Vec<[u8; 4]> {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (kind, formats) = (ImageType::Extension("png"), CompressedImageFormats::NONE);
    let image = Image::from_buffer(&bytes, kind, formats, true, ImageSampler::Default, RenderAssetUsages::MAIN_WORLD).unwrap();
    image.data.unwrap().chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect()
}

/// How far a channel of a lit surface may be from the colour that it is painted in.
const LIT: f32 = 24.0;

/// The part of a picture that has the colours of margins, from a tenth of a millimetre to fifteen.
fn in_margin_colours(pixels: &[[u8; 4]]) -> f64 {
    let scale: Vec<[f32; 3]> = (1..=150).map(|tenths| margin_colour(f64::from(tenths) * 1e-4).map(|c| 255.0 * c)).collect();
    let close = |p: &&[u8; 4]| scale.iter().any(|colour| (0..3).all(|i| (f32::from(p[i]) - colour[i]).abs() < LIT));
    pixels.iter().filter(close).count() as f64 / pixels.len() as f64
}

/// A picture of tissue: many colours, some bright, reds among them; or of a margin, the opened surface in the scale's colours.
fn assert_shows_something(path: &Path) {
    let pixels = pixels(path);
    let colours: BTreeSet<[u8; 4]> = pixels.iter().copied().collect();
    let share = |wanted: &dyn Fn(&[u8; 4]) -> bool| pixels.iter().filter(|p| wanted(p)).count() as f64 / pixels.len() as f64;
    let bright = share(&|p| p[0].max(p[1]).max(p[2]) > 60);
    let red = share(&|p| u16::from(p[0]) > u16::from(p[1]) + 25 && u16::from(p[0]) > u16::from(p[2]) + 25);
    println!("{}: {} colours, {:.1} % bright, {:.1} % red", path.display(), colours.len(), 100.0 * bright, 100.0 * red);
    assert!(colours.len() > 500, "{} has {} colours", path.display(), colours.len());
    assert!(bright > 0.02, "{} is dark", path.display());
    if path.file_name().is_some_and(|name| name == MARGIN) {
        let margin = in_margin_colours(&pixels);
        println!("{}: {:.1} % in the colours of margins", path.display(), 100.0 * margin);
        assert!(margin > 0.05, "{} shows no margin", path.display());
    } else {
        assert!(red > 0.005, "{} shows no tissue", path.display());
    }
}

#[test]
fn both_views_show_the_scene() {
    match adapter_available() {
        Ok(adapter) => println!("drawing with {adapter}"),
        Err(why) => return println!("nothing is drawn here: {why}"),
    }
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/kidney_resection.scene.ron");
    let folder = tempfile::tempdir().unwrap();
    let wanted = Performance { seconds: Some(0.1), pictures: Some(folder.path().into()), ..Performance::default() };
    perform(Theatre::load(&scene).unwrap(), &wanted, |_, _| {}).unwrap();
    for view in ["global", "laparoscopic"] {
        assert_shows_something(&folder.path().join(format!("1_before_{view}.png")));
    }
    let [global, laparoscopic] = ["global", "laparoscopic"].map(|v| pixels(&folder.path().join(format!("1_before_{v}.png"))));
    let differ = global.iter().zip(&laparoscopic).filter(|(a, b)| a != b).count();
    assert!(differ > global.len() / 4, "the views are the same");
}

#[test]
fn pictures_from_elsewhere_show_something() {
    let Some(places) = std::env::var_os("KEYHOLE_PICTURES") else {
        return println!("KEYHOLE_PICTURES is not set: no pictures from elsewhere");
    };
    let mut files = Vec::new();
    for place in std::env::split_paths(&places) {
        if place.is_dir() {
            let inside: Vec<PathBuf> = std::fs::read_dir(&place).unwrap().map(|e| e.unwrap().path()).collect();
            assert!(!inside.is_empty(), "{} is empty", place.display());
            files.extend(inside);
        } else {
            files.push(place);
        }
    }
    files.sort();
    files.iter().for_each(|f| assert_shows_something(f));
}
