//! The target list of a BOP dataset with its references and detections.

use std::{collections::BTreeSet, path::PathBuf};

use super::ImageTargets;
use crate::formats::{
    BopDataset, BopSplit, FormatError, ReferenceTarget,
    detections::{Detection, SkippedDetection, read_detections, usable_detections},
    targets::{check_reference_targets, read_reference_targets},
};

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
    /// List of detections.
    pub detections: PathBuf,
    /// At most this many entries of the list, from its start.
    pub limit: Option<usize>,
}

/// Everything that is needed to estimate the poses of a target list.
#[derive(Debug)]
pub struct TargetList {
    /// Models, cameras and splits.
    pub dataset: BopDataset,
    /// Split of the targets.
    pub split: BopSplit,
    /// Split of the reference views; `None`: the targets' split.
    pub reference_split: Option<BopSplit>,
    /// In the order of the list; a target with several references has as many entries.
    pub targets: Vec<ReferenceTarget>,
    /// Usable detections of the targets' images, in the order of the file.
    pub detections: Vec<Detection>,
    /// Detections of the targets' images that cannot be used.
    pub skipped: Vec<SkippedDetection>,
}

impl TargetList {
    /// Reads all files and checks them against the annotations.
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
        let detections = read_detections(&files.detections, Some(&split))?;
        Self::new(dataset, split, reference_split, targets, detections, &place)
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

    /// The walk over the targets: images by ascending scene and image.
    pub fn images(&self) -> Vec<ImageTargets<'_>> {
        ImageTargets::group(&self.targets, &self.detections)
    }
}
