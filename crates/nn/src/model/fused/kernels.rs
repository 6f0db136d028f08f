//! Which fused operations there are, and their loops where a build has them.

use std::sync::atomic::{AtomicU32, Ordering};

use burn::{nn::Linear, tensor::Tensor};

use super::{AttentionMaps, FocusedMaps, PositionBias, TokenMaps, VisionMaps};

/// Kernels that are switched off, a bit each: see [`Kernel::switch`].
static OFF: AtomicU32 = AtomicU32::new(0);

/// Lists every kernel once: its name, where its loops are, and its arguments. A build without `flex` has none of them, and
/// every call answers `None`.
macro_rules! kernels {
    ($($kernel:ident: $module:ident::$name:ident $(<const $d:ident>)? ($($arg:ident: $type:ty),* $(,)?) -> $output:ty;)*) => {
        /// A fused operation.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Kernel {
            $(
                #[doc = concat!("`", stringify!($name), "`.")]
                $kernel
            ),*
        }

        impl Kernel {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$kernel),*];

            /// The name of its function.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$kernel => stringify!($name)),*
                }
            }
        }

        $(
            pub(super) fn $name $(<const $d: usize>)? ($($arg: $type),*) -> Option<$output> {
                #[cfg(feature = "flex")]
                if Kernel::$kernel.is_on() {
                    return super::flex::$module::$name($($arg),*);
                }
                let _ = ($($arg),*);
                None
            }
        )*
    };
}

kernels! {
    LinearRelu: linear_relu::linear_relu(x: &Tensor<2>, weight: &Tensor<2>, shift: &Tensor<1>) -> Tensor<2>;
    LinearReluMax: pooled::linear_relu_max(x: &Tensor<2>, weight: &Tensor<2>, shift: &Tensor<1>, group: usize) -> Tensor<2>;
    SharedLayersMax: pooled::shared_layers_max(
        x: &Tensor<2>, layers: &[(Tensor<2>, Tensor<1>)], group: usize, counts: &[u32],
    ) -> Tensor<2>;
    RowMoments: moments::row_moments(x: &Tensor<2>, weights: Option<&Tensor<2>>) -> Tensor<2>;
    LinearGelu: in_place::linear_gelu(x: &Tensor<3>, map: &Linear) -> Tensor<3>;
    Gelu: in_place::gelu<const D>(x: &mut Tensor<D>) -> ();
    LayerNormGelu: in_place::layer_norm_gelu(x: &mut Tensor<3>, gamma: &Tensor<1>, beta: &Tensor<1>, epsilon: f64) -> ();
    LinearOnto: in_place::linear_onto(residual: &Tensor<3>, x: &Tensor<3>, map: &Linear, gamma: &Tensor<1>) -> Tensor<3>;
    FocusCubed: focus::focus_cubed(x: &Tensor<3>, scale: &Tensor<3>, epsilon: f32) -> Tensor<3>;
    SelfAttention: self_attention::self_attention(qkv: &Tensor<3>, heads: usize, bias: Option<PositionBias>) -> Tensor<3>;
    RelativeScores: relative_scores::relative_scores(projected: &Tensor<4>, embedding: &Tensor<4>) -> Tensor<4>;
    SoftmaxAttention: softmax_attention::softmax_attention(
        qkv: [&Tensor<3>; 3], position: Option<&Tensor<4>>, heads: usize,
    ) -> Tensor<3>;
    InterpolatedEmbedding: embedding::interpolated_embedding(
        tables: &[Tensor<2>; 2], distances: &Tensor<1>, angles: &Tensor<2>,
    ) -> Tensor<2>;
    Cosines: cosines::cosines(a: &Tensor<3>, b: &Tensor<3>, map: &Linear, factor: f32) -> Tensor<3>;
    SampledLinear: panels::sampled_linear(
        x: &Tensor<2>, map: &Linear, width: usize, rows: &[i32], weights: &[f32],
    ) -> Tensor<2>;
    VisionBlock: vision_block::vision_block(maps: &VisionMaps, x: &Tensor<3>) -> Tensor<3>;
    VisionBlockAt: vision_block::vision_block_at(maps: &VisionMaps, x: &Tensor<3>, wanted: &[usize]) -> Tensor<2>;
    AttentionLayer: attention_layer::attention_layer(
        maps: &AttentionMaps, tail: &TokenMaps, x: &Tensor<3>, memory: &Tensor<3>, embedding: Option<&Tensor<4>>,
    ) -> Tensor<3>;
    DenseLayer: dense_layer::dense_layer(
        maps: &FocusedMaps, tail: &TokenMaps, dense: &Tensor<3>, sparse: &Tensor<3>,
    ) -> Tensor<3>;
}

impl Kernel {
    /// Switches a kernel off (or on again) in this process, so that its plain form runs. Benchmarks measure by it what a
    /// kernel gains.
    pub fn switch(self, on: bool) {
        let bit = 1 << self as u32;
        if on {
            OFF.fetch_and(!bit, Ordering::Relaxed)
        } else {
            OFF.fetch_or(bit, Ordering::Relaxed)
        };
    }

    #[cfg(feature = "flex")]
    fn is_on(self) -> bool {
        OFF.load(Ordering::Relaxed) & (1 << self as u32) == 0
    }
}
