//! Colour features of the points (`feature_extraction.rgb_net` of the release): an image encoder whose maps are
//! sampled bilinearly at the points' pixels only, which equals sampling the up-sampled map.

use burn::{
    module::{Module, Param},
    nn::Linear,
    tensor::{Int, Tensor, TensorData},
};
use unopose_core::config::{ColorConfig, ModelConfig};

use super::{
    conv_encoder::ConvEncoder,
    fused::{sampled_linear, weighted_rows},
    hybrid_encoder::HybridEncoder,
    init::Initializer,
    precision::{like, single},
    rows::select_rows,
    vit::VisionTransformer,
};

/// Image encoder and its read-out at the points.
#[derive(Module, Debug)]
pub struct FeatureExtraction {
    /// The encoder of the configuration.
    pub rgb_net: RgbNet,
}

/// Exactly one of `vit` (with `output_upscaling`), `conv` or `hybrid` (with `project`) and `constant` is present.
#[derive(Module, Debug)]
pub struct RgbNet {
    pub vit: Option<VisionTransformer>,
    pub output_upscaling: Option<Linear>,
    pub conv: Option<ConvEncoder>,
    pub hybrid: Option<HybridEncoder>,
    pub project: Option<Linear>,
    pub constant: Option<Param<Tensor<1>>>,
    image_size: usize,
    out_dim: usize,
}

/// Up-sampling factor of the transformer's patch grid.
const UPSCALING: usize = 4;

impl FeatureExtraction {
    /// With the encoder that `config.color` names.
    pub fn new(config: &ModelConfig, init: &mut Initializer) -> Self {
        let out_dim = config.color.out_dim();
        let mut net = RgbNet {
            vit: None,
            output_upscaling: None,
            conv: None,
            hybrid: None,
            project: None,
            constant: None,
            image_size: config.image_size,
            out_dim,
        };
        match &config.color {
            ColorConfig::Vit(vit) => {
                let network = VisionTransformer::new(vit, config.image_size, init);
                net.vit = Some(if vit.freeze { network.no_grad() } else { network });
                net.output_upscaling = Some(init.linear(4 * vit.embed_dim, UPSCALING * UPSCALING * out_dim));
            }
            ColorConfig::Conv { channels, .. } => {
                net.conv = Some(ConvEncoder::new(*channels, init));
                net.project = Some(init.linear(channels.iter().sum(), out_dim));
            }
            ColorConfig::Hybrid(hybrid) => {
                net.hybrid = Some(HybridEncoder::new(hybrid, config.image_size, init));
                let channels = hybrid.channels.iter().sum::<usize>() + hybrid.embed_dim;
                net.project = Some(init.linear(channels, out_dim));
            }
            ColorConfig::None { .. } => net.constant = Some(init.normal([out_dim], 1.0)),
        }
        Self { rgb_net: net }
    }

    /// Images `[B, 3, S, S]` and, per item, `N` pixel indices into the `S x S` crop, to features `[B, N, out_dim]`, in single
    /// precision whatever they were computed in: kept references go with new ones into one batch.
    pub fn forward(&self, images: Tensor<4>, choose: &PixelChoice) -> Tensor<3> {
        single(self.rgb_net.forward(images, choose))
    }
}

impl RgbNet {
    fn forward(&self, images: Tensor<4>, choose: &PixelChoice) -> Tensor<3> {
        let batch = images.dims()[0];
        if let (Some(project), Some(maps)) = (&self.project, self.maps(&images)) {
            let sampled = maps.map(|map| sample_map(map, choose, self.image_size));
            return project.forward(Tensor::cat(sampled.to_vec(), 2));
        }
        if let Some(vit) = &self.vit {
            let images = like(images, &vit.pos_embed);
            let side = self.image_size / vit.patch_size();
            let taps = PatchTaps::new(choose, self.image_size, side, batch);
            return self.sample_patches(vit.forward_at(images, &taps.used), taps, choose);
        }
        let constant = self.constant.as_ref().map(Param::val);
        let constant = constant.unwrap_or_else(|| Tensor::zeros([self.out_dim], &images.device()));
        constant.unsqueeze::<3>().expand([batch, choose.points, self.out_dim])
    }

    /// The levels that `project` reads.
    fn maps(&self, images: &Tensor<4>) -> Option<[Tensor<4>; 3]> {
        let images = like(images.clone(), &self.project.as_ref()?.weight);
        match (&self.conv, &self.hybrid) {
            (Some(conv), _) => Some(conv.forward(images)),
            (None, hybrid) => Some(hybrid.as_ref()?.forward(images)),
        }
    }

    /// The whole up-sampled map `[B, out_dim, 4 S / patch, 4 S / patch]` of the transformer's tokens
    /// `[B, patches, 4 * embed_dim]`, for comparison; empty without a transformer.
    pub fn upscaled_tokens(&self, tokens: Tensor<3>) -> Tensor<4> {
        match &self.output_upscaling {
            Some(upscaling) => self.unfold(upscaling, tokens),
            None => Tensor::zeros([tokens.dims()[0], self.out_dim, 1, 1], &tokens.device()),
        }
    }

    /// Bilinear samples of a map `[B, C, side, side]` at the chosen pixels: `[B, N, C]`.
    pub fn sample(&self, map: Tensor<4>, choose: &PixelChoice) -> Tensor<3> {
        sample_map(map, choose, self.image_size)
    }

    /// [`Self::sample`] of the up-sampled map of the transformer's tokens `[B, patches, 4 * embed_dim]`. Only the patches
    /// around the chosen pixels are computed, and none is moved to its place in the map. Zeros without a transformer.
    pub fn sample_tokens(&self, tokens: Tensor<3>, choose: &PixelChoice) -> Tensor<3> {
        let [batch, patches, channels] = tokens.dims();
        let taps = PatchTaps::new(choose, self.image_size, patches.isqrt(), batch);
        let used: Vec<i32> = taps.used.iter().map(|&patch| patch as i32).collect();
        let count = used.len();
        let used = Tensor::<1, Int>::from_data(TensorData::new(used, [count]), &tokens.device().inner());
        let tokens = select_rows(tokens.reshape([batch * patches, channels]), used);
        self.sample_patches(tokens, taps, choose)
    }

    /// [`Self::sample_tokens`] from the tokens of the used patches only, `[n, 4 * embed_dim]`.
    fn sample_patches(&self, tokens: Tensor<2>, taps: PatchTaps, choose: &PixelChoice) -> Tensor<3> {
        let shape = [choose.batch, choose.points, self.out_dim];
        match &self.output_upscaling {
            Some(upscaling) => {
                sampled_linear(tokens, upscaling, self.out_dim, taps.rows, taps.weights).reshape(shape)
            }
            None => Tensor::zeros(shape, &tokens.device()),
        }
    }

    fn unfold(&self, upscaling: &Linear, tokens: Tensor<3>) -> Tensor<4> {
        let [batch, patches, _] = tokens.dims();
        let side = patches.isqrt();
        upscaling
            .forward(tokens) // [B, side * side, 4 * 4 * C]
            .reshape([batch, side, side, UPSCALING, UPSCALING, self.out_dim])
            .permute([0, 5, 1, 3, 2, 4]) // [B, C, side, 4, side, 4]
            .reshape([batch, self.out_dim, side * UPSCALING, side * UPSCALING])
    }
}

/// Where bilinear samples of the transformer's up-sampled map read.
struct PatchTaps {
    /// Patches `[B * side * side]` that are read at all, image by image.
    used: Vec<usize>,
    /// Four rows per point in the list of the used patches' cells.
    rows: Vec<i32>,
    weights: Vec<f32>,
}

impl PatchTaps {
    fn new(choose: &PixelChoice, image_size: usize, side: usize, batch: usize) -> Self {
        let cells = UPSCALING * UPSCALING;
        let (mut rows, weights) = choose.taps(image_size, side * UPSCALING, |row, column| {
            let patch = row / UPSCALING * side + column / UPSCALING;
            patch * cells + row % UPSCALING * UPSCALING + column % UPSCALING
        });
        let mut place = vec![None; batch * side * side];
        let mut used = Vec::new();
        for row in &mut rows {
            let patch = *row as usize / cells;
            let at = *place[patch].get_or_insert_with(|| {
                used.push(patch);
                used.len() - 1
            });
            *row = (at * cells) as i32 + *row % cells as i32;
        }
        Self { used, rows, weights }
    }
}

/// The pixels of `N` points per item inside the square crop.
#[derive(Clone, Debug)]
pub struct PixelChoice {
    /// `row * S + col`, `[B * N]`.
    index: Vec<u32>,
    batch: usize,
    points: usize,
}

impl PixelChoice {
    /// One list of `N` indices per item.
    pub fn new<'a>(items: impl Iterator<Item = &'a [u32]>) -> Self {
        let (mut index, mut batch) = (Vec::new(), 0);
        for item in items {
            index.extend_from_slice(item);
            batch += 1;
        }
        let points = index.len() / batch.max(1);
        Self { index, batch, points }
    }

    /// The items of both, one after the other; both have the same number of points.
    pub fn chain(&self, other: &Self) -> Self {
        let index = [self.index.as_slice(), &other.index].concat();
        Self { index, batch: self.batch + other.batch, points: self.points }
    }

    /// Points per item.
    pub fn points(&self) -> usize {
        self.points
    }

    /// The first `count` points of every item.
    pub fn first(&self, count: usize) -> Self {
        let count = count.min(self.points);
        let of_item = |item: &[u32]| item[..count].to_vec();
        let index = self.index.chunks(self.points.max(1)).flat_map(of_item).collect();
        Self { index, batch: self.batch, points: count }
    }

    /// `row * S + column` of every point, item by item.
    pub fn pixels(&self) -> &[u32] {
        &self.index
    }

    /// The items `first..first + count`.
    pub fn items(&self, first: usize, count: usize) -> Self {
        let index = self.index[first * self.points..(first + count) * self.points].to_vec();
        Self { index, batch: count, points: self.points }
    }

    /// The same points in crops whose side is `factor` times shorter: `image_size` is the side of the present ones.
    pub fn reduced(&self, image_size: usize, factor: usize) -> Self {
        let (size, factor) = (image_size as u32, factor as u32);
        let reduce = |&pixel: &u32| pixel / size / factor * (size / factor) + pixel % size / factor;
        Self { index: self.index.iter().map(reduce).collect(), ..*self }
    }

    /// Bilinear samples (align_corners = false) of a square grid of tokens `[B, side * side, C]`, row by row, that covers the
    /// crops of `image_size` pixels: `[B, N, C]`.
    pub fn sample_grid(&self, tokens: Tensor<3>, image_size: usize) -> Tensor<3> {
        let [batch, cells, channels] = tokens.dims();
        let side = cells.isqrt();
        let (rows, weights) = self.taps(image_size, side, |row, column| row * side + column);
        let samples = weighted_rows(tokens.reshape([batch * cells, channels]), rows, weights);
        samples.reshape([self.batch, self.points, channels])
    }

    /// Rows of the four neighbours in a flattened `[B * side * side]` map, whose order within an item is `place(row,
    /// column)`, and their weights (half-pixel convention, borders clamped), `[B * N * 4]` each.
    fn taps(
        &self,
        image_size: usize,
        side: usize,
        place: impl Fn(usize, usize) -> usize,
    ) -> (Vec<i32>, Vec<f32>) {
        let scale = side as f32 / image_size as f32;
        let axis = |pixel: u32| {
            let x = ((pixel as f32 + 0.5) * scale - 0.5).max(0.0);
            let low = (x as usize).min(side - 1);
            (low, (low + 1).min(side - 1), x - low as f32)
        };
        let mut rows = Vec::with_capacity(self.index.len() * 4);
        let mut weights = Vec::with_capacity(self.index.len() * 4);
        for (k, &pixel) in self.index.iter().enumerate() {
            let base = k / self.points * side * side;
            let (row0, row1, fy) = axis(pixel / image_size as u32);
            let (col0, col1, fx) = axis(pixel % image_size as u32);
            for (row, wy) in [(row0, 1.0 - fy), (row1, fy)] {
                for (col, wx) in [(col0, 1.0 - fx), (col1, fx)] {
                    rows.push((base + place(row, col)) as i32);
                    weights.push(wy * wx);
                }
            }
        }
        (rows, weights)
    }
}

/// Bilinear samples (align_corners = false) of a square map `[B, C, side, side]` at the chosen pixels: `[B, N, C]`.
fn sample_map(map: Tensor<4>, choose: &PixelChoice, image_size: usize) -> Tensor<3> {
    let [batch, channels, side, _] = map.dims();
    choose.sample_grid(map.permute([0, 2, 3, 1]).reshape([batch, side * side, channels]), image_size)
}
