//! Detections and segmentations as a list: those of BOP, results and annotations of COCO, masks of Segment Anything.

mod list;
mod polygon;
mod segmentation;

#[cfg(test)]
mod tests;

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{BopSplit, FormatError, Target, files::write_json, rle::Rle};

pub use list::{ListedMask, MaskList};

/// One detected instance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// Scene of the image.
    pub scene_id: u32,
    /// Number of the image in its scene.
    pub image_id: u32,
    /// Object id.
    pub category_id: u32,
    /// x, y, width, height in pixels.
    pub bbox: [f64; 4],
    /// Confidence that the object is there; compared with others of the same list only.
    pub score: f64,
    /// Seconds for the whole image, negative when unknown.
    pub time: f64,
    /// Mask, as large as the image.
    pub segmentation: Rle,
}

/// Reads a list of detections in the order of the file. RLE masks stay encoded; polygons are filled, for which `split` has the
/// sizes of images where the list has none.
pub fn read_detections(path: &Path, split: Option<&BopSplit>) -> Result<Vec<Detection>, FormatError> {
    let size = |scene_id, im_id| split?.scene(scene_id).ok()?.image_size(im_id).ok();
    MaskList::read(path)?.masks().map(|mask| mask.detection(size)).collect()
}

/// The true segmentation: visible masks of the targets' instances, the most visible ones where there are more. Targets whose
/// annotation or masks cannot be read have none, each with a warning; an error when that is all of them.
pub fn visible_instances(split: &BopSplit, targets: &[Target]) -> Result<Vec<Detection>, FormatError> {
    let (mut detections, mut broken) = (Vec::new(), None);
    for target in targets {
        match instances_of_target(split, target) {
            Ok(instances) => detections.extend(instances),
            Err(error) => {
                let Target { scene_id, im_id, obj_id, .. } = target;
                tracing::warn!("scene {scene_id} image {im_id} object {obj_id} has no mask: {error}");
                broken = Some(error);
            }
        }
    }
    match broken {
        Some(error) if detections.is_empty() => Err(error),
        _ => Ok(detections),
    }
}

fn instances_of_target(split: &BopSplit, target: &Target) -> Result<Vec<Detection>, FormatError> {
    let (scene, im_id) = (split.scene(target.scene_id)?, target.im_id);
    let instances = scene.gt(im_id)?.iter().zip(scene.gt_info(im_id)?).enumerate();
    let mut of_object: Vec<_> = instances.filter(|(_, (gt, _))| gt.obj_id == target.obj_id).collect();
    of_object.sort_by(|(_, (_, a)), (_, (_, b))| b.visib_fract.total_cmp(&a.visib_fract));
    let best = of_object.into_iter().take(target.inst_count as usize);
    best.map(|(index, (_, info))| {
        Ok(Detection {
            scene_id: target.scene_id,
            image_id: im_id,
            category_id: target.obj_id,
            bbox: info.bbox_visib.map(f64::from),
            score: 1.0,
            time: 0.0,
            segmentation: Rle::encode_compressed(&scene.mask_visib(im_id, index)?),
        })
    })
    .collect()
}

/// Writes a detection list.
pub fn write_detections(path: &Path, detections: &[Detection]) -> Result<(), FormatError> {
    write_json(path, detections, false)
}
