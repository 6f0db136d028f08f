//! The UNOPose network (CVPR 2025): colour features, geometric structure embedding, coarse and fine matching.
//!
//! Everything without a gradient (frames, neighbourhoods, distances, angles, sampling) comes prepared in
//! [`PairTensors`]; the network sees tensors only and knows no files. Field names mirror the official state names, so
//! the published weights load with no more mapping than layout.

mod attention;
mod batch_norm;
mod conv_encoder;
mod feature_extraction;
pub mod fused;
mod geo_embedding;
mod init;
mod linear_attention;
mod matching;
mod positional_encoding;
mod precision;
mod rows;
mod sparse_to_dense;
mod stages;
mod tensors;
mod transformer;
mod vit;

pub use attention::MultiHeadAttention;
pub use feature_extraction::{FeatureExtraction, PixelChoice};
pub use geo_embedding::GeometricStructureEmbedding;
pub use init::Initializer;
pub use linear_attention::LinearTransformerLayer;
pub use matching::BlockOutput;
pub use positional_encoding::{GroupTensors, PositionalEncoding};
pub use sparse_to_dense::{DenseTokens, SparseToDenseTransformer};
pub use stages::{CoarseInput, CoarsePointMatching, FineInput, FinePointMatching, Supervision};
pub use tensors::{CloudTensors, PairTensors, PoseTensors, group_tensors, into_group_tensors};
pub use transformer::{GeometricTransformer, TransformerLayer};
pub use vit::VisionTransformer;

use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use unopose_core::config::ModelConfig;

/// The whole network.
#[derive(Module, Debug)]
pub struct UnoPose {
    pub feature_extraction: FeatureExtraction,
    pub geo_embedding: GeometricStructureEmbedding,
    pub coarse_point_matching: CoarsePointMatching,
    pub fine_point_matching: Option<FinePointMatching>,
}

/// Block outputs of both stages (the fine list is empty without a fine stage).
#[derive(Clone, Debug)]
pub struct MatchingOutputs {
    pub coarse: Vec<BlockOutput>,
    pub fine: Vec<BlockOutput>,
}

/// What the matching stages need of a cloud and what can be kept for later queries.
#[derive(Clone, Debug)]
pub struct CloudFeatures {
    /// Colour features of the dense points `[B, N, C_color]`.
    pub dense: Tensor<3>,
    /// Structure embedding `[B, 1 + M, 1 + M, C]`.
    pub embedding: Tensor<4>,
    pub own: OwnLayers,
}

/// Sparse tokens of a cloud after the first layer of the coarse and of the fine stage, which do not look at the other
/// cloud, `[B, 1 + M, C]`; `None` where they are not kept but computed with the rest.
#[derive(Clone, Debug, Default)]
pub struct OwnLayers {
    pub coarse: Option<Tensor<3>>,
    pub fine: Option<Tensor<3>>,
}

impl UnoPose {
    /// A freshly initialised network; the same seed gives the same weights on every device.
    pub fn new(config: &ModelConfig, seed: u64, device: &Device) -> Self {
        let init = &mut Initializer::new(seed, device);
        Self {
            feature_extraction: FeatureExtraction::new(config, init),
            geo_embedding: GeometricStructureEmbedding::new(&config.geo_embedding, init),
            coarse_point_matching: CoarsePointMatching::new(config, init),
            fine_point_matching: config.use_fine.then(|| FinePointMatching::new(config, init)),
        }
    }

    /// Colour features and structure embedding of a batch of clouds.
    pub fn encode(&self, cloud: &CloudTensors) -> CloudFeatures {
        self.encode_structure(cloud, self.feature_extraction.forward(cloud.images.clone(), &cloud.choose))
    }

    /// [`Self::encode`] with colour features `[B, N, C_color]` that are already there.
    pub fn encode_structure(&self, cloud: &CloudTensors, colors: Tensor<3>) -> CloudFeatures {
        let embedding = self.geo_embedding.forward(cloud.distances.clone(), cloud.angles.clone());
        CloudFeatures { dense: colors, embedding, own: OwnLayers::default() }
    }

    /// Adds the first layers of both stages to what can be kept of a cloud with its positional encoding.
    pub fn with_own_layers(
        &self,
        cloud: &CloudTensors,
        features: CloudFeatures,
        position: Option<Tensor<3>>,
    ) -> CloudFeatures {
        let coarse = self.coarse_point_matching.own(&coarse_input(cloud, &features));
        let fine = match (&self.fine_point_matching, position) {
            (Some(stage), Some(position)) => stage.own(fine_input(cloud, &features, position)),
            _ => None,
        };
        CloudFeatures { own: OwnLayers { coarse: Some(coarse), fine }, ..features }
    }

    /// [`Self::encode`] of two batches of clouds. Clouds of equal sizes share the pass over their images, which
    /// reads the weights once, and the tables of the structure embedding.
    pub fn encode_both(&self, a: &CloudTensors, b: &CloudTensors) -> [CloudFeatures; 2] {
        let (first, second) = (a.points.dims()[0], b.points.dims()[0]);
        if a.choose.points() != b.choose.points() {
            return [self.encode(a), self.encode(b)];
        }
        let images = Tensor::cat(vec![a.images.clone(), b.images.clone()], 0);
        let dense = self.feature_extraction.forward(images, &a.choose.chain(&b.choose));
        let colors =
            [(0, first), (first, second)].map(|(start, count)| dense.clone().narrow(0, start, count));
        if a.angles.dims()[1..] != b.angles.dims()[1..] {
            let [of_a, of_b] = colors;
            return [self.encode_structure(a, of_a), self.encode_structure(b, of_b)];
        }
        let distances = Tensor::cat(vec![a.distances.clone(), b.distances.clone()], 0);
        let angles = Tensor::cat(vec![a.angles.clone(), b.angles.clone()], 0);
        let embedding = self.geo_embedding.forward(distances, angles);
        let [of_a, of_b] = colors;
        [(of_a, 0, first), (of_b, first, second)].map(|(dense, start, count)| CloudFeatures {
            dense,
            embedding: embedding.clone().narrow(0, start, count),
            own: OwnLayers::default(),
        })
    }

    /// Coarse stage on encoded clouds.
    pub fn coarse(
        &self,
        query: (&CloudTensors, &CloudFeatures),
        reference: (&CloudTensors, &CloudFeatures),
        which: Supervision,
    ) -> Vec<BlockOutput> {
        let [query, reference] = [query, reference].map(|(cloud, features)| coarse_input(cloud, features));
        self.coarse_point_matching.forward(query, reference, which)
    }

    /// Fine stage on encoded clouds and their positional encodings `[B, N, C]`; empty without a fine stage.
    pub fn fine(
        &self,
        query: (&CloudTensors, &CloudFeatures, Tensor<3>),
        reference: (&CloudTensors, &CloudFeatures, Tensor<3>),
        which: Supervision,
    ) -> Vec<BlockOutput> {
        let Some(stage) = &self.fine_point_matching else { return Vec::new() };
        let [query, reference] =
            [query, reference].map(|(cloud, features, position)| fine_input(cloud, features, position));
        stage.forward(query, reference, which)
    }

    /// Training pass: the fine stage starts from the noisy pose that the batch's query neighbourhoods were built with.
    /// `groups` are the batch's, of the queries and of the references.
    pub fn forward_train(&self, batch: &PairTensors, groups: &[[GroupTensors; 2]; 2]) -> MatchingOutputs {
        self.forward_matching(batch, groups.each_ref().map(|groups| self.position(groups)))
    }

    /// Positional encoding `[B, N, C]` of a cloud's neighbourhoods; `None` without a fine stage.
    ///
    /// Its batch norm is the only operation that looks at more than one pair of a training batch.
    pub fn position(&self, groups: &[GroupTensors; 2]) -> Option<Tensor<3>> {
        self.fine_point_matching.as_ref().map(|stage| stage.position(groups))
    }

    /// [`Self::forward_train`] from the query's and the reference's positional encodings.
    pub fn forward_matching(
        &self,
        batch: &PairTensors,
        positions: [Option<Tensor<3>>; 2],
    ) -> MatchingOutputs {
        let query = self.encode(&batch.query);
        let reference = self.encode(&batch.reference);
        let coarse =
            self.coarse((&batch.query, &query), (&batch.reference, &reference), Supervision::AllBlocks);
        let fine = match positions {
            [Some(at_query), Some(at_reference)] => self.fine(
                (&batch.query, &query, at_query),
                (&batch.reference, &reference, at_reference),
                Supervision::AllBlocks,
            ),
            _ => Vec::new(),
        };
        MatchingOutputs { coarse, fine }
    }
}

fn coarse_input(cloud: &CloudTensors, features: &CloudFeatures) -> CoarseInput {
    CoarseInput {
        features: sparse_features(cloud, features),
        embedding: features.embedding.clone(),
        own: features.own.coarse.clone(),
    }
}

fn fine_input(cloud: &CloudTensors, features: &CloudFeatures, position: Tensor<3>) -> FineInput {
    FineInput {
        features: features.dense.clone(),
        position,
        sparse_rows: cloud.sparse_tokens.clone(),
        embedding: features.embedding.clone(),
        own: features.own.fine.clone(),
    }
}

/// `[B, N, C] -> [B, M, C]`.
fn sparse_features(cloud: &CloudTensors, features: &CloudFeatures) -> Tensor<3> {
    let [batch, n, width] = features.dense.dims();
    let count = cloud.sparse_points.dims()[0];
    let dense = features.dense.clone().reshape([batch * n, width]);
    rows::select_rows(dense, cloud.sparse_points.clone()).reshape([batch, count / batch, width])
}
