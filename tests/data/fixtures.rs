//! Input preparation against the official implementation's tensors.

use unopose_core::{
    config::{FineConfig, ModelConfig, PoseNoiseConfig, Quirks},
    geometry::Pose,
};
use unopose_pairs::data::{PoseNoise, metric_pose, query_from_points, reference_from_points};
use unopose_tests::reference_tensors::{ReferenceTensors, max_difference};

fn pose(r: &[f32], t: &[f32]) -> Pose {
    Pose::from_row_major(&std::array::from_fn(|i| r[i] as f64), &std::array::from_fn(|i| t[i] as f64))
}

#[test]
fn noisy_poses_match() {
    let file = ReferenceTensors::open("aug_pose_noise");
    for item in 0..4 {
        let [angles, translation] =
            ["angles_deg_unclamped", "trans_unclamped"].map(|name| file.item(name, item));
        let noise = PoseNoise {
            angles_deg: std::array::from_fn(|i| angles[i] as f64),
            translation: std::array::from_fn(|i| translation[i] as f64),
        };
        let truth = pose(&file.item("gt_R", item), &file.item("gt_t", item));
        let noisy = noise.apply(&truth, &PoseNoiseConfig::default(), true);
        let rotation =
            max_difference(noisy.rotation_row_major().map(|x| x as f32), &file.item("out_R", item));
        let shift = max_difference(noisy.translation.iter().map(|&x| x as f32), &file.item("out_t", item));
        assert!(rotation < 1e-6 && shift < 1e-6, "[{item}] R {rotation:e}, t {shift:e}");
    }
}

/// The sizes of the reference model.
fn small_model() -> ModelConfig {
    ModelConfig {
        reference_points: 400,
        fine_points: 256,
        coarse_points: 64,
        fine: FineConfig { pe_radii: [0.2, 0.4], pe_samples: [16, 32], ..FineConfig::default() },
        quirks: Quirks::release(),
        ..ModelConfig::default()
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn prepared_clouds_match() {
    let file = ReferenceTensors::open("e2e_eval");
    let config = small_model();
    for item in 0..2 {
        let choose = |name: &str| file.int_item(name, item).iter().map(|&i| i as u32).collect::<Vec<_>>();
        let reference = reference_from_points(
            &file.cloud("tem1_pts", item),
            &choose("tem1_choose"),
            file.item("tem1_rgb", item),
            &config,
        );
        let query = query_from_points(
            &file.cloud("pts", item),
            &choose("rgb_choose"),
            file.item("rgb", item),
            reference.radius,
            &config,
        );
        assert!((reference.radius - file.item("radius", item)[0]).abs() < 1e-6);
        let check = |name: &str, got: &[f32], tolerance: f32| {
            let worst = max_difference(got.iter().copied(), &file.item(name, item));
            assert!(worst < tolerance, "{name}[{item}] {worst:e}");
        };
        check("dense_pm", query.points.as_flattened(), 3e-5);
        check("dense_po", reference.cloud.points.as_flattened(), 3e-5);
        let indices = |list: &[u32]| list.iter().map(|&i| i as i64).collect::<Vec<_>>();
        assert_eq!(indices(&query.sparse), file.int_item("fps_idx_m", item));
        assert_eq!(indices(&reference.cloud.sparse), file.int_item("fps_idx_o", item));
        let dense = file.int_item("fps_idx_dense_o", item);
        let tem1_choose = file.int_item("tem1_choose", item);
        let expected: Vec<i64> = dense.iter().map(|&i| tem1_choose[i as usize]).collect();
        assert_eq!(indices(&reference.cloud.choose), expected);
        check("geo_d_indices_m", &query.structure.distances, 9e-3);
        check("geo_d_indices_o", &reference.cloud.structure.distances, 9e-3);
        check("geo_a_indices_m", &query.structure.angles, 3e-4);
        check("geo_a_indices_o", &reference.cloud.structure.angles, 5e-3);

        let init = pose(&file.item("init_R", item), &file.item("init_t", item));
        let inverse = init.inverse();
        let moved: Vec<[f32; 3]> = query.points.iter().map(|p| inverse.transform_f32(p)).collect();
        check("pe_in_m", moved.as_flattened(), 3e-5);

        let solved = pose(&file.item("finepose.R", item), &file.item("finepose.t", item));
        let metric = metric_pose(&solved, query.center, reference.cloud.center, reference.radius);
        check("pred_t", &metric.translation.iter().map(|&t| t as f32).collect::<Vec<_>>(), 6e-6);
    }
}
