//! The targets of a BOP dataset: from detections and one reference view per target to absolute poses.

use std::time::Instant;

use unopose_core::frame::{Mask, RgbdFrame};
use unopose_dataset::{
    formats::detections::Detection,
    protocol::{
        ImagePoses, ImageTargets, NO_DETECTION, ObjectTargets, TargetList, TargetPoses, best_outcome,
    },
};
use unopose_pairs::data::DataError;

use super::{
    InferError, PoseEstimator, Query,
    experiment::ReferenceColor,
    target_references::{PosedReference, TargetReferences},
};

/// Estimates all targets, image by image: the instances of an image are one batch. A target with several references
/// takes, for each detection, the pose with the best score. An image that cannot be read costs its own targets alone. `color`
/// is [`ReferenceColor::Keep`] but for experiments. `progress` is called with the images done and all images.
pub fn estimate_targets(
    estimator: &PoseEstimator,
    list: &TargetList,
    color: ReferenceColor,
    progress: &mut dyn FnMut(usize, usize),
) -> TargetPoses {
    let references = TargetReferences::new(estimator, list.reference_split(), color);
    let mut run = Run { estimator, list, references };
    let (mut poses, images) = (TargetPoses::default(), list.images());
    let total = images.len();
    for (done, image) in images.into_iter().enumerate() {
        progress(done, total);
        let mut made = ImagePoses::new(&mut poses, &image);
        run.image(image, &mut made);
        made.finish();
    }
    progress(total, total);
    let TargetReferences { made, seconds, unread, .. } = run.references;
    poses.unread.merge(&unread);
    TargetPoses { references: made, reference_seconds: seconds, ..poses }
}

/// An object of an image that can get a pose.
struct Wanted<'a> {
    object: ObjectTargets<'a>,
    /// At least one.
    references: Vec<PosedReference>,
}

/// An instance to be compared with the references of its object.
struct Attempt<'a> {
    /// Number of the object among those wanted.
    object: usize,
    detection: &'a Detection,
    mask: Mask,
}

struct Run<'a> {
    estimator: &'a PoseEstimator,
    list: &'a TargetList,
    references: TargetReferences<'a>,
}

impl Run<'_> {
    fn image(&mut self, image: ImageTargets<'_>, made: &mut ImagePoses<'_>) {
        let frame = self.list.split.scene(image.scene_id).and_then(|scene| scene.frame(image.im_id));
        let frame = match frame {
            Ok(frame) => frame,
            Err(error) => {
                let reason = made.unread(image.scene_id, image.im_id, &error);
                return image.objects.iter().for_each(|object| made.reject(object.obj_id, &reason));
            }
        };
        let seconds_before = self.references.seconds;
        let mut wanted = Vec::new();
        for object in image.objects {
            let references = self.usable_references(&object, made);
            if !references.is_empty() {
                wanted.push(Wanted { object, references });
            }
        }
        made.add_seconds(self.references.seconds - seconds_before);
        // Once for the confident detections; again, with the best of the others, for objects that got no pose.
        loop {
            let (mut attempts, mut over) = (Vec::new(), true);
            for (number, Wanted { object, .. }) in wanted.iter_mut().enumerate() {
                for detection in object.next_detections() {
                    over = false;
                    match detection.segmentation.decode() {
                        Ok(mask) => attempts.push(Attempt { object: number, detection, mask }),
                        Err(error) => made.reject(object.obj_id, error),
                    }
                }
            }
            if over {
                return;
            }
            let start = Instant::now();
            for object in self.estimate(&frame, &wanted, &attempts, made) {
                wanted[object].object.posed = true;
            }
            made.add_seconds(start.elapsed().as_secs_f64());
        }
    }

    /// Empty, with the reasons noted, when there is no detection or no usable reference.
    fn usable_references(
        &mut self,
        object: &ObjectTargets<'_>,
        made: &mut ImagePoses<'_>,
    ) -> Vec<PosedReference> {
        let mut references = Vec::new();
        if !object.has_detections() {
            made.reject(object.obj_id, NO_DETECTION);
            return references;
        }
        for target in &object.references {
            match self.references.get(target) {
                Ok(reference) => references.push(reference),
                Err(reason) => made.reject(object.obj_id, reason),
            }
        }
        references
    }

    /// Adds the poses of a batch; returns the numbers of the objects that got one.
    fn estimate(
        &self,
        frame: &RgbdFrame,
        wanted: &[Wanted<'_>],
        attempts: &[Attempt<'_>],
        made: &mut ImagePoses<'_>,
    ) -> Vec<usize> {
        let mut queries = Vec::new();
        for Attempt { object, mask, .. } in attempts {
            let references = wanted[*object].references.iter();
            queries.extend(references.map(|(reference, _)| Query { reference, frame, mask }));
        }
        made.add_pairs(queries.len());
        let mut estimates = self.estimator.estimate_batch(&queries).into_iter();
        let mut posed = Vec::new();
        for &Attempt { object, detection, .. } in attempts {
            let outcomes = wanted[object].references.iter().zip(estimates.by_ref()).map(
                |((_, t_reference_object), estimate)| {
                    estimate.map(|e| (e.score, e.t_query_reference * *t_reference_object))
                },
            );
            match best_outcome(outcomes) {
                Some(Ok((score, t_camera_object))) => {
                    made.add_pose(detection, score, t_camera_object);
                    posed.push(object);
                }
                Some(Err(error)) => made.reject(detection.category_id, reason_of(&error)),
                None => {}
            }
        }
        posed
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
