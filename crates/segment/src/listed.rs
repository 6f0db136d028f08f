//! Proposals of any other segmenter (FastSAM, Segment Anything, ...) from a list of masks.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use unopose_core::frame::RgbdFrame;
use unopose_dataset::formats::{
    FormatError,
    detections::{ListedMask, MaskList},
};

use super::{ImageKey, MAX_PROPOSALS, Proposal, ProposalGenerator, SegmentError};

/// Masks of a file by image; their categories do not matter.
#[derive(Clone, Debug)]
pub struct ListedProposals {
    path: PathBuf,
    /// CRC-32 of the file.
    checksum: u32,
    masks: MaskList,
    /// Whether the masks are those of more than one image.
    several_images: bool,
}

impl ListedProposals {
    /// Reads the list and takes its checksum.
    pub fn read(path: &Path) -> Result<Self, SegmentError> {
        let masks = MaskList::read(path)?;
        let images: BTreeSet<_> = masks.masks().map(|mask| mask.image()).collect();
        let bytes = std::fs::read(path).map_err(|e| FormatError::io(path, e))?;
        Ok(Self { path: path.to_owned(), checksum: crc32fast::hash(&bytes), several_images: images.len() > 1, masks })
    }
}

impl ProposalGenerator for ListedProposals {
    fn name(&self) -> String {
        let stem = self.path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        format!("listed-{stem}")
    }

    fn fingerprint(&self) -> String {
        format!("{} {:08x}", self.name(), self.checksum)
    }

    /// Without a key the file must be about one image.
    fn proposals(&self, frame: &RgbdFrame, image: Option<ImageKey>) -> Result<Vec<Proposal>, SegmentError> {
        let mut list: Vec<ListedMask<'_>> = Vec::new();
        for mask in self.masks.masks() {
            if image.is_none_or(|key| mask.dataset_image().is_ok_and(|image| image == key)) {
                list.push(mask);
            }
        }
#[cfg(test)]
mod tests {
    use unopose_core::{
        frame::{DepthMap, Mask},
        geometry::Intrinsics,
    };
    use unopose_dataset::formats::detections::write_detections;

    use super::*;

    #[test]
    fn masks_come_back_by_image_and_best_first() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fastsam.json");
        let masks = [3, 5].map(|pixel| {
            let mut mask = Mask::empty(4, 2);
            mask.data[pixel] = true;
            mask
        });
        let list: Vec<Detection> = masks
            .iter()
            .zip([0.2, 0.7])
            .filter_map(|(mask, score)| {
                Some(Proposal::new(mask.clone(), 0.0)?.detection(1, 2, 0, score, -1.0))
            })
            .collect();
        write_detections(&path, &list).unwrap();
        let listed = ListedProposals::read(&path).unwrap();
        let intrinsics = Intrinsics { fx: 4.0, fy: 4.0, cx: 2.0, cy: 1.0 };
        let frame = RgbdFrame { rgb: image::RgbImage::new(4, 2), depth: DepthMap::zeros(4, 2), intrinsics };
        for key in [None, Some((1, 2))] {
            let found = listed.proposals(&frame, key).unwrap();
            assert_eq!(found.iter().map(|p| &p.mask).collect::<Vec<_>>(), [&masks[1], &masks[0]]);
        }
        assert!(listed.proposals(&frame, Some((1, 3))).unwrap().is_empty());
        write_detections(&path, &list[..1]).unwrap();
        let changed = ListedProposals::read(&path).unwrap();
        assert!(changed.name() == listed.name() && changed.fingerprint() != listed.fingerprint());
        let small = RgbdFrame { rgb: image::RgbImage::new(3, 2), ..frame };
        let message = listed.proposals(&small, None).unwrap_err().to_string();
        assert!(message.contains("4 x 2") && message.contains("3 x 2"), "{message}");
    }
}
