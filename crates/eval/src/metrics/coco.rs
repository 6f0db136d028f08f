//! Mean average precision of detections as in COCO and the BOP challenge on 2D detection and segmentation: overlaps of
//! masks (segm) or of boxes (bbox), thresholds 0.50 to 0.95, 101-point interpolation, at most 100 detections per image
//! and object.
//!
//! Ground truth that is hardly visible is ignored: a detection that matches it is neither a hit nor a false alarm. Boxes
//! of the ground truth are those of the whole silhouette (the challenge's "amodal" boxes).

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use unopose_dataset::formats::{
    BopSplit, Foreground, Target, detections::Detection, targets::MIN_VISIBILITY,
};

use super::{
    EvalError,
    average_precision::{average_precision, mean},
    matching::top,
    scoring::annotated,
};

/// Overlaps from which a detection is a hit: 0.5, 0.55, ... 0.95.
const THRESHOLDS: usize = 10;
/// Best detections of an object in an image that count.
const MAX_DETECTIONS: usize = 100;

/// Where an instance is.
#[derive(Clone, Debug, PartialEq)]
enum Region {
    /// x, y, width, height in pixels.
    Box([f64; 4]),
    Mask(Foreground),
}

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegionKind {
    /// Bounding boxes (COCO's bbox); those of the ground truth enclose the whole silhouette.
    Box,
    /// Visible masks (COCO's segm).
    Mask,
}

/// An annotated instance.
#[derive(Clone, Debug, PartialEq)]
struct CocoGroundTruth {
    scene_id: u32,
    im_id: u32,
    obj_id: u32,
    region: Region,
    ignored: bool,
}

/// A detected instance.
#[derive(Clone, Debug, PartialEq)]
struct CocoDetection {
    scene_id: u32,
    im_id: u32,
    obj_id: u32,
    score: f64,
    region: Region,
}

/// Mean average precisions, each in 0..=1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct CocoScores {
    /// Mean over thresholds and objects.
    #[serde(rename = "mAP")]
    pub map: f64,
    /// At an overlap (IoU) of 0.5, mean over the objects.
    #[serde(rename = "AP50")]
    pub ap50: f64,
    /// At an overlap of 0.75, mean over the objects.
    #[serde(rename = "AP75")]
    pub ap75: f64,
    /// Share of the instances that are found, mean over thresholds and objects.
    #[serde(rename = "AR100")]
    pub ar100: f64,
    /// Mean over the thresholds, by object id.
    pub per_object: BTreeMap<u32, f64>,
    /// Annotated instances to be found.
    pub n_instances: usize,
    /// Annotated instances that are hardly visible.
    pub n_ignored: usize,
    /// Detections that were compared.
    pub n_detections: usize,
    /// Detections left out: of images without any ground truth, and of objects without any that counts.
    pub n_outside: usize,
}

impl Region {
    /// Intersection over union; 0 between a box and a mask.
    fn iou(&self, other: &Self) -> f64 {
        match (self, other) {
            (Self::Mask(a), Self::Mask(b)) => a.iou(b),
            (Self::Box(a), Self::Box(b)) => {
                let side = |i: usize| (a[i] + a[i + 2]).min(b[i] + b[i + 2]) - a[i].max(b[i]);
                let both = side(0).max(0.0) * side(1).max(0.0);
                let either = a[2] * a[3] + b[2] * b[3] - both;
                if either > 0.0 { both / either } else { 0.0 }
            }
            _ => 0.0,
        }
    }
}

/// Scores the detections in the images of `targets` by their masks or boxes. A detection whose mask cannot be decoded, or has
/// another size than the image, is a false alarm.
pub fn coco_scores(
    split: &BopSplit,
    targets: &[Target],
    detections: &[Detection],
    kind: RegionKind,
) -> Result<CocoScores, EvalError> {
    let detections = coco_detections(detections, kind);
    let targets = annotated(split, targets.to_vec())?;
    Ok(coco_map(&coco_ground_truth(split, &targets, kind)?, &detections))
}

/// Scores detections. The images are those of the ground truth: it holds all annotated instances of every image, also of
/// objects that are not asked for.
fn coco_map(ground_truth: &[CocoGroundTruth], detections: &[CocoDetection]) -> CocoScores {
    let images: BTreeSet<(u32, u32)> = ground_truth.iter().map(|g| (g.scene_id, g.im_id)).collect();
    let mut objects: BTreeMap<u32, BTreeMap<(u32, u32), ObjectInImage>> = BTreeMap::new();
    let mut counted: BTreeMap<u32, usize> = BTreeMap::new();
    for truth in ground_truth {
        *counted.entry(truth.obj_id).or_default() += usize::from(!truth.ignored);
        let image = objects.entry(truth.obj_id).or_default();
        image.entry((truth.scene_id, truth.im_id)).or_default().truths.push(truth);
    }
    objects.retain(|obj_id, _| counted[obj_id] > 0);
    let mut n_detections = 0;
    for detection in detections {
        let image = (detection.scene_id, detection.im_id);
        if let (Some(of_object), true) = (objects.get_mut(&detection.obj_id), images.contains(&image)) {
            of_object.entry(image).or_default().detections.push(detection);
            n_detections += 1;
        }
    }
    let objects: Vec<(u32, Vec<ObjectInImage>)> =
        objects.into_iter().map(|(id, images)| (id, images.into_values().collect())).collect();
    let scored: Vec<ObjectScore> =
        objects.par_iter().map(|(id, images)| ObjectScore::new(*id, images, counted[id])).collect();
    let over_objects =
        |value: &dyn Fn(&ObjectScore) -> f64| mean(scored.iter().map(value)).unwrap_or_default();
    let over_thresholds = |values: &[f64; THRESHOLDS]| values.iter().sum::<f64>() / THRESHOLDS as f64;
    CocoScores {
        map: over_objects(&|o| over_thresholds(&o.precision)),
        ap50: over_objects(&|o| o.precision[0]),
        ap75: over_objects(&|o| o.precision[5]),
        ar100: over_objects(&|o| over_thresholds(&o.recall)),
        per_object: scored.iter().map(|o| (o.obj_id, over_thresholds(&o.precision))).collect(),
        n_instances: counted.values().sum(),
        n_ignored: ground_truth.iter().filter(|g| g.ignored).count(),
        n_detections,
        n_outside: detections.len() - n_detections,
    }
}

/// All annotated instances of the targets' images. Images whose annotation or masks cannot be read are left out, each with a
/// warning.
fn coco_ground_truth(
    split: &BopSplit,
    targets: &[Target],
    kind: RegionKind,
) -> Result<Vec<CocoGroundTruth>, EvalError> {
    let images: BTreeSet<(u32, u32)> = targets.iter().map(|t| (t.scene_id, t.im_id)).collect();
    let images: Vec<(u32, u32)> = images.into_iter().collect();
    let of_image = |&(scene_id, im_id): &(u32, u32)| -> Result<Vec<CocoGroundTruth>, EvalError> {
        let scene = split.scene(scene_id)?;
        let instances = scene.gt(im_id)?.iter().zip(scene.gt_info(im_id)?).enumerate();
        instances
            .map(|(index, (gt, info))| {
                let region = match kind {
                    RegionKind::Box => Region::Box(info.bbox_obj.map(f64::from)),
                    RegionKind::Mask => Region::Mask(Foreground::of_mask(&scene.mask_visib(im_id, index)?)),
                };
                let ignored = info.visib_fract < MIN_VISIBILITY;
                Ok(CocoGroundTruth { scene_id, im_id, obj_id: gt.obj_id, region, ignored })
            })
            .collect()
    };
    let found: Vec<Result<Vec<CocoGroundTruth>, EvalError>> = images.par_iter().map(of_image).collect();
    let (mut truths, mut broken) = (Vec::new(), None);
    for of_image in found {
        match of_image {
            Ok(of_image) => truths.extend(of_image),
            Err(error) => {
                tracing::warn!("{error}: the image does not count");
                broken = Some(error);
            }
        }
    }
    match broken {
        Some(error) if truths.is_empty() => Err(error),
        _ => Ok(truths),
    }
}

/// Detections as they are compared; one with a broken mask overlaps nothing.
fn coco_detections(detections: &[Detection], kind: RegionKind) -> Vec<CocoDetection> {
    let convert = |detection: &Detection| CocoDetection {
        scene_id: detection.scene_id,
        im_id: detection.image_id,
        obj_id: detection.category_id,
        score: detection.score,
        region: match kind {
            RegionKind::Box => Region::Box(detection.bbox),
            RegionKind::Mask => Region::Mask(Foreground::new(&detection.segmentation).unwrap_or_default()),
        },
    };
    detections.iter().map(convert).collect()
}

/// One object in one image.
#[derive(Default)]
struct ObjectInImage<'a> {
    truths: Vec<&'a CocoGroundTruth>,
    detections: Vec<&'a CocoDetection>,
}

struct ObjectScore {
    obj_id: u32,
    /// By threshold.
    precision: [f64; THRESHOLDS],
    recall: [f64; THRESHOLDS],
}

impl ObjectScore {
    fn new(obj_id: u32, images: &[ObjectInImage], instances: usize) -> Self {
        let mut ranked: [Vec<(f64, bool)>; THRESHOLDS] = Default::default();
        images.iter().for_each(|image| image.rank(&mut ranked));
        let hits = |list: &Vec<(f64, bool)>| list.iter().filter(|(_, hit)| *hit).count();
        Self {
            obj_id,
            recall: std::array::from_fn(|t| hits(&ranked[t]) as f64 / instances.max(1) as f64),
            precision: ranked.map(|list| average_precision(list, instances).unwrap_or_default()),
        }
    }
}

impl ObjectInImage<'_> {
    /// Adds the detections that count with their scores, by threshold.
    fn rank(&self, ranked: &mut [Vec<(f64, bool)>; THRESHOLDS]) {
        let mut truths = self.truths.clone();
        truths.sort_by_key(|truth| truth.ignored);
        let best = top(self.detections.iter().map(|d| d.score), MAX_DETECTIONS);
        let overlaps: Vec<Vec<f64>> = best
            .iter()
            .map(|&d| truths.iter().map(|truth| self.detections[d].region.iou(&truth.region)).collect())
            .collect();
        for (index, ranked) in ranked.iter_mut().enumerate() {
            let threshold = 0.5 + 0.05 * index as f64;
            let mut taken = vec![false; truths.len()];
            for (&d, overlaps) in best.iter().zip(&overlaps) {
                let matched = best_overlap(overlaps, &truths, &taken, threshold);
                if let Some(g) = matched {
                    taken[g] = true;
                }
                if matched.is_none_or(|g| !truths[g].ignored) {
                    ranked.push((self.detections[d].score, matched.is_some()));
                }
            }
        }
    }
}

/// The free ground truth with the largest overlap, the later of equal ones; an ignored one only when no other is left.
fn best_overlap(
    overlaps: &[f64],
    truths: &[&CocoGroundTruth],
    taken: &[bool],
    threshold: f64,
) -> Option<usize> {
    let best = |ignored: bool| {
        let free = (0..truths.len()).filter(|&g| truths[g].ignored == ignored && !taken[g]);
        let near = free.filter(|&g| overlaps[g] >= threshold);
        near.max_by(|&a, &b| overlaps[a].total_cmp(&overlaps[b]))
    };
    best(false).or_else(|| best(true))
}

#[cfg(test)]
#[path = "coco_tests.rs"]
mod tests;
