//! Detections and segmentations as a COCO-like list.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{
    BopSplit, FormatError, Target,
    files::{read_json, write_json},
    rle::Rle,
};

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
    #[serde(default = "unknown")]
    pub time: f64,
    /// Mask, as large as the image.
    pub segmentation: Rle,
}

fn unknown() -> f64 {
    -1.0
}

/// Reads a detection list in the order of the file. The masks stay encoded.
pub fn read_detections(path: &Path) -> Result<Vec<Detection>, FormatError> {
    let detections: Vec<Detection> = read_json(path)?;
    for (entry, detection) in detections.iter().enumerate() {
        let wrong = |field: &str, value: String, expected: &str| {
            Err(FormatError::field(format!("{}: entry {entry}", path.display()), field, value, expected))
        };
        let Detection { score, bbox, .. } = detection;
        if !score.is_finite() {
            return wrong("score", score.to_string(), "a finite number");
        }
        if !bbox.iter().all(|x| x.is_finite()) || bbox[2] < 0.0 || bbox[3] < 0.0 {
            return wrong("bbox", format!("{bbox:?}"), "x, y, width >= 0, height >= 0");
        }
    }
    Ok(detections)
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

#[cfg(test)]
mod tests {
    use unopose_core::frame::Mask;

    use super::*;
    use crate::formats::rle::Counts;

    #[test]
    fn both_mask_forms_survive_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("dets.json");
        let mask = Mask { width: 3, height: 2, data: vec![true, false, true, true, false, false] };
        let detection = |segmentation, score| Detection {
            scene_id: 1,
            image_id: 2,
            category_id: 3,
            bbox: [0.0, 0.0, 2.0, 1.0],
            score,
            time: 0.5,
            segmentation,
        };
        let list = [detection(Rle::encode(&mask), 0.2), detection(Rle::encode_compressed(&mask), 0.24)];
        write_detections(&path, &list).unwrap();
        let read = read_detections(&path).unwrap();
        assert_eq!(read, list);
        assert!(matches!(read[1].segmentation.counts, Counts::Compressed(_)));
        assert_eq!(read[0].segmentation.decode().unwrap(), read[1].segmentation.decode().unwrap());

        for (broken, part) in [
            (
                Detection { score: -1.0, bbox: [0.0, 0.0, -2.0, 1.0], ..list[1].clone() },
                "entry 1: bbox is [0.0, 0.0, -2.0",
            ),
            (Detection { score: f64::NAN, ..list[1].clone() }, "invalid type: null"),
        ] {
            write_detections(&path, &[list[0].clone(), broken]).unwrap();
            let message = read_detections(&path).unwrap_err().to_string();
            assert!(message.contains("dets.json") && message.contains(part), "{message}");
        }
    }
}
