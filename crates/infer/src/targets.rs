//! The targets of a BOP dataset: from detections and one reference view per target to absolute poses.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap, VecDeque},
    time::Instant,
};

use unopose_core::{
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::{
    formats::{PoseResult, detections::Detection},
    protocol::{Rejection, TargetList, TargetPoses, next_detections},
};
use unopose_pairs::data::DataError;

use super::{
    InferError, PoseEstimator, Query,
    experiment::ReferenceColor,
    target_references::{PosedReference, ReferenceKey, TargetReferences},
};

/// Estimates all targets, image by image: the instances of an image are one batch. A target with several references
/// takes, for each detection, the pose with the best score. `color` is [`ReferenceColor::Keep`] but for experiments. `progress` is called with the images done and all images.
pub fn estimate_targets(
    estimator: &PoseEstimator,
    list: &TargetList,
    color: ReferenceColor,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<TargetPoses, InferError> {
    let mut detections: HashMap<(u32, u32, u32), Vec<&Detection>> = HashMap::new();
    for detection in &list.detections {
        let key = (detection.scene_id, detection.image_id, detection.category_id);
        detections.entry(key).or_default().push(detection);
    }
    let mut images: BTreeMap<(u32, u32), BTreeMap<u32, Vec<ReferenceKey>>> = BTreeMap::new();
    for target in &list.targets {
        let objects = images.entry((target.scene_id, target.im_id)).or_default();
        let reference = (target.ref_scene_id, target.ref_im_id, target.obj_id);
        objects.entry(target.obj_id).or_default().push(reference);
    }
    let mut run = Run {
        estimator,
        references: TargetReferences::new(estimator, list.reference_split(), color),
        poses: TargetPoses::default(),
    };
    let total = images.len();
    for (done, (&(scene_id, im_id), objects)) in images.iter().enumerate() {
        progress(done, total);
        let image = Image { scene_id, im_id, frame: list.split.scene(scene_id)?.frame(im_id)? };
        let mut seconds = run.references.seconds;
        let mut wanted = Vec::new();
        for (&obj_id, references) in objects {
            let mut detections = detections.remove(&(scene_id, im_id, obj_id)).unwrap_or_default();
            // The stable sort keeps the file's order among equal scores.
            detections.sort_by(|a, b| b.score.total_cmp(&a.score));
            wanted.extend(run.wanted(&image, obj_id, detections.into(), references)?);
        }
        seconds = run.references.seconds - seconds;
        run.image(&image, &mut wanted, seconds);
    }
    progress(total, total);
    let TargetReferences { made, seconds, .. } = run.references;
    Ok(TargetPoses { references: made, reference_seconds: seconds, ..run.poses })
}

struct Image {
    scene_id: u32,
    im_id: u32,
    frame: RgbdFrame,
}

/// An object of an image that has no pose yet.
struct Wanted<'a> {
    obj_id: u32,
    references: Vec<PosedReference>,
    /// Not tried so far, by descending score.
    detections: VecDeque<&'a Detection>,
}

impl<'a> Wanted<'a> {
    fn next(&mut self) -> Vec<&'a Detection> {
        next_detections(&mut self.detections)
    }
}

/// An instance to be compared with references.
struct Attempt<'a> {
    detection: &'a Detection,
    mask: Mask,
    references: Vec<PosedReference>,
}

struct Run<'a> {
    estimator: &'a PoseEstimator,
    references: TargetReferences<'a>,
    poses: TargetPoses,
}

impl Run<'_> {
    /// `None`, with the reason noted, when there is no detection or no usable reference.
    fn wanted<'d>(
        &mut self,
        image: &Image,
        obj_id: u32,
        detections: VecDeque<&'d Detection>,
        keys: &[ReferenceKey],
    ) -> Result<Option<Wanted<'d>>, InferError> {
        if detections.is_empty() {
            self.reject(image, obj_id, "no detection");
            return Ok(None);
        }
        let mut references = Vec::new();
        for &key in keys {
            match self.references.get(key)? {
                Ok(reference) => references.push(reference),
                Err(reason) => self.reject(image, obj_id, reason),
            }
        }
        Ok((!references.is_empty()).then_some(Wanted { obj_id, references, detections }))
    }

    /// Poses of the objects of an image whose references took `seconds`.
    fn image(&mut self, image: &Image, wanted: &mut Vec<Wanted<'_>>, mut seconds: f64) {
        let first = self.poses.results.len();
        // Once for the confident detections; again, with the best of the others, for objects that got no pose.
        while !wanted.is_empty() {
            let mut attempts = Vec::new();
            for object in wanted.iter_mut() {
                for detection in object.next() {
                    let references = object.references.clone();
                    match detection.segmentation.decode() {
                        Ok(mask) => attempts.push(Attempt { detection, mask, references }),
                        Err(error) => self.reject(image, object.obj_id, error),
                    }
                }
            }
            let start = Instant::now();
            let posed = self.estimate(image, &attempts);
            seconds += start.elapsed().as_secs_f64();
            wanted.retain(|object| !posed.contains(&object.obj_id) && !object.detections.is_empty());
        }
        self.poses.seconds += seconds;
        // Every line of an image repeats the time of the whole image.
        let results = &mut self.poses.results[first..];
        let known = results.iter().all(|r| r.time >= 0.0);
        let detection_time = results.iter().map(|r| r.time).fold(0.0, f64::max);
        results.iter_mut().for_each(|r| r.time = if known { detection_time + seconds } else { -1.0 });
    }

    /// Adds results with the time of their detection; returns the objects that got one.
    fn estimate(&mut self, image: &Image, attempts: &[Attempt<'_>]) -> BTreeSet<u32> {
        let mut queries = Vec::new();
        for Attempt { mask, references, .. } in attempts {
            queries.extend(references.iter().map(|(reference, _)| Query {
                reference,
                frame: &image.frame,
                mask,
            }));
        }
        self.poses.pairs += queries.len();
        let mut estimates = self.estimator.estimate_batch(&queries).into_iter();
        let mut posed = BTreeSet::new();
        for Attempt { detection, references, .. } in attempts {
            let obj_id = detection.category_id;
            let (mut best, mut reason): (Option<(f64, Pose)>, _) = (None, None);
            for ((_, t_reference_object), estimate) in references.iter().zip(estimates.by_ref()) {
                match estimate {
                    Ok(estimate) if best.is_none_or(|(score, _)| estimate.score > score) => {
                        best = Some((estimate.score, estimate.t_query_reference * *t_reference_object));
                    }
                    Ok(_) => {}
                    Err(error) => reason = Some(error),
                }
            }
            let Some((score, t_camera_object)) = best else {
                self.reject(image, obj_id, reason.map_or("no reference".into(), |error| reason_of(&error)));
                continue;
            };
            posed.insert(obj_id);
            let Image { scene_id, im_id, .. } = *image;
            let (score, time) = (score * detection.score, detection.time);
            self.poses.results.push(PoseResult { scene_id, im_id, obj_id, score, t_camera_object, time });
        }
        posed
    }

    fn reject(&mut self, image: &Image, obj_id: u32, reason: impl ToString) {
        let Image { scene_id, im_id, .. } = *image;
        let reason = reason.to_string();
        tracing::debug!("scene {scene_id} image {im_id} object {obj_id}: {reason}");
        self.poses.rejections.push(Rejection { scene_id, im_id, obj_id, reason });
    }
}

/// A reason without the numbers of the single case, so that equal ones can be counted.
fn reason_of(error: &InferError) -> String {
    match error {
        InferError::Query(DataError::TooFewPoints { minimum, .. }) => {
            format!("fewer than {minimum} points within 1.2 reference radii of their mean")
        }
        InferError::Query(DataError::TooFewPixels { minimum, .. }) => {
            format!("not more than {minimum} usable pixels")
        }
        InferError::Query(DataError::NoDepth { .. }) => "no pixel of the mask has depth".into(),
        other => other.to_string(),
    }
}
