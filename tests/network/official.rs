//! The small official network of the reference tensors and its two pairs.

use burn::tensor::Tensor;
use unopose_core::{
    config::{
        ColorConfig, EmbeddingEvaluation, FineConfig, GeoEmbeddingConfig, HypothesisConfig, LossConfig,
        MatchingConfig, ModelConfig, OverlapMode, Quirks, VitConfig,
    },
    geometry::Pose,
};
use unopose_nn::{
    loss::pair_losses,
    model::{MatchingOutputs, PairTensors, UnoPose},
};
use unopose_pairs::data::{
    CloudInput, PairKey, PreparedReference, TrainSample, positional_groups, query_from_points,
    reference_from_points,
};
use unopose_tests::tensor_fixture::Fixture;

fn choose(fixture: &Fixture, name: &str, b: usize) -> Vec<u32> {
    fixture.file.int_item(name, b).into_iter().map(|v| v as u32).collect()
}

pub fn pose(fixture: &Fixture, rotation: &str, translation: &str, b: usize, scale: f64) -> Pose {
    let r: Vec<f64> = fixture.file.item(rotation, b).into_iter().map(f64::from).collect();
    let t: Vec<f64> = fixture.file.item(translation, b).into_iter().map(|x| x as f64 / scale).collect();
    Pose::from_row_major(&r.try_into().unwrap(), &t.try_into().unwrap())
}

/// The sizes of `fixtures/config.json`, with the release's behaviour.
pub fn small_official() -> ModelConfig {
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

/// Queries and references of the two pairs from tensors whose names begin with `prefix`; without crops where the file has
/// none.
pub fn inputs(fixture: &Fixture, prefix: &str, config: &ModelConfig) -> Vec<(CloudInput, PreparedReference)> {
    let name = |name: &str| format!("{prefix}{name}");
    let image = |part: &str, b: usize| match fixture.file.contains(&name(part)) {
        true => fixture.file.item(&name(part), b),
        false => vec![0.0; 3 * config.image_size * config.image_size],
    };
    (0..2)
        .map(|b| {
            let reference = reference_from_points(
                &fixture.file.cloud(&name("tem1_pts"), b),
                &choose(fixture, &name("tem1_choose"), b),
                image("tem1_rgb", b),
                config,
            );
            let query = query_from_points(
                &fixture.file.cloud(&name("pts"), b),
                &choose(fixture, &name("rgb_choose"), b),
                image("rgb", b),
                reference.radius,
                config,
            );
            (query, reference)
        })
        .collect()
}

/// The pairs as training samples; `labels` begins the names of poses.
pub fn training_samples(fixture: &Fixture, labels: &str, config: &ModelConfig) -> Vec<TrainSample> {
    let name = |name: &str| format!("{labels}{name}");
    let prefix = if labels.is_empty() { "" } else { "eval." };
    inputs(fixture, prefix, config)
        .into_iter()
        .enumerate()
        .map(|(b, (query, reference))| {
            let t_init = pose(fixture, &name("init_R"), &name("init_t"), b, 1.0);
            let t_reference_query = t_init.inverse();
            let moved: Vec<_> = query.points.iter().map(|p| t_reference_query.transform_f32(p)).collect();
            let scale = reference.radius as f64 + 1e-6;
            TrainSample {
                t_query_reference: pose(
                    fixture,
                    &name("rotation_label"),
                    &name("translation_label"),
                    b,
                    scale,
                ),
                t_init,
                query_groups: positional_groups(&moved, config),
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
        .collect()
}

/// Losses and gradients of a training step against tensors whose names begin with `prefix`.
pub fn check_training(
    fixture: &Fixture,
    prefix: &str,
    model: &UnoPose,
    outputs: &MatchingOutputs,
    batch: &PairTensors,
) {
    let losses = pair_losses(&LossConfig::default(), outputs, batch);
    for (name, value) in &losses.terms {
        let (stage, rest) = name.split_once('.').unwrap();
        let (block, term) = rest.split_once('.').unwrap();
        let stage = if stage == "coarse" { "coarse_hard" } else { "fine" };
        let term = match term {
            "info_nce" => "atten",
            "overlap" => "score",
            other => other,
        };
        fixture.check(&format!("{prefix}per_sample.{stage}_{term}_loss{block}"), value.clone(), 1e-4);
    }
    fixture.check(&format!("{prefix}loss_total"), losses.total.clone(), 8e-5);

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
        let expected = &fixture.file.f32(&format!("{prefix}grad.{name}")).1;
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
