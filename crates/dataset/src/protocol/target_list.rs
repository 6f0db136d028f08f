//! The target list of a BOP dataset with its references and detections, and what becomes of it.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    path::PathBuf,
};

use serde::Serialize;

use crate::formats::{
    BopDataset, BopSplit, FormatError, PoseResult, ReferenceTarget,
    detections::{Detection, SkippedDetection, read_detections, usable_detections},
    targets::{check_reference_targets, read_reference_targets},
};

/// Detections scored above this get a pose; the best of the others when none of these does.
pub const MIN_DETECTION_SCORE: f64 = 0.25;

/// Files of [`TargetList::open`].
#[derive(Clone, Debug)]
pub struct TargetFiles {
    /// BOP dataset folder.
    pub dataset: PathBuf,
    /// Split of the targets; found when `None`.
    pub split: Option<String>,
    /// Split of the reference views; that of the targets when `None`.
    pub reference_split: Option<String>,
    /// List of targets with their reference views.
    pub targets: PathBuf,
    pub detections: PathBuf,
    /// Only the first so many entries of the list.
    pub limit: Option<usize>,
}

/// Everything that is needed to estimate the poses of a target list.
#[derive(Debug)]
pub struct TargetList {
    pub dataset: BopDataset,
    pub split: BopSplit,
    /// `None`: the targets' split.
    pub reference_split: Option<BopSplit>,
    pub targets: Vec<ReferenceTarget>,
    pub detections: Vec<Detection>,
    /// Detections of the targets' images that cannot be used.
    pub skipped: Vec<SkippedDetection>,
}

/// An instance that got no pose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rejection {
    pub scene_id: u32,
    pub im_id: u32,
    pub obj_id: u32,
    pub reason: String,
}

/// Poses of a target list.
#[derive(Clone, Debug, Default)]
pub struct TargetPoses {
    /// Score: that of the pose times that of the detection; time: the image's, -1 when a detection's is unknown.
    pub results: Vec<PoseResult>,
    pub rejections: Vec<Rejection>,
    /// Instances compared with a reference.
    pub pairs: usize,
    /// Seconds of all pairs, references included, files excluded.
    pub seconds: f64,
    /// References made, and the seconds of [`Self::seconds`] that this took.
    pub references: usize,
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

impl TargetList {
    pub fn open(files: &TargetFiles) -> Result<Self, FormatError> {
        let dataset = BopDataset::open(&files.dataset)?;
        let split = match &files.split {
            Some(name) => dataset.split(name)?,
            None => dataset.test_split()?,
        };
        let reference_split = files.reference_split.as_ref().map(|name| dataset.split(name)).transpose()?;
        let mut targets = read_reference_targets(&files.targets)?;
        targets.truncate(files.limit.unwrap_or(usize::MAX).max(1));
        let place = files.targets.display().to_string();
        Self::new(dataset, split, reference_split, targets, read_detections(&files.detections)?, &place)
    }

    /// From its parts; `place` is the list of targets in messages. Targets and references have to be there, detections with
    /// masks of no use are put aside.
    pub fn new(
        dataset: BopDataset,
        split: BopSplit,
        reference_split: Option<BopSplit>,
        targets: Vec<ReferenceTarget>,
        detections: Vec<Detection>,
        place: &str,
    ) -> Result<Self, FormatError> {
        check_reference_targets(&targets, place, &split, reference_split.as_ref().unwrap_or(&split))?;
        let images: BTreeSet<(u32, u32)> = targets.iter().map(|t| (t.scene_id, t.im_id)).collect();
        let (detections, skipped) = usable_detections(detections, &split, &images)?;
        Ok(Self { dataset, split, reference_split, targets, detections, skipped })
    }

    /// The split of the reference views.
    pub fn reference_split(&self) -> &BopSplit {
        self.reference_split.as_ref().unwrap_or(&self.split)
    }
}

/// Takes the confident detections, or else the best one, from those that are left by descending score.
pub fn next_detections<'a>(detections: &mut VecDeque<&'a Detection>) -> Vec<&'a Detection> {
    let confident = detections.iter().take_while(|d| d.score > MIN_DETECTION_SCORE).count();
    let count = confident.max(1).min(detections.len());
    detections.drain(..count).collect()
}
