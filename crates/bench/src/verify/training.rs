//! One training step from stored pairs and noisy poses: losses, gradients, BatchNorm statistics after it.

use std::collections::BTreeMap;

use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param, ParamId},
    tensor::{Device, Gradients, Tensor, activation::sigmoid, container::TensorContainer},
};
use unopose_core::{
    config::{LossConfig, ModelConfig},
    geometry::{Pose, nearest_match},
};
use unopose_infer::InferError;
use unopose_nn::{
    checkpoint::official_tensors,
    loss::pair_losses,
    model::{BlockOutput, PairTensors, UnoPose},
};
use unopose_pairs::data::{PairKey, TrainSample, normalised_pose, positional_groups};

use super::{
    ReferenceTensors, VerifyError,
    computed::{Computed, read},
    inputs::Pair,
};

/// Forward passes of the positional encoding per step: query, then reference.
const PASSES: i64 = 2;

/// Computes everything that a training file can hold. `model` is on the autodiff tape.
pub(super) fn compute(
    model: &UnoPose,
    (config, loss): (&ModelConfig, &LossConfig),
    batches_tracked: &BTreeMap<String, i64>,
    stored: &ReferenceTensors,
    pairs: &[Pair],
    device: &Device,
) -> Result<Computed, VerifyError> {
    let samples: Vec<TrainSample> = pairs
        .iter()
        .enumerate()
        .map(|(b, pair)| sample(pair, config, stored, b, pairs.len()))
        .collect::<Result<_, _>>()?;
    let batch = PairTensors::from_samples(&samples, config, device);
    let groups = PairTensors::groups_of(&samples, config, device);
    let outputs = model.forward_train(&batch, &groups);
    let mut out = Computed::default();
    let poses: Vec<Pose> = samples.iter().map(|s| s.t_query_reference).collect();
    let sparse = |points: &[[f32; 3]], indices: &[u32]| -> Vec<[f32; 3]> {
        indices.iter().map(|&i| points[i as usize]).collect()
    };
    let cloud = |s: &TrainSample| [s.query.points.clone(), s.reference.cloud.points.clone()];
    let thinned =
        |s: &TrainSample| [&s.query, &s.reference.cloud].map(|cloud| sparse(&cloud.points, &cloud.sparse));
    let stages = [
        ("coarse", "coarse_hard", &outputs.coarse, samples.iter().map(thinned).collect::<Vec<_>>()),
        ("fine", "fine", &outputs.fine, samples.iter().map(cloud).collect()),
    ];
    for (stage, loss_name, blocks, clouds) in &stages {
        out.clouds(&format!("{stage}_p1"), clouds.iter().map(|c| c[0].as_slice()));
        out.clouds(&format!("{stage}_p2"), clouds.iter().map(|c| c[1].as_slice()));
        for (index, block) in blocks.iter().enumerate() {
            out.tensor(format!("{stage}_sim{index}"), block.similarity.clone())?;
            out.tensor(
                format!("{stage}_score{index}"),
                Tensor::cat(block.overlap_probability().to_vec(), 1),
            )?;
            if let Some(saliency) = block.saliency() {
                let saliency = Tensor::cat(saliency.map(sigmoid).to_vec(), 1);
                out.tensor(format!("{stage}_saliency{index}"), saliency)?;
            }
        }
        if let Some(block) = blocks.last() {
            accuracy(&mut out, loss_name, block, clouds, &poses, loss.match_distance)?;
        }
    }

    let losses = pair_losses(loss, &outputs, &batch);
    for (name, value) in &losses.terms {
        let mut parts = name.split('.');
        let (Some(stage), Some(block), Some(term)) = (parts.next(), parts.next(), parts.next()) else {
            continue;
        };
        let stage = if stage == "coarse" { "coarse_hard" } else { stage };
        let term = match term {
            "info_nce" => "atten",
            "overlap" => "score",
            other => other,
        };
        let values = read(value.clone())?;
        per_sample(
            &mut out,
            &format!("{stage}_{term}_loss{block}"),
            values.into_iter().map(f64::from).collect(),
        );
    }
    out.tensor("loss_total", losses.total.clone())?;

    for (name, value) in
        official_tensors(&gradients(model, losses.total.backward())).map_err(InferError::from)?
    {
        let values: Vec<f64> = value.iter::<f64>().collect();
        insert(&mut out, format!("grad.{name}"), value.shape().to_vec(), values);
    }
    for (name, value) in official_tensors(model).map_err(InferError::from)? {
        let values: Vec<f64> = value.iter::<f64>().collect();
        insert(&mut out, format!("buffer_after.{name}"), value.shape().to_vec(), values);
    }
    for (name, count) in batches_tracked {
        insert(&mut out, format!("buffer_after.{name}"), vec![1], vec![(count + PASSES) as f64]);
    }
    Ok(out)
}

fn insert(out: &mut Computed, name: String, shape: Vec<usize>, values: Vec<f64>) {
    out.0.insert(name, super::computed::Values { shape, values, compared: Vec::new() });
}

fn sample(
    pair: &Pair,
    config: &ModelConfig,
    stored: &ReferenceTensors,
    b: usize,
    batch: usize,
) -> Result<TrainSample, VerifyError> {
    let t_init = stored.pose("init_R", "init_t", b, batch)?;
    let label = stored.pose("rotation_label", "translation_label", b, batch)?;
    let t_reference_query = t_init.inverse();
    let moved: Vec<_> = pair.query.points.iter().map(|p| t_reference_query.transform_f32(p)).collect();
    Ok(TrainSample {
        t_query_reference: normalised_pose(
            &label,
            pair.query.center,
            pair.reference.cloud.center,
            pair.reference.radius,
        ),
        t_init,
        query_groups: positional_groups(&moved, config),
        query: pair.query.clone(),
        reference: pair.reference.clone(),
        key: PairKey::default(),
    })
}

/// The release's figures of a stage's last block: share of query points whose best column is right, number of matched
/// query points, mean distance of the matched ones to their partners under the true pose.
fn accuracy(
    out: &mut Computed,
    stage: &str,
    block: &BlockOutput,
    clouds: &[[Vec<[f32; 3]>; 2]],
    poses: &[Pose],
    match_distance: f32,
) -> Result<(), VerifyError> {
    let [_, rows, columns] = block.similarity.dims();
    let similarity = read(block.similarity.clone())?;
    let (mut right, mut count, mut distance) = (Vec::new(), Vec::new(), Vec::new());
    for ((item, [query, reference]), pose) in similarity.chunks(rows * columns).zip(clouds).zip(poses) {
        let t_reference_query = pose.inverse();
        let moved: Vec<[f32; 3]> = query.iter().map(|p| t_reference_query.transform_f32(p)).collect();
        let best: Vec<usize> = item.chunks(columns).skip(1).map(largest).collect();
        let labels = nearest_match(&moved, reference, match_distance);
        right.push(
            best.iter().zip(&labels).filter(|(b, l)| **b == **l as usize).count() as f64 / best.len() as f64,
        );
        let matched: Vec<f64> = moved
            .iter()
            .zip(&best)
            .filter_map(|(p, &b)| Some((p, reference.get(b.checked_sub(1)?)?)))
            .map(|(p, r)| (0..3).map(|i| ((p[i] - r[i]) as f64).powi(2)).sum::<f64>().sqrt())
            .collect();
        count.push(matched.len() as f64);
        distance.push(matched.iter().sum::<f64>() / (matched.len() as f64 + 1e-8));
    }
    per_sample(out, &format!("{stage}_acc"), right);
    per_sample(out, &format!("{stage}_fg_num"), count);
    per_sample(out, &format!("{stage}_dis"), distance);
    Ok(())
}

fn largest(row: &[f32]) -> usize {
    (0..row.len()).reduce(|a, b| if row[b] > row[a] { b } else { a }).unwrap_or(0)
}

/// A value per pair and its mean.
fn per_sample(out: &mut Computed, name: &str, values: Vec<f64>) {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    insert(out, format!("loss.{name}"), vec![1], vec![mean]);
    insert(out, format!("per_sample.{name}"), vec![values.len()], values);
}

/// The network with every parameter replaced by its gradient, 0 where there is none.
fn gradients(model: &UnoPose, gradients: Gradients) -> UnoPose {
    let mut collect = Collect { gradients, found: TensorContainer::new() };
    model.visit(&mut collect);
    model.valid().map(&mut Replace(collect.found))
}

struct Collect {
    gradients: Gradients,
    found: TensorContainer<ParamId>,
}

impl ModuleVisitor for Collect {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = param.val().grad(&self.gradients) {
            self.found.register(param.id, gradient);
        }
    }
}

struct Replace(TensorContainer<ParamId>);

impl ModuleMapper for Replace {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let gradient = self.0.remove::<Tensor<D>>(&param.id);
        param.map(|value| gradient.unwrap_or_else(|| value.zeros_like()))
    }
}
