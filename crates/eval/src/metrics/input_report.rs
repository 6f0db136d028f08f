//! What of the input was not used, and what of it looks wrong.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use unopose_dataset::{
    formats::units,
    protocol::{IdMatch, SkippedDetection, UnreadImages, UsableDetections},
};

use super::EvalObject;

/// Part of `scores.json`: input that was left out, and warnings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[non_exhaustive]
pub struct InputReport {
    /// Detections that belong to no target.
    pub n_unmatched_detections: usize,
    /// Numbers of detections of the targets' images whose masks cannot be used, by kind of fault.
    pub unusable_masks: BTreeMap<String, usize>,
    /// What is wrong with each image that could not be read; its targets count as missed.
    pub unread_images: BTreeMap<String, String>,
    /// What makes the scores doubtful, with the numbers that gave it away.
    pub warnings: Vec<String>,
}

impl InputReport {
    /// What became of a list of detections.
    pub fn of_detections(detections: &UsableDetections) -> Self {
        let mut report = Self::default();
        report.add_detections(&detections.skipped, &detections.ids);
        report
    }

    pub(super) fn add_detections(&mut self, skipped: &[SkippedDetection], ids: &IdMatch) {
        self.n_unmatched_detections = ids.unmatched;
        let problems = UsableDetections::mask_problems(skipped);
        self.unusable_masks = problems.iter().map(|(kind, (count, _))| (kind.to_string(), *count)).collect();
        if ids.is_suspicious() {
            self.warnings.extend(ids.message("detections"));
        }
        self.warnings.extend(UsableDetections::messages(skipped, &IdMatch::default()));
    }

    /// Adds images that could not be read and are not known yet.
    pub(super) fn add_unread(&mut self, unread: &UnreadImages) {
        let unread = unread.except(&self.unread_images);
        self.unread_images.extend(unread.messages());
        self.warnings.extend(unread.by_cause());
    }
}

/// What is wrong with the sizes of models, a line each; `place` is their `models_info.json`.
pub fn model_problems(objects: &BTreeMap<u32, EvalObject>, place: &str) -> Vec<String> {
    let problems = objects.iter().flat_map(|(obj_id, object)| {
        let own = f64::from(object.mesh.diameter());
        let said = units::diameter_problem(object.diameter)
            .map(|problem| format!("{place}: object {obj_id}: {problem}"));
        let differs = units::diameters_disagree(own, object.diameter);
        let differs = differs.map(|problem| format!("model of object {obj_id}: {problem}"));
        said.into_iter().chain(differs)
    });
    problems.collect()
}
