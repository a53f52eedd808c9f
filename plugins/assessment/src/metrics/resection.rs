//! What a resection took away and what it left: volumes in the rest shape.

use keyhole_tetmesh::{MaterialId, TetMesh};

/// Cubic metres of tumour and of healthy tissue.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Volumes {
    /// Tumour, m3.
    pub tumour_m3: f64,
    /// The rest, m3.
    pub healthy_m3: f64,
}

/// A piece of what was one organ.
#[derive(Clone, Copy, Debug)]
pub struct Piece<'a> {
    /// Its mesh.
    pub mesh: &'a TetMesh,
    /// Whether it has been freed; what has not stays in the patient.
    pub freed: bool,
}

/// What a resection took away and what it left, m3.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Resection {
    /// Before.
    pub before: Volumes,
    /// What stays in the patient.
    pub left: Volumes,
    /// What has come free. The rest was taken away by the blade itself.
    pub freed: Volumes,
}

impl Volumes {
    /// Of a mesh; `is_tumour` tells the materials.
    #[must_use]
    pub fn of(mesh: &TetMesh, is_tumour: impl Fn(MaterialId) -> bool) -> Self {
        let mut volumes = Self::default();
        for (tet, _) in mesh.iter() {
            let of = if is_tumour(mesh.tet(tet).material) { &mut volumes.tumour_m3 } else { &mut volumes.healthy_m3 };
            *of += mesh.volume(tet);
        }
        volumes
    }

    fn add(&mut self, other: Self) {
        self.tumour_m3 += other.tumour_m3;
        self.healthy_m3 += other.healthy_m3;
    }
}

impl Resection {
    /// Of an organ that had `before`, from its pieces.
    #[must_use]
    pub fn of(before: Volumes, pieces: &[Piece], is_tumour: impl Fn(MaterialId) -> bool) -> Self {
        let mut resection = Self { before, ..Self::default() };
        for piece in pieces {
            let volumes = Volumes::of(piece.mesh, &is_tumour);
            if piece.freed { resection.freed.add(volumes) } else { resection.left.add(volumes) }
        }
        resection
    }

    /// Takes another organ's in.
    pub fn add(&mut self, other: &Self) {
        self.before.add(other.before);
        self.left.add(other.left);
        self.freed.add(other.freed);
    }

    /// Tumour that stays in the patient, m3.
    #[must_use]
    pub fn tumour_left_m3(&self) -> f64 {
        self.left.tumour_m3
    }

    /// Healthy tissue that was taken away, by the blade or with a piece, m3.
    #[must_use]
    pub fn healthy_removed_m3(&self) -> f64 {
        (self.before.healthy_m3 - self.left.healthy_m3).max(0.0)
    }

    /// Healthy tissue that stays, as a part of what there was; `None` when there was none.
    #[must_use]
    pub fn preserved(&self) -> Option<f64> {
        (self.before.healthy_m3 > 0.0).then(|| self.left.healthy_m3 / self.before.healthy_m3)
    }
}
