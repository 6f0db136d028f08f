use unopose_core::frame::Mask;

use super::*;
use crate::formats::rle::Counts;

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
    let read = read_detections(&path, None).unwrap();
    assert_eq!(read, list);
    assert!(matches!(read[1].segmentation.counts, Counts::Compressed(_)));
    assert_eq!(read[0].segmentation.decode().unwrap(), read[1].segmentation.decode().unwrap());

    for (broken, part) in [
        (
            Detection { score: -1.0, bbox: [0.0, 0.0, -2.0, 1.0], ..list[1].clone() },
            "entry 1 of a list of BOP detections: bbox is [0.0, 0.0, -2.0",
        ),
        (
            Detection { score: f64::NAN, ..list[1].clone() },
            "entry 1 of a list of BOP detections: score not found",
        ),
    ] {
        write_detections(&path, &[list[0].clone(), broken]).unwrap();
        let message = read_detections(&path, None).unwrap_err().to_string();
        assert!(message.contains("dets.json") && message.contains(part), "{message}");
    }
}

/// A list of one entry or a whole document.
fn read(text: &str) -> Result<Vec<Detection>, FormatError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("000004/dets.json");
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, text).unwrap();
    read_detections(&path, None)
}

/// Column 1 to 2, row 1 of 4 x 3 pixels.
const SQUARE: [(u32, u32); 2] = [(1, 1), (2, 1)];

#[test]
fn every_form_of_a_mask_is_the_same_mask() {
    for segmentation in [
        r#"{"size": [3, 4], "counts": [4, 1, 2, 1, 4]}"#,
        r#"{"counts": "41202", "size": [3, 4]}"#,
        "[[1, 1, 3, 1, 3, 2, 1, 2]]",
        "[[1.0, 1.0, 2.0, 1.0, 2.0, 2.0, 1.0, 2.0], [2, 1, 3, 1, 3, 2, 2, 2]]",
    ] {
        let text = format!(
            r#"{{"images": [{{"id": 17, "file_name": "000004/rgb/000031.png", "width": 4, "height": 3}}],
                "annotations": [{{"id": 1, "image_id": 17, "category_id": 5, "bbox": [1.0, 1.0, 2.0, 1.0], "area": 2.0,
                "iscrowd": 0, "segmentation": {segmentation}}}]}}"#
        );
        let list = read(&text).unwrap_or_else(|error| panic!("{segmentation}: {error}"));
        let Detection { scene_id, image_id, category_id, bbox, score, time, .. } = list[0];
        assert_eq!((scene_id, image_id, category_id, score, time), (4, 31, 5, 1.0, -1.0));
        assert_eq!(bbox, [1.0, 1.0, 2.0, 1.0]);
        let mask = list[0].segmentation.decode().unwrap();
        assert_eq!((mask.width, mask.height), (4, 3));
        assert_eq!(mask.pixels().collect::<Vec<_>>(), SQUARE, "{segmentation}");
    }
}

#[test]
fn images_of_coco_name_scene_and_image() {
    let read = |image: &str| {
        let text = format!(
            r#"{{"images": [{{"id": 17, "width": 4, "height": 3, {image}}}], "annotations": [{{"image_id": 17,
                "category_id": 5, "bbox": [1, 1, 2, 1], "score": 0.5, "segmentation": [[1, 1, 3, 1, 3, 2, 1, 2]]}}]}}"#
        );
        read(&text).map(|list| (list[0].scene_id, list[0].image_id, list[0].score))
    };
    assert_eq!(read(r#""scene_id": 2, "im_id": 3"#).unwrap(), (2, 3, 0.5));
    assert_eq!(read(r#""file_name": "test/000002/gray/000003.tif""#).unwrap(), (2, 3, 0.5));
    // As in the `scene_gt_coco.json` of a scene, beside its images.
    assert_eq!(read(r#""file_name": "rgb/000003.png""#).unwrap(), (4, 3, 0.5));
    let message = read(r#""file_name": "left.jpg""#).unwrap_err().to_string();
    assert!(message.contains("list of COCO annotations: scene_id not found"), "{message}");
    assert!(message.contains("SSSSSS/rgb/IIIIII.png"), "{message}");
}

#[test]
fn what_a_form_lacks_is_named_with_the_form() {
    let rle = r#""segmentation": {"size": [3, 4], "counts": [4, 1, 2, 1, 4]}"#;
    let bop = r#""scene_id": 1, "image_id": 2, "category_id": 3, "bbox": [1, 1, 2, 1], "score": 1"#;
    let polygon = |polygons: &str| format!(r#"[{{{bop}, "segmentation": {polygons}}}]"#);
    let listed = |entry: &str| format!("[{{{entry}, {rle}}}]");
    let annotation = r#"{"images": [{"id": 1, "width": 4, "height": 3, "file_name": "1/rgb/2.png"}],
        "annotations": [{"image_id": 1, "category_id": 1, "bbox": [0, 0, 1, 1], "segmentation": SEG}]}"#;
    let annotated = |polygons: &str| annotation.replace("SEG", polygons);
    for (text, parts) in [
        (
            listed(r#""image_id": 0, "category_id": 1, "bbox": [1, 1, 2, 1], "score": 0.9"#),
            ["entry 0 of a list of COCO results: scene_id not found", "images with file_name"],
        ),
        (
            listed(r#""area": 2, "bbox": [1, 1, 2, 1], "predicted_iou": 0.9, "stability_score": 0.97"#),
            ["list of masks of Segment Anything: image_id not found", "--proposals"],
        ),
        (
            listed(r#""scene_id": 1, "image_id": 2, "bbox": [1, 1, 2, 1], "score": 1"#),
            ["category_id not found", "BOP"],
        ),
        (
            listed(r#""scene_id": 1, "image_id": 2, "category_id": 3, "score": 1"#),
            ["bbox not found", "entry 0"],
        ),
        (
            listed(r#""scene_id": 1, "image_id": -2, "category_id": 3, "score": 1"#),
            ["image_id is -2", "entry 0"],
        ),
        (format!("[{{{bop}}}]"), ["segmentation not found", "boxes are not enough"]),
        (polygon("[]"), ["segmentation not found", "boxes are not enough"]),
        (polygon("[[1, 1, 3, 1, 3, 2]]"), ["size of the image not found", "width and height"]),
        (polygon("[1, 1, 3, 1, 3, 2]"), ["invalid type: integer `1`, expected a polygon", "line 1"]),
        (polygon("[[true, false]]"), ["boolean `true`", "coco_rle"]),
        (polygon("7"), ["integer `7`, expected segmentation as RLE", "polygons"]),
        (polygon(r#"{"size": [3], "counts": []}"#), ["invalid length 1", "array of length 2"]),
        (annotated("[[1, 1, 3]]"), ["polygon 0 is a list of 3 numbers", "pairs x, y"]),
        (annotated("[[1, 1, 3, 1, 1e9, 2]]"), ["one with a corner at 1000000000.0", "near the image"]),
        (
            annotated("[[1, 1]]").replace("\"image_id\": 1", "\"image_id\": 9"),
            ["annotation 0: image_id is 9", "ids in images"],
        ),
        (annotated("[[1, 1]]").replace("4,", "1000000000,"), ["size is [3, 1000000000]", "at most"]),
        ("7".into(), ["expected a list of masks", "images and annotations"]),
        (r#"{"annotations": []}"#.into(), ["missing field `images`", "dets.json"]),
    ] {
        let message = read(&text).unwrap_err().to_string();
        assert!(
            parts.iter().all(|part| message.contains(part)) && message.contains("dets.json"),
            "{message}"
        );
    }
    assert!(read("[]").unwrap().is_empty());
}

#[test]
fn masks_without_ids_are_those_of_one_image() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sam.json");
    let text = r#"[{"segmentation": {"size": [3, 4], "counts": [4, 1, 2, 1, 4]}, "area": 2, "bbox": [1, 1, 2, 1],
        "predicted_iou": 0.93, "point_coords": [[1.5, 1.0]], "stability_score": 0.97, "crop_box": [0, 0, 4, 3]},
        {"segmentation": [[1, 1, 3, 1, 3, 2, 1, 2]], "predicted_iou": 0.5}]"#;
    std::fs::write(&path, text).unwrap();
    let list = MaskList::read(&path).unwrap();
    let masks: Vec<ListedMask<'_>> = list.masks().collect();
    assert_eq!(
        masks.iter().map(|m| (m.image(), m.score())).collect::<Vec<_>>(),
        [((None, None), 0.93), ((None, None), 0.5)]
    );
    for mask in masks {
        let mask = mask.rle(Some((4, 3))).unwrap().decode().unwrap();
        assert_eq!(mask.pixels().collect::<Vec<_>>(), SQUARE);
    }
}

#[test]
fn mutated_lists_are_lists_or_errors() {
    let seed = r#"{"images": [{"id": 1, "width": 40, "height": 30, "file_name": "1/rgb/2.png"}], "annotations": [{"image_id": 1,
        "category_id": 1, "bbox": [0, 0, 1, 1], "segmentation": [[1.5, 1, 33, 1.25, 33, 20, 1, 22]]}, {"image_id": 1,
        "category_id": 1, "bbox": [0, 0, 1, 1], "segmentation": {"size": [30, 40], "counts": [4, 1, 2, 1, 1192]}}]}"#;
    let mut state = 1u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    for _ in 0..1000 {
        let mut bytes = seed.as_bytes().to_vec();
        for _ in 0..1 + random(2) {
            let at = random(bytes.len());
            match random(3) {
                0 => bytes[at] = b"0123456789-e.[]{},\""[random(19)],
                1 => drop(bytes.drain(at..(at + random(9)).min(bytes.len()))),
                _ => bytes.insert(at, b"0123456789-e.[]{}"[random(17)]),
            }
        }
        let Ok(text) = String::from_utf8(bytes) else { continue };
        for detection in read(&text).unwrap_or_default() {
            if let Ok(runs) = detection.segmentation.runs() {
                let [height, width] = detection.segmentation.size.map(u64::from);
                assert_eq!(runs.iter().map(|&n| u64::from(n)).sum::<u64>(), height * width);
            }
        }
    }
}
