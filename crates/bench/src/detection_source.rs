//! Where the detections of the targets come from.

use std::{convert::Infallible, path::PathBuf, str::FromStr};

use super::UnoSegMasks;

/// A source of detections. `gt`, `unoseg` or a file as an argument; a [`ListRequest`](super::ListRequest) takes it with
/// the masks that UNOSeg has found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DetectionSource<M = ()> {
    /// The annotated visible masks, `gt`.
    GroundTruth,
    /// A file of detections.
    File(PathBuf),
    /// Made by [`unopose_segment::segment_targets`], `unoseg`.
    UnoSeg(M),
}

impl FromStr for DetectionSource {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "gt" => Self::GroundTruth,
            "unoseg" => Self::UnoSeg(()),
            path => Self::File(path.into()),
        })
    }
}

impl DetectionSource<UnoSegMasks> {
    /// As in a report's title.
    pub(crate) fn name(&self) -> String {
        match self {
            Self::GroundTruth => "ground-truth".into(),
            Self::UnoSeg(masks) => format!("unoseg ({})", masks.proposals),
            Self::File(path) => {
                path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_name_a_source_or_a_file() {
        let source = |text: &str| text.parse::<DetectionSource>().unwrap();
        assert_eq!(source("gt"), DetectionSource::GroundTruth);
        assert_eq!(source("unoseg"), DetectionSource::UnoSeg(()));
        assert_eq!(source("./gt"), DetectionSource::File("./gt".into()));
    }
}
