//! Batch normalisation of `x W` over rows, folded into `W`: the positional encoding's shared layers.
//!
//! The batch statistics of `y = x W` follow from the mean and the second moments of `x`, so the normalisation becomes
//! part of the weights before the rows are touched. Over the hundreds of thousands of neighbour rows this leaves one
//! matrix product and one ReLU instead of a dozen passes.

use burn::{
    module::{Module, Param, RunningState},
    nn::Linear,
    tensor::Tensor,
};

use super::{fused::row_moments, init::Initializer};

/// Scale, shift and running statistics per channel, as in PyTorch (unbiased running variance, momentum 0.1).
#[derive(Module, Debug)]
pub struct RowBatchNorm {
    pub weight: Param<Tensor<1>>,
    pub bias: Param<Tensor<1>>,
    pub running_mean: RunningState<Tensor<1>>,
    pub running_var: RunningState<Tensor<1>>,
}

const EPSILON: f64 = 1e-5;
const MOMENTUM: f64 = 0.1;

impl RowBatchNorm {
    pub fn new(channels: usize, init: &mut Initializer) -> Self {
        Self {
            weight: init.constant([channels], 1.0),
            bias: init.constant([channels], 0.0),
            running_mean: RunningState::new(Tensor::zeros([channels], init.device())),
            running_var: RunningState::new(Tensor::ones([channels], init.device())),
        }
    }

    /// Weight `[C_in, C]` and shift `[C]` of the map with the normalisation by the running statistics folded in.
    pub fn fold(&self, map: &Linear) -> (Tensor<2>, Tensor<1>) {
        self.fold_statistics(map.weight.val(), self.running_mean.value(), self.running_var.value())
    }

    /// [`Self::fold`] with the statistics of `x W` over the rows `[rows, C_in]`, which also update the running ones.
    /// `rows_mask` `[rows, 1]` of 0 and 1 says which rows count (`None`: all).
    pub fn fold_batch(
        &self,
        map: &Linear,
        x: &Tensor<2>,
        rows_mask: Option<Tensor<2>>,
    ) -> (Tensor<2>, Tensor<1>) {
        let weight = map.weight.val();
        let [rows, inputs] = x.dims();
        let count = match &rows_mask {
            None => Tensor::full([1, 1], rows as f32, &x.device().inner()),
            Some(mask) => mask.clone().inner().sum_dim(0),
        };
        let moments = row_moments(x.clone(), rows_mask);
        let input_mean = moments.clone().narrow(0, inputs, 1); // [1, C_in]
        let covariance =
            moments.narrow(0, 0, inputs) - input_mean.clone().transpose().matmul(input_mean.clone());
        let mean = input_mean.matmul(weight.clone()).squeeze_dim::<1>(0);
        let variance = (weight.clone() * covariance.matmul(weight.clone())).sum_dim(0).clamp_min(0.0);
        let variance = variance.squeeze_dim::<1>(0);
        self.update(mean.clone().inner(), variance.clone().inner(), count.squeeze_dim(0));
        self.fold_statistics(weight, mean, variance)
    }

    fn fold_statistics(
        &self,
        weight: Tensor<2>,
        mean: Tensor<1>,
        variance: Tensor<1>,
    ) -> (Tensor<2>, Tensor<1>) {
        let scale = (variance + EPSILON).sqrt().recip() * self.weight.val(); // [C]
        let shift = self.bias.val() - mean * scale.clone();
        (weight * scale.unsqueeze(), shift)
    }

    fn update(&self, mean: Tensor<1>, variance: Tensor<1>, count: Tensor<1>) {
        let unbiased = variance * (count.clone() / (count - 1.0).clamp_min(1.0));
        let blend = |old: Tensor<1>, new: Tensor<1>| old * (1.0 - MOMENTUM) + new * MOMENTUM;
        self.running_mean.update(blend(self.running_mean.value_sync().inner(), mean));
        self.running_var.update(blend(self.running_var.value_sync().inner(), unbiased));
    }
}
