//! The whole network against the tensors of the official implementation (`fixtures/e2e_*.safetensors` of the shared folder).

use burn::tensor::{Device, Tensor};
use unopose_core::{
    config::{
        ColorConfig, EmbeddingEvaluation, FineConfig, GeoEmbeddingConfig, HypothesisConfig, LossConfig,
        MatchingConfig, ModelConfig, OverlapMode, Quirks, VitConfig,
    },
    geometry::Pose,
};
use unopose_infer::{Uniforms, estimate_pairs};
use unopose_nn::{
    checkpoint::load_official,
    loss::pair_losses,
    model::{CloudTensors, EncodedCloud, PairTensors, Supervision, UnoPose},
};
use unopose_pairs::data::{
    CloudInput, PairKey, PreparedReference, TrainSample, positional_groups, query_from_points,
    reference_from_points,
};
use unopose_tests::tensor_fixture::Fixture;
use unopose_tests::test_device::test_device;

fn choose(fixture: &Fixture, name: &str, b: usize) -> Vec<u32> {
    fixture.file.int_item(name, b).into_iter().map(|v| v as u32).collect()
}

fn pose(fixture: &Fixture, rotation: &str, translation: &str, b: usize, scale: f64) -> Pose {
    let r: Vec<f64> = fixture.file.item(rotation, b).into_iter().map(f64::from).collect();
    let t: Vec<f64> = fixture.file.item(translation, b).into_iter().map(|x| x as f64 / scale).collect();
    Pose::from_row_major(&r.try_into().unwrap(), &t.try_into().unwrap())
}

/// The sizes of `fixtures/config.json`, with the release's behaviour.
fn small_official() -> ModelConfig {
    let matching = MatchingConfig { blocks: 3, heads: 4, hidden_dim: 32, out_dim: 32, temperature: 0.1 };
    ModelConfig {
        image_size: 224,
        reference_points: 400,
        fine_points: 256,
        coarse_points: 64,
        color: ColorConfig::Vit(VitConfig {
            embed_dim: 48,
            depth: 4,
            heads: 3,
            out_dim: 32,
            ..VitConfig::default()
        }),
        geo_embedding: GeoEmbeddingConfig {
            hidden_dim: 32,
            evaluation: EmbeddingEvaluation::Exact,
            ..GeoEmbeddingConfig::default()
        },
        coarse: matching.clone(),
        fine: FineConfig { matching, pe_radii: [0.2, 0.4], pe_samples: [16, 32], ..FineConfig::default() },
        overlap: OverlapMode::Release,
        hypotheses: HypothesisConfig { proposals: 600, kept: 60, ..HypothesisConfig::default() },
        quirks: Quirks::release(),
        ..ModelConfig::default()
    }
}

fn inputs(fixture: &Fixture, config: &ModelConfig) -> Vec<(CloudInput, PreparedReference)> {
    (0..2)
        .map(|b| {
            let reference = reference_from_points(
                &fixture.file.cloud("tem1_pts", b),
                &choose(fixture, "tem1_choose", b),
                fixture.file.item("tem1_rgb", b),
                config,
            );
            let query = query_from_points(
                &fixture.file.cloud("pts", b),
                &choose(fixture, "rgb_choose", b),
                fixture.file.item("rgb", b),
                reference.radius,
                config,
            );
            (query, reference)
        })
        .collect()
}

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
        let pairs = inputs(&fixture, &config);
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
    let samples: Vec<TrainSample> = inputs(&fixture, &config)
        .into_iter()
        .enumerate()
        .map(|(b, (query, reference))| {
            let t_init = pose(&fixture, "init_R", "init_t", b, 1.0);
            let t_reference_query = t_init.inverse();
            let moved: Vec<_> = query.points.iter().map(|p| t_reference_query.transform_f32(p)).collect();
            let scale = reference.radius as f64 + 1e-6;
            TrainSample {
                t_query_reference: pose(&fixture, "rotation_label", "translation_label", b, scale),
                t_init,
                query_groups: positional_groups(&moved, &config),
                query,
                reference,
                key: PairKey {
                    index: b as u64,
                    obj_id: 0,
                    query_image: 0,
                    query_instance: 0,
                    reference_image: 0,
                    reference_instance: 0,
                },
            }
        })
        .collect();
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
    let losses = pair_losses(&LossConfig::default(), &outputs, &batch);
    for (name, value) in &losses.terms {
        let (stage, rest) = name.split_once('.').unwrap();
        let (block, term) = rest.split_once('.').unwrap();
        let stage = if stage == "coarse" { "coarse_hard" } else { "fine" };
        let term = match term {
            "info_nce" => "atten",
            "overlap" => "score",
            other => other,
        };
        fixture.check(&format!("per_sample.{stage}_{term}_loss{block}"), value.clone(), 1e-4);
    }
    fixture.check("loss_total", losses.total.clone(), 8e-5);

    let gradients = losses.total.backward();
    let stage = model.fine_point_matching.as_ref().unwrap();
    let checks: Vec<(&str, Vec<f32>)> = vec![
        (
            "coarse_point_matching.in_proj.weight",
            gradient(&model.coarse_point_matching.in_proj.weight.val(), &gradients),
        ),
        ("fine_point_matching.in_proj.weight", gradient(&stage.in_proj.weight.val(), &gradients)),
        ("geo_embedding.proj_d.weight", gradient(&model.geo_embedding.proj_d.weight.val(), &gradients)),
        ("geo_embedding.proj_a.weight", gradient(&model.geo_embedding.proj_a.weight.val(), &gradients)),
        (
            "fine_point_matching.PE.mlp1.layer0.conv.weight",
            gradient(&stage.PE.mlp1.layer0.conv.weight.val(), &gradients),
        ),
    ];
    for (name, actual) in checks {
        let expected = &fixture.file.f32(&format!("grad.{name}")).1;
        let dot: f64 = actual.iter().zip(expected).map(|(a, b)| (a * b) as f64).sum();
        let norm = |v: &[f32]| v.iter().map(|x| (x * x) as f64).sum::<f64>().sqrt();
        let difference: Vec<f32> = actual.iter().zip(expected).map(|(a, b)| a - b).collect();
        let relative = norm(&difference) / norm(expected);
        println!("{name}: relative L2 {relative:.2e}, cosine {:.6}", dot / norm(&actual) / norm(expected));
        assert!(relative <= 5e-2, "{name}: relative L2 difference {relative}");
    }
}

/// Gradient of a linear weight in the official `[out, in]` layout.
fn gradient(weight: &Tensor<2>, gradients: &burn::tensor::Gradients) -> Vec<f32> {
    let gradient = weight.grad(gradients).expect("the parameter takes part in the loss");
    gradient.transpose().try_into_vec_as::<f32>().unwrap()
}
