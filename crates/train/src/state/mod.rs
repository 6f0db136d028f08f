//! The whole state of a run on disk, and its exact return.
//!
//! `last.safetensors` holds the weights being trained; its metadata name the folder `state-<step>` beside it with the
//! optimizer's moments, the averaged weights and checksums of both. The folder is complete before `last.safetensors` is
//! replaced by a rename, and the folder of the previous checkpoint is deleted only after that: whenever the process is
//! killed, one complete pair remains.

mod manifest;
#[cfg(test)]
mod tests;

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
use unopose_core::{
    config::{Config, ModelConfig},
    files::{PART_PREFIX, sync_folder, write_atomic},
};
use unopose_nn::checkpoint::{self, CheckpointError, Meta};

use super::{TrainError, optimization::Optimization};
use manifest::{Manifest, damaged};

/// Metadata of `last.safetensors`: name of the folder with the rest of the state.
const STATE_KEY: &str = "state";
/// Metadata of `last.safetensors`: [`RunState`] as JSON.
const PROGRESS_KEY: &str = "progress";
/// Start of the folder names; the step follows.
const STATE_PREFIX: &str = "state-";
/// Files of the folder.
const MOMENTS_FILE: &str = "optimizer.bpk";
const AVERAGE_FILE: &str = "average.safetensors";

/// What a run knows besides its tensors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunState {
    /// Index of the next training pair in the stream.
    pub next_pair: u64,
    /// Training time of all calls, seconds.
    pub elapsed_s: f64,
    /// An interrupt ended a validation of these weights, which is to be done first.
    #[serde(default)]
    pub validation_due: bool,
    /// All steps are done.
    pub finished: bool,
}

/// Path of the weights of a run's last checkpoint.
pub fn last_path(run: &Path) -> PathBuf {
    run.join("last.safetensors")
}

/// Writes the state of `optimization` into the run folder. A failure (a full disk) leaves the state before.
pub fn save<M: Module>(
    run: &Path,
    optimization: &Optimization<M>,
    config: &Config,
    state: &RunState,
) -> Result<(), TrainError> {
    let step = optimization.step();
    let scratch = run.join(format!("{PART_PREFIX}{STATE_PREFIX}{step}"));
    let written = write_folder(&scratch, optimization, config)
        .and_then(|manifest| keep_folder(run, &scratch, step, &manifest));
    if scratch.exists() {
        // An error of its own would hide the first.
        let _ = fs::remove_dir_all(&scratch);
    }
    let name = written?;
    let state = serde_json::to_string(state)
        .map_err(|e| TrainError::State { path: last_path(run), message: e.to_string() })?;
    let extra = [(STATE_KEY.to_owned(), name.clone()), (PROGRESS_KEY.to_owned(), state)].into();
    checkpoint::save(&last_path(run), optimization.model(), config, &Meta { step, extra })?;
    remove_states_except(run, &name).map_err(io(run))
}

/// Everything but the weights being trained.
fn write_folder<M: Module>(
    scratch: &Path,
    optimization: &Optimization<M>,
    config: &Config,
) -> Result<Manifest, TrainError> {
    if scratch.exists() {
        fs::remove_dir_all(scratch).map_err(io(scratch))?;
    }
    let moments = scratch.join(MOMENTS_FILE);
    let bytes = optimization
        .adam()
        .into_bytes()
        .map_err(|e| TrainError::State { path: moments.clone(), message: e.to_string() })?;
    write_atomic(&moments, |writer| std::io::Write::write_all(writer, &bytes[..]))?;
    let mut files = vec![MOMENTS_FILE];
    if let Some(average) = optimization.average() {
        let meta = Meta { step: optimization.step(), ..Meta::default() };
        checkpoint::save(&scratch.join(AVERAGE_FILE), average, config, &meta)?;
        files.push(AVERAGE_FILE);
    }
    Manifest::write(scratch, &files)
}

/// Gives the folder its name, which it returns: `state-<step>`, with a number where a folder of that name has another
/// content (left by a run that was killed and went on differently).
fn keep_folder(run: &Path, scratch: &Path, step: u64, manifest: &Manifest) -> Result<String, TrainError> {
    let mut name = format!("{STATE_PREFIX}{step}");
    let mut number = 1;
    while run.join(&name).exists() {
        // The same step saved again: an interrupt right after a timed checkpoint.
        if Manifest::read(&run.join(&name)).is_ok_and(|there| there == *manifest) {
            return Ok(name);
        }
        number += 1;
        name = format!("{STATE_PREFIX}{step}-{number}");
    }
    let folder = run.join(&name);
    fs::rename(scratch, &folder).and_then(|()| sync_folder(run)).map_err(io(&folder))?;
    Ok(name)
}

/// Restores `optimization` (made from `config`) to the run's last checkpoint; `None` when there is none. With
/// `reset_optimizer` the moments start anew, and so does the average where its file is damaged.
pub fn restore<M: Module>(
    run: &Path,
    optimization: &mut Optimization<M>,
    config: &ModelConfig,
    reset_optimizer: bool,
) -> Result<Option<RunState>, TrainError> {
    let last = last_path(run);
    if !last.exists() {
        return Ok(None);
    }
    let (model, meta) = checkpoint::load_into(&last, optimization.model().clone(), config)?;
    let state = run_state(&meta, &last)?;
    let folder = run.join(entry(&meta, &last, STATE_KEY)?);
    let adam = match reset_optimizer {
        true => optimization.adam().clone(),
        false => read_moments(&folder, optimization.adam().clone())?,
    };
    let average = match optimization.average() {
        Some(start) => match read_average(&folder, start, config) {
            Ok(Some(average)) => Some(average),
            // A run that began without an average starts one from its weights.
            Ok(None) => Some(model.valid()),
            Err(error) if reset_optimizer => {
                tracing::warn!("the average of the weights starts anew: {error}");
                Some(model.valid())
            }
            Err(error) => return Err(error),
        },
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
pub fn clear(run: &Path) -> Result<(), TrainError> {
    // The best weights first: without a state they would be those to beat.
    for name in
        ["best.safetensors", "curves.svg", "poses.png", "proposals.png", "metrics.jsonl", "last.safetensors"]
    {
        let path = run.join(name);
        match fs::remove_file(&path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(io(&path)(e)),
            _ => {}
        }
    }
    remove_states_except(run, "").map_err(io(run))
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

fn read_moments(folder: &Path, adam: ModuleOptimizer) -> Result<ModuleOptimizer, TrainError> {
    let bytes = Manifest::read(folder)?.verified(folder, MOMENTS_FILE)?;
    let state = |what: &str| damaged(folder.join(MOMENTS_FILE), what);
    let record =
        OptimizerRecord::from_bytes(Bytes::from_bytes_vec(bytes)).map_err(|e| state(&e.to_string()))?;
    let stored = record.len();
    let adam = adam.load_record(record);
    let read = adam.to_record().len();
    if read != stored {
        return Err(state(&format!("holds {stored} optimizer tensors of which {read} could be used")));
    }
    Ok(adam)
}

/// `None` when the run had none.
fn read_average<M: Module>(folder: &Path, start: &M, config: &ModelConfig) -> Result<Option<M>, TrainError> {
    let manifest = Manifest::read(folder)?;
    if !manifest.lists(AVERAGE_FILE) {
        return Ok(None);
    }
    manifest.verified(folder, AVERAGE_FILE)?;
    Ok(Some(checkpoint::load_into(&folder.join(AVERAGE_FILE), start.clone(), config)?.0))
}

/// Deletes the state folders of other checkpoints.
fn remove_states_except(run: &Path, keep: &str) -> std::io::Result<()> {
    for entry in fs::read_dir(run)? {
        let entry = entry?;
        let name = entry.file_name();
        let number =
            name.to_str().filter(|name| *name != keep).and_then(|name| name.strip_prefix(STATE_PREFIX));
        // No folder that someone else named.
        let ours = number.is_some_and(|number| number.bytes().all(|b| b.is_ascii_digit() || b == b'-'));
        if ours && entry.file_type()?.is_dir() {
            fs::remove_dir_all(entry.path())?;
        }
    }
    Ok(())
}

fn io(path: &Path) -> impl Fn(std::io::Error) -> TrainError + use<> {
    let path = path.to_owned();
    move |source| TrainError::Io { path: path.clone(), source }
}
