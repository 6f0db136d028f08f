//! Optimisation, its schedule, and what a training run writes when.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Precision;

/// The training loop. Defaults are the release's (`docs/network.md`, section 8).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Optimizer steps of the whole run. The learning rate reaches zero at the last one.
    pub steps: u64,
    /// Pairs per forward and backward pass.
    pub batch_size: usize,
    /// Forward and backward passes whose gradients are averaged into one optimizer step.
    pub accumulation: usize,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Adam's decay rates of the first and second moment.
    pub betas: [f32; 2],
    /// Number added to the denominator of Adam's update.
    pub epsilon: f32,
    /// Steps of linear warm-up.
    pub warmup_steps: u64,
    /// Share of the peak learning rate at step 0.
    pub warmup_factor: f64,
    /// Largest global gradient norm. Larger gradients are scaled down. 0: no clipping.
    pub clip_norm: f64,
    /// Decay per step of the exponential moving average of the weights, which is validated and saved as the best weights.
    /// 0: no average.
    pub ema_decay: f64,
    /// Steps between validations. The first is before training, the last at its end.
    pub validate_every: u64,
    /// Minutes between validations, where that is sooner than `validate_every`. 0: by steps only.
    pub validate_minutes: f64,
    /// Pairs per validation; images of a proposal network.
    pub validation_pairs: usize,
    /// Images of the generated validation set.
    pub validation_images: usize,
    /// Seconds between checkpoints of the whole training state.
    pub checkpoint_seconds: f64,
    /// Number type of the network's products. Weights and optimizer state are single precision in any case.
    pub precision: Precision,
    /// Threads that prepare pairs. 0: one per core.
    pub workers: usize,
    /// Batches that are prepared ahead.
    pub prefetch: usize,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            steps: 188_340,
            batch_size: 32,
            accumulation: 1,
            learning_rate: 1e-4,
            betas: [0.5, 0.999],
            epsilon: 1e-6,
            warmup_steps: 1000,
            warmup_factor: 1e-3,
            clip_norm: 0.0,
            ema_decay: 0.0,
            validate_every: 5000,
            validate_minutes: 0.0,
            validation_pairs: 64,
            validation_images: 100,
            checkpoint_seconds: 600.0,
            precision: Precision::F32,
            workers: 0,
            prefetch: 2,
        }
    }
}
