//! The training and validation sets of a run: the configured folders, or generated ones.

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use unopose_core::{
    config::{Config, ModelConfig, SynthConfig},
    folder_lock::LockError,
};
use unopose_dataset::{
    formats::{megapose::ShardDataset, models::read_models_info},
    mesh,
};
use unopose_eval::metrics::{EvalObject, print_decided_objects};
use unopose_pairs::data::PairSampler;
use unopose_synth::{Stage, SynthError};

use super::{
    TrainError,
    observer::{Phase, PhaseExtent, TrainObserver},
    options::{StopReason, TrainOptions},
    validation::Validation,
};

/// The validation pairs are the same whatever the run's seed.
const VALIDATION_SEED: u64 = 1;
const METRES_PER_MM: f32 = 1e-3;

/// The opened sets.
pub struct Datasets {
    training: Arc<ShardDataset>,
    validation: Arc<ShardDataset>,
    validation_folder: PathBuf,
}

impl Datasets {
    /// Opens the configured folders. Where none is configured, opens `<data_root>/<name>/train` or `/val`, generated
    /// first as far as it is not there; breaks when the run was interrupted or its time, counted from `start`, ended
    /// meanwhile.
    pub fn open_or_generate(
        config: &Config,
        options: &TrainOptions,
        start: Instant,
    ) -> Result<ControlFlow<StopReason, Self>, TrainError> {
        let root = options.data_root.join(&config.name);
        let stop = || {
            let late = options.time_limit.is_some_and(|limit| start.elapsed() >= limit);
            let reasons =
                [(options.interrupt.is_requested(), StopReason::Interrupted), (late, StopReason::TimeUp)];
            reasons.into_iter().find_map(|(holds, reason)| holds.then_some(reason))
        };
        let sets = [
            (
                &config.data.train,
                "train",
                config.synth.clone(),
                [Phase::TrainingModels, Phase::TrainingImages],
            ),
            (
                &config.data.validation,
                "val",
                validation_synth(config),
                [Phase::ValidationModels, Phase::ValidationImages],
            ),
        ];
        let mut folders = Vec::new();
        for (given, name, synth, phases) in sets {
            let folder = given.clone().unwrap_or_else(|| root.join(name));
            if given.is_none() {
                generate(&synth, &folder, phases, &*options.observer, &|| stop().is_some())?;
            }
            if let Some(reason) = stop() {
                return Ok(ControlFlow::Break(reason));
            }
            folders.push(folder);
        }
        let open = |folder: &Path| -> Result<Arc<ShardDataset>, TrainError> {
            let dataset = ShardDataset::open(folder)?;
            for problem in dataset.problems() {
                tracing::warn!("{}: {problem}", folder.display());
            }
            Ok(Arc::new(dataset))
        };
        let [training, validation] = [open(&folders[0])?, open(&folders[1])?];
        let validation_folder = folders.swap_remove(1);
        Ok(ControlFlow::Continue(Self { training, validation, validation_folder }))
    }

    /// The images to train on.
    pub fn training_images(&self) -> Arc<ShardDataset> {
        self.training.clone()
    }

    /// The images to validate on.
    pub fn validation_images(&self) -> Arc<ShardDataset> {
        self.validation.clone()
    }

    /// The stream of training pairs.
    pub fn training_sampler(&self, config: &Config) -> Result<PairSampler, TrainError> {
        self.sampler_prepared_with(config, &config.model)
    }

    /// The stream of training pairs, prepared for another network than `config.model`.
    pub fn sampler_prepared_with(
        &self,
        config: &Config,
        model: &ModelConfig,
    ) -> Result<PairSampler, TrainError> {
        Ok(PairSampler::new(self.training.clone(), &config.data, model, config.seed)?)
    }

    /// The validation pairs, prepared for `model`.
    pub fn validation_sampler(
        &self,
        config: &Config,
        model: &ModelConfig,
    ) -> Result<PairSampler, TrainError> {
        Ok(PairSampler::new(self.validation.clone(), &config.data, model, VALIDATION_SEED)?)
    }

    /// The validation pairs, with the meshes of their objects where the set has them, and with the objects whose pose only the
    /// print tells.
    pub fn validation(&self, config: &Config) -> Result<Validation, TrainError> {
        let sampler = self.validation_sampler(config, &config.model)?;
        let source = self.validation.clone();
        let prints = print_decided_objects(&self.validation_folder.join("models"))?;
        let validation =
            Validation::new(sampler, source, config.train.validation_pairs, |ids| self.objects(ids))?;
        Ok(validation.with_print_decided(prints))
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

/// How often a folder that another process fills is tried again.
const RETRY: Duration = Duration::from_millis(500);

/// Fills `folder` until it is complete or `stop` says so; `phases` are those of its objects and of its images. Waits for
/// another process that fills it.
fn generate(
    config: &SynthConfig,
    folder: &Path,
    phases: [Phase; 2],
    observer: &dyn TrainObserver,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(), TrainError> {
    let begun = Mutex::new([false; 2]);
    let mut told = false;
    loop {
        let generated = unopose_synth::generate(config, folder, &|state| {
            let mut begun = begun.lock().unwrap_or_else(PoisonError::into_inner);
            let (index, note) = match state.stage {
                Stage::Objects => (0, "models"),
                Stage::Images => (1, "images"),
            };
            if !std::mem::replace(&mut begun[index], true) {
                let first = state.done.saturating_sub(1) as u64;
                observer.begin(phases[index], PhaseExtent::new(first, state.total as u64));
            }
            observer.advance(phases[index], state.done as u64, note);
            if stop() {
                state.stop();
            }
        });
        match generated {
            Err(SynthError::Lock(held @ LockError::Held { .. })) => {
                if !std::mem::replace(&mut told, true) {
                    observer.line(&format!("waiting for the data: {held}"));
                }
                if stop() {
                    break;
                }
                std::thread::sleep(RETRY);
            }
            Ok(_) | Err(SynthError::Stopped) => break,
            Err(error) => return Err(error.into()),
        }
    }
    let begun = begun.into_inner().unwrap_or_else(PoisonError::into_inner);
    phases.iter().zip(begun).filter(|(_, begun)| *begun).for_each(|(phase, _)| observer.end(*phase));
    Ok(())
}
