//! Detections and segmentations as a list: those of BOP, results and annotations of COCO, masks of Segment Anything.

mod list;
mod polygon;
mod segmentation;

#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use serde::Serialize;

use super::{BopSplit, Foreground, FormatError, Target, files::write_json, rle::Rle};

pub use list::{ListedMask, MaskList};

/// One detected instance.
#[derive(Clone, Debug, PartialEq, Serialize)]
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

/// A detection that cannot be used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SkippedDetection {
    /// Scene of the image.
    pub scene_id: u32,
    /// Number of the image in its scene.
    pub im_id: u32,
    /// Object id.
    pub obj_id: u32,
    /// Index in the list.
    pub entry: usize,
    /// What is wrong with its mask.
    pub reason: String,
}

/// Reads a list of detections in the order of the file. RLE masks stay encoded; polygons are filled, for which `split` has the
/// sizes of images where the list has none.
pub fn read_detections(path: &Path, split: Option<&BopSplit>) -> Result<Vec<Detection>, FormatError> {
    let size = |scene_id, im_id| split?.scene(scene_id).ok()?.image_size(im_id).ok();
    MaskList::read(path)?.masks().map(|mask| mask.detection(size)).collect()
}

/// Splits off the detections in `images` of a split whose masks are broken, empty or of another size than the image.
/// Images that are not there are left alone.
pub(crate) fn usable_detections(
    detections: Vec<Detection>,
    split: &BopSplit,
    images: &BTreeSet<(u32, u32)>,
) -> Result<(Vec<Detection>, Vec<SkippedDetection>), FormatError> {
    let mut sizes: BTreeMap<(u32, u32), [u32; 2]> = BTreeMap::new();
    for &(scene_id, im_id) in images {
        let (width, height) = split.scene(scene_id)?.image_size(im_id)?;
        sizes.insert((scene_id, im_id), [height, width]);
    }
    let (mut usable, mut skipped) = (Vec::new(), Vec::new());
    for (entry, detection) in detections.into_iter().enumerate() {
        let size = sizes.get(&(detection.scene_id, detection.image_id));
        match size.and_then(|size| detection.problem(*size)) {
            None => usable.push(detection),
            Some(reason) => skipped.push(SkippedDetection {
                scene_id: detection.scene_id,
                im_id: detection.image_id,
                obj_id: detection.category_id,
                entry,
                reason,
            }),
        }
    }
    Ok((usable, skipped))
}

/// The true segmentation: visible masks of the targets' instances, the most visible ones where there are more.
pub fn visible_instances(split: &BopSplit, targets: &[Target]) -> Result<Vec<Detection>, FormatError> {
    let mut detections = Vec::new();
    for target in targets {
        let (scene, im_id) = (split.scene(target.scene_id)?, target.im_id);
        let instances = scene.gt(im_id)?.iter().zip(scene.gt_info(im_id)?).enumerate();
        let mut of_object: Vec<_> = instances.filter(|(_, (gt, _))| gt.obj_id == target.obj_id).collect();
        of_object.sort_by(|(_, (_, a)), (_, (_, b))| b.visib_fract.total_cmp(&a.visib_fract));
        for (index, (_, info)) in of_object.into_iter().take(target.inst_count as usize) {
            detections.push(Detection {
                scene_id: target.scene_id,
                image_id: im_id,
                category_id: target.obj_id,
                bbox: info.bbox_visib.map(f64::from),
                score: 1.0,
                time: 0.0,
                segmentation: Rle::encode_compressed(&scene.mask_visib(im_id, index)?),
            });
        }
    }
    Ok(detections)
}

impl Detection {
    /// Why the mask is of no use in an image of `size` (height, width).
    fn problem(&self, size: [u32; 2]) -> Option<String> {
        match Foreground::new(&self.segmentation) {
            Err(error) => Some(error.to_string()),
            Ok(mask) if mask.size() != size => {
                let ([h, w], [height, width]) = (mask.size(), size);
                Some(format!("segmentation size is {w} x {h}, expected the image's {width} x {height}"))
            }
            Ok(mask) if mask.area() == 0 => Some("segmentation is empty, expected at least one pixel".into()),
            Ok(_) => None,
        }
    }
}

/// Writes a detection list.
pub fn write_detections(path: &Path, detections: &[Detection]) -> Result<(), FormatError> {
    write_json(path, detections, false)
}
