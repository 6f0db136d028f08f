//! What the numbers of the tree have to be besides their limits: how they depend on each other, and what their products may
//! be.

use std::fmt::Display;

use super::{
    ColorConfig, Config, ConfigError, DataConfig, MatchingConfig, ModelConfig, SynthConfig, TrainConfig,
    limits::limit_rules,
};

/// Bytes of the batches that are prepared ahead.
const PREPARED_BYTES: f64 = (1u64 << 36) as f64;
/// Pixels of the colour crops of a batch.
const CROP_PIXELS: f64 = (1u64 << 28) as f64;
/// Numbers of the largest tensor of a batch.
const TENSOR_NUMBERS: f64 = (1u64 << 36) as f64;
/// Weights of a stack of transformer blocks, in units of a square matrix of all channels.
const SQUARE_WEIGHTS: f64 = (1u64 << 31) as f64;
/// Patches of a crop in each direction.
const PATCHES: usize = 128;
/// Colour samples of a rendered image.
const IMAGE_SAMPLES: f64 = (1u64 << 27) as f64;
/// Pixels of the images of a shard.
const SHARD_PIXELS: f64 = (1u64 << 33) as f64;
/// Texels of the objects of a shard.
const SHARD_TEXELS: f64 = (1u64 << 32) as f64;
/// Shards of a set; their numbers have six digits.
const SHARDS: f64 = 1e6;

/// What one field has to be, and whether it is.
pub(super) struct Rule {
    /// Dotted path, with `[i]` behind it where the rule is about an entry of a list.
    pub field: String,
    pub value: String,
    pub holds: bool,
    /// What the value has to be, as it follows "expected".
    pub expected: String,
}

/// Checks every rule of the tree; the error names the first field that breaks one.
pub(super) fn validate(config: &Config) -> Result<(), ConfigError> {
    first_broken(rules(config))
}

impl SynthConfig {
    /// Checks every rule of the `[synth]` part alone; the error names the first field that breaks one.
    pub fn check(&self) -> Result<(), ConfigError> {
        let rules = rules(&Config { synth: self.clone(), ..Config::default() });
        first_broken(rules.into_iter().filter(|rule| rule.field.starts_with("synth.")))
    }
}

fn first_broken(rules: impl IntoIterator<Item = Rule>) -> Result<(), ConfigError> {
    match rules.into_iter().find(|rule| !rule.holds) {
        Some(Rule { field, value, expected, .. }) => Err(ConfigError::Range { field, value, expected }),
        None => Ok(()),
    }
}

/// The rules of every field of this configuration, limits of single numbers first.
pub(super) fn rules(config: &Config) -> Vec<Rule> {
    let mut rules = Rules(limit_rules(config));
    let name_ok = !config.name.is_empty() && !config.name.contains(['/', '\\']) && config.name != "..";
    rules.require("name", &config.name, name_ok, "a folder name");
    for (field, seed) in [("seed", config.seed), ("synth.seed", config.synth.seed)] {
        // TOML integers are signed.
        let signed = i64::try_from(seed).is_ok();
        rules.require(field, seed, signed, "at most 9223372036854775807");
    }
    rules.synth(&config.synth);
    rules.model(&config.model);
    rules.data(&config.data);
    for (field, cells) in
        [("proposals.width", config.proposals.width), ("proposals.height", config.proposals.height)]
    {
        rules.require(field, cells, cells.is_multiple_of(16), "a multiple of 16");
    }
    rules.train(&config.train, &config.model);
    rules.0
}

struct Rules(Vec<Rule>);

impl Rules {
    fn require(&mut self, field: &str, value: impl Display, holds: bool, expected: &str) {
        let (field, value, expected) = (field.to_owned(), value.to_string(), expected.to_owned());
        self.0.push(Rule { field, value, holds, expected });
    }

    fn at_least_field(&mut self, field: &str, value: usize, other: &str, minimum: usize) {
        self.require(field, value, value >= minimum, &format!("at least {minimum} ({other})"));
    }

    /// `value` times `others` is at most `most` of `what`.
    fn product(&mut self, field: &str, value: usize, others: f64, most: f64, what: &str) {
        let holds = value as f64 * others <= most;
        self.require(field, value, holds, &format!("so small that {what} at most {most}"));
    }

    fn ordered<T: PartialOrd + std::fmt::Debug>(&mut self, field: &str, [low, high]: [T; 2]) {
        self.require(field, format!("[{low:?}, {high:?}]"), low <= high, "the smaller number first");
    }

    fn synth(&mut self, s: &SynthConfig) {
        let (camera, sensor) = (&s.camera, &s.sensor);
        for (field, range) in [
            ("synth.diameter", s.diameter),
            ("synth.camera.distance", camera.distance),
            ("synth.camera.elevation_deg", camera.elevation_deg),
            ("synth.camera.fill", camera.fill),
            ("synth.camera.focal", camera.focal),
            ("synth.sensor.baseline", sensor.baseline),
            ("synth.sensor.noise_gain", sensor.noise_gain),
            ("synth.sensor.range", sensor.range),
            ("synth.sensor.brightness", sensor.brightness),
        ] {
            self.ordered(field, range);
        }
        self.ordered("synth.objects_per_scene", s.objects_per_scene);
        self.ordered("synth.distractors", s.distractors);
        self.ordered("synth.sensor.jpeg_quality", sensor.jpeg_quality);
        let shares = "at most 1 with synth.bins";
        self.require("synth.shelves", s.shelves, s.bins + s.shelves <= 1.0, shares);
        let (shares, holds) =
            ("at most 1 with synth.sensor.stereo", sensor.stereo + sensor.time_of_flight <= 1.0);
        self.require("synth.sensor.time_of_flight", sensor.time_of_flight, holds, shares);
        let pixels = f64::from(s.width) * f64::from(s.height);
        let supersampling = s.supersampling as usize;
        let samples = pixels * supersampling as f64;
        let what =
            "the colour samples of an image (synth.width x synth.height x synth.supersampling squared) are";
        self.product("synth.supersampling", supersampling, samples, IMAGE_SAMPLES, what);
        let what = "the pixels of a shard (synth.images_per_shard x synth.width x synth.height) are";
        self.product("synth.images_per_shard", s.images_per_shard, pixels, SHARD_PIXELS, what);
        let texels = f64::from(s.texture_size) * s.objects.min(s.objects_per_shard) as f64;
        let what = "the texels of a shard (synth.texture_size squared x synth.objects_per_shard) are";
        self.product("synth.texture_size", s.texture_size as usize, texels, SHARD_TEXELS, what);
        let per_shard = 1.0 / s.images_per_shard as f64;
        let what = "the shards (synth.images / synth.images_per_shard) are";
        self.product("synth.images", s.images, per_shard, SHARDS, what);
    }

    fn model(&mut self, m: &ModelConfig) {
        self.at_least_field("model.fine_points", m.fine_points, "model.coarse_points", m.coarse_points);
        self.at_least_field("model.reference_points", m.reference_points, "model.fine_points", m.fine_points);
        self.color(&m.color, m.image_size);
        let g = &m.geo_embedding;
        let below = g.angle_k < m.coarse_points;
        self.require("model.geo_embedding.angle_k", g.angle_k, below, "below model.coarse_points");
        let even = g.hidden_dim.is_multiple_of(2);
        let expected = "an even number (sine and cosine pairs)";
        self.require("model.geo_embedding.hidden_dim", g.hidden_dim, even, expected);
        self.matching("model.coarse", &m.coarse, g.hidden_dim);
        self.matching("model.fine.matching", &m.fine.matching, g.hidden_dim);
        let h = &m.hypotheses;
        self.at_least_field("model.hypotheses.proposals", h.proposals, "model.hypotheses.kept", h.kept);
    }

    fn color(&mut self, c: &ColorConfig, image_size: usize) {
        match c {
            ColorConfig::Vit(v) => {
                let whole = v.embed_dim.is_multiple_of(v.heads);
                let expected = "a multiple of model.color.heads";
                self.require("model.color.embed_dim", v.embed_dim, whole, expected);
                let expected = "at least 4, the blocks whose tokens are read";
                self.require("model.color.depth", v.depth, v.depth >= 4, expected);
                let what = "model.color.depth x model.color.embed_dim squared is";
                let square = (v.embed_dim as f64).powi(2);
                self.product("model.color.depth", v.depth, square, SQUARE_WEIGHTS, what);
                let tiles = image_size.is_multiple_of(v.patch_size);
                self.require("model.image_size", image_size, tiles, "a multiple of model.color.patch_size");
                let few = image_size / v.patch_size.max(1) <= PATCHES;
                let expected = format!("at most {PATCHES} x model.color.patch_size");
                self.require("model.image_size", image_size, few, &expected);
            }
            ColorConfig::Hybrid(h) => {
                let whole = h.embed_dim.is_multiple_of(h.heads);
                let expected = "a multiple of model.color.heads";
                self.require("model.color.embed_dim", h.embed_dim, whole, expected);
                let what = "model.color.depth x model.color.embed_dim squared is";
                let square = (h.embed_dim as f64).powi(2);
                self.product("model.color.depth", h.depth, square, SQUARE_WEIGHTS, what);
                let tiles = image_size.is_multiple_of(8);
                self.require("model.image_size", image_size, tiles, "a multiple of 8");
                let few = image_size / 8 <= PATCHES;
                let expected = format!("at most {PATCHES} x 8");
                self.require("model.image_size", image_size, few, &expected);
            }
            ColorConfig::Conv { .. } => {
                let quarters = image_size.is_multiple_of(4);
                self.require("model.image_size", image_size, quarters, "a multiple of 4");
            }
            ColorConfig::None { .. } => {}
        }
    }

    fn matching(&mut self, prefix: &str, m: &MatchingConfig, embedding_dim: usize) {
        let expected = format!("model.geo_embedding.hidden_dim = {embedding_dim}");
        let equal = m.hidden_dim == embedding_dim;
        self.require(&format!("{prefix}.hidden_dim"), m.hidden_dim, equal, &expected);
        let expected = format!("a divisor of {prefix}.hidden_dim = {}", m.hidden_dim);
        let whole = m.hidden_dim.is_multiple_of(m.heads);
        self.require(&format!("{prefix}.heads"), m.heads, whole, &expected);
        let what = format!("{prefix}.blocks x {prefix}.hidden_dim squared is");
        let square = (m.hidden_dim as f64).powi(2);
        self.product(&format!("{prefix}.blocks"), m.blocks, square, SQUARE_WEIGHTS, &what);
    }

    fn data(&mut self, d: &DataConfig) {
        let entries = d.pose_noise.rotation_std_deg.len();
        let holds = (1..=1000).contains(&entries);
        self.require("data.pose_noise.rotation_std_deg (entries)", entries, holds, "1 to 1000");
    }

    fn train(&mut self, t: &TrainConfig, m: &ModelConfig) {
        let before_end = t.warmup_steps < t.steps;
        self.require("train.warmup_steps", t.warmup_steps, before_end, "fewer than train.steps");
        let square = |side: f64| side * side;
        let number = |count: usize| count as f64;
        let (channels, crop) = (number(m.geo_embedding.hidden_dim), square(number(m.image_size)));
        let widest = match &m.color {
            ColorConfig::Conv { channels, .. } => number(channels[0]) / 4.0,
            ColorConfig::Vit(v) => number(v.out_dim) / 16.0,
            ColorConfig::Hybrid(h) => number(h.channels[0]) / 4.0,
            ColorConfig::None { .. } => 0.0,
        };
        let neighbours = |i: usize| number(m.fine_points) * number(m.fine.pe_samples[i]);
        let encoded =
            neighbours(0).max(neighbours(1)) * m.fine.pe_channels.map(number).into_iter().fold(0.0, f64::max);
        let pairs = square(number(m.coarse_points) + 1.0);
        let embedded = pairs * (number(m.geo_embedding.angle_k) + 1.0) * channels;
        for (numbers, most, what) in [
            (crop, CROP_PIXELS, "the pixels of its crops (model.image_size squared each) are"),
            (
                crop * widest,
                TENSOR_NUMBERS,
                "the colour features of its crops (model.image_size, model.color) are",
            ),
            (
                square(number(m.fine_points)),
                TENSOR_NUMBERS,
                "its similarities (model.fine_points squared each) are",
            ),
            (
                embedded,
                TENSOR_NUMBERS,
                "its structure embedding (model.coarse_points squared x model.geo_embedding) is",
            ),
            (
                encoded,
                TENSOR_NUMBERS,
                "its positional encoding (model.fine_points x model.fine.pe_samples x model.fine.pe_channels) is",
            ),
        ] {
            self.product("train.batch_size", t.batch_size, numbers, most, what);
        }
        // Two crops of three single-precision channels, two clouds with their neighbourhoods.
        let bytes = 24.0 * crop + 16.0 * (neighbours(0) + neighbours(1)) + 8.0 * pairs;
        let what = "the bytes of prepared batches (train.prefetch x train.batch_size pairs) are";
        self.product("train.prefetch", t.prefetch, t.batch_size as f64 * bytes, PREPARED_BYTES, what);
    }
}
