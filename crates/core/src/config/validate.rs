//! Ranges that the types do not express.

use std::fmt::Display;

use super::{
    ColorConfig, Config, ConfigError, DataConfig, LossConfig, MatchingConfig, ModelConfig, TrainConfig,
};

/// Checks every range of the tree; the error names the first field that is outside.
pub(super) fn validate(config: &Config) -> Result<(), ConfigError> {
    let name_ok = !config.name.is_empty() && !config.name.contains(['/', '\\']) && config.name != "..";
    require("name", &config.name, name_ok, "a folder name")?;
    // TOML integers are signed.
    require("seed", config.seed, i64::try_from(config.seed).is_ok(), "at most 9223372036854775807")?;
    model(&config.model)?;
    data(&config.data)?;
    loss(&config.loss)?;
    train(&config.train)
}

pub(super) fn require(
    field: &str,
    value: impl Display,
    holds: bool,
    expected: &str,
) -> Result<(), ConfigError> {
    if holds {
        return Ok(());
    }
    Err(ConfigError::Range { field: field.into(), value: value.to_string(), expected: expected.into() })
}

fn at_least(field: &str, value: usize, minimum: usize) -> Result<(), ConfigError> {
    require(field, value, value >= minimum, &format!("at least {minimum}"))
}

fn positive(field: &str, value: f64) -> Result<(), ConfigError> {
    require(field, value, value.is_finite() && value > 0.0, "a finite number above 0")
}

fn not_negative(field: &str, value: f64) -> Result<(), ConfigError> {
    require(field, value, value.is_finite() && value >= 0.0, "a finite number of at least 0")
}

fn model(m: &ModelConfig) -> Result<(), ConfigError> {
    at_least("model.image_size", m.image_size, 8)?;
    at_least("model.coarse_points", m.coarse_points, 4)?;
    at_least("model.fine_points", m.fine_points, m.coarse_points)?;
    at_least("model.reference_points", m.reference_points, m.fine_points)?;
    not_negative("model.reference_reach", m.reference_reach.into())?;
    color(&m.color, m.image_size)?;
    let g = &m.geo_embedding;
    positive("model.geo_embedding.sigma_d", g.sigma_d.into())?;
    positive("model.geo_embedding.sigma_a", g.sigma_a.into())?;
    require(
        "model.geo_embedding.angle_k",
        g.angle_k,
        (1..m.coarse_points).contains(&g.angle_k),
        "at least 1 and below model.coarse_points",
    )?;
    require(
        "model.geo_embedding.hidden_dim",
        g.hidden_dim,
        g.hidden_dim >= 2 && g.hidden_dim.is_multiple_of(2),
        "an even number of at least 2 (sine and cosine pairs)",
    )?;
    matching("model.coarse", &m.coarse, g.hidden_dim)?;
    matching("model.fine.matching", &m.fine.matching, g.hidden_dim)?;
    for (i, (&radius, &samples)) in m.fine.pe_radii.iter().zip(&m.fine.pe_samples).enumerate() {
        positive(&format!("model.fine.pe_radii[{i}]"), radius.into())?;
        at_least(&format!("model.fine.pe_samples[{i}]"), samples, 1)?;
    }
    for (i, &channels) in m.fine.pe_channels.iter().enumerate() {
        at_least(&format!("model.fine.pe_channels[{i}]"), channels, 1)?;
    }
    positive("model.fine.focusing_factor", m.fine.focusing_factor.into())?;
    let h = &m.hypotheses;
    at_least("model.hypotheses.kept", h.kept, 1)?;
    at_least("model.hypotheses.proposals", h.proposals, h.kept)?;
    positive("model.hypotheses.power", h.power.into())
}

fn color(c: &ColorConfig, image_size: usize) -> Result<(), ConfigError> {
    match c {
        ColorConfig::Vit(v) => {
            at_least("model.color.depth", v.depth, 4)?;
            at_least("model.color.heads", v.heads, 1)?;
            at_least("model.color.out_dim", v.out_dim, 1)?;
            at_least("model.color.patch_size", v.patch_size, 1)?;
            let whole = v.embed_dim > 0 && v.embed_dim.is_multiple_of(v.heads);
            require("model.color.embed_dim", v.embed_dim, whole, "a multiple of model.color.heads")?;
            let tiles = image_size.is_multiple_of(v.patch_size);
            require("model.image_size", image_size, tiles, "a multiple of model.color.patch_size")
        }
        ColorConfig::Conv { channels, out_dim } => {
            at_least("model.color.out_dim", *out_dim, 1)?;
            let quarters = image_size.is_multiple_of(4);
            require("model.image_size", image_size, quarters, "a multiple of 4")?;
            channels
                .iter()
                .enumerate()
                .try_for_each(|(i, &c)| at_least(&format!("model.color.channels[{i}]"), c, 1))
        }
        ColorConfig::None { out_dim } => at_least("model.color.out_dim", *out_dim, 1),
    }
}

fn matching(prefix: &str, m: &MatchingConfig, embedding_dim: usize) -> Result<(), ConfigError> {
    at_least(&format!("{prefix}.blocks"), m.blocks, 1)?;
    at_least(&format!("{prefix}.heads"), m.heads, 1)?;
    at_least(&format!("{prefix}.out_dim"), m.out_dim, 1)?;
    require(
        &format!("{prefix}.hidden_dim"),
        m.hidden_dim,
        m.hidden_dim == embedding_dim,
        &format!("model.geo_embedding.hidden_dim = {embedding_dim}"),
    )?;
    require(
        &format!("{prefix}.heads"),
        m.heads,
        m.hidden_dim.is_multiple_of(m.heads),
        &format!("a divisor of {prefix}.hidden_dim = {}", m.hidden_dim),
    )?;
    positive(&format!("{prefix}.temperature"), m.temperature.into())
}

fn data(d: &DataConfig) -> Result<(), ConfigError> {
    let share = |field: &str, value: f64| require(field, value, (0.0..=1.0).contains(&value), "in [0, 1]");
    share("data.min_visible_fraction", d.min_visible_fraction.into())?;
    share("data.min_overlap", d.min_overlap)?;
    share("data.augmentation.color_probability", d.augmentation.color_probability)?;
    share("data.augmentation.dilation_probability", d.augmentation.dilation_probability)?;
    let listed = (0.8..=1.0).contains(&d.min_reference_visible_fraction);
    require("data.min_reference_visible_fraction", d.min_reference_visible_fraction, listed, "in [0.8, 1]")?;
    let angle = d.max_rotation_deg > 0.0 && d.max_rotation_deg <= 180.0;
    require("data.max_rotation_deg", d.max_rotation_deg, angle, "above 0 and at most 180")?;
    positive("data.overlap_distance", d.overlap_distance.into())?;
    not_negative("data.augmentation.query_shift", d.augmentation.query_shift)?;
    not_negative("data.augmentation.query_noise", d.augmentation.query_noise)?;
    let noise = &d.pose_noise;
    at_least("data.pose_noise.rotation_std_deg (entries)", noise.rotation_std_deg.len(), 1)?;
    noise
        .rotation_std_deg
        .iter()
        .enumerate()
        .try_for_each(|(i, &std)| not_negative(&format!("data.pose_noise.rotation_std_deg[{i}]"), std))?;
    not_negative("data.pose_noise.max_rotation_deg", noise.max_rotation_deg)?;
    not_negative("data.pose_noise.translation_std", noise.translation_std)?;
    not_negative("data.pose_noise.max_translation", noise.max_translation)
}

fn loss(l: &LossConfig) -> Result<(), ConfigError> {
    positive("loss.match_distance", l.match_distance.into())?;
    positive("loss.overlap_distance", l.overlap_distance.into())?;
    positive("loss.clamp", l.clamp.into())?;
    not_negative("loss.saliency_weight", l.saliency_weight.into())?;
    not_negative("loss.overlap_weight", l.overlap_weight.into())?;
    not_negative("loss.correspondence_weight", l.correspondence_weight.into())
}

fn train(t: &TrainConfig) -> Result<(), ConfigError> {
    require("train.steps", t.steps, t.steps >= 1, "at least 1")?;
    at_least("train.batch_size", t.batch_size, 1)?;
    at_least("train.accumulation", t.accumulation, 1)?;
    at_least("train.validation_pairs", t.validation_pairs, 1)?;
    at_least("train.validation_images", t.validation_images, 2)?;
    at_least("train.prefetch", t.prefetch, 1)?;
    positive("train.learning_rate", t.learning_rate)?;
    positive("train.epsilon", t.epsilon.into())?;
    for (i, &beta) in t.betas.iter().enumerate() {
        require(&format!("train.betas[{i}]"), beta, (0.0..1.0).contains(&beta), "in [0, 1)")?;
    }
    let before_end = t.warmup_steps < t.steps;
    require("train.warmup_steps", t.warmup_steps, before_end, "fewer than train.steps")?;
    let share = (0.0..=1.0).contains(&t.warmup_factor);
    require("train.warmup_factor", t.warmup_factor, share, "in [0, 1]")?;
    not_negative("train.clip_norm", t.clip_norm)?;
    require("train.ema_decay", t.ema_decay, (0.0..1.0).contains(&t.ema_decay), "in [0, 1)")?;
    require("train.validate_every", t.validate_every, t.validate_every >= 1, "at least 1")?;
    not_negative("train.validate_minutes", t.validate_minutes)?;
    positive("train.checkpoint_seconds", t.checkpoint_seconds)
}
