//! The UNOPose network (CVPR 2025): colour features, geometric structure embedding, coarse and fine matching.
//!
//! Everything without a gradient (frames, neighbourhoods, distances, angles, sampling) comes prepared in
//! [`PairTensors`]; the network sees tensors only and knows no files. Field names mirror the official state names, so
//! the published weights load with no more mapping than layout.

mod attention;
mod batch_norm;
mod conv_encoder;
mod encoded_cloud;
mod feature_extraction;
pub mod fused;
mod geo_embedding;
mod hybrid_encoder;
mod init;
mod linear_attention;
mod matching;
mod positional_encoding;
mod precision;
mod proposals;
mod rows;
mod sparse_to_dense;
mod stages;
mod student;
mod tensors;
mod transformer;
mod vit;

pub use attention::MultiHeadAttention;
pub use encoded_cloud::{EncodedCloud, SelfAttended};
pub use feature_extraction::{FeatureExtraction, PixelChoice};
pub use geo_embedding::GeometricStructureEmbedding;
pub use init::Initializer;
pub use linear_attention::LinearTransformerLayer;
pub use matching::BlockOutput;
pub use positional_encoding::{GroupTensors, PositionalEncoding};
pub use proposals::{ProposalNetwork, ProposalOutput};
pub use sparse_to_dense::{DenseTokens, SparseToDenseTransformer};
pub use stages::{CoarsePointMatching, FinePointMatching, Supervision};
pub use student::Student;
pub use tensors::{
    CloudTensors, PairTensors, PoseTensors, SparseRows, StructureTensors, ViewTensors, group_tensors,
    into_group_tensors,
};
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
    /// Colour features of the points.
    pub feature_extraction: FeatureExtraction,
    /// Embedding of distances and angles.
    pub geo_embedding: GeometricStructureEmbedding,
    /// Matching of the sparse points.
    pub coarse_point_matching: CoarsePointMatching,
    /// Matching of the dense points; `None` with `use_fine = false`.
    pub fine_point_matching: Option<FinePointMatching>,
}

/// Block outputs of both stages (the fine list is empty without a fine stage).
#[derive(Clone, Debug)]
pub struct MatchingOutputs {
    /// Colour features of the dense points of query and reference, `[B, N, C_color]`.
    pub colors: [Tensor<3>; 2],
    /// Compared blocks of the coarse stage.
    pub coarse: Vec<BlockOutput>,
    /// Compared blocks of the fine stage.
    pub fine: Vec<BlockOutput>,
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
    pub fn encode(&self, cloud: &CloudTensors) -> EncodedCloud {
        self.encode_structure(&cloud.structure, &cloud.rows, self.colors(&cloud.view))
    }

    /// Colour features of the dense points `[B, N, C_color]`.
    pub fn colors(&self, view: &ViewTensors) -> Tensor<3> {
        self.feature_extraction.forward(view.images.clone(), &view.choose)
    }

    /// [`Self::encode`] with colour features `[B, N, C_color]` that are already there.
    pub fn encode_structure(
        &self,
        structure: &StructureTensors,
        rows: &SparseRows,
        colors: Tensor<3>,
    ) -> EncodedCloud {
        let embedding = self.geo_embedding.forward(structure.distances.clone(), structure.angles.clone());
        EncodedCloud::new(colors, embedding, rows.clone())
    }

    /// Adds what can be kept of a cloud that meets many others: the first self-attention of both stages, which looks at no
    /// other cloud.
    pub fn with_self_attention(&self, cloud: EncodedCloud) -> EncodedCloud {
        let coarse = self.coarse_point_matching.self_attention(&cloud);
        let fine = match (&self.fine_point_matching, &cloud.position) {
            (Some(stage), Some(_)) => stage.self_attention(&cloud),
            _ => None,
        };
        EncodedCloud { attended: SelfAttended { coarse: Some(coarse), fine }, ..cloud }
    }

    /// [`Self::encode`] of two batches of clouds. Clouds of equal sizes share the pass over their images, which
    /// reads the weights once, and the tables of the structure embedding.
    pub fn encode_both(&self, a: &CloudTensors, b: &CloudTensors) -> [EncodedCloud; 2] {
        if a.view.choose.points() != b.view.choose.points() {
            return [self.encode(a), self.encode(b)];
        }
        let counts = [a, b].map(|cloud| cloud.view.images.dims()[0]);
        let starts = [0, counts[0]];
        let images = Tensor::cat(vec![a.view.images.clone(), b.view.images.clone()], 0);
        let dense = self.feature_extraction.forward(images, &a.view.choose.chain(&b.view.choose));
        let part = |side: usize| dense.clone().narrow(0, starts[side], counts[side]);
        if a.structure.angles.dims()[1..] != b.structure.angles.dims()[1..] {
            return [(a, part(0)), (b, part(1))]
                .map(|(cloud, colors)| self.encode_structure(&cloud.structure, &cloud.rows, colors));
        }
        let both = a.structure.chain(&b.structure);
        let embedding = self.geo_embedding.forward(both.distances, both.angles);
        [(a, 0), (b, 1)].map(|(cloud, side)| {
            let embedding = embedding.clone().narrow(0, starts[side], counts[side]);
            EncodedCloud::new(part(side), embedding, cloud.rows.clone())
        })
    }

    /// Coarse stage on encoded clouds.
    pub fn coarse(
        &self,
        query: &EncodedCloud,
        reference: &EncodedCloud,
        which: Supervision,
    ) -> Vec<BlockOutput> {
        self.coarse_point_matching.forward(query, reference, which)
    }

    /// Fine stage on encoded clouds with their positional encodings; empty without a fine stage or an encoding.
    pub fn fine(
        &self,
        query: &EncodedCloud,
        reference: &EncodedCloud,
        which: Supervision,
    ) -> Vec<BlockOutput> {
        match &self.fine_point_matching {
            Some(stage) if query.position.is_some() && reference.position.is_some() => {
                stage.forward(query, reference, which)
            }
            _ => Vec::new(),
        }
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
        let [at_query, at_reference] = positions;
        let query = EncodedCloud { position: at_query, ..self.encode(&batch.query) };
        let reference = EncodedCloud { position: at_reference, ..self.encode(&batch.reference) };
        self.forward_encoded(&query, &reference)
    }

    /// Every block of both stages on encoded clouds.
    pub fn forward_encoded(&self, query: &EncodedCloud, reference: &EncodedCloud) -> MatchingOutputs {
        MatchingOutputs {
            colors: [query.dense.clone(), reference.dense.clone()],
            coarse: self.coarse(query, reference, Supervision::AllBlocks),
            fine: self.fine(query, reference, Supervision::AllBlocks),
        }
    }
}
