//! Invariances and recovered poses, over random clouds and motions.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;
use unopose_core::{config::HypothesisConfig, geometry::*};

type Cloud = Vec<[f32; 3]>;

fn cloud(points: std::ops::Range<usize>) -> impl Strategy<Value = Cloud> {
    proptest::collection::vec(proptest::array::uniform3(-1.0f32..1.0), points)
}

fn motion() -> impl Strategy<Value = Pose> {
    let part = || -1.0..1.0f64;
    ((part(), part(), part(), part()), (part(), part(), part())).prop_filter_map(
        "a rotation needs a quaternion away from 0",
        |((w, i, j, k), (x, y, z))| {
            let q = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 0.1)?;
            Some(Pose::new(*q.to_rotation_matrix().matrix(), Vector3::new(x, y, z)))
        },
    )
}

fn moved(points: &[[f32; 3]], pose: &Pose) -> Cloud {
    points.iter().map(|p| pose.transform_f32(p)).collect()
}

/// Whether the frame's choices are far from a tie: separate directions of least spread and a clear sign.
fn determined(points: &[[f32; 3]]) -> bool {
    let frame = GlobalReferenceFrame::new(points, false);
    let [_, middle, least] = frame.singular_values;
    let heights: Vec<f64> = frame.coordinates.iter().map(|c| c[2] as f64).collect();
    let cubes: f64 = heights.iter().map(|h| h.powi(3)).sum();
    let size: f64 = heights.iter().map(|h| h.abs().powi(3)).sum();
    middle > 1.2 * least && cubes.abs() > 0.05 * size
}

fn largest_difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
    a.as_flattened().iter().zip(b.as_flattened()).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_corrected_frame_does_not_see_motion(points in cloud(30..80), pose in motion()) {
        prop_assume!(determined(&points));
        let (a, b) = (global_reference_frame(&points, false), global_reference_frame(&moved(&points, &pose), false));
        // Rounding of the moved points, 1e-7, is amplified where the x axis is a sum of nearly opposite terms.
        prop_assert!(largest_difference(&a, &b) < 1e-3, "{}", largest_difference(&a, &b));
    }

    #[test]
    fn the_frame_does_not_see_the_scale(points in cloud(30..80), scale in 0.01f32..100.0) {
        prop_assume!(determined(&points));
        let scaled: Cloud = points.iter().map(|p| p.map(|v| v * scale)).collect();
        let (a, b) = (global_reference_frame(&points, false), global_reference_frame(&scaled, false));
        prop_assert!(largest_difference(&a, &b) < 1e-3);
    }

    #[test]
    fn frames_follow_a_permutation(points in cloud(30..60), shift in 1usize..29) {
        prop_assume!(determined(&points));
        let mut turned = points.clone();
        turned.rotate_left(shift);
        let mut expected = global_reference_frame(&points, false);
        expected.rotate_left(shift);
        prop_assert!(largest_difference(&global_reference_frame(&turned, false), &expected) < 1e-4);
    }

    #[test]
    fn structure_does_not_see_motion(points in cloud(5..30), pose in motion()) {
        let structure = |p: &[[f32; 3]]| structure_indices(p, 0.2, 15.0, 3);
        let (a, b) = (structure(&points), structure(&moved(&points, &pose)));
        let distances = a.distances.iter().zip(&b.distances).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max);
        prop_assert!(distances < 1e-4, "{distances}");
    }

    #[test]
    fn local_offsets_stay_inside_the_ball(points in cloud(20..60)) {
        let groups = ball_groups(&points, 0.5, 8, Some(LocalFrames::default()));
        for (entries, &count) in groups.features.chunks_exact(8 * 6).zip(&groups.counts) {
            prop_assert!((1..=8).contains(&count));
            for (k, entry) in entries.chunks_exact(6).enumerate() {
                let norm = |v: &[f32]| v.iter().map(|x| x * x).sum::<f32>().sqrt();
                prop_assert!(norm(&entry[..3]) < 0.5 && norm(&entry[3..]) <= 1.0 + 1e-5);
                if k >= count as usize {
                    prop_assert_eq!(entry, &entries[..6]);
                }
            }
        }
    }

    #[test]
    fn procrustes_recovers_the_motion(points in cloud(4..40), pose in motion()) {
        let frame = GlobalReferenceFrame::new(&points, false);
        prop_assume!(frame.singular_values[1] > 1e-2);
        let found = weighted_procrustes(&points, &moved(&points, &pose), None, 0.0);
        prop_assert!(found.rotation_angle_deg(&pose) < 0.01);
        prop_assert!(found.translation_distance(&pose) < 1e-4);
        prop_assert!(found.rotation_defect() < 1e-12);
    }

    #[test]
    fn a_perfect_assignment_gives_the_pose(points in cloud(20..40), pose in motion(), seed in 0u32..1000) {
        let query = moved(&points, &pose);
        let n = points.len();
        let mut similarity = vec![-10.0f32; (n + 1) * (n + 1)];
        (1..=n).for_each(|i| similarity[i * (n + 2)] = 10.0);
        let assignment = match_assignment(&similarity, &vec![1.0; n], &vec![1.0; n]);
        prop_assert!(assignment.label_query.iter().zip(1..).all(|(&l, i)| l == i));
        let mut state = seed;
        let uniforms = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 24) as f32
        };
        let config = HypothesisConfig { proposals: 50, kept: 10, ..HypothesisConfig::default() };
        let coarse = coarse_pose(&assignment, &query, &points, &config, uniforms, false);
        prop_assert!(coarse.pose.rotation_angle_deg(&pose) < 0.1);
        for hypothesis in &coarse.hypotheses {
            let [a, b, c] = hypothesis.pairs;
            prop_assert!(a.0 != b.0 && b.0 != c.0 && a.0 != c.0);
        }
        let fine = fine_pose(&assignment, &query, &points);
        prop_assert!(fine.pose.rotation_angle_deg(&pose) < 0.1, "{}", fine.pose.rotation_angle_deg(&pose));
        prop_assert!((fine.score - 1.0).abs() < 1e-6);
    }
}
