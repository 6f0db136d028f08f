//! Matching from end to end against the official implementation, evaluation and training step, from stored colour features:
//! everything but the backbone, whose blocks have fixtures of their own. A part of the shared folder's `e2e_*` tensors.

use burn::tensor::Tensor;
use unopose_core::{
    config::ModelConfig,
    geometry::{coarse_pose, fine_pose},
};
use unopose_infer::{host_assignments, sparse_points};
use unopose_nn::model::{CloudTensors, EncodedCloud, PairTensors, Supervision, UnoPose, group_tensors};
use unopose_pairs::data::{metric_pose, positional_groups};
use unopose_tests::{tensor_fixture::Fixture, test_device::test_device};

use crate::official::{check_training, inputs, pose, small_official, training_samples};

/// The network with the stored weights in all but the backbone.
fn network(fixture: &Fixture, config: &ModelConfig, device: &burn::tensor::Device) -> UnoPose {
    let model = UnoPose::new(config, 1, device);
    UnoPose {
        geo_embedding: fixture.weights(model.geo_embedding, "w.geo_embedding."),
        coarse_point_matching: fixture.weights(model.coarse_point_matching, "w.coarse_point_matching."),
        fine_point_matching: Some(
            fixture.weights(model.fine_point_matching.unwrap(), "w.fine_point_matching."),
        ),
        ..model
    }
}

/// An encoded cloud with stored colour features.
fn encoded(fixture: &Fixture, model: &UnoPose, cloud: &CloudTensors, features: &str) -> EncodedCloud {
    model.encode_structure(&cloud.structure, &cloud.rows, fixture.tensor(features))
}

#[test]
fn poses_follow_from_colour_features() {
    let (device, config) = (test_device(), small_official());
    let fixture = Fixture::open("matching_e2e");
    let model = network(&fixture, &config, &device);
    let pairs = inputs(&fixture, "eval.", &config);
    let queries: Vec<_> = pairs.iter().map(|p| &p.0).collect();
    let references: Vec<_> = pairs.iter().map(|p| &p.1.cloud).collect();
    let [query, reference] =
        [&queries, &references].map(|clouds| CloudTensors::from_clouds(clouds, &config, &device));
    let query = encoded(&fixture, &model, &query, "eval.dense_fm");
    let reference = encoded(&fixture, &model, &reference, "eval.dense_fo");

    let coarse = model.coarse(&query, &reference, Supervision::LastBlock).remove(0);
    fixture.check("eval.coarse_sim0", coarse.similarity.clone(), 3e-3);
    fixture.check("eval.coarse_scores", Tensor::cat(coarse.overlap_probability().to_vec(), 1), 9e-5);
    let matched = host_assignments(coarse, config.overlap, true).unwrap();
    let starts: Vec<_> = pairs
        .iter()
        .zip(&matched)
        .enumerate()
        .map(|(b, ((query, reference), matched))| {
            let mut uniforms = fixture.file.item("eval.uniform", b).into_iter();
            let (from, to) = (sparse_points(query), sparse_points(&reference.cloud));
            let next = || uniforms.next().unwrap();
            coarse_pose(&matched.assignment, &from, &to, &config.hypotheses, next, true).pose
        })
        .collect();
    for (b, start) in starts.iter().enumerate() {
        let expected = pose(&fixture, "eval.init_R", "eval.init_t", b, 1.0);
        assert!(start.rotation_angle_deg(&expected) < 1e-2, "{start:?}");
        assert!(start.translation_distance(&expected) < 1e-4, "{start:?}");
    }

    let stage = model.fine_point_matching.as_ref().unwrap();
    let position =
        |groups: Vec<_>| stage.position(&group_tensors(&groups.iter().collect::<Vec<_>>(), &config, &device));
    let moved = pairs.iter().zip(&starts).map(|((query, _), start)| {
        let t_reference_query = start.inverse();
        let points: Vec<_> = query.points.iter().map(|p| t_reference_query.transform_f32(p)).collect();
        positional_groups(&points, &config)
    });
    let query = EncodedCloud { position: Some(position(moved.collect())), ..query };
    let still = pairs.iter().map(|p| p.1.groups.clone()).collect();
    let reference = EncodedCloud { position: Some(position(still)), ..reference };
    let fine = model.fine(&query, &reference, Supervision::LastBlock).remove(0);
    fixture.check("eval.fine_scores", Tensor::cat(fine.overlap_probability().to_vec(), 1), 3e-3);
    let matched = host_assignments(fine, config.overlap, false).unwrap();
    for (b, ((query, reference), matched)) in pairs.iter().zip(&matched).enumerate() {
        let solved = fine_pose(&matched.assignment, &query.points, &reference.cloud.points);
        let metric = metric_pose(&solved.pose, query.center, reference.cloud.center, reference.radius);
        let expected = pose(&fixture, "eval.pred_R", "eval.pred_t", b, 1.0);
        let angle = metric.rotation_angle_deg(&expected);
        let shift = metric.translation_distance(&expected);
        let score = (solved.score - f64::from(fixture.file.item("eval.pred_pose_score", b)[0])).abs();
        // The bounds of the whole chain from the images, five times what rounding of the inputs moves.
        assert!(angle < 1e-3 && shift < 6e-6 && score < 2e-6, "pair {b}: {angle} deg, {shift} m, {score}");
    }
}

#[test]
fn losses_and_gradients_follow_from_colour_features() {
    let (device, config) = (test_device().autodiff(), small_official());
    let fixture = Fixture::open("matching_e2e");
    let model = network(&fixture, &config, &device);
    let samples = training_samples(&fixture, "train.", &config);
    let batch = PairTensors::from_samples(&samples, &config, &device);
    let groups = PairTensors::groups_of(&samples, &config, &device);
    let [query, reference] =
        [(&batch.query, "eval.dense_fm", &groups[0]), (&batch.reference, "eval.dense_fo", &groups[1])].map(
            |(cloud, features, groups)| EncodedCloud {
                position: model.position(groups),
                ..encoded(&fixture, &model, cloud, features)
            },
        );
    let outputs = model.forward_encoded(&query, &reference);
    for index in [0, 2] {
        let name = format!("train.coarse_sim{index}");
        fixture.check(&name, outputs.coarse[index].similarity.clone(), 5e-3);
    }
    fixture.check("train.fine_score2", Tensor::cat(outputs.fine[2].overlap_probability().to_vec(), 1), 3e-3);
    check_training(&fixture, "train.", &model, &outputs, &batch);
}
