//! Every stage of an evaluation, from the stored points and crops to the pose.

use burn::{
    module::Param,
    nn::Linear,
    tensor::{Device, Int, Tensor},
};
use unopose_core::{
    config::ModelConfig,
    geometry::{Assignment, CoarsePose, Pose, fine_pose, local_sign_counts},
};
use unopose_infer::host_assignments;
use unopose_nn::model::{
    BlockOutput, CloudTensors, DenseTokens, EncodedCloud, PixelChoice, Supervision, UnoPose, group_tensors,
};
use unopose_pairs::data::{metric_pose, positional_groups};

use super::{
    ReferenceTensors, VerifyError,
    clouds::{self, SIDES},
    computed::Computed,
    hypotheses,
    inputs::Pair,
};

/// The up-sampled feature map is stored at every 16th pixel, from row 3 and column 5.
const STRIDE: usize = 16;
const FIRST: [usize; 2] = [3, 5];

/// Heights this near to the threshold of the counted sign are decided by rounding: clouds at norm 7 (radii) have a
/// resolution of 5e-7.
const HEIGHT_MARGIN: f64 = 2e-6;

/// One side of all pairs.
struct Side<'a> {
    cloud: EncodedCloud,
    /// `m` or `o`, `1` or `2` in the names.
    letter: &'a str,
    number: &'a str,
}

/// Computes everything that an evaluation file can hold.
pub(super) fn compute(
    model: &UnoPose,
    config: &ModelConfig,
    stored: &ReferenceTensors,
    pairs: &[Pair],
    device: &Device,
) -> Result<Computed, VerifyError> {
    let mut out = Computed::default();
    clouds::compute(&mut out, pairs, config);
    let query = side(&mut out, model, config, pairs, ["m", "1", "query"], device)?;
    let reference = side(&mut out, model, config, pairs, ["o", "2", "ref"], device)?;

    let block = coarse(&mut out, model, &query, &reference)?;
    let coarse = assignments(&block, config, config.quirks.score_split_at_reference)?;
    let initial = hypotheses::compute(&mut out, config, stored, pairs, &coarse)?;
    let poses = fine(&mut out, model, config, pairs, [&query, &reference], (stored, &initial), device)?;
    let metric: Vec<Pose> = pairs
        .iter()
        .zip(&poses)
        .map(|(pair, pose)| {
            metric_pose(pose, pair.query.center, pair.reference.cloud.center, pair.reference.radius)
        })
        .collect();
    out.poses("pred_", metric.iter());
    Ok(out)
}

/// Colour features and structure embedding of one side.
fn side<'a>(
    out: &mut Computed,
    model: &UnoPose,
    config: &ModelConfig,
    pairs: &[Pair],
    [letter, number, word]: [&'a str; 3],
    device: &Device,
) -> Result<Side<'a>, VerifyError> {
    let (batch, side) = (pairs.len(), config.image_size);
    let pick = if letter == "m" { SIDES[0].1 } else { SIDES[1].1 };
    let inputs: Vec<_> = pairs.iter().map(pick).collect();
    let cloud = CloudTensors::from_clouds(&inputs, config, device);
    // The points' pixels and the stored lattice in one pass.
    let axis = |first: usize| (first..side).step_by(STRIDE);
    let lattice: Vec<u32> =
        axis(FIRST[0]).flat_map(|row| axis(FIRST[1]).map(move |col| (row * side + col) as u32)).collect();
    let pixels: Vec<Vec<u32>> = inputs.iter().map(|c| [&c.choose[..], &lattice].concat()).collect();
    let choice = PixelChoice::new(pixels.iter().map(Vec::as_slice));
    let sampled = model.feature_extraction.forward(cloud.view.images.clone(), &choice); // [B, N + lattice, C]
    let [_, total, width] = sampled.dims();
    let n = total - lattice.len();
    let dense = sampled.clone().slice([0..batch, 0..n]);
    let (rows, columns) = (axis(FIRST[0]).count(), axis(FIRST[1]).count());
    let map = sampled.slice([0..batch, n..total]).swap_dims(1, 2).reshape([batch, width, rows, columns]);
    out.tensor(format!("upfeat_{word}_s16"), map)?;
    if let Some(vit) = &model.feature_extraction.rgb_net.vit {
        out.tensor(format!("cls_{word}"), vit.forward(cloud.view.images.clone()).class_token)?;
    }
    out.tensor(format!("dense_f{letter}"), dense.clone())?;
    let cloud = model.encode_structure(&cloud.structure, &cloud.rows, dense);
    out.tensor(format!("geo_embedding_{letter}"), cloud.embedding.clone())?;
    let sparse = rows_of(cloud.dense.clone(), &cloud.rows.points);
    out.tensor(format!("sparse_f{letter}"), sparse)?;
    Ok(Side { cloud, letter, number })
}

/// `[B, N, C]` and flattened row indices to `[B, M, C]`.
fn rows_of(x: Tensor<3>, rows: &Tensor<1, Int>) -> Tensor<3> {
    let [batch, n, width] = x.dims();
    let m = rows.dims()[0] / batch;
    x.reshape([batch * n, width]).select(0, rows.clone()).reshape([batch, m, width])
}

/// Projected features with the background token in front `[B, 1 + N, C]`.
fn tokens(
    project: &Linear,
    background: &Param<Tensor<3>>,
    x: Tensor<3>,
    extra: Option<Tensor<3>>,
) -> Tensor<3> {
    let x = project.forward(x);
    let x = match extra {
        Some(extra) => x + extra,
        None => x,
    };
    let [batch, _, width] = x.dims();
    Tensor::cat(vec![background.val().expand([batch, 1, width]), x], 1)
}

fn coarse(
    out: &mut Computed,
    model: &UnoPose,
    query: &Side<'_>,
    reference: &Side<'_>,
) -> Result<BlockOutput, VerifyError> {
    let stage = &model.coarse_point_matching;
    let [mut q, mut p] = [query, reference].map(|side| {
        let sparse = rows_of(side.cloud.dense.clone(), &side.cloud.rows.points);
        tokens(&stage.in_proj, &stage.bg_token, sparse, None)
    });
    for (index, block) in stage.transformers.iter().enumerate() {
        (q, p) = block.forward(q, query.cloud.embedding.clone(), p, reference.cloud.embedding.clone());
        out.tensor(format!("coarse_block{index}_f{}", query.number), q.clone())?;
        out.tensor(format!("coarse_block{index}_f{}", reference.number), p.clone())?;
    }
    out.tensor("coarse_out1_0", stage.out_proj.forward(q))?;
    out.tensor("coarse_out2_0", stage.out_proj.forward(p))?;
    let outputs = model.coarse(&query.cloud, &reference.cloud, Supervision::LastBlock);
    let block = outputs.into_iter().next_back().ok_or(VerifyError::Part("coarse transformer block"))?;
    out.tensor("coarse_sim0", block.similarity.clone())?;
    out.tensor("coarse_scores", Tensor::cat(block.overlap_probability().to_vec(), 1))?;
    Ok(block)
}

/// One assignment per pair from a block's similarities and overlaps.
fn assignments(
    block: &BlockOutput,
    config: &ModelConfig,
    split_at_reference: bool,
) -> Result<Vec<Assignment>, VerifyError> {
    let matched = host_assignments(block.clone(), config.overlap, split_at_reference)?;
    Ok(matched.into_iter().map(|matched| matched.assignment).collect())
}

/// Fine stage from the initial poses; gives the solved poses in matching frames.
fn fine(
    out: &mut Computed,
    model: &UnoPose,
    config: &ModelConfig,
    pairs: &[Pair],
    [query, reference]: [&Side<'_>; 2],
    (stored, initial): (&ReferenceTensors, &[CoarsePose]),
    device: &Device,
) -> Result<Vec<Pose>, VerifyError> {
    let Some(stage) = &model.fine_point_matching else {
        out.items("pred_pose_score", &[], initial.iter().map(|c| [c.score]));
        return Ok(initial.iter().map(|c| c.pose).collect());
    };
    let moved: Vec<Vec<[f32; 3]>> = pairs
        .iter()
        .zip(initial)
        .map(|(pair, coarse)| {
            let t_reference_query = coarse.pose.inverse();
            pair.query.points.iter().map(|p| t_reference_query.transform_f32(p)).collect()
        })
        .collect();
    out.clouds("pe_in_m", moved.iter().map(Vec::as_slice));
    let still: Vec<Vec<[f32; 3]>> = pairs.iter().map(|p| p.reference.cloud.points.clone()).collect();
    let mut positions = Vec::new();
    for (side, clouds) in [(query, &moved), (reference, &still)] {
        for scale in 0..2 {
            let name = format!("pe_sign_count{}_{}", scale + 1, side.letter);
            let (radius, samples) = (config.fine.pe_radii[scale], config.fine.pe_samples[scale]);
            let padding = config.quirks.local_frames_count_padding;
            let counts = clouds
                .iter()
                .flat_map(|points| local_sign_counts(points, radius, samples, padding, HEIGHT_MARGIN));
            let expected = stored.tensors.get(&name).map_or(&[][..], |t| &t.values);
            let counts: Vec<f64> = counts
                .enumerate()
                .map(|(i, ours)| match expected.get(i) {
                    Some(&theirs) if (theirs - ours.count as f64).abs() <= ours.undecided as f64 => theirs,
                    _ => ours.count as f64,
                })
                .collect();
            out.items(name, &[config.fine_points], counts.chunks(config.fine_points).map(<[f64]>::to_vec));
        }
        let groups: Vec<_> = clouds.iter().map(|points| positional_groups(points, config)).collect();
        let position = stage.position(&group_tensors(&groups.iter().collect::<Vec<_>>(), config, device));
        out.tensor(format!("pe_{}", side.letter), position.clone())?;
        positions.push((side, position));
    }

    let dense: Vec<DenseTokens> = positions
        .iter()
        .map(|(side, position)| DenseTokens {
            features: tokens(
                &stage.in_proj,
                &stage.bg_token,
                side.cloud.dense.clone(),
                Some(position.clone()),
            ),
            sparse_rows: side.cloud.rows.tokens.clone(),
            embedding: side.cloud.embedding.clone(),
            attended: None,
        })
        .collect();
    let Ok([mut q, mut p]) = <[DenseTokens; 2]>::try_from(dense) else {
        return Err(VerifyError::Part("second cloud"));
    };
    for (index, block) in stage.transformers.iter().enumerate() {
        (q, p) = block.forward(q, p);
        out.tensor(format!("fine_block{index}_f{}", query.number), q.features.clone())?;
        out.tensor(format!("fine_block{index}_f{}", reference.number), p.features.clone())?;
    }
    out.tensor("fine_out1_0", stage.out_proj.forward(q.features))?;
    out.tensor("fine_out2_0", stage.out_proj.forward(p.features))?;

    let [at_query, at_reference] = [0, 1]
        .map(|i| EncodedCloud { position: Some(positions[i].1.clone()), ..positions[i].0.cloud.clone() });
    let blocks = model.fine(&at_query, &at_reference, Supervision::LastBlock);
    let block = blocks.last().ok_or(VerifyError::Part("fine transformer block"))?;
    out.tensor("fine_sim0", block.similarity.clone())?;
    out.tensor("fine_scores", Tensor::cat(block.overlap_probability().to_vec(), 1))?;
    let matched = assignments(block, config, false)?;
    let solved: Vec<_> = pairs
        .iter()
        .zip(&matched)
        .map(|(pair, a)| fine_pose(a, &pair.query.points, &pair.reference.cloud.points))
        .collect();
    let n = config.fine_points;
    out.poses("finepose.", solved.iter().map(|s| &s.pose));
    out.items("finepose.score", &[], solved.iter().map(|s| [s.score]));
    out.items("pred_pose_score", &[], solved.iter().map(|s| [s.score]));
    out.items("finepose.assign_weight", &[n], solved.iter().map(|s| s.weights.clone()));
    out.items("finepose.nn_dis", &[n], solved.iter().map(|s| s.distances.clone()));
    out.clouds("finepose.pred_pts", solved.iter().map(|s| s.predicted.as_slice()));
    out.items("finepose.label1", &[n], matched.iter().map(|a| a.label_query.clone()));
    out.items("finepose.label2", &[n], matched.iter().map(|a| a.label_reference.clone()));
    Ok(solved.iter().map(|s| s.pose).collect())
}
