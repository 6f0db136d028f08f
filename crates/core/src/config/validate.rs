//! Ranges that the types do not express.

use std::fmt::Display;

use super::{
    ColorConfig, Config, ConfigError, DataConfig, LossConfig, MatchingConfig, ModelConfig, TrainConfig,
};

/// What one field has to be, and whether it is.
pub(super) struct Rule {
    /// Dotted path, with `[i]` behind it where the rule is about an entry of a list.
    pub field: String,
    pub value: String,
    pub holds: bool,
    /// What the value has to be, as it follows "expected".
    pub expected: String,
}

/// Checks every range of the tree; the error names the first field that is outside.
pub(super) fn validate(config: &Config) -> Result<(), ConfigError> {
    match rules(config).into_iter().find(|rule| !rule.holds) {
        Some(Rule { field, value, expected, .. }) => Err(ConfigError::Range { field, value, expected }),
        None => Ok(()),
    }
}

/// The rules of every field of this configuration.
pub(super) fn rules(config: &Config) -> Vec<Rule> {
    let mut rules = Rules(Vec::new());
    let name_ok = !config.name.is_empty() && !config.name.contains(['/', '\\']) && config.name != "..";
    rules.require("name", &config.name, name_ok, "a folder name");
    // TOML integers are signed.
    let signed = i64::try_from(config.seed).is_ok();
    rules.require("seed", config.seed, signed, "at most 9223372036854775807");
    rules.model(&config.model);
    rules.data(&config.data);
    rules.loss(&config.loss);
    rules.train(&config.train);
    rules.0
}

struct Rules(Vec<Rule>);

impl Rules {
    fn require(&mut self, field: &str, value: impl Display, holds: bool, expected: &str) {
        let (field, value, expected) = (field.to_owned(), value.to_string(), expected.to_owned());
        self.0.push(Rule { field, value, holds, expected });
    }

    fn at_least(&mut self, field: &str, value: usize, minimum: usize) {
        self.require(field, value, value >= minimum, &format!("at least {minimum}"));
    }

    fn at_least_field(&mut self, field: &str, value: usize, other: &str, minimum: usize) {
        self.require(field, value, value >= minimum, &format!("at least {minimum} ({other})"));
    }

    fn positive(&mut self, field: &str, value: f64) {
        self.require(field, value, value.is_finite() && value > 0.0, "a finite number above 0");
    }

    fn not_negative(&mut self, field: &str, value: f64) {
        self.require(field, value, value.is_finite() && value >= 0.0, "a finite number of at least 0");
    }

    fn share(&mut self, field: &str, value: f64) {
        self.require(field, value, (0.0..=1.0).contains(&value), "in [0, 1]");
    }

    fn model(&mut self, m: &ModelConfig) {
        self.at_least("model.image_size", m.image_size, 8);
        self.at_least("model.coarse_points", m.coarse_points, 4);
        self.at_least_field("model.fine_points", m.fine_points, "model.coarse_points", m.coarse_points);
        self.at_least_field("model.reference_points", m.reference_points, "model.fine_points", m.fine_points);
        self.not_negative("model.reference_reach", m.reference_reach.into());
        self.color(&m.color, m.image_size);
        let g = &m.geo_embedding;
        self.positive("model.geo_embedding.sigma_d", g.sigma_d.into());
        self.positive("model.geo_embedding.sigma_a", g.sigma_a.into());
        let below = (1..m.coarse_points).contains(&g.angle_k);
        let expected = "at least 1 and below model.coarse_points";
        self.require("model.geo_embedding.angle_k", g.angle_k, below, expected);
        let even = g.hidden_dim >= 2 && g.hidden_dim.is_multiple_of(2);
        let expected = "an even number of at least 2 (sine and cosine pairs)";
        self.require("model.geo_embedding.hidden_dim", g.hidden_dim, even, expected);
        self.matching("model.coarse", &m.coarse, g.hidden_dim);
        self.matching("model.fine.matching", &m.fine.matching, g.hidden_dim);
        for (i, (&radius, &samples)) in m.fine.pe_radii.iter().zip(&m.fine.pe_samples).enumerate() {
            self.positive(&format!("model.fine.pe_radii[{i}]"), radius.into());
            self.at_least(&format!("model.fine.pe_samples[{i}]"), samples, 1);
        }
        for (i, &channels) in m.fine.pe_channels.iter().enumerate() {
            self.at_least(&format!("model.fine.pe_channels[{i}]"), channels, 1);
        }
        self.positive("model.fine.focusing_factor", m.fine.focusing_factor.into());
        let h = &m.hypotheses;
        self.at_least("model.hypotheses.kept", h.kept, 1);
        self.at_least_field("model.hypotheses.proposals", h.proposals, "model.hypotheses.kept", h.kept);
        self.positive("model.hypotheses.power", h.power.into());
        self.at_least("model.hypotheses.starts", h.starts, 1);
    }

    fn color(&mut self, c: &ColorConfig, image_size: usize) {
        match c {
            ColorConfig::Vit(v) => {
                self.at_least("model.color.depth", v.depth, 4);
                self.at_least("model.color.heads", v.heads, 1);
                self.at_least("model.color.out_dim", v.out_dim, 1);
                self.at_least("model.color.patch_size", v.patch_size, 1);
                let whole = v.embed_dim > 0 && v.embed_dim.is_multiple_of(v.heads);
                let expected = "a multiple of model.color.heads";
                self.require("model.color.embed_dim", v.embed_dim, whole, expected);
                let tiles = image_size.is_multiple_of(v.patch_size);
                self.require("model.image_size", image_size, tiles, "a multiple of model.color.patch_size");
            }
            ColorConfig::Conv { channels, out_dim } => {
                self.at_least("model.color.out_dim", *out_dim, 1);
                let quarters = image_size.is_multiple_of(4);
                self.require("model.image_size", image_size, quarters, "a multiple of 4");
                for (i, &channels) in channels.iter().enumerate() {
                    self.at_least(&format!("model.color.channels[{i}]"), channels, 1);
                }
            }
            ColorConfig::None { out_dim } => self.at_least("model.color.out_dim", *out_dim, 1),
        }
    }

    fn matching(&mut self, prefix: &str, m: &MatchingConfig, embedding_dim: usize) {
        self.at_least(&format!("{prefix}.blocks"), m.blocks, 1);
        self.at_least(&format!("{prefix}.heads"), m.heads, 1);
        self.at_least(&format!("{prefix}.out_dim"), m.out_dim, 1);
        let expected = format!("model.geo_embedding.hidden_dim = {embedding_dim}");
        let equal = m.hidden_dim == embedding_dim;
        self.require(&format!("{prefix}.hidden_dim"), m.hidden_dim, equal, &expected);
        let expected = format!("a divisor of {prefix}.hidden_dim = {}", m.hidden_dim);
        let whole = m.hidden_dim.is_multiple_of(m.heads);
        self.require(&format!("{prefix}.heads"), m.heads, whole, &expected);
        self.positive(&format!("{prefix}.temperature"), m.temperature.into());
    }

    fn data(&mut self, d: &DataConfig) {
        self.share("data.min_visible_fraction", d.min_visible_fraction.into());
        self.share("data.min_overlap", d.min_overlap);
        self.share("data.augmentation.color_probability", d.augmentation.color_probability);
        self.share("data.augmentation.dilation_probability", d.augmentation.dilation_probability);
        let share = d.min_reference_visible_fraction;
        let listed = (0.8..=1.0).contains(&share);
        self.require("data.min_reference_visible_fraction", share, listed, "in [0.8, 1]");
        let angle = d.max_rotation_deg > 0.0 && d.max_rotation_deg <= 180.0;
        self.require("data.max_rotation_deg", d.max_rotation_deg, angle, "above 0 and at most 180");
        self.positive("data.overlap_distance", d.overlap_distance.into());
        self.not_negative("data.augmentation.query_shift", d.augmentation.query_shift);
        self.not_negative("data.augmentation.query_noise", d.augmentation.query_noise);
        let noise = &d.pose_noise;
        self.at_least("data.pose_noise.rotation_std_deg (entries)", noise.rotation_std_deg.len(), 1);
        for (i, &std) in noise.rotation_std_deg.iter().enumerate() {
            self.not_negative(&format!("data.pose_noise.rotation_std_deg[{i}]"), std);
        }
        self.not_negative("data.pose_noise.max_rotation_deg", noise.max_rotation_deg);
        self.not_negative("data.pose_noise.translation_std", noise.translation_std);
        self.not_negative("data.pose_noise.max_translation", noise.max_translation);
    }

    fn loss(&mut self, l: &LossConfig) {
        self.positive("loss.match_distance", l.match_distance.into());
        self.positive("loss.overlap_distance", l.overlap_distance.into());
        self.positive("loss.clamp", l.clamp.into());
        self.not_negative("loss.saliency_weight", l.saliency_weight.into());
        self.not_negative("loss.overlap_weight", l.overlap_weight.into());
        self.not_negative("loss.correspondence_weight", l.correspondence_weight.into());
    }

    fn train(&mut self, t: &TrainConfig) {
        self.require("train.steps", t.steps, t.steps >= 1, "at least 1");
        self.at_least("train.batch_size", t.batch_size, 1);
        self.at_least("train.accumulation", t.accumulation, 1);
        self.at_least("train.validation_pairs", t.validation_pairs, 1);
        self.at_least("train.validation_images", t.validation_images, 2);
        self.at_least("train.prefetch", t.prefetch, 1);
        self.positive("train.learning_rate", t.learning_rate);
        self.positive("train.epsilon", t.epsilon.into());
        for (i, &beta) in t.betas.iter().enumerate() {
            self.require(&format!("train.betas[{i}]"), beta, (0.0..1.0).contains(&beta), "in [0, 1)");
        }
        let before_end = t.warmup_steps < t.steps;
        self.require("train.warmup_steps", t.warmup_steps, before_end, "fewer than train.steps");
        self.share("train.warmup_factor", t.warmup_factor);
        self.not_negative("train.clip_norm", t.clip_norm);
        self.require("train.ema_decay", t.ema_decay, (0.0..1.0).contains(&t.ema_decay), "in [0, 1)");
        self.require("train.validate_every", t.validate_every, t.validate_every >= 1, "at least 1");
        self.not_negative("train.validate_minutes", t.validate_minutes);
        self.positive("train.checkpoint_seconds", t.checkpoint_seconds);
    }
}
