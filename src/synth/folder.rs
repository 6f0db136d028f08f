//! Which configuration a folder belongs to.

use std::path::Path;

use super::SynthError;
use crate::{
    config::SynthConfig,
    formats::files::{read_json, write_json},
};

const CONFIG_FILE: &str = "generation.json";

/// Refuses values that cannot give images.
pub(super) fn check(config: &SynthConfig) -> Result<(), SynthError> {
    let error = |field, value: String, expected| Err(SynthError::Config { field, value, expected });
    let counts = [
        ("images", config.images),
        ("images_per_shard", config.images_per_shard),
        ("objects", config.objects),
        ("objects_per_shard", config.objects_per_shard),
        ("views_per_scene", config.views_per_scene),
    ];
    if let Some((field, value)) = counts.into_iter().find(|c| c.1 == 0) {
        return error(field, value.to_string(), "at least 1");
    }
    if config.width < 16 || config.height < 16 || config.width > 8192 || config.height > 8192 {
        return error(
            "width x height",
            format!("{} x {}", config.width, config.height),
            "16..8192 pixels each",
        );
    }
    if !(1..=8).contains(&config.supersampling) {
        return error("supersampling", config.supersampling.to_string(), "1..8");
    }
    if !(32..=8192).contains(&config.texture_size) {
        return error("texture_size", config.texture_size.to_string(), "32..8192 pixels");
    }
    let ranges = [("diameter", config.diameter), ("camera.distance", config.camera.distance)];
    for (field, [low, high]) in ranges {
        if !(low > 0.0 && high >= low && high.is_finite()) {
            return error(field, format!("[{low}, {high}]"), "0 < low <= high");
        }
    }
    Ok(())
}

/// Notes the configuration in the folder, or refuses a folder of another one.
pub(super) fn claim(config: &SynthConfig, out: &Path) -> Result<(), SynthError> {
    let file = out.join(CONFIG_FILE);
    if !file.is_file() {
        return Ok(write_json(&file, config, true)?);
    }
    // Both through JSON text: a number is compared as it is written (f32 values do not survive `to_value`).
    let found: serde_json::Value = read_json(&file)?;
    let wanted = serde_json::to_string(config).and_then(|text| serde_json::from_str(&text));
    let wanted: serde_json::Value =
        wanted.map_err(|e| SynthError::Io { path: file.clone(), source: e.into() })?;
    if found == wanted {
        return Ok(());
    }
    let differing = |w: &serde_json::Map<String, serde_json::Value>| {
        w.iter().find(|(k, v)| found.get(k.as_str()) != Some(*v)).map(|(k, v)| {
            format!("{k} is {} there and {v} here", found.get(k.as_str()).unwrap_or(&serde_json::Value::Null))
        })
    };
    let difference = wanted.as_object().and_then(differing).unwrap_or_else(|| "other fields".into());
    Err(SynthError::OtherConfig { folder: out.to_owned(), difference })
}
