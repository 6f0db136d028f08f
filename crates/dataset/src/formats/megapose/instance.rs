//! One instance of a set's index.

use std::ops::RangeInclusive;

use nalgebra::Vector3;

use super::super::bop::{GtInfoRecord, GtRecord};

const MM_PER_METRE: f64 = 1000.0;

/// Distances of annotated objects to their camera, metres; what lies outside was written in another unit.
pub const PLAUSIBLE_DISTANCE: RangeInclusive<f64> = 0.02..=20.0;

/// One instance of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InstanceRef {
    /// Index into [`super::ShardDataset::image_keys`].
    pub image: u32,
    /// Position in the image's `gt.json`.
    pub instance: u32,
    /// Object id, that of `gt.json`.
    pub obj_id: u32,
    /// Visible share of the silhouette, 0..=1.
    pub visib_fract: f32,
    /// Visible pixels.
    pub px_count_visib: u32,
}

/// The instances of an image whose number is not known yet (0), and how many visible ones are left out because of their
/// distance.
pub(super) fn instance_refs(gt: &[GtRecord], info: &[GtInfoRecord]) -> (Vec<InstanceRef>, usize) {
    let near =
        |gt: &GtRecord| PLAUSIBLE_DISTANCE.contains(&(Vector3::from(gt.cam_t_m2c).norm() / MM_PER_METRE));
    let pairs = || gt.iter().zip(info).enumerate();
    let left_out = pairs().filter(|(_, (gt, info))| info.px_count_visib > 0 && !near(gt)).count();
    let instances = pairs()
        .filter(|(_, (gt, _))| near(gt))
        .map(|(i, (gt, info))| InstanceRef {
            image: 0,
            instance: i as u32,
            obj_id: gt.obj_id,
            visib_fract: info.visib_fract as f32,
            px_count_visib: info.px_count_visib,
        })
        .collect();
    (instances, left_out)
}
