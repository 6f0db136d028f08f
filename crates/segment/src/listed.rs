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
        let bytes =
            unopose_core::files::read_regular(path, u64::MAX).map_err(|e| FormatError::io(path, e))?;
        Ok(Self {
            path: path.to_owned(),
            checksum: crc32fast::hash(&bytes),
            several_images: images.len() > 1,
            masks,
        })
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
        if image.is_none() && self.several_images {
            let expected = "the masks of one image";
            return Err(FormatError::field(
                self.path.display(),
                "list of masks",
                "of several images",
                expected,
            )
            .into());
        }
        let mut list: Vec<ListedMask<'_>> = Vec::new();
        for mask in self.masks.masks() {
            match image {
                Some(key) if mask.dataset_image()? != key => {}
                _ => list.push(mask),
            }
        }
        list.sort_by(|a, b| b.score().total_cmp(&a.score()));
        let size = (frame.width(), frame.height());
        let mut proposals = Vec::new();
        for mask in list.into_iter().take(MAX_PROPOSALS) {
            let rle = mask.rle(Some(size))?;
            let [height, width] = rle.size;
            if (width, height) != size {
                let expected = format!("that of the image, {} x {}", size.0, size.1);
                let value = format!("{width} x {height}");
                return Err(FormatError::field(mask.place(), "mask size", value, expected).into());
            }
            let decoded = rle.decode().map_err(|e| e.within(mask.place()))?;
            proposals.extend(Proposal::new(decoded, mask.score() as f32));
        }
        Ok(proposals)
    }
}

#[cfg(test)]
mod tests {
    use unopose_core::{
        frame::{DepthMap, Mask},
        geometry::Intrinsics,
    };
    use unopose_dataset::formats::detections::{Detection, write_detections};

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
        // Without ids, as Segment Anything writes them: masks of one image, but of no image of a dataset.
        let sam = r#"[{"segmentation": {"size": [2, 4], "counts": [5, 1, 2]}, "predicted_iou": 0.9, "bbox": [2, 1, 1, 1]},
            {"segmentation": [[1, 0, 4, 0, 4, 1, 1, 1]], "predicted_iou": 0.95, "bbox": [1, 0, 3, 1]}]"#;
        let sam_path = folder.path().join("sam.json");
        std::fs::write(&sam_path, sam).unwrap();
        let sam = ListedProposals::read(&sam_path).unwrap();
        let found = sam.proposals(&frame, None).unwrap();
        let pixels = found.iter().map(|p| p.mask.pixels().collect::<Vec<_>>()).collect::<Vec<_>>();
        assert_eq!(pixels, [vec![(1, 0), (2, 0), (3, 0)], vec![(2, 1)]]);
        let message = sam.proposals(&frame, Some((1, 2))).unwrap_err().to_string();
        assert!(message.contains("image_id not found") && message.contains("--proposals"), "{message}");
        let small = RgbdFrame { rgb: image::RgbImage::new(3, 2), ..frame };
        let message = listed.proposals(&small, None).unwrap_err().to_string();
        assert!(message.contains("4 x 2") && message.contains("3 x 2"), "{message}");
    }
}
