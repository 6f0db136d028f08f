//! The objects and pictures of a shard, built once.

use std::collections::{HashMap, HashSet};

use rand::seq::index;
use rayon::prelude::*;
use unopose_core::config::SynthConfig;

use super::{
    SynthError,
    background::Backgrounds,
    object::{ObjectLibrary, SynthObject},
    random::{Domain, stream},
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
    /// Opens the mesh and picture folders; nothing is built yet.
    pub fn new(config: &SynthConfig) -> Result<Self, SynthError> {
        let (library, backgrounds) = (ObjectLibrary::new(config)?, Backgrounds::new(config)?);
        Ok(Self { library, backgrounds, built: HashMap::new() })
    }

    /// How many objects had to be made up because their mesh file could not be used.
    pub fn replaced(&self) -> usize {
        self.library.replaced()
    }

    /// What the scenes of a shard are made of. Distractors have ids above those of the set's objects.
    pub fn scene_assets(&mut self, config: &SynthConfig, shard: u32) -> Result<SceneAssets, SynthError> {
        let mut ids = pool_of(config, shard);
        let own = ids.len();
        if config.distractors[1] > 0 {
            let first = config.objects + shard as usize * DISTRACTORS_PER_SHARD;
            ids.extend((1..=DISTRACTORS_PER_SHARD).map(|k| (first + k) as u32));
        }
        let mut objects = self.get(&ids, &|| {})?;
        let distractors = objects.split_off(own);
        Ok(SceneAssets { objects, distractors, backgrounds: self.backgrounds.clone() })
    }

    /// The objects in the order of `ids`; `done` is called after each one that had to be made. A mesh folder without
    /// any usable mesh is an error.
    pub fn get(&mut self, ids: &[u32], done: &(dyn Fn() + Sync)) -> Result<Vec<SynthObject>, SynthError> {
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
        self.library.check_meshes()?;
        Ok(ids.iter().filter_map(|id| self.built.get(id).cloned()).collect())
    }
}

/// Ids of the objects that the scenes of a shard draw from, ascending.
fn pool_of(config: &SynthConfig, shard: u32) -> Vec<u32> {
    let amount = config.objects_per_shard.min(config.objects);
    let mut rng = stream(config.seed, Domain::Pool, shard.into());
    let mut pool: Vec<u32> =
        index::sample(&mut rng, config.objects, amount).iter().map(|i| i as u32 + 1).collect();
    pool.sort_unstable();
    pool
}
