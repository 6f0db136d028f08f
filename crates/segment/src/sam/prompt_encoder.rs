//! Points and boxes as tokens, and the positions of the image's patches: sines and cosines of random frequencies. Field
//! names are the published ones.

use std::f64::consts::TAU;

use burn::{
    module::{Module, Param},
    tensor::{Device, Tensor, TensorData},
};

use super::layers::{Embedding, parameter};

/// Embeddings by kind of point: outside, inside, upper left and lower right corner of a box.
const KINDS: usize = 4;
/// Index of points inside an object.
const INSIDE: usize = 1;
/// Index of the upper left corner of a box; the lower right one follows.
const CORNERS: usize = 2;

/// Encodes points and boxes.
#[derive(Module, Debug)]
pub struct PromptEncoder {
    pub(super) pe_layer: PositionEmbeddingRandom,
    /// By kind of point, `[1, D]` each.
    pub(super) point_embeddings: Vec<Embedding>,
    /// Stands for the absent box of a point, `[1, D]`.
    pub(super) not_a_point_embed: Embedding,
    /// Stands for the absent mask, `[1, D]`.
    pub(super) no_mask_embed: Embedding,
    image_size: usize,
}

/// Random frequencies.
#[derive(Module, Debug)]
pub struct PositionEmbeddingRandom {
    /// `[2, D / 2]`.
    pub positional_encoding_gaussian_matrix: Param<Tensor<2>>,
}

impl PromptEncoder {
    /// `width` channels, for images of `image_size` pixels.
    pub(super) fn new(width: usize, image_size: usize, device: &Device) -> Self {
        let embedding = || Embedding::new(1, width, device);
        let frequencies = parameter([2, width / 2], device);
        Self {
            pe_layer: PositionEmbeddingRandom { positional_encoding_gaussian_matrix: frequencies },
            point_embeddings: (0..KINDS).map(|_| embedding()).collect(),
            not_a_point_embed: embedding(),
            no_mask_embed: embedding(),
            image_size,
        }
    }

    /// Points inside objects, x and y in pixels of the padded input, each a prompt of its own: `[P, 2, D]`, the point and
    /// a token that stands for the absent box.
    pub fn embed_points(&self, points: &[[f64; 2]]) -> Tensor<3> {
        let count = points.len();
        let tokens = self.at(points).unsqueeze_dim::<3>(1) + self.kind(INSIDE); // [P, 1, D]
        let width = tokens.dims()[2];
        let none = self.not_a_point_embed.weight.val().unsqueeze::<3>().expand([count, 1, width]);
        Tensor::cat(vec![tokens, none], 1)
    }

    /// A box by its upper left and lower right corner: `[1, 2, D]`.
    pub fn embed_box(&self, corners: [[f64; 2]; 2]) -> Tensor<3> {
        let kinds = Tensor::cat(vec![self.kind(CORNERS), self.kind(CORNERS + 1)], 1);
        self.at(&corners).unsqueeze::<3>() + kinds
    }

    /// Positions of the patches of a grid, `[1, h w, D]`.
    pub fn positions(&self, [h, w]: [usize; 2]) -> Tensor<3> {
        let at = |index: usize, count: usize| (index as f64 + 0.5) / count as f64;
        let points: Vec<[f64; 2]> =
            (0..h).flat_map(|row| (0..w).map(move |column| [at(column, w), at(row, h)])).collect();
        self.encode(&points).unsqueeze()
    }

    /// What is added to the image when no mask is given, `[1, 1, D]`.
    pub(super) fn no_mask(&self) -> Tensor<3> {
        self.no_mask_embed.weight.val().unsqueeze()
    }

    /// `[1, 1, D]`.
    fn kind(&self, index: usize) -> Tensor<3> {
        self.point_embeddings[index].weight.val().unsqueeze()
    }

    /// The centres of pixels, `[P, D]`.
    fn at(&self, pixels: &[[f64; 2]]) -> Tensor<2> {
        let side = self.image_size as f64;
        let points: Vec<[f64; 2]> = pixels.iter().map(|p| p.map(|x| (x + 0.5) / side)).collect();
        self.encode(&points)
    }

    /// Points of the unit square, `[P, D]`.
    fn encode(&self, points: &[[f64; 2]]) -> Tensor<2> {
        let matrix = self.pe_layer.positional_encoding_gaussian_matrix.val();
        let values: Vec<f32> = points.iter().flatten().map(|x| (2.0 * x - 1.0) as f32).collect();
        let points = Tensor::from_data(TensorData::new(values, [points.len(), 2]), &matrix.device());
        let angles: Tensor<2> = points.matmul(matrix) * TAU;
        Tensor::cat(vec![angles.clone().sin(), angles.cos()], 1)
    }
}
