//! What becomes of the targets of a list.

use std::collections::BTreeMap;

use serde::Serialize;
use unopose_core::geometry::Pose;

use super::{ImageTargets, UnreadImages};
use crate::formats::{FormatError, PoseResult, detections::Detection};

/// Reason of an object that no detection belongs to.
pub const NO_DETECTION: &str = "no detection";

/// An instance that got no pose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rejection {
    /// Scene of the target.
    pub scene_id: u32,
    /// Image of the target.
    pub im_id: u32,
    /// Object that has no pose there.
    pub obj_id: u32,
    /// In words, the same for equal causes.
    pub reason: String,
}

/// Poses of a target list.
#[derive(Clone, Debug, Default)]
pub struct TargetPoses {
    /// Score: that of the pose times that of the detection; time: the image's, -1 when a detection's is unknown.
    pub results: Vec<PoseResult>,
    /// Instances without a pose, in the order of the walk.
    pub rejections: Vec<Rejection>,
    /// Images of targets or references that could not be read; their targets are among the rejections.
    pub unread: UnreadImages,
    /// Comparisons of an instance with a reference.
    pub pairs: usize,
    /// Seconds of all pairs, references included, files excluded.
    pub seconds: f64,
    /// References made.
    pub references: usize,
    /// The part of [`Self::seconds`] that the references took.
    pub reference_seconds: f64,
}

impl TargetPoses {
    /// Of a pair, its share of the references included; `None` without pairs.
    pub fn mean_time_per_pair_s(&self) -> Option<f64> {
        (self.pairs > 0).then(|| self.seconds / self.pairs as f64)
    }

    /// Rejections counted by reason, most frequent first.
    pub fn reasons(&self) -> Vec<(String, usize)> {
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for rejection in &self.rejections {
            *counts.entry(&rejection.reason).or_default() += 1;
        }
        let mut counts: Vec<_> = counts.into_iter().map(|(reason, n)| (reason.to_owned(), n)).collect();
        counts.sort_by_key(|&(_, n)| std::cmp::Reverse(n));
        counts
    }
}

/// One image's part of [`TargetPoses`], from its first pose to its time.
#[derive(Debug)]
pub struct ImagePoses<'p> {
    poses: &'p mut TargetPoses,
    scene_id: u32,
    im_id: u32,
    /// Results of the images before.
    results_before: usize,
    /// Seconds of the images before.
    seconds_before: f64,
}

impl<'p> ImagePoses<'p> {
    /// Starts an image.
    pub fn new(poses: &'p mut TargetPoses, image: &ImageTargets<'_>) -> Self {
        let ImageTargets { scene_id, im_id, .. } = *image;
        let (results_before, seconds_before) = (poses.results.len(), poses.seconds);
        Self { poses, scene_id, im_id, results_before, seconds_before }
    }

    /// Counts comparisons of an instance with a reference.
    pub fn add_pairs(&mut self, pairs: usize) {
        self.poses.pairs += pairs;
    }

    /// Adds computing time to that of the image.
    pub fn add_seconds(&mut self, seconds: f64) {
        self.poses.seconds += seconds;
    }

    /// Adds the pose of a detection. `score` is the pose's own; the result has its product with the detection's.
    pub fn add_pose(&mut self, detection: &Detection, score: f64, t_camera_object: Pose) {
        self.poses.results.push(PoseResult {
            scene_id: self.scene_id,
            im_id: self.im_id,
            obj_id: detection.category_id,
            score: score * detection.score,
            t_camera_object,
            time: detection.time,
        });
    }

    /// Notes why an instance of an object has no pose.
    pub fn reject(&mut self, obj_id: u32, reason: impl ToString) {
        let (Self { scene_id, im_id, .. }, reason) = (&*self, reason.to_string());
        tracing::debug!("scene {scene_id} image {im_id} object {obj_id}: {reason}");
        let rejection = Rejection { scene_id: *scene_id, im_id: *im_id, obj_id, reason };
        self.poses.rejections.push(rejection);
    }

    /// Notes that an image of this one's targets or references cannot be read; returns the reason for [`Self::reject`].
    pub fn unread(&mut self, scene_id: u32, im_id: u32, error: &FormatError) -> String {
        format!("image cannot be read: {}", self.poses.unread.add(scene_id, im_id, error))
    }

    /// Ends the image: every result repeats the time of the whole image, that of the detections and the seconds added
    /// since [`Self::new`]. It is -1 when the time of a detection is unknown.
    pub fn finish(self) {
        let seconds = self.poses.seconds - self.seconds_before;
        let results = &mut self.poses.results[self.results_before..];
        let known = results.iter().all(|r| r.time >= 0.0);
        let detection_time = results.iter().map(|r| r.time).fold(0.0, f64::max);
        results.iter_mut().for_each(|r| r.time = if known { detection_time + seconds } else { -1.0 });
    }
}

/// Of a detection's outcomes with the references of its object: the estimate with the best score, the first of equals.
/// The last failure when there is no estimate.
pub fn best_outcome<T, E>(
    outcomes: impl IntoIterator<Item = Result<(f64, T), E>>,
) -> Option<Result<(f64, T), E>> {
    outcomes.into_iter().reduce(|best, next| {
        let better = match (&best, &next) {
            (Ok((best, _)), Ok((score, _))) => score > best,
            (Ok(_), Err(_)) => false,
            (Err(_), _) => true,
        };
        if better { next } else { best }
    })
}
