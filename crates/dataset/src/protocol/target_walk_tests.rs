//! Small lists, walked and answered by hand.

use nalgebra::{Matrix3, Vector3};
use unopose_core::geometry::Pose;

use super::*;
use crate::formats::{
    ReferenceTarget,
    detections::Detection,
    rle::{Counts, Rle},
};

/// Of scene 1.
fn target(im_id: u32, obj_id: u32, ref_im_id: u32) -> ReferenceTarget {
    ReferenceTarget { scene_id: 1, im_id, obj_id, ref_scene_id: 1, ref_im_id, rot_deg: None, overlap: None }
}

/// Of scene 1; the box's x is a mark to tell detections apart.
fn detection(image_id: u32, category_id: u32, score: f64, time: f64, mark: f64) -> Detection {
    Detection {
        scene_id: 1,
        image_id,
        category_id,
        bbox: [mark, 0.0, 1.0, 1.0],
        score,
        time,
        segmentation: Rle { size: [1, 1], counts: Counts::Runs(vec![0, 1]) },
    }
}

fn marks(detections: &[&Detection]) -> Vec<f64> {
    detections.iter().map(|d| d.bbox[0]).collect()
}

fn pose(x: f64) -> Pose {
    Pose::new(Matrix3::identity(), Vector3::new(x, 0.0, 1.0))
}

#[test]
fn images_and_objects_ascend_and_references_keep_their_order() {
    let earlier = ReferenceTarget { scene_id: 0, ..target(9, 4, 2) };
    let targets = [target(3, 7, 5), target(2, 7, 8), target(3, 6, 5), target(3, 7, 1), earlier];
    // Another image, and an object that is no target there.
    let detections = [detection(5, 7, 0.9, 0.0, 1.0), detection(2, 6, 0.9, 0.0, 2.0)];
    let images = ImageTargets::group(&targets, &detections);
    let ids: Vec<_> = images.iter().map(|image| (image.scene_id, image.im_id)).collect();
    assert_eq!(ids, [(0, 9), (1, 2), (1, 3)]);
    let objects: Vec<u32> = images[2].objects.iter().map(|object| object.obj_id).collect();
    assert_eq!(objects, [6, 7]);
    let references: Vec<u32> = images[2].objects[1].references.iter().map(|r| r.ref_im_id).collect();
    assert_eq!(references, [5, 1]);
    for mut object in images.into_iter().flat_map(|image| image.objects) {
        assert!(!object.has_detections() && object.next_detections().is_empty());
    }
}

#[test]
fn confident_detections_come_at_once_and_the_others_one_by_one() {
    let targets = [target(1, 1, 0)];
    let scores = [0.1, 0.6, MIN_DETECTION_SCORE, 0.9, 0.6, MIN_DETECTION_SCORE, 0.2];
    let detections: Vec<_> =
        (0..).zip(scores).map(|(mark, score)| detection(1, 1, score, 0.0, f64::from(mark))).collect();
    let object = ImageTargets::group(&targets, &detections).remove(0).objects.remove(0);
    // The threshold itself is not confident; equal scores keep the order of the list.
    let mut failing = object.clone();
    for expected in [&[3.0, 1.0, 4.0][..], &[2.0], &[5.0], &[6.0], &[0.0], &[], &[]] {
        assert_eq!(marks(&failing.next_detections()), expected);
    }
    assert!(!failing.has_detections());
    let mut posed = object;
    assert_eq!(posed.next_detections().len(), 3);
    assert_eq!(marks(&posed.next_detections()), [2.0]);
    posed.posed = true;
    assert!(posed.next_detections().is_empty() && posed.has_detections());
}

#[test]
fn the_best_reference_is_taken_and_the_last_failure_told() {
    let best = |outcomes: &[Result<(f64, u32), &'static str>]| best_outcome(outcomes.to_vec());
    // The first of equals.
    assert_eq!(best(&[Err("a"), Ok((0.4, 1)), Ok((0.7, 2)), Err("b"), Ok((0.7, 3))]), Some(Ok((0.7, 2))));
    assert_eq!(best(&[Err("a"), Err("b")]), Some(Err("b")));
    assert_eq!(best(&[]), None);
}

#[test]
fn every_result_of_an_image_repeats_its_time() {
    let targets = [target(1, 1, 0), target(1, 2, 0), target(2, 1, 0), target(3, 1, 0)];
    let detections = [
        detection(1, 1, 0.5, 0.25, 0.0),
        detection(1, 2, 1.0, 0.75, 0.0),
        detection(2, 1, 1.0, -1.0, 0.0),
        detection(2, 1, 1.0, 0.5, 0.0),
    ];
    let mut poses = TargetPoses::default();
    for image in ImageTargets::group(&targets, &detections) {
        let mut made = ImagePoses::new(&mut poses, &image);
        for mut object in image.objects {
            if !object.has_detections() {
                made.reject(object.obj_id, NO_DETECTION);
            }
            for detection in object.next_detections() {
                made.add_pairs(1);
                made.add_seconds(2.0);
                made.add_pose(detection, 0.5, pose(0.1));
            }
        }
        made.finish();
    }
    let results: Vec<_> = poses.results.iter().map(|r| (r.im_id, r.obj_id, r.score, r.time)).collect();
    // The longest time of the detections and that of all pairs; in image 2 the time of one detection is unknown.
    let expected = [(1, 1, 0.25, 4.75), (1, 2, 0.5, 4.75), (2, 1, 0.5, -1.0), (2, 1, 0.5, -1.0)];
    assert_eq!(results, expected);
    assert_eq!(poses.results[0].t_camera_object, pose(0.1));
    assert_eq!((poses.pairs, poses.seconds, poses.mean_time_per_pair_s()), (4, 8.0, Some(2.0)));
    assert_eq!((poses.rejections[0].im_id, poses.rejections[0].obj_id), (3, 1));
    assert_eq!(poses.reasons(), [(NO_DETECTION.to_owned(), 1)]);
}
