//! Settings of a [`PoseEstimator`] and what it says about itself.

use std::sync::OnceLock;

use unopose_core::config::{HypothesisConfig, ModelConfig, Precision};
use unopose_nn::device::{DeviceChoice, require_precision};

use super::{Calibration, InferError, PoseEstimator, Refinement};

impl PoseEstimator {
    /// Number type of the network's products, single precision at first. Only the first conversion counts: digits that
    /// one has taken away are gone.
    pub fn with_precision(mut self, precision: Precision) -> Result<Self, InferError> {
        require_precision(&self.device, precision)?;
        self.model = self.model.in_precision(precision);
        self.network = OnceLock::new();
        Ok(self)
    }

    /// Seed of point sampling and hypotheses, 0 at first.
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// How pose hypotheses are made and judged, at first as the checkpoint says. References prepared before keep what they
    /// were prepared with.
    pub fn with_hypotheses(mut self, hypotheses: HypothesisConfig) -> Self {
        self.config.hypotheses = hypotheses;
        self.network = OnceLock::new();
        self
    }

    /// Refinement after the network, none at first.
    pub fn with_refinement(mut self, refinement: Refinement) -> Self {
        self.refinement = refinement;
        self
    }

    /// The calibration of the confidence, at first the checkpoint's.
    pub fn with_calibration(mut self, calibration: Option<Calibration>) -> Self {
        self.calibration = calibration;
        self
    }

    /// Probability below which an estimate is not confident, at first the calibration's.
    pub fn with_min_confidence(mut self, min_confidence: Option<f64>) -> Self {
        self.min_confidence = min_confidence;
        self
    }

    /// The network's configuration.
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// `None`: estimates have no confidence.
    pub fn calibration(&self) -> Option<&Calibration> {
        self.calibration.as_ref()
    }

    /// What follows the network.
    pub fn refinement(&self) -> Refinement {
        self.refinement
    }

    /// Seed of point sampling and hypotheses.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Where the weights come from.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// The backend in use.
    pub fn backend(&self) -> DeviceChoice {
        self.backend
    }
}
