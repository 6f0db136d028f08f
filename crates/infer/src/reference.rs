//! A reference view that is kept for its queries.

use std::sync::OnceLock;

use unopose_nn::model::EncodedCloud;
use unopose_pairs::data::CloudInput;

use super::{CloudPair, IcpReference, point_features::PointFeatures};

/// A reference view, prepared and encoded once for any number of queries.
pub struct Reference {
    pub(super) cloud: CloudInput,
    pub(super) radius: f32,
    pub(super) encoded: EncodedCloud,
    pub(super) points: Vec<[f32; 3]>,
    pub(super) surface: OnceLock<Option<IcpReference>>,
    pub(super) features: OnceLock<Option<PointFeatures>>,
    pub(super) seconds: f64,
}

impl Reference {
    /// All measured points of the masked view, metres, reference camera's frame.
    pub fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    /// sRGB of [`Self::points`]; `None` for a reference that was kept without its colours.
    pub fn colors(&self) -> Option<Vec<[u8; 3]>> {
        let view = self.cloud.view.as_ref()?;
        Some(self.points.iter().map(|p| view.rgb_at(p)).collect())
    }

    /// The view as the network sees it.
    pub fn cloud(&self) -> &CloudInput {
        &self.cloud
    }

    /// Beside a query's cloud that was prepared against this reference.
    pub fn pair<'a>(&'a self, query: &'a CloudInput) -> CloudPair<'a> {
        CloudPair { query, reference: &self.cloud, radius: self.radius }
    }

    /// The surface for refinement, made on first use; `None` when the points make none.
    pub fn surface(&self) -> Option<&IcpReference> {
        let surface = || {
            let surface = IcpReference::new(&self.points)?;
            Some(match &self.cloud.view {
                Some(view) => surface.with_colors(view),
                None => surface,
            })
        };
        self.surface.get_or_init(surface).as_ref()
    }

    /// The colour encoder's features of the dense points, read from the device on first use; `None` when they cannot be.
    pub(super) fn features(&self) -> Option<&PointFeatures> {
        let read = || PointFeatures::of_batch(&self.encoded.dense).ok()?.pop();
        self.features.get_or_init(read).as_ref()
    }

    /// Largest distance of the sampled points to their mean, metres.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Seconds its preparation took.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// About the memory that keeping it takes.
    pub fn bytes(&self) -> usize {
        self.encoded.bytes()
            + 12 * (self.points.len() + self.cloud.points.len())
            + 4 * (self.cloud.rgb.len() + self.cloud.choose.len() + self.cloud.sparse.len())
            + 4 * (self.cloud.structure.distances.len() + self.cloud.structure.angles.len())
    }
}
