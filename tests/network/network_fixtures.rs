//! The whole network against the tensors of the official implementation (`fixtures/e2e_*.safetensors` of the shared folder).

use burn::tensor::{Device, Tensor};
use unopose_core::config::{EmbeddingEvaluation, ModelConfig};
use unopose_infer::{Uniforms, estimate_pairs};
use unopose_nn::{
    checkpoint::load_official,
    model::{CloudTensors, EncodedCloud, PairTensors, Supervision, UnoPose},
};
use unopose_pairs::data::{CloudInput, positional_groups};
use unopose_tests::{tensor_fixture::Fixture, test_device::test_device};

use crate::official::{check_training, inputs, pose, small_official, training_samples};

fn network(config: &ModelConfig, device: &Device) -> UnoPose {
    let weights = unopose_tests::shared("fixtures/weights.safetensors");
    let (model, unused) = load_official(&weights, config, device).unwrap();
    assert!(unused.iter().any(|name| name == "fine_point_matching.dis_proj.weight"), "unused: {unused:?}");
    model
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn evaluation_matches_the_official_network() {
    let device = test_device();
    for evaluation in [EmbeddingEvaluation::Exact, EmbeddingEvaluation::Table] {
        let mut config = small_official();
        config.geo_embedding.evaluation = evaluation;
        let model = network(&config, &device);
        let fixture = Fixture::open("e2e_eval");
        let pairs = inputs(&fixture, "", &config);
        let clouds: Vec<&CloudInput> = pairs.iter().map(|p| &p.0).collect();
        let references: Vec<&CloudInput> = pairs.iter().map(|p| &p.1.cloud).collect();
        let query = CloudTensors::from_clouds(&clouds, &config, &device);
        let reference = CloudTensors::from_clouds(&references, &config, &device);
        let (query, reference) = (model.encode(&query), model.encode(&reference));
        fixture.check("dense_fm", query.dense.clone(), 2e-5);
        fixture.check("dense_fo", reference.dense.clone(), 2e-5);
        fixture.check("geo_embedding_m", query.embedding.clone(), 4e-3);
        fixture.check("geo_embedding_o", reference.embedding.clone(), 4e-3);
        let coarse = model.coarse(&query, &reference, Supervision::LastBlock);
        fixture.check("coarse_sim0", coarse[0].similarity.clone(), 3e-3);
        fixture.check("coarse_scores", Tensor::cat(coarse[0].overlap_probability().to_vec(), 1), 9e-5);

        let stage = model.fine_point_matching.as_ref().unwrap();
        let moved: Vec<_> = pairs
            .iter()
            .enumerate()
            .map(|(b, (query, _))| {
                let t_reference_query = pose(&fixture, "init_R", "init_t", b, 1.0).inverse();
                let points: Vec<_> =
                    query.points.iter().map(|p| t_reference_query.transform_f32(p)).collect();
                positional_groups(&points, &config)
            })
            .collect();
        let groups = |list: Vec<_>| unopose_nn::model::group_tensors(&list, &config, &device);
        let query_position = stage.position(&groups(moved.iter().collect()));
        let reference_position = stage.position(&groups(pairs.iter().map(|p| &p.1.groups).collect()));
        fixture.check("pe_m", query_position.clone(), 3e-2);
        fixture.check("pe_o", reference_position.clone(), 3e-2);
        let query = EncodedCloud { position: Some(query_position), ..query };
        let reference = EncodedCloud { position: Some(reference_position), ..reference };
        let fine = model.fine(&query, &reference, Supervision::LastBlock);
        fixture.check("fine_sim0", fine[0].similarity.clone(), 4e-2);
        fixture.check("fine_scores", Tensor::cat(fine[0].overlap_probability().to_vec(), 1), 3e-3);

        let views: Vec<_> = pairs.iter().map(|(q, r)| (q, r)).collect();
        let uniforms: Vec<Vec<f32>> = (0..2).map(|b| fixture.file.item("uniform", b)).collect();
        let estimates = estimate_pairs(&model, &config, &views, Uniforms::Given(&uniforms), &device).unwrap();
        for (b, estimate) in estimates.iter().enumerate() {
            let expected = pose(&fixture, "pred_R", "pred_t", b, 1.0);
            let angle = estimate.t_query_reference.rotation_angle_deg(&expected);
            let shift = estimate.t_query_reference.translation_distance(&expected);
            let score = (estimate.score - fixture.file.item("pred_pose_score", b)[0] as f64).abs();
            println!("pair {b}: {angle:.1e} deg, {shift:.1e} m, score {score:.1e}");
            assert!(
                angle < 1e-3 && shift < 6e-6 && score < 2e-6,
                "pair {b}: {angle} deg, {shift} m, {score}"
            );
        }
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn training_losses_match_the_official_network() {
    let device = test_device().autodiff();
    let config = small_official();
    let model = network(&config, &device);
    let fixture = Fixture::open("e2e_train");
    let samples = training_samples(&fixture, "", &config);
    let batch = PairTensors::from_samples(&samples, &config, &device);
    let groups = PairTensors::groups_of(&samples, &config, &device);
    let outputs = model.forward_train(&batch, &groups);
    for (index, block) in outputs.coarse.iter().enumerate() {
        fixture.check(&format!("coarse_sim{index}"), block.similarity.clone(), 5e-3);
        fixture.check(
            &format!("coarse_score{index}"),
            Tensor::cat(block.overlap_probability().to_vec(), 1),
            1e-4,
        );
    }
    fixture.check("fine_sim2", outputs.fine[2].similarity.clone(), 8e-2);
    check_training(&fixture, "", &model, &outputs, &batch);
}
