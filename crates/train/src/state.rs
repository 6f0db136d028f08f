//! The whole state of a run on disk, and its exact return.
//!
//! `last.safetensors` holds the weights being trained; its metadata name the folder `state-<step>` beside it with the
//! optimizer's moments and the averaged weights. The folder is complete before `last.safetensors` is replaced by a
//! rename, and the folder of the previous checkpoint is deleted only after that: whenever the process is killed, one
//! complete pair remains.

use std::{
    fs,
    path::{Path, PathBuf},
};

use burn::{
    module::Module,
    optim::{ModuleOptimizer, OptimizerRecord},
    tensor::Bytes,
};
use serde::{Deserialize, Serialize};
use unopose_core::config::{Config, ModelConfig};
use unopose_nn::checkpoint::{self, CheckpointError, Meta};

use super::{TrainError, optimization::Optimization};

/// Metadata of `last.safetensors`: name of the folder with the rest of the state.
const STATE_KEY: &str = "state";
/// Metadata of `last.safetensors`: [`RunState`] as JSON.
const PROGRESS_KEY: &str = "progress";
/// Start of the folder names; the step follows.
const STATE_PREFIX: &str = "state-";

/// What a run knows besides its tensors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunState {
    /// Index of the next training pair in the stream.
    pub next_pair: u64,
    /// Training time of all calls, seconds.
    pub elapsed_s: f64,
    /// Best validation score so far.
    pub best_score: Option<f64>,
    /// All steps are done.
    pub finished: bool,
}

/// Path of the weights of a run's last checkpoint.
pub fn last_path(run: &Path) -> PathBuf {
    run.join("last.safetensors")
}

/// Writes the state of `optimization` into the run folder.
pub fn save<M: Module>(
    run: &Path,
    optimization: &Optimization<M>,
    config: &Config,
    state: &RunState,
) -> Result<(), TrainError> {
    let io = |path: &Path| {
        let path = path.to_owned();
        move |source| TrainError::Io { path, source }
    };
    let name = format!("{STATE_PREFIX}{}", optimization.step());
    let (folder, scratch) = (run.join(&name), run.join(format!(".part-{name}")));
    if scratch.exists() {
        fs::remove_dir_all(&scratch).map_err(io(&scratch))?;
    }
    fs::create_dir_all(&scratch).map_err(io(&scratch))?;
    let moments = scratch.join("optimizer.bpk");
    let bytes = optimization
        .adam()
        .into_bytes()
        .map_err(|e| TrainError::State { path: moments.clone(), message: e.to_string() })?;
    fs::write(&moments, &bytes[..]).map_err(io(&moments))?;
    let step = optimization.step();
    if let Some(average) = optimization.average() {
        let meta = Meta { step, ..Meta::default() };
        checkpoint::save(&scratch.join("average.safetensors"), average, config, &meta)?;
    }
    // The same step saved again (an interrupt right after a timed checkpoint) has the same content.
    if folder.exists() {
        fs::remove_dir_all(&scratch).map_err(io(&scratch))?;
    } else {
        fs::rename(&scratch, &folder).map_err(io(&folder))?;
    }
    let state = serde_json::to_string(state)
        .map_err(|e| TrainError::State { path: last_path(run), message: e.to_string() })?;
    let extra = [(STATE_KEY.to_owned(), name.clone()), (PROGRESS_KEY.to_owned(), state)].into();
    checkpoint::save(&last_path(run), optimization.model(), config, &Meta { step, extra })?;
    remove_states_except(run, &name).map_err(io(run))
}

/// Restores `optimization` (made from `config`) to the run's last checkpoint; `None` when there is none.
pub fn restore<M: Module>(
    run: &Path,
    optimization: &mut Optimization<M>,
    config: &ModelConfig,
) -> Result<Option<RunState>, TrainError> {
    let last = last_path(run);
    if !last.exists() {
        return Ok(None);
    }
    let (model, meta) = checkpoint::load_into(&last, optimization.model().clone(), config)?;
    let state = run_state(&meta, &last)?;
    let folder = run.join(entry(&meta, &last, STATE_KEY)?);
    let adam = read_moments(&folder.join("optimizer.bpk"), optimization.adam().clone())?;
    let average = match optimization.average() {
        Some(average) => {
            let path = folder.join("average.safetensors");
            let start = average.clone();
            // A run that began without an average starts one from its weights.
            Some(if path.exists() { checkpoint::load_into(&path, start, config)?.0 } else { model.valid() })
        }
        None => None,
    };
    optimization.restore(model, average, adam, meta.step);
    Ok(Some(state))
}

/// Steps and state of the run's last checkpoint, without its tensors.
pub fn read_state(run: &Path) -> Result<Option<(u64, RunState)>, TrainError> {
    let last = last_path(run);
    if !last.exists() {
        return Ok(None);
    }
    let meta = checkpoint::read_meta(&last)?;
    Ok(Some((meta.step, run_state(&meta, &last)?)))
}

/// Deletes what a run has written into its folder.
pub fn clear(run: &Path) -> std::io::Result<()> {
    for name in ["last.safetensors", "best.safetensors", "metrics.jsonl", "curves.svg", "poses.png"] {
        match fs::remove_file(run.join(name)) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
    }
    remove_states_except(run, "")
}

fn run_state(meta: &Meta, last: &Path) -> Result<RunState, TrainError> {
    serde_json::from_str(entry(meta, last, PROGRESS_KEY)?)
        .map_err(|e| TrainError::State { path: last.to_owned(), message: format!("{PROGRESS_KEY}: {e}") })
}

fn entry<'a>(meta: &'a Meta, last: &Path, key: &'static str) -> Result<&'a str, TrainError> {
    let absent = || CheckpointError::Metadata {
        path: last.to_owned(),
        key,
        value: "absent".into(),
        expected: "a checkpoint written by a training run (use --init for other weights)".into(),
    };
    Ok(meta.extra.get(key).ok_or_else(absent)?)
}

fn read_moments(path: &Path, adam: ModuleOptimizer) -> Result<ModuleOptimizer, TrainError> {
    let bytes = fs::read(path).map_err(|source| TrainError::Io { path: path.to_owned(), source })?;
    let state = |message: String| TrainError::State { path: path.to_owned(), message };
    let record =
        OptimizerRecord::from_bytes(Bytes::from_bytes_vec(bytes)).map_err(|e| state(e.to_string()))?;
    let stored = record.len();
    let adam = adam.load_record(record);
    let read = adam.to_record().len();
    if read != stored {
        return Err(state(format!("holds {stored} optimizer tensors of which {read} could be used")));
    }
    Ok(adam)
}

fn remove_states_except(run: &Path, keep: &str) -> std::io::Result<()> {
    for entry in fs::read_dir(run)? {
        let entry = entry?;
        let name = entry.file_name();
        let Some(name) = name.to_str() else { continue };
        let partial = name.starts_with(".part-state-");
        if partial || (name.starts_with(STATE_PREFIX) && name != keep) {
            fs::remove_dir_all(entry.path())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::{
        nn::{BatchNorm, BatchNormConfig, Linear, LinearConfig},
        store::{ModuleSnapshot, bridge},
        tensor::{Device, Distribution, Tensor},
    };
    use unopose_core::config::TrainConfig;

    #[derive(Module, Debug)]
    struct Net {
        first: Linear,
        norm: BatchNorm,
        last: Linear,
    }

    fn net(device: &Device) -> Net {
        Net {
            first: LinearConfig::new(5, 16).init(device),
            norm: BatchNormConfig::new(16).init(device),
            last: LinearConfig::new(16, 1).init(device),
        }
    }

    fn config() -> Config {
        let train = TrainConfig { ema_decay: 0.9, clip_norm: 0.5, accumulation: 2, ..TrainConfig::default() };
        Config { train, ..Config::default() }
    }

    fn steps(optimization: &mut Optimization<Net>, range: std::ops::Range<u64>, device: &Device) {
        for step in range {
            for pass in 0..2 {
                device.seed(100 * step + pass);
                let x = Tensor::<2>::random([32, 5], Distribution::Default, device);
                let y = x.clone().square().sum_dim(1);
                let model = optimization.model();
                let hidden = burn::tensor::activation::relu(model.norm.forward(model.first.forward(x)));
                let loss = (model.last.forward(hidden) - y).square().mean();
                optimization.accumulate(loss);
            }
            optimization.apply(1e-2 / (1.0 + step as f64));
        }
    }

    fn bits<M: Module>(model: &M) -> Vec<(String, Vec<u32>)> {
        let tensors = model.valid().collect(None, None, true);
        let bits = tensors.into_iter().map(|t| {
            let name = t.name.clone();
            let values = bridge::into_data(t).unwrap().try_into_vec::<f32>().unwrap();
            (name, values.into_iter().map(f32::to_bits).collect())
        });
        bits.collect()
    }

    #[test]
    fn half_the_steps_and_a_resume_equal_all_steps_bit_for_bit() {
        let device = Device::default().autodiff();
        let config = config();
        let folder = tempfile::tempdir().unwrap();
        device.seed(7);
        let start = net(&device);
        // Parameters initialise on first use; the two runs must start from the same values.
        bits(&start);

        let mut whole = Optimization::new(start.clone(), &config.train);
        // Batch statistics are shared between clones of a module: `fork` them apart by a trip through `valid`.
        let mut half = Optimization::new(start.valid().train(), &config.train);
        steps(&mut half, 0..4, &device);
        let state = RunState { next_pair: 16, elapsed_s: 0.1, best_score: Some(-0.25), finished: false };
        save(folder.path(), &half, &config, &state).unwrap();
        drop(half);

        device.seed(8);
        let mut resumed = Optimization::new(net(&device), &config.train);
        let read = restore(folder.path(), &mut resumed, &config.model).unwrap();
        assert_eq!(read, Some(state));
        assert_eq!(resumed.step(), 4);
        steps(&mut resumed, 4..8, &device);
        steps(&mut whole, 0..8, &device);
        assert_eq!(bits(resumed.model()), bits(whole.model()));
        assert_eq!(bits(resumed.average().unwrap()), bits(whole.average().unwrap()));
        assert_ne!(bits(resumed.model()), bits(resumed.average().unwrap()));
    }

    #[test]
    fn a_crash_between_the_two_writes_leaves_the_previous_state() {
        let device = Device::default().autodiff();
        let config = config();
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path();
        let mut optimization = Optimization::new(net(&device), &config.train);
        assert_eq!(restore(run, &mut optimization, &config.model).unwrap(), None);
        steps(&mut optimization, 0..1, &device);
        save(run, &optimization, &config, &RunState::default()).unwrap();
        let saved = bits(optimization.model());
        // What a kill leaves: the next step's folder complete or half written, the weights still the old ones.
        fs::create_dir_all(run.join("state-2")).unwrap();
        fs::create_dir_all(run.join(".part-state-3")).unwrap();
        steps(&mut optimization, 1..2, &device);
        restore(run, &mut optimization, &config.model).unwrap();
        assert_eq!((optimization.step(), bits(optimization.model())), (1, saved));
        steps(&mut optimization, 1..4, &device);
        save(run, &optimization, &config, &RunState::default()).unwrap();
        let mut names: Vec<_> =
            fs::read_dir(run).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        assert_eq!(names, ["last.safetensors", "state-4"]);
    }
}
