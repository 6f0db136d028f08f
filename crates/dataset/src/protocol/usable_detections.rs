//! Which detections of a list can be used: their ids are those of targets, their masks fit the images.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
};

use serde::Serialize;

use super::{IdMatch, id_match::Ids};
use crate::formats::{BopSplit, Foreground, FormatError, detections::Detection};

/// A detection that cannot be used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SkippedDetection {
    /// Scene of the image.
    pub scene_id: u32,
    /// Number of the image in its scene.
    pub im_id: u32,
    /// Object id.
    pub obj_id: u32,
    /// Index in the list.
    pub entry: usize,
    /// What kind of fault it is.
    #[serde(skip)]
    pub problem: MaskProblem,
    /// What is wrong with its mask.
    pub reason: String,
}

/// Kinds of masks that are of no use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum MaskProblem {
    /// The run lengths do not decode to the mask's own size.
    Damaged,
    /// Width and height are those of the image, in the other order.
    SwappedSize,
    /// Another size than the image's.
    OtherSize,
    /// No pixel is set.
    Empty,
}

impl fmt::Display for MaskProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Damaged => "damaged run lengths",
            Self::SwappedSize => "width and height swapped",
            Self::OtherSize => "another size than the image",
            Self::Empty => "empty mask",
        })
    }
}

/// A list of detections, sorted by what can be done with them.
#[derive(Clone, Debug, Default)]
pub struct UsableDetections {
    /// In the order of the list; those of images that are no targets are among them.
    pub detections: Vec<Detection>,
    /// Those of the targets' images whose masks are of no use.
    pub skipped: Vec<SkippedDetection>,
    /// Their ids against those of the targets.
    pub ids: IdMatch,
}

impl UsableDetections {
    /// Puts aside the detections in the images of `targets` whose masks are broken, empty or of another size than the image.
    /// Images that are not there are left alone.
    pub fn new(detections: Vec<Detection>, split: &BopSplit, targets: &BTreeSet<Ids>) -> Self {
        let images: BTreeSet<(u32, u32)> = targets.iter().map(|ids| (ids[0], ids[1])).collect();
        let size = |&(scene_id, im_id): &(u32, u32)| {
            let size = split.scene(scene_id).and_then(|scene| scene.image_size(im_id));
            // An image that cannot be read is told where it is needed.
            size.ok().map(|(width, height)| ((scene_id, im_id), [height, width]))
        };
        let sizes: BTreeMap<(u32, u32), [u32; 2]> = images.iter().filter_map(size).collect();
        let of = |d: &Detection| [d.scene_id, d.image_id, d.category_id];
        let ids = IdMatch::new(&detections.iter().map(of).collect::<Vec<_>>(), targets);
        let mut sorted = Self { ids, ..Self::default() };
        for (entry, detection) in detections.into_iter().enumerate() {
            let size = sizes.get(&(detection.scene_id, detection.image_id));
            match size.and_then(|size| problem(&detection, *size)) {
                None => sorted.detections.push(detection),
                Some((problem, reason)) => sorted.skipped.push(SkippedDetection {
                    scene_id: detection.scene_id,
                    im_id: detection.image_id,
                    obj_id: detection.category_id,
                    entry,
                    problem,
                    reason,
                }),
            }
        }
        sorted
    }

    /// Unusable masks by kind, each with their number and the first of them.
    pub fn mask_problems(skipped: &[SkippedDetection]) -> BTreeMap<MaskProblem, (usize, &SkippedDetection)> {
        let mut kinds = BTreeMap::new();
        for detection in skipped {
            kinds.entry(detection.problem).or_insert((0, detection)).0 += 1;
        }
        kinds
    }

    /// What keeps detections from being used, in a line per cause; empty when all can be used.
    pub fn messages(skipped: &[SkippedDetection], ids: &IdMatch) -> Vec<String> {
        let masks = Self::mask_problems(skipped).into_iter().map(|(problem, (count, first))| {
            let SkippedDetection { entry, reason, .. } = first;
            format!("{count} unusable masks: {problem} (entry {entry}: {reason})")
        });
        ids.message("detections").into_iter().chain(masks).collect()
    }

    /// An error when no detection of a target can be used; `place` is the list in the message.
    pub fn require_any(&self, targets: &BTreeSet<Ids>, place: &str) -> Result<(), FormatError> {
        if self.ids.entries == 0 {
            return Err(FormatError::field(place, "list of detections", "empty", "at least one detection"));
        }
        let of_target = |d: &Detection| targets.contains(&[d.scene_id, d.image_id, d.category_id]);
        if self.detections.iter().any(of_target) {
            return Ok(());
        }
        let why = Self::messages(&self.skipped, &self.ids).join("; ");
        Err(FormatError::field(place, "number of usable detections", 0, format!("at least one: {why}")))
    }
}

/// Why a mask is of no use in an image of `size` (height, width).
fn problem(detection: &Detection, size: [u32; 2]) -> Option<(MaskProblem, String)> {
    let mask = match Foreground::new(&detection.segmentation) {
        Ok(mask) => mask,
        Err(error) => return Some((MaskProblem::Damaged, error.to_string())),
    };
    let ([h, w], [height, width]) = (mask.size(), size);
    if mask.size() != size {
        let swapped = [w, h] == size;
        let problem = if swapped { MaskProblem::SwappedSize } else { MaskProblem::OtherSize };
        let reason = format!("segmentation size is {w} x {h}, expected the image's {width} x {height}");
        return Some((problem, reason));
    }
    let reason = "segmentation is empty, expected at least one pixel";
    (mask.area() == 0).then(|| (MaskProblem::Empty, reason.to_owned()))
}

#[cfg(test)]
mod tests {
    use unopose_core::frame::Mask;

    use super::*;
    use crate::formats::rle::{Counts, Rle};

    fn detection(segmentation: Rle) -> Detection {
        Detection {
            scene_id: 1,
            image_id: 2,
            category_id: 3,
            bbox: [0.0, 0.0, 2.0, 1.0],
            score: 0.5,
            time: 0.5,
            segmentation,
        }
    }

    #[test]
    fn every_kind_of_useless_mask_is_told_apart() {
        let mask = Mask { width: 3, height: 2, data: vec![true, false, true, true, false, false] };
        let whole = detection(Rle::encode(&mask));
        let runs = |size, runs: &[u32]| detection(Rle { size, counts: Counts::Runs(runs.to_vec()) });
        assert_eq!(problem(&whole, [2, 3]), None);
        let cases = [
            (whole.clone(), [4, 3], MaskProblem::OtherSize, "size is 3 x 2, expected the image's 3 x 4"),
            (whole, [3, 2], MaskProblem::SwappedSize, "size is 3 x 2, expected the image's 2 x 3"),
            (runs([2, 3], &[6]), [2, 3], MaskProblem::Empty, "empty"),
            (runs([2, 2], &[6]), [2, 2], MaskProblem::Damaged, "sum of counts is 6"),
        ];
        for (detection, size, expected, part) in cases {
            let (problem, reason) = problem(&detection, size).unwrap();
            assert!(problem == expected && reason.contains(part), "{problem:?}: {reason}");
        }
    }
}
