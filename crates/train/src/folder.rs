//! The run folder before training.

use std::{fs, path::Path};

use unopose_core::{config::Config, files::write_atomic};
use unopose_nn::checkpoint;

use super::{TrainError, options::TrainOptions, state};

/// Makes the folder, refuses a run of another network in it, writes the resolved configuration.
pub fn prepare(config: &Config, options: &TrainOptions) -> Result<(), TrainError> {
    let out = &options.out;
    let io = |source| TrainError::Io { path: out.clone(), source };
    fs::create_dir_all(out).map_err(io)?;
    if options.fresh {
        state::clear(out).map_err(io)?;
    }
    let last = state::last_path(out);
    if last.exists() {
        let earlier = checkpoint::read_config(&last)?;
        if let Some((field, theirs, ours)) =
            checkpoint::differences(&earlier.model, &config.model).into_iter().next()
        {
            return Err(TrainError::OtherModel { path: last, field, theirs, ours });
        }
    }
    let text = config.to_toml()?;
    Ok(write_atomic(&out.join("config.toml"), |writer| std::io::Write::write_all(writer, text.as_bytes()))?)
}

/// The last step of a run that an earlier call finished.
pub fn finished_step(config: &Config, out: &Path) -> Result<Option<u64>, TrainError> {
    let done = state::read_state(out)?.filter(|(step, state)| state.finished && *step >= config.train.steps);
    Ok(done.map(|(step, _)| step))
}
