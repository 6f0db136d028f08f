//! The target list of a BOP dataset with its references and detections.

use std::{collections::BTreeSet, path::PathBuf};

use super::{IdMatch, ImageTargets, SkippedDetection, UsableDetections};
use crate::formats::{
    BopDataset, BopSplit, DatasetSplits, FormatError, ReferenceTarget,
    detections::{Detection, read_detections},
    targets::{check_reference_targets, read_reference_targets},
};

/// Files of [`TargetList::open`].
#[derive(Clone, Debug)]
pub struct TargetFiles {
    /// Dataset and splits.
    pub splits: DatasetSplits,
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
    /// The ids of all detections against those of the targets.
    pub ids: IdMatch,
}

impl TargetList {
    /// Reads all files and checks them against the annotations.
    pub fn open(files: &TargetFiles) -> Result<Self, FormatError> {
        let dataset = files.splits.open()?;
        let (split, reference_split) =
            (files.splits.of_targets(&dataset)?, files.splits.of_references(&dataset)?);
        let mut targets = read_reference_targets(&files.targets)?;
        targets.truncate(files.limit.unwrap_or(usize::MAX).max(1));
        let place = files.targets.display().to_string();
        let detections = read_detections(&files.detections, Some(&split))?;
        let places = [place, files.detections.display().to_string()];
        Self::new(dataset, split, reference_split, targets, detections, places)
    }

    /// From its parts; `places` are the lists of targets and of detections in messages. Targets and references have to be
    /// there, detections with masks of no use are put aside. An error when no detection of a target is left.
    pub fn new(
        dataset: BopDataset,
        split: BopSplit,
        reference_split: Option<BopSplit>,
        targets: Vec<ReferenceTarget>,
        detections: Vec<Detection>,
        places: [String; 2],
    ) -> Result<Self, FormatError> {
        check_reference_targets(&targets, &places[0], &split, reference_split.as_ref().unwrap_or(&split))?;
        let ids: BTreeSet<[u32; 3]> = targets.iter().map(|t| [t.scene_id, t.im_id, t.obj_id]).collect();
        let usable = UsableDetections::new(detections, &split, &ids);
        usable.require_any(&ids, &places[1])?;
        let UsableDetections { detections, skipped, ids } = usable;
        Ok(Self { dataset, split, reference_split, targets, detections, skipped, ids })
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
