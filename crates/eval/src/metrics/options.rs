//! What the caller of the scoring chooses.

use unopose_dataset::formats::BopDataset;

use super::bins::RotationBins;

/// What scoring leaves open.
#[derive(Clone, Copy)]
pub struct ScoreOptions<'a> {
    /// VSD's tolerance of visibility, metres.
    pub delta: f64,
    /// Rotations between target and reference views, for the bins.
    pub rotations: Option<&'a RotationBins>,
    /// Called after every image with the numbers of images done (not in order) and of all images.
    pub progress: &'a (dyn Fn(usize, usize) + Sync),
}

impl ScoreOptions<'_> {
    /// BOP's parameters for a dataset: 15 mm, 5 mm for ITODD.
    pub fn for_dataset(dataset: &BopDataset) -> Self {
        let delta = if dataset.name().eq_ignore_ascii_case("itodd") { 0.005 } else { 0.015 };
        Self { delta, rotations: None, progress: &|_, _| {} }
    }
}
