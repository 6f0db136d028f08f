//! `best.safetensors`: the weights of the best validation.

use std::path::{Path, PathBuf};

use burn::module::Module;
use unopose_core::config::Config;
use unopose_nn::checkpoint::{self, CheckpointError, Meta};

use super::{
    TrainError,
    journal::{Event, ValidationRecord},
};

/// Metadata: [`ValidationRecord::score`] of the weights.
const SCORE_KEY: &str = "score";

/// The file and its score. The score stands in the file itself, so that whatever else of a run is lost, weights are never
/// replaced by worse ones.
pub struct Best {
    path: PathBuf,
    score: Option<f64>,
}

/// Path of the best weights of a run.
pub fn best_path(run: &Path) -> PathBuf {
    run.join("best.safetensors")
}

impl Best {
    /// What the run folder holds. `events` are those of the run: in files of an earlier version the score is only there.
    pub fn open(run: &Path, events: &[Event]) -> Result<Self, TrainError> {
        let path = best_path(run);
        if !path.exists() {
            return Ok(Self { path, score: None });
        }
        let meta = checkpoint::read_meta(&path)?;
        let validated = events.iter().find_map(|event| match event {
            Event::Validation(record) if record.step == meta.step => Some(record.score()),
            _ => None,
        });
        let value = meta.extra.get(SCORE_KEY);
        let score =
            value.map_or(validated, |text| text.parse().ok()).ok_or_else(|| CheckpointError::Metadata {
                path: path.clone(),
                key: SCORE_KEY,
                value: value.cloned().unwrap_or_else(|| "absent".into()),
                expected: "the score of the best validation (move the file away to begin without it)".into(),
            })?;
        Ok(Self { path, score: Some(score) })
    }

    /// Whether there are weights.
    pub fn exists(&self) -> bool {
        self.score.is_some()
    }

    /// Keeps `model`, which was validated, if it is better than all before.
    pub fn offer<M: Module>(
        &mut self,
        model: &M,
        config: &Config,
        record: &ValidationRecord,
    ) -> Result<(), TrainError> {
        let score = record.score();
        if self.score.is_none_or(|best| score > best) {
            let extra = [(SCORE_KEY.to_owned(), score.to_string())].into();
            checkpoint::save(&self.path, model, config, &Meta { step: record.step, extra })?;
            self.score = Some(score);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::{nn::LinearConfig, tensor::Device};

    #[test]
    fn weights_are_never_replaced_by_worse_ones_whatever_else_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path();
        let (config, model) = (Config::default(), LinearConfig::new(2, 2).init(&Device::default()));
        let record = |step, average_recall| ValidationRecord {
            step,
            average_recall: Some(average_recall),
            loss: 1.0,
            ..ValidationRecord::default()
        };
        let step = || checkpoint::read_meta(&best_path(run)).unwrap().step;
        let mut best = Best::open(run, &[]).unwrap();
        assert!(!best.exists());
        best.offer(&model, &config, &record(0, 0.248)).unwrap();
        best.offer(&model, &config, &record(5, 0.102)).unwrap();
        assert_eq!(step(), 0);
        // Another process, to which nothing but the file is left.
        let mut best = Best::open(run, &[]).unwrap();
        assert_eq!(best.score, Some(record(0, 0.248).score()));
        best.offer(&model, &config, &record(6, 0.102)).unwrap();
        assert_eq!(step(), 0);
        best.offer(&model, &config, &record(7, 0.249)).unwrap();
        assert_eq!(step(), 7);

        // A file without a score is that of a validation in the journal, or of unknown worth.
        let meta = Meta { step: 20, ..Meta::default() };
        checkpoint::save(&best_path(run), &model, &config, &meta).unwrap();
        let events = [record(0, 0.1), record(20, 0.3)].map(Event::Validation);
        assert_eq!(Best::open(run, &events).unwrap().score, Some(record(20, 0.3).score()));
        let error = Best::open(run, &events[..1]).err().unwrap().to_string();
        assert!(error.contains("best.safetensors") && error.contains("score"), "{error}");
    }
}
