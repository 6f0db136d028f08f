//! Filling a folder with shards, models and index files.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    ops::Range,
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use rand::seq::index;
use rayon::prelude::*;

use super::{
    SynthError,
    object::{ObjectLibrary, SynthObject},
    random::{Domain, stream},
    shard,
};
use crate::{
    config::SynthConfig,
    formats::{
        ModelInfo,
        files::{read_json, write_json},
        megapose::{ShardDataset, ShardWriter, shard_file_name, write_index_files},
        models::write_models_info,
        write_atomic,
    },
    mesh::ply,
};

/// What is being made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    Objects,
    Images,
}

/// State of a running generation.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    pub stage: Stage,
    /// Items finished, those of earlier runs included.
    pub done: usize,
    pub total: usize,
}

/// What a generation did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    pub shards_written: usize,
    /// Shards that were there already.
    pub shards_kept: usize,
    pub images_written: usize,
}

const SET_NAME: &str = "gso";
const CONFIG_FILE: &str = "generation.json";

/// Makes the whole set in `out`: shards, models, index files. Finished shards of an earlier run are kept, so that a
/// killed run continues where it stopped. `progress` is called from several threads.
pub fn generate(
    config: &SynthConfig,
    out: &Path,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Summary, SynthError> {
    check(config)?;
    claim(config, out)?;
    let mut cache = ObjectCache::new(config)?;
    write_models(config, out, &mut cache, progress)?;
    let shards = config.images.div_ceil(config.images_per_shard.max(1)) as u32;
    let summary = make_shards(config, out, 0..shards, &mut cache, progress)?;
    let index = out.join(format!("megapose_{SET_NAME}_fixed_obj_id_to_visib0_8_scene_im_inst_ids.json"));
    if summary.shards_written > 0 || !index.is_file() {
        remove_index_files(out)?;
        let dataset = ShardDataset::open(out)?;
        write_index_files(out, SET_NAME, &dataset)?;
    }
    Ok(summary)
}

/// Makes some shards only, for sets spread over many machines; [`generate`] completes the set once all are there.
pub fn generate_shards(
    config: &SynthConfig,
    out: &Path,
    shards: Range<u32>,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Summary, SynthError> {
    check(config)?;
    claim(config, out)?;
    make_shards(config, out, shards, &mut ObjectCache::new(config)?, progress)
}

/// The objects of the current pool; those of the next pool are taken over.
struct ObjectCache {
    library: ObjectLibrary,
    built: HashMap<u32, SynthObject>,
}

impl ObjectCache {
    fn new(config: &SynthConfig) -> Result<Self, SynthError> {
        Ok(Self { library: ObjectLibrary::new(config)?, built: HashMap::new() })
    }

    /// The objects in the order of `ids`; `done` is called after each one that had to be made.
    fn get(&mut self, ids: &[u32], done: &(dyn Fn() + Sync)) -> Vec<SynthObject> {
        let wanted: HashSet<u32> = ids.iter().copied().collect();
        self.built.retain(|id, _| wanted.contains(id));
        let missing: Vec<u32> = ids.iter().copied().filter(|id| !self.built.contains_key(id)).collect();
        let library = &self.library;
        let make = |&id: &u32| {
            let object = library.build(id);
            done();
            (id, object)
        };
        self.built.extend(missing.par_iter().map(make).collect::<Vec<_>>());
        ids.iter().filter_map(|id| self.built.get(id).cloned()).collect()
    }
}

fn make_shards(
    config: &SynthConfig,
    out: &Path,
    shards: Range<u32>,
    cache: &mut ObjectCache,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Summary, SynthError> {
    let per_shard = config.images_per_shard;
    let images_in = |shard: u32| (config.images.saturating_sub(shard as usize * per_shard)).min(per_shard);
    let total = shards.clone().map(images_in).sum();
    let done = AtomicUsize::new(0);
    let report = |finished: usize| {
        let done = done.fetch_add(finished, Ordering::Relaxed) + finished;
        progress(Progress { stage: Stage::Images, done, total });
    };
    let mut summary = Summary::default();
    for shard in shards {
        let path = out.join("train_pbr_web").join(shard_file_name(shard));
        let images = images_in(shard);
        if images == 0 || path.is_file() {
            summary.shards_kept += usize::from(images > 0);
            report(images);
            continue;
        }
        let objects = cache.get(&pool_of(config, shard), &|| {});
        let mut writer = ShardWriter::default();
        for image in shard::encode_shard(config, &objects, shard, images, &report)? {
            writer.push(image);
        }
        writer.write(&path)?;
        summary.shards_written += 1;
        summary.images_written += images;
    }
    Ok(summary)
}

/// Ids of the objects that the scenes of a shard draw from, ascending.
pub(super) fn pool_of(config: &SynthConfig, shard: u32) -> Vec<u32> {
    let amount = config.objects_per_shard.min(config.objects);
    let mut rng = stream(config.seed, Domain::Pool, shard.into());
    let mut pool: Vec<u32> =
        index::sample(&mut rng, config.objects, amount).iter().map(|i| i as u32 + 1).collect();
    pool.sort_unstable();
    pool
}

/// Refuses values that cannot give images.
fn check(config: &SynthConfig) -> Result<(), SynthError> {
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
fn claim(config: &SynthConfig, out: &Path) -> Result<(), SynthError> {
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

fn remove_index_files(out: &Path) -> Result<(), SynthError> {
    for suffix in ["valid_inst_ids.json", "obj_id_to_visib0_8_scene_im_inst_ids.json"] {
        let path = out.join(format!("megapose_{SET_NAME}_fixed_{suffix}"));
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(SynthError::Io { path, source });
            }
            _ => {}
        }
    }
    Ok(())
}

/// One entry of the models list.
#[derive(serde::Serialize)]
struct ModelName {
    obj_id: u32,
    gso_id: String,
}

/// Meshes (PLY in mm with their texture), `models_info.json` and the models list.
fn write_models(
    config: &SynthConfig,
    out: &Path,
    cache: &mut ObjectCache,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<(), SynthError> {
    let (folder, names_file) = (out.join("models"), out.join(format!("{SET_NAME}_models.json")));
    let info_file = folder.join("models_info.json");
    if names_file.is_file() && info_file.is_file() {
        return Ok(());
    }
    let (done, total) = (AtomicUsize::new(0), config.objects);
    let report = || {
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress(Progress { stage: Stage::Objects, done, total });
    };
    let mut names = Vec::new();
    let mut infos = BTreeMap::new();
    let ids: Vec<u32> = (1..=config.objects as u32).collect();
    for chunk in ids.chunks(config.objects_per_shard) {
        let objects = cache.get(chunk, &report);
        let written: Vec<Result<ModelInfo, SynthError>> = objects
            .par_iter()
            .map(|object| {
                if config.write_models {
                    write_model(object, &folder)?;
                }
                Ok(object.info())
            })
            .collect();
        for (object, info) in objects.iter().zip(written) {
            infos.insert(object.obj_id, info?);
            names.push(ModelName { obj_id: object.obj_id, gso_id: object.name.clone() });
        }
    }
    write_models_info(&info_file, &infos)?;
    Ok(write_json(&names_file, &names, true)?)
}

/// `obj_OOOOOO.ply` and `obj_OOOOOO.png`.
fn write_model(object: &SynthObject, folder: &Path) -> Result<(), SynthError> {
    let stem = format!("obj_{:06}", object.obj_id);
    let texture = format!("{stem}.png");
    if let Some(picture) = &object.mesh.texture {
        crate::formats::image_io::write_rgb(&folder.join(&texture), picture)?;
    }
    let name = object.mesh.texture.is_some().then_some(texture.as_str());
    write_atomic(&folder.join(format!("{stem}.ply")), |out| ply::write(&object.mesh, 1000.0, name, out))?;
    Ok(())
}
