//! Object meshes beside the images.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use rayon::prelude::*;
use unopose_core::{config::SynthConfig, files::write_atomic};
use unopose_dataset::{
    formats::{ModelInfo, files::write_json, image_io::write_rgb, models::write_models_info},
    mesh::ply,
};

use super::{
    GenerationProgress, Stage, SynthError,
    background::Backgrounds,
    generate::pool_of,
    object::{ObjectLibrary, SynthObject},
    scene::SceneAssets,
};

/// The objects of the current pool; those of the next pool are taken over.
pub(super) struct ObjectCache {
    library: ObjectLibrary,
    backgrounds: Backgrounds,
    built: HashMap<u32, SynthObject>,
}

/// Distractors that the scenes of one shard draw from.
const DISTRACTORS_PER_SHARD: usize = 16;

impl ObjectCache {
    pub fn new(config: &SynthConfig) -> Result<Self, SynthError> {
        let (library, backgrounds) = (ObjectLibrary::new(config)?, Backgrounds::new(config)?);
        Ok(Self { library, backgrounds, built: HashMap::new() })
    }

    /// How many objects had to be made up because their mesh file could not be used.
    pub fn replaced(&self) -> usize {
        self.library.replaced()
    }

    /// What the scenes of a shard are made of. Distractors have ids above those of the set's objects.
    pub fn scene_assets(&mut self, config: &SynthConfig, shard: u32) -> SceneAssets {
        let mut ids = pool_of(config, shard);
        let own = ids.len();
        if config.distractors[1] > 0 {
            let first = config.objects + shard as usize * DISTRACTORS_PER_SHARD;
            ids.extend((1..=DISTRACTORS_PER_SHARD).map(|k| (first + k) as u32));
        }
        let mut objects = self.get(&ids, &|| {});
        let distractors = objects.split_off(own);
        SceneAssets { objects, distractors, backgrounds: self.backgrounds.clone() }
    }

    /// The objects in the order of `ids`; `done` is called after each one that had to be made.
    pub fn get(&mut self, ids: &[u32], done: &(dyn Fn() + Sync)) -> Vec<SynthObject> {
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

/// One entry of the models list.
#[derive(serde::Serialize)]
struct ModelName {
    obj_id: u32,
    gso_id: String,
}

/// Meshes (PLY in mm with their texture), `models_info.json` and the models list.
pub(super) fn write_models(
    config: &SynthConfig,
    out: &Path,
    set: &str,
    cache: &mut ObjectCache,
    progress: &(dyn Fn(GenerationProgress) + Sync),
) -> Result<(), SynthError> {
    let (folder, names_file) = (out.join("models"), out.join(format!("{set}_models.json")));
    let info_file = folder.join("models_info.json");
    if names_file.is_file() && info_file.is_file() {
        return Ok(());
    }
    let (done, total) = (AtomicUsize::new(0), config.objects);
    let report = || {
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress(GenerationProgress { stage: Stage::Objects, done, total });
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
pub(super) fn write_model(object: &SynthObject, folder: &Path) -> Result<(), SynthError> {
    let stem = format!("obj_{:06}", object.obj_id);
    let texture = format!("{stem}.png");
    if let Some(picture) = &object.mesh.texture {
        write_rgb(&folder.join(&texture), picture)?;
    }
    let name = object.mesh.texture.is_some().then_some(texture.as_str());
    write_atomic(&folder.join(format!("{stem}.ply")), |out| ply::write(&object.mesh, 1000.0, name, out))?;
    Ok(())
}
