//! The training and validation sets of a run: the configured folders, or generated ones.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use unopose_core::config::{Config, SynthConfig};
use unopose_dataset::{
    formats::{megapose::ShardDataset, models::read_models_info},
    mesh,
};
use unopose_eval::eval::EvalObject;
use unopose_pairs::data::PairSampler;
use unopose_synth::Stage;

use super::{TrainError, interrupt::Interrupt, progress::Progress, validation::Validation};

/// The validation pairs are the same whatever the run's seed.
const VALIDATION_SEED: u64 = 1;
const METRES_PER_MM: f32 = 1e-3;

pub struct Datasets {
    training: Arc<ShardDataset>,
    validation: Arc<ShardDataset>,
    validation_folder: PathBuf,
}

impl Datasets {
    /// Opens the configured folders. Where none is configured, opens `<root>/<name>/train` or `/val`, generated first
    /// as far as it is not there; `None` when the run was interrupted meanwhile.
    pub fn open_or_generate(
        config: &Config,
        root: &Path,
        interrupt: &Interrupt,
    ) -> Result<Option<Self>, TrainError> {
        let root = root.join(&config.name);
        let folder = |given: &Option<PathBuf>, name: &str, synth: SynthConfig, label| match given {
            Some(folder) => Ok(folder.clone()),
            None => generate(&synth, root.join(name), label),
        };
        let training = folder(&config.data.train, "train", config.synth.clone(), "training set")?;
        if interrupt.is_requested() {
            return Ok(None);
        }
        let synth = validation_synth(config);
        let validation_folder = folder(&config.data.validation, "val", synth, "validation set")?;
        if interrupt.is_requested() {
            return Ok(None);
        }
        let open = |folder: &Path| -> Result<Arc<ShardDataset>, TrainError> {
            let dataset = ShardDataset::open(folder)?;
            for problem in dataset.problems() {
                tracing::warn!("{}: {problem}", folder.display());
            }
            Ok(Arc::new(dataset))
        };
        Ok(Some(Self {
            training: open(&training)?,
            validation: open(&validation_folder)?,
            validation_folder,
        }))
    }

    /// The stream of training pairs.
    pub fn training_sampler(&self, config: &Config) -> Result<PairSampler, TrainError> {
        Ok(PairSampler::new(self.training.clone(), &config.data, &config.model, config.seed)?)
    }

    /// The validation pairs, with the meshes of their objects where the set has them.
    pub fn validation(&self, config: &Config) -> Result<Validation, TrainError> {
        let sampler =
            PairSampler::new(self.validation.clone(), &config.data, &config.model, VALIDATION_SEED)?;
        let source = self.validation.clone();
        Validation::new(sampler, source, config.train.validation_pairs, |ids| self.objects(ids))
    }

    /// Meshes and sizes from `models/` beside the shards; empty when there are none.
    fn objects(&self, ids: BTreeSet<u32>) -> Result<BTreeMap<u32, EvalObject>, TrainError> {
        let folder = self.validation_folder.join("models");
        let infos_file = folder.join("models_info.json");
        if !infos_file.is_file() {
            return Ok(BTreeMap::new());
        }
        let infos = read_models_info(&infos_file)?;
        let mut objects = BTreeMap::new();
        for id in ids {
            let file = folder.join(format!("obj_{id:06}.ply"));
            let Some(info) = infos.get(&id).filter(|_| file.is_file()) else { continue };
            let mesh = mesh::load(&file, METRES_PER_MM)?;
            objects.insert(id, EvalObject::new(mesh, info.diameter, &info.symmetries));
        }
        Ok(objects)
    }
}

/// A smaller set of other objects, with the meshes that the average recall needs.
fn validation_synth(config: &Config) -> SynthConfig {
    let synth = &config.synth;
    SynthConfig {
        seed: synth.seed.wrapping_add(1_000_003),
        images: config.train.validation_images,
        images_per_shard: synth.images_per_shard.min(config.train.validation_images),
        objects: synth.objects.min(synth.objects_per_shard),
        write_models: true,
        ..synth.clone()
    }
}

fn generate(config: &SynthConfig, folder: PathBuf, label: &'static str) -> Result<PathBuf, TrainError> {
    let bars: Mutex<[Option<Progress>; 2]> = Mutex::new([None, None]);
    unopose_synth::generate(config, &folder, &|state| {
        let mut bars = bars.lock().unwrap_or_else(PoisonError::into_inner);
        let (slot, note) = match state.stage {
            Stage::Images => (0, "images"),
            Stage::Objects => (1, "models"),
        };
        let first = state.done.saturating_sub(1) as u64;
        let bar = bars[slot].get_or_insert_with(|| Progress::new(label, first, state.total as u64));
        bar.set(state.done as u64, note);
    })?;
    bars.into_inner().unwrap_or_else(PoisonError::into_inner).iter().flatten().for_each(Progress::finish);
    Ok(folder)
}
