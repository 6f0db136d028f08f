//! One instance of a set's index.

use nalgebra::Vector3;

use super::super::{
    bop::{GtInfoRecord, GtRecord},
    units,
};

const MM_PER_METRE: f64 = 1000.0;

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

/// The instances of an image whose number is not known yet (0), and what is wrong with the visible ones that are left out
/// because of their distance.
pub(super) fn instance_refs(gt: &[GtRecord], info: &[GtInfoRecord]) -> (Vec<InstanceRef>, Vec<String>) {
    let (mut instances, mut left_out) = (Vec::new(), Vec::new());
    for (i, (gt, info)) in gt.iter().zip(info).enumerate() {
        match units::distance_problem(Vector3::from(gt.cam_t_m2c).norm() / MM_PER_METRE) {
            None => instances.push(InstanceRef {
                image: 0,
                instance: i as u32,
                obj_id: gt.obj_id,
                visib_fract: info.visib_fract as f32,
                px_count_visib: info.px_count_visib,
            }),
            Some(problem) if info.px_count_visib > 0 => left_out.push(format!("instance {i} {problem}")),
            Some(_) => {}
        }
    }
    (instances, left_out)
}
