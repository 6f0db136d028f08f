//! Batch normalisation of rows, optionally weighted: padded neighbours of a ball query can be left out of the statistics.

use burn::{
    module::{Module, Param, RunningState},
    tensor::Tensor,
};

use super::init::Initializer;

/// Normalises `[rows, channels]` over the rows; running statistics as in PyTorch (unbiased variance, momentum 0.1).
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

    /// `[rows, channels]` in and out. `rows_mask` `[rows, 1]` of 0 and 1 says which rows count in the statistics
    /// (`None`: all). Batch statistics are used, and the running ones updated, when the input is on the autodiff tape.
    pub fn forward(&self, x: Tensor<2>, rows_mask: Option<Tensor<2>>) -> Tensor<2> {
        if !x.is_autodiff() {
            let (scale, shift) = self.folded();
            return x * scale + shift;
        }
        let (mean, variance, count) = match rows_mask {
            None => {
                let rows = x.dims()[0] as f64;
                let mean = x.clone().mean_dim(0); // [1, C]
                let centred = x.clone() - mean.clone();
                (
                    mean,
                    (centred.clone() * centred).mean_dim(0),
                    Tensor::from_floats([[rows as f32]], &x.device()),
                )
            }
            Some(mask) => {
                let count = mask.clone().sum_dim(0); // [1, 1]
                let mean = (x.clone() * mask.clone()).sum_dim(0) / count.clone();
                let centred = (x.clone() - mean.clone()) * mask;
                (mean, (centred.clone() * centred).sum_dim(0) / count.clone(), count)
            }
        };
        self.update(mean.clone().inner(), variance.clone().inner(), count.inner());
        let scale = (variance + EPSILON).sqrt().recip() * self.weight.val().unsqueeze(); // [1, C]
        (x - mean) * scale + self.bias.val().unsqueeze()
    }

    /// Scale and shift `[1, channels]` of the inference form.
    pub fn folded(&self) -> (Tensor<2>, Tensor<2>) {
        let scale = self.weight.val() * (self.running_var.value() + EPSILON).sqrt().recip();
        let shift = self.bias.val() - self.running_mean.value() * scale.clone();
        (scale.unsqueeze(), shift.unsqueeze())
    }

    fn update(&self, mean: Tensor<2>, variance: Tensor<2>, count: Tensor<2>) {
        let unbiased = variance * (count.clone() / (count - 1.0).clamp_min(1.0));
        let blend =
            |old: Tensor<1>, new: Tensor<2>| old * (1.0 - MOMENTUM) + new.squeeze_dim::<1>(0) * MOMENTUM;
        self.running_mean.update(blend(self.running_mean.value_sync().inner(), mean));
        self.running_var.update(blend(self.running_var.value_sync().inner(), unbiased));
    }
}
