//! What must hold of organs and of anatomy.

use super::Rules;
use crate::format::*;
use crate::surface;
use keyhole_tetmesh::TetMesh;
use std::path::Path;

impl Rules {
    pub(super) fn organ(&mut self, path: &str, organ: &SceneOrgan, folder: &Path) {
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

    pub(super) fn anatomy(&mut self, path: &str, anatomy: &SceneAnatomy, folder: &Path) {
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
}
