//! Who may know whom: read from `cargo metadata` and from the sources, not from a promise.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, PackageId};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Crates that every plugin may depend on.
const SHARED: [&str; 2] = ["keyhole-tetmesh", "keyhole-whiteboard"];

/// Crates that may render, and what rendering means.
const RENDERING: [&str; 3] = ["keyhole", "keyhole-view", "keyhole-hud"];
const RENDERERS: [&str; 8] = ["bevy", "bevy_render", "bevy_pbr", "bevy_winit", "bevy_window", "bevy_core_pipeline", "wgpu", "egui"];

/// Rooms whose algorithms are plain functions, with the app known to `plugin.rs` alone.
const PLAIN: [&str; 10] = ["tetmesh", "imaging", "tissue", "collision", "cutting", "instruments", "grasping", "suturing", "hid", "scene"];

/// What an algorithm file never says.
const APP_WORDS: [&str; 6] = ["bevy_app", "Query<", "Commands", "ResMut<", "MessageReader<", "MessageWriter<"];

fn metadata() -> Metadata {
    MetadataCommand::new().manifest_path(root().join("Cargo.toml")).other_options(vec!["--locked".into()]).exec().unwrap()
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn a_plugin_knows_the_mesh_and_the_whiteboard_and_no_other_room() {
    let metadata = metadata();
    let rooms: BTreeSet<&str> = metadata.workspace_packages().iter().map(|p| p.name.as_str()).collect();
    assert!(rooms.len() > SHARED.len(), "the workspace has been found");
    for package in metadata.workspace_packages().iter().filter(|p| p.name.as_str() != "keyhole") {
        for dependency in &package.dependencies {
            let name = dependency.name.as_str();
            assert!(
                !rooms.contains(name) || SHARED.contains(&name),
                "{} depends on {name}: a plugin may depend on {SHARED:?} and on no other crate of the workspace",
                package.name
            );
        }
    }
}

#[test]
fn only_the_view_the_hud_and_the_app_render() {
    let metadata = metadata();
    let names: BTreeMap<&PackageId, &str> = metadata.packages.iter().map(|p| (&p.id, p.name.as_str())).collect();
    let nodes: BTreeMap<&PackageId, _> = metadata.resolve.as_ref().unwrap().nodes.iter().map(|n| (&n.id, n)).collect();
    let mut seen_renderer = false;
    for package in metadata.workspace_packages() {
        let mut reached: BTreeMap<&PackageId, Vec<&str>> = BTreeMap::from([(&package.id, vec![package.name.as_str()])]);
        let mut open = vec![&package.id];
        while let Some(id) = open.pop() {
            for dependency in &nodes[id].deps {
                let normal = dependency.dep_kinds.iter().any(|k| k.kind == DependencyKind::Normal);
                if normal && !reached.contains_key(&dependency.pkg) {
                    let mut path = reached[id].clone();
                    path.push(names[&dependency.pkg]);
                    reached.insert(&dependency.pkg, path);
                    open.push(&dependency.pkg);
                }
            }
        }
        let renders = reached.values().find(|path| RENDERERS.contains(path.last().unwrap()));
        if RENDERING.contains(&package.name.as_str()) {
            seen_renderer |= renders.is_some();
        } else {
            assert!(renders.is_none(), "{} must build without a renderer, but: {}", package.name, renders.unwrap().join(" -> "));
        }
    }
    assert!(seen_renderer, "the renderer has been recognised where it belongs");
}

#[test]
fn algorithms_do_not_know_the_app() {
    let mut read = 0;
    for room in PLAIN {
        for file in sources(&root().join("plugins").join(room).join("src")) {
            if file.file_name().is_some_and(|n| n == "plugin.rs") {
                continue;
            }
            let text = std::fs::read_to_string(&file).unwrap();
            let code = text.split("#[cfg(test)]").next().unwrap();
            for (line, number) in code.lines().zip(1..).filter(|(l, _)| !l.trim_start().starts_with("//")) {
                let word = APP_WORDS.iter().find(|w| line.contains(**w));
                assert!(word.is_none(), "{}:{number}: `{}` belongs into plugin.rs", file.display(), word.unwrap());
            }
            read += 1;
        }
    }
    assert!(read > 2 * PLAIN.len(), "the sources have been found");
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if entry.is_dir() {
            files.extend(sources(&entry));
        } else if entry.extension().is_some_and(|e| e == "rs") {
            files.push(entry);
        }
    }
    files.sort();
    files
}
