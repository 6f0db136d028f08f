//! Templates of a CAD model as CNOS takes them: views from the vertices of an icosphere.

use std::sync::Arc;

use nalgebra::Vector3;
use rayon::prelude::*;
use unopose_core::{
    frame::{Mask, RgbdFrame},
    geometry::{Intrinsics, Pose, icosphere},
};
use unopose_dataset::{formats::BopDataset, mesh, render::posed_view};

use super::SegmentError;

/// Side of a template, pixels.
const SIDE: u32 = 256;
/// Share of the side that the sphere around the model fills.
const FILL: f64 = 0.9;
/// Distance of the camera, radii of that sphere.
const DISTANCE: f64 = 5.0;

/// Templates of the models of a dataset.
#[derive(Clone, Debug)]
pub struct Templates<'a> {
    dataset: &'a BopDataset,
    directions: Vec<Vector3<f64>>,
}

impl<'a> Templates<'a> {
    /// Numbers of templates: the vertices of an icosphere.
    pub const COUNTS: [usize; 3] = [12, 42, 162];

    /// With `count` templates per object, one of [`Self::COUNTS`].
    pub fn new(dataset: &'a BopDataset, count: usize) -> Result<Self, SegmentError> {
        let subdivisions = Self::COUNTS.iter().zip(0..).find(|(n, _)| **n == count);
        let (_, subdivisions) = subdivisions.ok_or_else(|| SegmentError::Prompt {
            what: "number of templates",
            value: count.to_string(),
            expected: "12, 42 or 162, the vertices of an icosphere".into(),
        })?;
        Ok(Self { dataset, directions: icosphere(subdivisions) })
    }

    /// Everything that decides about the views of an object.
    pub fn fingerprint(&self) -> String {
        format!("templates 1 {} {}", self.directions.len(), self.dataset.root().display())
    }

    /// The model of an object from all sides, without the views in which nothing of it is seen.
    pub fn views(&self, obj_id: u32) -> Result<Vec<(RgbdFrame, Mask)>, SegmentError> {
        let model = Arc::new(mesh::load(&self.dataset.textured_model_path(obj_id)?, 1e-3)?);
        let bounds = model.bounds();
        let center = Vector3::from(bounds.center()).cast::<f64>();
        let radius = 0.5 * Vector3::from(bounds.size()).cast::<f64>().norm();
        let middle = 0.5 * f64::from(SIDE - 1);
        let focal = 0.5 * FILL * f64::from(SIDE) / (1.0 / DISTANCE).asin().tan();
        let intrinsics = Intrinsics { fx: focal, fy: focal, cx: middle, cy: middle };
        let view = |direction: &Vector3<f64>| {
            let position = center + direction * (DISTANCE * radius);
            let t_camera_object = Pose::looking_at(&position, &center, 0.0);
            let drawn = posed_view(&[(model.clone(), t_camera_object)], intrinsics, [SIDE; 2]);
            let mask = drawn.instances.into_iter().next().map(|instance| instance.mask_visib)?;
            (mask.count() > 0).then_some((drawn.frame, mask))
        };
        Ok(self.directions.par_iter().filter_map(view).collect())
    }
}

#[cfg(test)]
mod tests {
    use unopose_core::files::write_atomic;
    use unopose_dataset::mesh::{TriangleMesh, ply};

    use super::*;

    #[test]
    fn a_box_is_seen_from_all_sides_in_the_middle() {
        let folder = tempfile::tempdir().unwrap();
        // 20 x 20 x 40 mm, off the origin.
        let corner =
            |i: u32| [0.02 * (i & 1) as f32, 0.02 * (i >> 1 & 1) as f32, 0.04 * (i >> 2) as f32 + 1.0];
        let sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
        let faces = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let mesh = TriangleMesh { vertices: (0..8).map(corner).collect(), faces, ..Default::default() };
        let path = folder.path().join("models/obj_000007.ply");
        write_atomic(&path, |out| ply::write(&mesh, 1000.0, None, out)).unwrap();
        let dataset = BopDataset::open(folder.path()).unwrap();
        let views = Templates::new(&dataset, 12).unwrap().views(7).unwrap();
        assert_eq!(views.len(), 12);
        let radius = 0.5 * 0.0024f64.sqrt();
        for (frame, mask) in &views {
            let b = mask.bounding_box().unwrap();
            // Centred, as the box is symmetric, up to perspective.
            let middle = [b.col_min + b.col_max, b.row_min + b.row_max];
            assert!(middle.iter().all(|&m| m.abs_diff(SIDE) <= 24), "{b:?}");
            // Inside the sphere's disc, and not small in it.
            let longest = (b.col_max - b.col_min).max(b.row_max - b.row_min);
            assert!((120..=231).contains(&longest), "{b:?}");
            let depths = mask.pixels().map(|(col, row)| f64::from(frame.depth.get(col, row)));
            let (least, most) = depths.fold((f64::MAX, 0.0f64), |(a, b), z| (a.min(z), b.max(z)));
            assert!(least > 4.0 * radius && most < 6.0 * radius, "{least} {most}");
        }
        let message = Templates::new(&dataset, 40).unwrap_err().to_string();
        assert!(message.contains("number of templates is 40, expected 12, 42 or 162"), "{message}");
        let message = Templates::new(&dataset, 12).unwrap().views(8).unwrap_err().to_string();
        assert!(message.contains("obj_000008.ply"), "{message}");
    }
}
