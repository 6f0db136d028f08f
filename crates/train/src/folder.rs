//! The run folder before training.

use std::path::Path;

use unopose_core::{config::Config, files::write_atomic};
use unopose_nn::checkpoint;

use super::{TrainError, best::best_path, state};

/// Refuses a folder with weights of another network.
pub fn require_same_network(config: &Config, out: &Path) -> Result<(), TrainError> {
    for path in [state::last_path(out), best_path(out)] {
        if !path.exists() {
            continue;
        }
        let earlier = checkpoint::read_config(&path)?;
        if let Some((field, theirs, ours)) =
            checkpoint::differences(&earlier.model, &config.model).into_iter().next()
        {
            return Err(TrainError::OtherModel { path, field, theirs, ours });
        }
    }
    Ok(())
}

/// Writes the resolved configuration.
pub fn write_config(config: &Config, out: &Path) -> Result<(), TrainError> {
    let text = config.to_toml()?;
    Ok(write_atomic(&out.join("config.toml"), |writer| std::io::Write::write_all(writer, text.as_bytes()))?)
}

/// The last step of a run that an earlier call finished.
pub fn finished_step(config: &Config, out: &Path) -> Result<Option<u64>, TrainError> {
    let done = state::read_state(out)?.filter(|(step, state)| state.finished && *step >= config.train.steps);
    Ok(done.map(|(step, _)| step))
}
