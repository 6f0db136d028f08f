//! What the tests of whole runs share.

use std::{path::Path, sync::Arc};

use burn::tensor::Device;
use unopose_core::config::Config;
use unopose_nn::checkpoint::TensorFile;
use unopose_train::{Event, Journal, TrainOptions};

pub fn config(overrides: &[&str]) -> Config {
    let overrides: Vec<String> = overrides.iter().map(|s| s.to_string()).collect();
    Config::embedded("smoke", &overrides).unwrap()
}

/// Options for a run in `folder/<name>`; all runs of a folder share the data.
pub fn options(folder: &Path, name: &str) -> TrainOptions {
    TrainOptions {
        out: folder.join(name),
        data_root: folder.join("data"),
        init: None,
        fresh: false,
        reset_optimizer: false,
        time_limit: None,
        stop_at: None,
        device: Device::default(),
        interrupt: Arc::default(),
        observer: Arc::new(()),
    }
}

pub fn bits(path: &Path) -> Vec<(String, Vec<u32>)> {
    let file = TensorFile::read(path).unwrap();
    let of = |data: &burn::tensor::TensorData| data.iter::<f32>().map(f32::to_bits).collect();
    file.tensors.iter().map(|(name, data)| (name.clone(), of(data))).collect()
}

pub fn losses(run: &Path) -> Vec<f64> {
    let events = Journal::read(&run.join("metrics.jsonl")).unwrap();
    let of = |event: &Event| match event {
        Event::Step(record) => Some(record.loss),
        Event::Validation(_) => None,
    };
    events.iter().filter_map(of).collect()
}
