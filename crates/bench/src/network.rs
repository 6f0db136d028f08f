//! Networks among the methods: what their configuration leaves out, and how they are called.

use std::path::Path;

use serde::Serialize;
use unopose_core::{
    config::{ModelConfig, OverlapMode},
    frame::MaskedView,
};
use unopose_infer::{InferError, PoseEstimator};
use unopose_nn::device::DeviceChoice;
use unopose_pairs::registration::{PairEstimator, PairPose, Refinement, RegistrationError};

/// The paper's ingredients that a network has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Switches {
    /// Global reference frame.
    pub(crate) grf: bool,
    /// Local reference frames.
    pub(crate) lrf: bool,
    /// Fine stage.
    pub(crate) fine: bool,
    /// Overlap prediction.
    pub(crate) overlap: bool,
}

impl Switches {
    fn of(config: &ModelConfig) -> Self {
        Self {
            grf: config.use_grf,
            lrf: config.fine.use_lrf,
            fine: config.use_fine,
            overlap: config.overlap != OverlapMode::Off,
        }
    }

    /// `unopose`, or `sam6d-style` without frames and overlap, as the paper adapts SAM-6D.
    pub(crate) fn name(self) -> &'static str {
        let Self { grf, lrf, overlap, .. } = self;
        if grf || lrf || overlap { "unopose" } else { "sam6d-style" }
    }
}

/// A network under a name of its own.
pub struct Network {
    name: String,
    estimator: PoseEstimator,
}

impl Network {
    /// Of a checkpoint, else the default one. Among several a network is called as its file.
    pub fn load(
        path: Option<&Path>,
        device: DeviceChoice,
        seed: u64,
        several: bool,
    ) -> Result<Self, InferError> {
        let estimator = match path {
            Some(path) => PoseEstimator::load(path, device)?,
            None => PoseEstimator::load_default(device)?,
        };
        let estimator = estimator.with_seed(seed);
        let stem = path.and_then(Path::file_stem).filter(|_| several);
        let name = match stem {
            Some(stem) => stem.to_string_lossy().replace(|c: char| !c.is_ascii_alphanumeric(), "-"),
            None => Switches::of(estimator.config()).name().to_owned(),
        };
        Ok(Self { name, estimator })
    }

    /// The ingredients that its configuration has.
    pub fn switches(&self) -> Switches {
        Switches::of(self.estimator.config())
    }
}

impl PairEstimator for Network {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn fingerprint(&self) -> String {
        self.estimator.fingerprint()
    }

    fn estimate(&self, query: MaskedView, reference: MaskedView) -> Result<PairPose, RegistrationError> {
        PairEstimator::estimate(&self.estimator, query, reference)
    }

    fn estimate_refined(
        &self,
        query: MaskedView,
        reference: MaskedView,
        refinement: Refinement,
    ) -> Option<Result<PairPose, RegistrationError>> {
        self.estimator.estimate_refined(query, reference, refinement)
    }

    fn refines_itself(&self) -> bool {
        self.estimator.refines_itself()
    }
}
