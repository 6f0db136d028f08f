//! One instance of a set's index.

use super::super::bop::{GtInfoRecord, GtRecord};

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

/// The instances of an image whose number is not known yet (0).
pub(super) fn instance_refs(gt: &[GtRecord], info: &[GtInfoRecord]) -> Vec<InstanceRef> {
    let pairs = gt.iter().zip(info).enumerate();
    pairs
        .map(|(i, (gt, info))| InstanceRef {
            image: 0,
            instance: i as u32,
            obj_id: gt.obj_id,
            visib_fract: info.visib_fract as f32,
            px_count_visib: info.px_count_visib,
        })
        .collect()
}
