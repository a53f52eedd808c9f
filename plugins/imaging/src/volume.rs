//! A label volume and the body cropped out of it.

use crate::error::ImagingError;
use crate::frame;
use glam::{DAffine3, DMat3, DVec3};
use std::path::{Path, PathBuf};

/// Shear beyond which axes do not count as perpendicular, degrees: a header's single precision stays far below it, the smallest gantry
/// tilt in use is far above.
const SHEAR_DEGREES: f64 = 0.1;

/// Shear up to which a volume is resampled, degrees: no gantry tilts more.
const MAX_SHEAR_DEGREES: f64 = 60.0;
/// Voxels that resampling may make of one.
const MAX_GROWTH: usize = 8;

/// Voxel sizes of scans of people, mm: from micro-CT to scouts. Others are a wrong unit or a damaged header.
const VOXEL_MM: [f64; 2] = [1e-3, 1e2];
/// Longest voxel axis over the shortest: beyond it the margin around a body would outgrow the scan.
const MAX_ANISOTROPY: f64 = 100.0;

/// Index of a label in the order asked for, plus one; 0 is everything else.
pub type Part = u8;

/// A label asked for: what it is called and the value or segment number it has in the input.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct LabelChoice {
    /// Name, for messages and the report.
    pub name: String,
    /// Voxel value, or segment number.
    pub value: i64,
}

/// Voxels of the labels that were asked for, x fastest.
#[derive(Clone, Debug)]
pub struct LabelVolume {
    /// Where it comes from.
    pub path: PathBuf,
    /// Voxels along each axis.
    pub dims: [usize; 3],
    /// The part of each voxel.
    pub parts: Vec<Part>,
    /// Name of each part, part 1 first.
    pub names: Vec<String>,
    /// From voxel indices (centres at integers) to patient LPS, mm.
    pub voxel_to_lps: DAffine3,
    /// What a reader should know: what was left out, filled in or resampled.
    pub notes: Vec<String>,
}

/// A part of a volume on a straight right-handed grid.
#[derive(Clone, Debug)]
pub struct Body {
    /// Voxels along each axis.
    pub dims: [usize; 3],
    /// Voxel size, mm.
    pub spacing: DVec3,
    /// The part of each voxel, x fastest.
    pub parts: Vec<Part>,
    /// From the grid's own coordinates (mm, voxel (0,0,0) at the origin, axes along the voxels) to patient LPS, mm: a rotation and a
    /// translation.
    pub grid_to_lps: DAffine3,
}

/// Smallest box of voxels that holds something, inclusive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VoxelBox {
    /// Lowest index on each axis.
    pub min: [usize; 3],
    /// Highest index on each axis.
    pub max: [usize; 3],
}

impl LabelVolume {
    /// Refuses sheared axes and voxels without size.
    ///
    /// # Errors
    /// [`ImagingError::Sheared`], [`ImagingError::Format`].
    pub fn check_geometry(&self) -> Result<(), ImagingError> {
        check_geometry(&self.path, &self.voxel_to_lps)
    }

    /// The volume on perpendicular axes: as it is, or resampled.
    ///
    /// # Errors
    /// [`ImagingError::Sheared`] for axes that nearly fall together, [`ImagingError::Format`].
    pub fn straight(self) -> Result<Self, ImagingError> {
        match self.check_geometry() {
            Err(ImagingError::Sheared { path, degrees }) => {
                let most = self.dims.iter().product::<usize>().saturating_mul(MAX_GROWTH);
                let straight = (degrees <= MAX_SHEAR_DEGREES).then(|| crate::resample::straighten_labels(&self, most)).flatten();
                let straight = straight.ok_or(ImagingError::Sheared { path, degrees })?;
                straight.check_geometry()?;
                Ok(straight)
            }
            done => done.map(|()| self),
        }
    }

    /// The box of all voxels that have a part, `None` when there are none.
    #[must_use]
    pub fn bounding_box(&self) -> Option<VoxelBox> {
        let [nx, ny, _] = self.dims;
        let mut found: Option<VoxelBox> = None;
        for (row, voxels) in self.parts.chunks_exact(nx).enumerate() {
            let Some(first) = voxels.iter().position(|v| *v != 0) else { continue };
            let last = voxels.iter().rposition(|v| *v != 0).unwrap_or(first);
            let (y, z) = (row % ny, row / ny);
            let b = found.get_or_insert(VoxelBox { min: [first, y, z], max: [last, y, z] });
            b.min = [b.min[0].min(first), b.min[1].min(y), b.min[2].min(z)];
            b.max = [b.max[0].max(last), b.max[1].max(y), b.max[2].max(z)];
        }
        found
    }

    /// The voxels of a box with a margin of `margin_mm` of nothing around it, as a right-handed grid: a left-handed volume is turned
    /// around along its first axis. The volume must have passed [`LabelVolume::check_geometry`].
    #[must_use]
    pub fn crop(&self, b: VoxelBox, margin_mm: f64) -> Body {
        let spacing = frame::spacing(&self.voxel_to_lps);
        let margin = spacing.to_array().map(|s| (margin_mm / s).ceil() as usize + 1);
        let inner: [usize; 3] = std::array::from_fn(|a| b.max[a] - b.min[a] + 1);
        let dims: [usize; 3] = std::array::from_fn(|a| inner[a] + 2 * margin[a]);
        let flip = self.voxel_to_lps.matrix3.determinant() < 0.0;
        let mut parts = vec![0; dims[0] * dims[1] * dims[2]];
        for z in 0..inner[2] {
            for y in 0..inner[1] {
                let from = (b.min[2] + z) * self.dims[0] * self.dims[1] + (b.min[1] + y) * self.dims[0] + b.min[0];
                let to = ((z + margin[2]) * dims[1] + y + margin[1]) * dims[0] + margin[0];
                let row = &mut parts[to..to + inner[0]];
                row.copy_from_slice(&self.parts[from..from + inner[0]]);
                if flip {
                    row.reverse();
                }
            }
        }
        let m = self.voxel_to_lps.matrix3;
        let mut origin = DVec3::from_array(std::array::from_fn(|a| b.min[a] as f64 - margin[a] as f64));
        let mut axes = DMat3::from_cols(m.x_axis / spacing.x, m.y_axis / spacing.y, m.z_axis / spacing.z);
        if flip {
            origin.x += (dims[0] - 1) as f64;
            axes.x_axis = -axes.x_axis;
        }
        let grid_to_lps = DAffine3 { matrix3: axes, translation: self.voxel_to_lps.transform_point3(origin) };
        Body { dims, spacing, parts, grid_to_lps }
    }
}

impl Body {
    /// Volume of a voxel, mm3.
    #[must_use]
    pub fn voxel_mm3(&self) -> f64 {
        self.spacing.element_product()
    }

    /// Number of voxels that have a part.
    #[must_use]
    pub fn count(&self) -> usize {
        self.parts.iter().filter(|v| **v != 0).count()
    }

    /// The box of all voxels that have a part, in the grid's coordinates of their centres, mm.
    #[must_use]
    pub fn extent_mm(&self) -> Option<(DVec3, DVec3)> {
        let mut found: Option<(DVec3, DVec3)> = None;
        for (i, _) in self.parts.iter().enumerate().filter(|(_, v)| **v != 0) {
            let p = self.centre(i);
            let b = found.get_or_insert((p, p));
            *b = (b.0.min(p), b.1.max(p));
        }
        found
    }

    /// Centre of a voxel in the grid's coordinates, mm.
    #[must_use]
    pub fn centre(&self, index: usize) -> DVec3 {
        let [nx, ny, _] = self.dims;
        DVec3::new((index % nx) as f64, (index / nx % ny) as f64, (index / (nx * ny)) as f64) * self.spacing
    }
}

/// Refuses voxels without size and positions that are not finite.
pub(crate) fn check_size(path: &Path, voxel_to_lps: &DAffine3) -> Result<(), ImagingError> {
    let spacing = frame::spacing(voxel_to_lps);
    let plausible = spacing.min_element() >= VOXEL_MM[0] && spacing.max_element() <= VOXEL_MM[1];
    if !voxel_to_lps.is_finite() || !plausible || spacing.max_element() > MAX_ANISOTROPY * spacing.min_element() {
        let reason = format!(
            "the voxel size is {spacing} mm: expected {} to {} mm, the longest at most {MAX_ANISOTROPY} times the shortest; repair the header",
            VOXEL_MM[0], VOXEL_MM[1]
        );
        return Err(ImagingError::Format { path: path.into(), reason });
    }
    Ok(())
}

/// Refuses sheared axes too.
pub(crate) fn check_geometry(path: &Path, voxel_to_lps: &DAffine3) -> Result<(), ImagingError> {
    check_size(path, voxel_to_lps)?;
    let degrees = frame::shear_degrees(voxel_to_lps);
    if degrees > SHEAR_DEGREES {
        return Err(ImagingError::Sheared { path: path.into(), degrees });
    }
    Ok(())
}
