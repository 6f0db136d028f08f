//! The pairs of a target list, one after the other.

use std::collections::{BTreeMap, HashMap};

use image::RgbImage;
use unopose_core::{
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::{
    formats::{BopScene, FormatError, ReferenceTarget, detections::Detection},
    protocol::TargetList,
};
use unopose_eval::metrics::{EvalObject, PoseErrors, TestView};
use unopose_infer::{
    InferError, PoseCriterion, PoseEstimator, Query, TargetReferences, experiment::ReferenceColor,
};

use super::{AnalysisError, PairRecord, measure, measure::Truth};

/// VSD's tolerance of visibility, metres (BOP's value).
const VSD_DELTA: f64 = 0.015;

/// Analyses every target that has a detection (its best one) and a usable reference. `progress` is called with the targets
/// done and all targets.
pub fn analyse(
    estimator: &PoseEstimator,
    list: &TargetList,
    right: PoseCriterion,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Vec<PairRecord>, AnalysisError> {
    let objects = EvalObject::load_all(&list.dataset, list.targets.iter().map(|t| t.obj_id))?;
    let infos = list.dataset.models_info()?;
    let mut detections: HashMap<(u32, u32, u32), &Detection> = HashMap::new();
    for detection in &list.detections {
        let key = (detection.scene_id, detection.image_id, detection.category_id);
        let best = detections.entry(key).or_insert(detection);
        if detection.score > best.score {
            *best = detection;
        }
    }
    let mut targets: Vec<&ReferenceTarget> = list.targets.iter().collect();
    targets.sort_by_key(|t| (t.scene_id, t.im_id));
    let mut references = TargetReferences::new(estimator, list.reference_split(), ReferenceColor::Keep);
    let mut view: Option<((u32, u32), RgbdFrame)> = None;
    let mut textures: BTreeMap<(u32, u32, u32), f64> = BTreeMap::new();
    let mut records = Vec::new();
    for (done, target) in targets.iter().enumerate() {
        progress(done, targets.len());
        let key = (target.scene_id, target.im_id);
        let (Some(detection), Some(object), Some(info)) = (
            detections.get(&(target.scene_id, target.im_id, target.obj_id)),
            objects.get(&target.obj_id),
            infos.get(&target.obj_id),
        ) else {
            continue;
        };
        let scene = list.split.scene(target.scene_id)?;
        if view.as_ref().is_none_or(|(of, _)| *of != key) {
            view = match scene.frame(target.im_id) {
                Ok(frame) => Some((key, frame)),
                Err(error) => {
                    tracing::warn!("scene {} image {} cannot be read: {error}", key.0, key.1);
                    continue;
                }
            };
        }
        let Some((_, frame)) = &view else { continue };
        let mask = detection.segmentation.decode().map_err(|error| {
            let place = format!("scene {} image {} object {}", target.scene_id, target.im_id, target.obj_id);
            FormatError::field(place, "segmentation", "unreadable", error.to_string())
        })?;
        let reference_key = (target.ref_scene_id, target.ref_im_id, target.obj_id);
        let (reference, t_reference_object) = match references.get(target) {
            Ok(reference) => reference,
            Err(reason) => {
                tracing::warn!("{reason}");
                continue;
            }
        };
        let texture = match textures.get(&reference_key) {
            Some(&texture) => texture,
            None => {
                let scene = list.reference_split().scene(target.ref_scene_id)?;
                let (index, _) = scene.most_visible(target.ref_im_id, target.obj_id)?;
                let texture =
                    texture(&scene.frame(target.ref_im_id)?.rgb, &scene.mask_visib(target.ref_im_id, index)?);
                *textures.entry(reference_key).or_insert(texture)
            }
        };
        let Some((visib_fract, t_query_object)) = instance(&scene, target, &mask)? else { continue };
        let query = Query { reference: &reference, frame, mask: &mask };
        let trace = match estimator.trace(&query) {
            Ok(trace) => trace,
            Err(error @ (InferError::Query(_) | InferError::NotFinite)) => {
                tracing::warn!(
                    "scene {} image {} object {}, reference scene {} image {}: {error}",
                    target.scene_id,
                    target.im_id,
                    target.obj_id,
                    target.ref_scene_id,
                    target.ref_im_id
                );
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        let network = trace.stages.estimate(&reference.pair(&trace.cloud)).t_query_reference;
        let truth = Truth { t_query_object, t_reference_object, object };
        let stages = measure::measure(estimator, &query, &trace, &network, &truth)?;
        let test = TestView { depth: &frame.depth, camera: &frame.intrinsics, delta: VSD_DELTA };
        let rendered = test.render(object, &t_query_object);
        let credit = |pose: &Pose| {
            let errors = PoseErrors::new(object, &test, &truth.implied(pose), &t_query_object, &rendered);
            errors.average_recall(object.diameter, frame.width())
        };
        let (network_credit, refined) = (credit(&network), trace.estimate.t_query_reference);
        let is_right = |pose: &Pose| {
            let error = truth.error(pose);
            error.rotation_deg < right.rotation_deg && error.translation < right.translation
        };
        records.push(PairRecord {
            has_right_candidate: trace.candidates.iter().any(is_right),
            scene_id: target.scene_id,
            im_id: target.im_id,
            obj_id: target.obj_id,
            ref_scene_id: target.ref_scene_id,
            ref_im_id: target.ref_im_id,
            visib_fract,
            rot_deg: info.symmetries.rotation_distance_deg(&t_query_object, &t_reference_object),
            diameter: object.diameter,
            texture,
            evidence: trace.estimate.evidence,
            probability: trace.estimate.confidence.as_ref().map(|c| c.probability),
            right: is_right(&refined),
            credit: network_credit,
            refined_credit: if trace.estimate.refined { credit(&refined) } else { network_credit },
            stages,
        });
    }
    progress(targets.len(), targets.len());
    Ok(records)
}

/// Visibility and pose of the object's instance that the mask covers best.
fn instance(
    scene: &BopScene,
    target: &ReferenceTarget,
    mask: &Mask,
) -> Result<Option<(f64, Pose)>, FormatError> {
    let mut best: Option<(f64, f64, Pose)> = None;
    for (index, (gt, info)) in scene.gt(target.im_id)?.iter().zip(scene.gt_info(target.im_id)?).enumerate() {
        if gt.obj_id == target.obj_id {
            let iou = scene.mask_visib(target.im_id, index)?.iou(mask);
            if best.as_ref().is_none_or(|b| iou > b.0) {
                best = Some((iou, info.visib_fract, scene.pose(target.im_id, index)?));
            }
        }
    }
    Ok(best.map(|(_, visib_fract, pose)| (visib_fract, pose)))
}

/// Mean absolute step of brightness between horizontal and vertical neighbours inside a mask, grey levels.
fn texture(rgb: &RgbImage, mask: &Mask) -> f64 {
    let gray = |col, row| {
        let [r, g, b] = rgb.get_pixel(col, row).0.map(f64::from);
        0.299 * r + 0.587 * g + 0.114 * b
    };
    let (mut sum, mut count) = (0.0, 0usize);
    for (col, row) in mask.pixels() {
        for (next_col, next_row) in [(col + 1, row), (col, row + 1)] {
            if next_col < mask.width && next_row < mask.height && mask.get(next_col, next_row) {
                sum += (gray(col, row) - gray(next_col, next_row)).abs();
                count += 1;
            }
        }
    }
    sum / count.max(1) as f64
}
