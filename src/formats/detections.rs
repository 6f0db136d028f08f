//! Detections and segmentations as a COCO-like list.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{
    FormatError,
    files::{read_json, write_json},
    rle::Rle,
};

/// One detected instance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    pub scene_id: u32,
    pub image_id: u32,
    /// Object id.
    pub category_id: u32,
    /// x, y, width, height in pixels.
    pub bbox: [f64; 4],
    pub score: f64,
    /// Seconds for the whole image, negative when unknown.
    #[serde(default = "unknown")]
    pub time: f64,
    pub segmentation: Rle,
}

fn unknown() -> f64 {
    -1.0
}

/// Reads a detection list in the order of the file. The masks stay encoded.
pub fn read_detections(path: &Path) -> Result<Vec<Detection>, FormatError> {
    read_json(path)
}

/// Writes a detection list.
pub fn write_detections(path: &Path, detections: &[Detection]) -> Result<(), FormatError> {
    write_json(path, detections, false)
}

/// Detections that get a pose: those scored above `threshold`, or the best one when there is none.
pub fn confident_or_best<'a>(detections: &[&'a Detection], threshold: f64) -> Vec<&'a Detection> {
    let confident: Vec<_> = detections.iter().copied().filter(|d| d.score > threshold).collect();
    if !confident.is_empty() {
        return confident;
    }
    detections.iter().copied().max_by(|a, b| a.score.total_cmp(&b.score)).into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{formats::rle::Counts, frame::Mask};

    #[test]
    fn both_mask_forms_survive_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("dets.json");
        let mask = Mask { width: 3, height: 2, data: vec![true, false, true, true, false, false] };
        let detection = |segmentation, score| Detection {
            scene_id: 1,
            image_id: 2,
            category_id: 3,
            bbox: [0.0, 0.0, 2.0, 1.0],
            score,
            time: 0.5,
            segmentation,
        };
        let list = [detection(Rle::encode(&mask), 0.2), detection(Rle::encode_compressed(&mask), 0.24)];
        write_detections(&path, &list).unwrap();
        let read = read_detections(&path).unwrap();
        assert_eq!(read, list);
        assert!(matches!(read[1].segmentation.counts, Counts::Compressed(_)));
        assert_eq!(read[0].segmentation.decode().unwrap(), read[1].segmentation.decode().unwrap());

        let all: Vec<_> = read.iter().collect();
        assert_eq!(confident_or_best(&all, 0.25), [&read[1]]);
        assert_eq!(confident_or_best(&all, 0.1).len(), 2);
        assert!(confident_or_best(&[], 0.1).is_empty());
    }
}
