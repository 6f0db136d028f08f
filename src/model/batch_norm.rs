//! Linear map, batch normalisation and ReLU over rows in one: the positional encoding's shared layer.
//!
//! The batch statistics of `y = x W` follow from the mean and the second moments of `x`, so the normalisation is folded
//! into the weights before the rows are touched. Over the hundreds of thousands of neighbour rows this leaves one
//! matrix product and one ReLU instead of a dozen passes.

use burn::{
    module::{Module, Param, RunningState},
    nn::Linear,
    tensor::{Tensor, activation::relu, module::linear},
};

use super::init::Initializer;

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

    /// `relu(norm(x W))` of rows `[rows, C_in]`. `rows_mask` `[rows, 1]` of 0 and 1 says which rows count in the
    /// statistics (`None`: all). With parameters on the autodiff tape the batch statistics are used and the running
    /// ones updated; otherwise the running ones are used.
    pub fn linear_relu(&self, map: &Linear, x: Tensor<2>, rows_mask: Option<Tensor<2>>) -> Tensor<2> {
        let weight = map.weight.val(); // [C_in, C]
        let (mean, variance) = if weight.is_autodiff() {
            self.batch_statistics(&weight, &x, rows_mask)
        } else {
            (self.running_mean.value().unsqueeze(), self.running_var.value().unsqueeze())
        };
        let scale = (variance + EPSILON).sqrt().recip() * self.weight.val().unsqueeze(); // [1, C]
        let shift = self.bias.val() - (mean * scale.clone()).squeeze_dim::<1>(0);
        relu(linear(x, weight * scale, Some(shift)))
    }

    /// Mean and biased variance of `x W`, `[1, C]` each.
    fn batch_statistics(
        &self,
        weight: &Tensor<2>,
        x: &Tensor<2>,
        rows_mask: Option<Tensor<2>>,
    ) -> (Tensor<2>, Tensor<2>) {
        let counted = match &rows_mask {
            None => x.clone(),
            Some(mask) => x.clone() * mask.clone(),
        };
        let count = match rows_mask {
            None => Tensor::full([1, 1], x.dims()[0] as f32, &x.device().inner()),
            Some(mask) => mask.sum_dim(0),
        };
        let input_mean = counted.clone().sum_dim(0) / count.clone(); // [1, C_in]
        let moments = x.clone().transpose().matmul(counted) / count.clone(); // [C_in, C_in]
        let covariance = moments - input_mean.clone().transpose().matmul(input_mean.clone());
        let mean = input_mean.matmul(weight.clone());
        let variance = (weight.clone() * covariance.matmul(weight.clone())).sum_dim(0).clamp_min(0.0);
        self.update(mean.clone().inner(), variance.clone().inner(), count.inner());
        (mean, variance)
    }

    fn update(&self, mean: Tensor<2>, variance: Tensor<2>, count: Tensor<2>) {
        let unbiased = variance * (count.clone() / (count - 1.0).clamp_min(1.0));
        let blend =
            |old: Tensor<1>, new: Tensor<2>| old * (1.0 - MOMENTUM) + new.squeeze_dim::<1>(0) * MOMENTUM;
        self.running_mean.update(blend(self.running_mean.value_sync().inner(), mean));
        self.running_var.update(blend(self.running_var.value_sync().inner(), unbiased));
    }
}
