//! The pairs stored in a file of reference tensors.

use unopose_core::config::{ColorConfig, ModelConfig};
use unopose_pairs::data::{CloudInput, PreparedReference, query_from_points, reference_from_points};

use super::{ReferenceTensors, VerifyError};

/// Names of tensors that are read, not computed; in training files the initial pose is one of them.
pub(super) const INPUTS: [&str; 9] = [
    "pts",
    "rgb",
    "rgb_choose",
    "tem1_pts",
    "tem1_rgb",
    "tem1_choose",
    "rotation_label",
    "translation_label",
    "uniform",
];

/// One pair as it is stored and as the network takes it.
pub(super) struct Pair {
    /// Metres, camera frame.
    pub query_points: Vec<[f32; 3]>,
    /// Metres, camera frame, before farthest point sampling.
    pub reference_points: Vec<[f32; 3]>,
    pub query: CloudInput,
    pub reference: PreparedReference,
}

/// `config` with the sizes that only the tensors have: points of the reference, side of the crop.
pub fn fit_config(config: &ModelConfig, tensors: &ReferenceTensors) -> Result<ModelConfig, VerifyError> {
    let mut config = config.clone();
    let rgb = tensors.shape("rgb", 4)?;
    if rgb[1] != 3 || rgb[2] != rgb[3] {
        return Err(tensors.error("rgb", format!("has shape {rgb:?}, expected [B, 3, S, S]")));
    }
    let side = rgb[2];
    if let ColorConfig::Vit(vit) = &config.color
        && !side.is_multiple_of(vit.patch_size)
    {
        let message = format!("has side {side}, expected a multiple of the patch size {}", vit.patch_size);
        return Err(tensors.error("rgb", message));
    }
    config.image_size = side;
    config.reference_points = tensors.shape("tem1_pts", 3)?[1];
    let n = tensors.shape("pts", 3)?[1];
    size("model.fine_points", config.fine_points, n, "pts")?;
    if config.reference_points < config.fine_points {
        return Err(VerifyError::Size {
            field: "model.fine_points",
            configured: config.fine_points,
            found: config.reference_points,
            tensor: "tem1_pts, which needs at least as many",
        });
    }
    for (name, tensor) in [("fps_idx_m", "fps_idx_m"), ("coarse_p1", "coarse_p1")] {
        if let Some(stored) = tensors.tensors.get(name).and_then(|t| t.shape.get(1)) {
            size("model.coarse_points", config.coarse_points, *stored, tensor)?;
        }
    }
    if tensors.contains("uniform") {
        let uniform = tensors.shape("uniform", 2)?[1];
        size("3 x model.hypotheses.proposals", 3 * config.hypotheses.proposals, uniform, "uniform")?;
    }
    Ok(config)
}

/// Sizes of points and hypotheses as the tensors have them, for weights that come without a configuration.
pub fn guess_config(config: &mut ModelConfig, tensors: &ReferenceTensors) {
    let axis = |name: &str, axis: usize| tensors.tensors.get(name).and_then(|t| t.shape.get(axis).copied());
    let set = |field: &mut usize, value: Option<usize>| *field = value.unwrap_or(*field);
    set(&mut config.fine_points, axis("pts", 1));
    set(&mut config.coarse_points, axis("fps_idx_m", 1).or(axis("coarse_p1", 1)));
    set(&mut config.hypotheses.proposals, axis("uniform", 1).map(|n| n / 3));
    set(&mut config.hypotheses.kept, axis("hyp.topk_idx", 1));
}

fn size(
    field: &'static str,
    configured: usize,
    found: usize,
    tensor: &'static str,
) -> Result<(), VerifyError> {
    if configured == found {
        return Ok(());
    }
    Err(VerifyError::Size { field, configured, found, tensor })
}

/// All pairs of the file.
pub(super) fn pairs(tensors: &ReferenceTensors, config: &ModelConfig) -> Result<Vec<Pair>, VerifyError> {
    let batch = tensors.shape("pts", 3)?[0];
    let side = config.image_size;
    for name in ["rgb", "tem1_rgb"] {
        let shape = tensors.shape(name, 4)?;
        if shape != [batch, 3, side, side] {
            return Err(
                tensors.error(name, format!("has shape {shape:?}, expected [{batch}, 3, {side}, {side}]"))
            );
        }
    }
    let cloud = |points: &str, choose: &str, b| {
        let p = tensors.points(points, b, batch)?;
        let c = tensors.choose(choose, b, batch, side * side)?;
        if p.len() != c.len() {
            let message =
                format!("has {} pixels, expected one for each of the {} {points}", c.len(), p.len());
            return Err(tensors.error(choose, message));
        }
        Ok((p, c))
    };
    (0..batch)
        .map(|b| {
            let (reference_points, choose) = cloud("tem1_pts", "tem1_choose", b)?;
            let image = tensors.item("tem1_rgb", 4, b, batch)?;
            let reference = reference_from_points(&reference_points, &choose, image, config);
            let (query_points, choose) = cloud("pts", "rgb_choose", b)?;
            let image = tensors.item("rgb", 4, b, batch)?;
            let query = query_from_points(&query_points, &choose, image, reference.radius, config);
            Ok(Pair { query_points, reference_points, query, reference })
        })
        .collect()
}
