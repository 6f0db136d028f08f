//! Which images of a dataset are meant.

use std::path::PathBuf;

use super::{super::FormatError, BopDataset, BopSplit};

/// A dataset folder, its splits of targets and references, and the camera of scenes with several.
#[derive(Clone, Debug, Default)]
pub struct DatasetSplits {
    /// BOP dataset folder.
    pub dataset: PathBuf,
    /// Split of the targets; found when `None`.
    pub split: Option<String>,
    /// Split of the reference views; that of the targets when `None`.
    pub reference_split: Option<String>,
    /// Camera of scenes with several, `cam1` in `rgb_cam1/`.
    pub sensor: Option<String>,
}

impl DatasetSplits {
    /// The dataset with its sensor.
    pub fn open(&self) -> Result<BopDataset, FormatError> {
        Ok(BopDataset::open(&self.dataset)?.with_sensor(self.sensor.clone()))
    }

    /// Split of the targets.
    pub fn of_targets(&self, dataset: &BopDataset) -> Result<BopSplit, FormatError> {
        match &self.split {
            Some(name) => dataset.split(name),
            None => dataset.test_split(),
        }
    }

    /// Split of the reference views; `None`: that of the targets.
    pub fn of_references(&self, dataset: &BopDataset) -> Result<Option<BopSplit>, FormatError> {
        self.reference_split.as_ref().map(|name| dataset.split(name)).transpose()
    }
}
