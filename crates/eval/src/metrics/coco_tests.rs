use unopose_dataset::formats::rle::{Counts, Rle};

use super::*;

const SIZE: u32 = 10;

/// A mask of 10 x 10 pixels whose columns `from..to` are set.
fn columns(from: u32, to: u32) -> Region {
    let runs = vec![from * SIZE, (to - from) * SIZE, (SIZE - to) * SIZE];
    Region::Mask(Foreground::new(&Rle { size: [SIZE, SIZE], counts: Counts::Runs(runs) }).unwrap())
}

fn truth(im_id: u32, obj_id: u32, region: Region, ignored: bool) -> CocoGroundTruth {
    CocoGroundTruth { scene_id: 1, im_id, obj_id, region, ignored }
}

fn detection(im_id: u32, obj_id: u32, region: Region, score: f64) -> CocoDetection {
    CocoDetection { scene_id: 1, im_id, obj_id, score, region }
}

#[test]
fn overlaps_decide_by_threshold() {
    // Overlap 7 / 10: a hit at 0.5, 0.55, ... 0.7.
    let scores = coco_map(&[truth(0, 1, columns(0, 10), false)], &[detection(0, 1, columns(0, 7), 0.9)]);
    assert!((scores.map - 0.5).abs() < 1e-12, "{scores:?}");
    assert_eq!((scores.ap50, scores.ap75, scores.ar100), (1.0, 0.0, 0.5));
    // Boxes: 8 / 10.
    let boxes = |w| Region::Box([2.0, 3.0, w, 4.0]);
    let scores = coco_map(&[truth(0, 1, boxes(10.0), false)], &[detection(0, 1, boxes(8.0), 0.9)]);
    assert!((scores.map - 0.7).abs() < 1e-12, "{scores:?}");
    assert_eq!(boxes(8.0).iou(&columns(0, 3)), 0.0);
}

#[test]
fn what_matches_ignored_ground_truth_does_not_count() {
    let truths = [truth(0, 1, columns(0, 5), false), truth(0, 1, columns(5, 10), true)];
    let hit = detection(0, 1, columns(0, 5), 0.5);
    // The better scored detection lies on the ignored instance.
    let scores = coco_map(&truths, &[detection(0, 1, columns(5, 10), 0.9), hit.clone()]);
    assert_eq!((scores.map, scores.n_instances, scores.n_ignored), (1.0, 1, 1));
    // A second one there is a false alarm: an instance is matched once. Precision 1/2 at every recall.
    let twice = [detection(0, 1, columns(5, 10), 0.9), detection(0, 1, columns(5, 10), 0.8), hit];
    assert!((coco_map(&truths, &twice).map - 0.5).abs() < 1e-12);
    // Ground truth that counts comes first even when the ignored one fits better.
    let truths = [truth(0, 1, columns(0, 6), true), truth(0, 1, columns(0, 10), false)];
    assert_eq!(coco_map(&truths, &[detection(0, 1, columns(0, 6), 0.9)]).ap50, 1.0);
}

#[test]
fn objects_count_alike_and_strangers_not_at_all() {
    // Object 1 is found in both images, object 2 in none of its one, object 3 is annotated but ignored.
    let truths = [
        truth(0, 1, columns(0, 5), false),
        truth(1, 1, columns(0, 5), false),
        truth(0, 2, columns(6, 9), false),
        truth(1, 3, columns(6, 9), true),
    ];
    let found = [
        detection(0, 1, columns(0, 5), 0.9),
        detection(1, 1, columns(0, 5), 0.8),
        detection(1, 3, columns(6, 9), 0.9),
        detection(0, 4, columns(0, 5), 0.9),
        detection(7, 1, columns(0, 5), 0.99),
    ];
    let scores = coco_map(&truths, &found);
    assert_eq!((scores.map, scores.per_object.len(), scores.per_object[&1]), (0.5, 2, 1.0));
    assert_eq!((scores.n_detections, scores.n_outside), (2, 3));
    // An object's detection in an image of the list that does not show it is a false alarm.
    let scores = coco_map(&truths[1..], &[found[0].clone(), found[1].clone()]);
    assert!((scores.per_object[&1] - 0.5).abs() < 1e-12);
}

#[test]
fn at_most_a_hundred_detections_count() {
    let truths = [truth(0, 1, columns(0, 5), false)];
    let mut found: Vec<CocoDetection> =
        (0..100).map(|i| detection(0, 1, columns(6, 8), 0.9 - 0.001 * f64::from(i))).collect();
    found.push(detection(0, 1, columns(0, 5), 0.1));
    assert_eq!(coco_map(&truths, &found).map, 0.0);
    assert!((coco_map(&truths, &found[1..]).map - 0.01).abs() < 1e-12);
    assert_eq!(coco_map(&[], &found), CocoScores { n_outside: 101, ..CocoScores::default() });
}
