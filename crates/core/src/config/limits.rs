//! The limits of every number of the tree, wide enough for any real use: what lies beyond them would run for years, take
//! more memory than there is, or overflow.

use std::ops::{
    Bound::{self, Excluded, Included},
    RangeBounds as _,
};

use serde_json::Value;

use super::{Config, schema::join, validate::Rule};

/// Most threads of a program or of the preparation of data.
pub const MAX_THREADS: u16 = 1024;

type Limit = (Bound<f64>, Bound<f64>);

const fn within(low: f64, high: f64) -> Limit {
    (Included(low), Included(high))
}

const fn above(low: f64, high: f64) -> Limit {
    (Excluded(low), Included(high))
}

const fn below(low: f64, high: f64) -> Limit {
    (Included(low), Excluded(high))
}

const SHARE: Limit = within(0.0, 1.0);
/// Channels of a layer.
const CHANNELS: Limit = within(1.0, 8192.0);

/// By dotted path; the numbers of a list have one limit. Seeds are not in it.
const LIMITS: &[(&str, Limit)] = &[
    ("synth.images", within(1.0, 1e8)),
    ("synth.images_per_shard", within(1.0, 1e5)),
    ("synth.objects", within(1.0, 1e6)),
    ("synth.objects_per_shard", within(1.0, 1e4)),
    ("synth.width", within(16.0, 4096.0)),
    ("synth.height", within(16.0, 4096.0)),
    ("synth.supersampling", within(1.0, 8.0)),
    ("synth.indirect_rays", within(0.0, 1024.0)),
    ("synth.views_per_scene", within(1.0, 1e4)),
    ("synth.objects_per_scene", within(0.0, 200.0)),
    ("synth.distractors", within(0.0, 200.0)),
    ("synth.bins", SHARE),
    ("synth.shelves", SHARE),
    ("synth.diameter", within(1e-3, 10.0)),
    ("synth.texture_size", within(32.0, 4096.0)),
    ("synth.textureless", SHARE),
    ("synth.printed", SHARE),
    ("synth.tumbling", SHARE),
    ("synth.mesh_scale", within(1e-9, 1e6)),
    ("synth.mesh_share", SHARE),
    ("synth.camera.distance", within(1e-2, 100.0)),
    ("synth.camera.elevation_deg", within(0.0, 90.0)),
    ("synth.camera.roll_deg", within(0.0, 360.0)),
    ("synth.camera.fill", within(1e-2, 100.0)),
    ("synth.camera.focal", within(0.1, 50.0)),
    ("synth.sensor.stereo", SHARE),
    ("synth.sensor.time_of_flight", SHARE),
    ("synth.sensor.baseline", within(1e-3, 10.0)),
    ("synth.sensor.disparity_noise", within(0.0, 100.0)),
    ("synth.sensor.noise_gain", within(1e-6, 1e3)),
    ("synth.sensor.disparity_steps", within(0.0, 1e6)),
    ("synth.sensor.tof_noise", within(0.0, 10.0)),
    ("synth.sensor.tof_offset", within(0.0, 10.0)),
    ("synth.sensor.edge_jitter", within(0.0, 100.0)),
    ("synth.sensor.edge_loss", SHARE),
    ("synth.sensor.grazing_cos", SHARE),
    ("synth.sensor.dark_loss", SHARE),
    ("synth.sensor.shiny_loss", SHARE),
    ("synth.sensor.speckle_loss", SHARE),
    ("synth.sensor.flying", SHARE),
    ("synth.sensor.range", within(0.0, 1e3)),
    ("synth.sensor.misalignment", within(0.0, 100.0)),
    ("synth.sensor.color_noise", within(0.0, 255.0)),
    ("synth.sensor.blur", within(0.0, 100.0)),
    ("synth.sensor.brightness", SHARE),
    ("synth.sensor.white_balance", SHARE),
    ("synth.sensor.tone", SHARE),
    ("synth.sensor.jpeg_quality", within(1.0, 100.0)),
    ("data.min_visible_fraction", SHARE),
    ("data.min_visible_pixels", within(0.0, 1e9)),
    // Index files of datasets list references from 0.8.
    ("data.min_reference_visible_fraction", within(0.8, 1.0)),
    ("data.max_rotation_deg", above(0.0, 180.0)),
    ("data.min_overlap", SHARE),
    ("data.overlap_distance", above(0.0, 1e6)),
    ("data.cache_mib", within(0.0, 4_194_304.0)),
    ("data.augmentation.color_probability", SHARE),
    ("data.augmentation.dilation_probability", SHARE),
    ("data.augmentation.dilation_iterations", within(0.0, 4096.0)),
    ("data.augmentation.query_shift", within(0.0, 10.0)),
    ("data.augmentation.query_noise", within(0.0, 10.0)),
    ("data.pose_noise.rotation_std_deg", within(0.0, 360.0)),
    ("data.pose_noise.max_rotation_deg", within(0.0, 360.0)),
    ("data.pose_noise.translation_std", within(0.0, 100.0)),
    ("data.pose_noise.max_translation", within(0.0, 100.0)),
    ("model.image_size", within(8.0, 2048.0)),
    ("model.reference_points", within(4.0, 1e6)),
    ("model.reference_reach", within(0.0, 1e6)),
    ("model.fine_points", within(4.0, 32_768.0)),
    ("model.coarse_points", within(4.0, 4096.0)),
    ("model.color.embed_dim", CHANNELS),
    ("model.color.depth", within(1.0, 128.0)),
    ("model.color.heads", within(1.0, 128.0)),
    ("model.color.patch_size", within(1.0, 128.0)),
    ("model.color.register_tokens", within(0.0, 1024.0)),
    ("model.color.channels", CHANNELS),
    ("model.color.out_dim", CHANNELS),
    ("model.geo_embedding.sigma_d", within(1e-6, 1e6)),
    ("model.geo_embedding.sigma_a", within(1e-6, 1e6)),
    ("model.geo_embedding.angle_k", within(1.0, 1024.0)),
    ("model.geo_embedding.hidden_dim", CHANNELS),
    ("model.coarse.blocks", within(1.0, 64.0)),
    ("model.coarse.heads", within(1.0, 128.0)),
    ("model.coarse.hidden_dim", CHANNELS),
    ("model.coarse.out_dim", CHANNELS),
    ("model.coarse.temperature", within(1e-6, 1e6)),
    ("model.fine.matching.blocks", within(1.0, 64.0)),
    ("model.fine.matching.heads", within(1.0, 128.0)),
    ("model.fine.matching.hidden_dim", CHANNELS),
    ("model.fine.matching.out_dim", CHANNELS),
    ("model.fine.matching.temperature", within(1e-6, 1e6)),
    ("model.fine.pe_radii", within(1e-6, 1e6)),
    ("model.fine.pe_samples", within(1.0, 8192.0)),
    ("model.fine.pe_channels", CHANNELS),
    ("model.fine.focusing_factor", above(0.0, 100.0)),
    ("model.hypotheses.proposals", within(1.0, 1e6)),
    ("model.hypotheses.kept", within(1.0, 1e6)),
    ("model.hypotheses.power", above(0.0, 100.0)),
    ("model.hypotheses.color_weight", within(0.0, 100.0)),
    ("model.hypotheses.feature_weight", within(0.0, 100.0)),
    ("model.hypotheses.free_space_weight", within(0.0, 100.0)),
    ("model.hypotheses.starts", within(1.0, 100.0)),
    ("model.hypotheses.turns", within(0.0, 100.0)),
    ("loss.match_distance", above(0.0, 1e9)),
    ("loss.overlap_distance", above(0.0, 1e9)),
    ("loss.saliency_weight", within(0.0, 1e6)),
    ("loss.overlap_weight", within(0.0, 1e6)),
    ("loss.correspondence_weight", within(0.0, 1e6)),
    ("loss.kept_structure_weight", within(0.0, 1e6)),
    ("loss.clamp", above(0.0, 1e9)),
    ("distil.teacher_image_size", within(8.0, 2048.0)),
    ("distil.teacher_blocks", within(1.0, 128.0)),
    ("distil.points", within(2.0, 32_768.0)),
    ("distil.feature_weight", within(0.0, 1e6)),
    ("distil.structure_weight", within(0.0, 1e6)),
    ("distil.contrast_weight", within(0.0, 1e6)),
    ("distil.temperature", within(1e-6, 1e6)),
    ("proposals.width", within(16.0, 2048.0)),
    ("proposals.height", within(16.0, 2048.0)),
    ("proposals.channels", within(1.0, 1024.0)),
    ("proposals.color_probability", SHARE),
    ("proposals.class_weight", within(0.0, 1e6)),
    ("proposals.vote_weight", within(0.0, 1e6)),
    ("proposals.vote_huber", above(0.0, 10.0)),
    ("proposals.boundary_weight", within(0.0, 1e6)),
    ("train.steps", within(1.0, 1e9)),
    ("train.batch_size", within(1.0, 65_536.0)),
    ("train.accumulation", within(1.0, 65_536.0)),
    ("train.learning_rate", above(0.0, 10.0)),
    ("train.betas", below(0.0, 1.0)),
    ("train.epsilon", above(0.0, 1.0)),
    ("train.warmup_steps", within(0.0, 1e9)),
    ("train.warmup_factor", SHARE),
    ("train.clip_norm", within(0.0, 1e9)),
    ("train.ema_decay", below(0.0, 1.0)),
    ("train.validate_every", within(1.0, 1e9)),
    ("train.validate_minutes", within(0.0, 1e6)),
    ("train.validation_pairs", within(1.0, 1e6)),
    ("train.validation_images", within(2.0, 1e6)),
    ("train.checkpoint_seconds", above(0.0, 1e9)),
    ("train.workers", within(0.0, MAX_THREADS as f64)),
    ("train.prefetch", within(1.0, 1024.0)),
];

/// The rule of every number of this configuration.
pub(super) fn limit_rules(config: &Config) -> Vec<Rule> {
    let mut rules = Vec::new();
    // As text first: a number of single precision stands there as it was written.
    let text = serde_json::to_string(config).unwrap_or_default();
    visit(&serde_json::from_str(&text).unwrap_or_default(), "", "", &mut rules);
    rules
}

/// `path` is that of the value, `key` that of its limit.
fn visit(value: &Value, path: &str, key: &str, rules: &mut Vec<Rule>) {
    match value {
        Value::Object(table) => table.iter().for_each(|(name, value)| {
            let path = join(path, name);
            visit(value, &path, &path, rules);
        }),
        Value::Array(list) => {
            list.iter().enumerate().for_each(|(i, value)| visit(value, &format!("{path}[{i}]"), key, rules))
        }
        // JSON has no other numbers than finite ones.
        Value::Number(_) | Value::Null => {
            let Some((_, limit)) = LIMITS.iter().find(|(limited, _)| *limited == key) else { return };
            let holds = value.as_f64().is_some_and(|number| limit.contains(&number));
            let value = value.as_number().map_or("not a finite number".to_owned(), ToString::to_string);
            rules.push(Rule { field: path.to_owned(), value, holds, expected: expected(limit) });
        }
        Value::Bool(_) | Value::String(_) => {}
    }
}

fn expected(limit: &Limit) -> String {
    match limit {
        (Included(low), Included(high)) => format!("{low} to {high}"),
        (Excluded(low), Included(high)) => format!("above {low} and at most {high}"),
        (Included(low), Excluded(high)) => format!("at least {low} and below {high}"),
        // Not in the table.
        (low, high) => format!("{low:?} to {high:?}"),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{
        super::{EMBEDDED_NAMES, SynthConfig},
        *,
    };

    const COLORS: [&str; 4] = [
        r#"model.color={kind="vit"}"#,
        r#"model.color={kind="conv", channels=[4, 8, 8], out_dim=8}"#,
        r#"model.color={kind="hybrid"}"#,
        r#"model.color={kind="none", out_dim=8}"#,
    ];

    fn with(overrides: &[String]) -> Result<Config, super::super::ConfigError> {
        Config::from_toml("", Path::new("defaults.toml"), overrides)
    }

    /// Paths of all numbers with their values; a list is one.
    fn numbers(value: &Value, path: &str, found: &mut Vec<(String, Value)>) {
        match value {
            Value::Object(table) => table.iter().for_each(|(k, v)| numbers(v, &join(path, k), found)),
            Value::Array(list) if list.iter().all(Value::is_number) => {
                found.push((path.to_owned(), value.clone()));
            }
            Value::Number(_) => found.push((path.to_owned(), value.clone())),
            _ => {}
        }
    }

    #[test]
    fn every_number_has_a_limit_and_every_limit_a_number() {
        let mut all = std::collections::BTreeSet::new();
        for color in COLORS {
            let config = with(&[color.to_owned()]).unwrap();
            let mut found = Vec::new();
            numbers(&serde_json::to_value(&config).unwrap(), "", &mut found);
            all.extend(found.into_iter().map(|(path, _)| path).filter(|path| !path.ends_with("seed")));
        }
        let limited: std::collections::BTreeSet<String> =
            LIMITS.iter().map(|(path, _)| (*path).to_owned()).collect();
        assert_eq!(limited.len(), LIMITS.len(), "a limit is there twice");
        assert_eq!(all, limited);
    }

    /// Extremes of any number are taken, or refused with the key's name.
    #[test]
    fn extreme_numbers_are_refused_by_name() {
        const EXTREMES: [&str; 10] = [
            "9223372036854775807",
            "4294967295",
            "100000",
            "1e308",
            "-1e308",
            "1e-300",
            "inf",
            "nan",
            "-1",
            "0",
        ];
        let mut refused = 0;
        for color in COLORS {
            let mut found = Vec::new();
            let config = with(&[color.to_owned()]).unwrap();
            numbers(&serde_json::to_value(&config).unwrap(), "", &mut found);
            // The other keys are the same with every colour encoder.
            let is_new = |path: &str| color == COLORS[0] || path.starts_with("model.color.");
            for (path, value) in found.into_iter().filter(|(path, _)| is_new(path)) {
                for extreme in EXTREMES {
                    let entries = value.as_array().map(|list| vec![extreme; list.len()].join(", "));
                    let text = entries.map_or(extreme.to_owned(), |entries| format!("[{entries}]"));
                    let set = format!("{path}={text}");
                    match with(&[color.to_owned(), set.clone()]) {
                        Ok(config) => assert!(config.to_toml().is_ok(), "{set}"),
                        Err(error) => {
                            let message = error.to_string();
                            assert!(message.contains(&path), "{set}: {message}");
                            refused += 1;
                        }
                    }
                }
            }
        }
        assert!(refused > 800, "{refused}");
    }

    #[test]
    fn products_are_limited_too() {
        for (set, part) in [
            (
                ["train.batch_size=65536", "model.image_size=1792"],
                "train.batch_size is 65536, expected so small",
            ),
            (["train.prefetch=1024", "train.batch_size=512"], "train.prefetch is 1024, expected so small"),
            (["synth.width=4096", "synth.supersampling=8"], "synth.supersampling is 8, expected so small"),
            (["synth.images_per_shard=100000", "synth.height=4096"], "synth.images_per_shard is 100000"),
            (["synth.texture_size=4096", "synth.objects_per_shard=10000"], "synth.texture_size is 4096"),
            (["synth.images=100000000", "synth.images_per_shard=1"], "synth.images is 100000000"),
            (
                ["synth.diameter=[0.3, 0.1]", "synth.bins=0.1"],
                "synth.diameter is [0.3, 0.1], expected the smaller",
            ),
            (
                ["synth.bins=0.6", "synth.shelves=0.6"],
                "synth.shelves is 0.6, expected at most 1 with synth.bins",
            ),
        ] {
            let set = ["synth.height=4096", "synth.objects=1000000"].into_iter().chain(set);
            let message = with(&set.map(String::from).collect::<Vec<_>>()).unwrap_err().to_string();
            assert!(message.contains(part), "{part} not in {message}");
        }
        let wrong = SynthConfig { diameter: [1e-30, 1e-30], ..SynthConfig::default() };
        let message = wrong.check().unwrap_err().to_string();
        assert!(message.contains("synth.diameter[0] is 1e-30, expected 0.001 to 10"), "{message}");
    }

    /// Sizes that people have trained and rendered with.
    #[test]
    fn real_sizes_are_taken() {
        for name in EMBEDDED_NAMES {
            Config::embedded(name, &[]).unwrap();
        }
        for set in [
            "train.batch_size=256",
            "train.batch_size=512",
            "model.image_size=518",
            "model.fine_points=4096",
            "synth.images_per_shard=1000",
            "synth.texture_size=2048",
            r#"model.color={kind="vit", embed_dim=1536, depth=40, heads=24}"#,
        ] {
            with(&[set.to_owned()]).unwrap();
        }
        let large = SynthConfig {
            images: 1_000_000,
            objects: 20_000,
            images_per_shard: 1000,
            width: 1920,
            height: 1080,
            supersampling: 4,
            ..SynthConfig::default()
        };
        large.check().unwrap();
    }
}
