//! The part of training that changes weights: accumulated gradients, Adam step, moving average.

use burn::{
    module::{Module, ModuleMapper, Param, ParamId},
    optim::{AdamConfig, GradientsAccumulator, GradientsParams, ModuleOptimizer},
    tensor::{Bool, Int, Tensor},
};
use unopose_core::config::TrainConfig;

use super::{ema, gradients};

/// A network with everything its optimisation carries from step to step.
pub struct Optimization<M: Module> {
    model: M,
    average: Option<M>,
    adam: ModuleOptimizer,
    accumulated: GradientsAccumulator<M>,
    accumulation: usize,
    clip_norm: f64,
    ema_decay: f64,
    step: u64,
}

impl<M: Module> Optimization<M> {
    /// Starts at step 0. `model` must be on an autodiff device.
    pub fn new(model: M, config: &TrainConfig) -> Self {
        let model = model.map(&mut NumberParameters { next: 0 });
        let adam = AdamConfig::new()
            .with_beta_1(config.betas[0])
            .with_beta_2(config.betas[1])
            .with_epsilon(config.epsilon);
        Self {
            average: (config.ema_decay > 0.0).then(|| model.valid()),
            model,
            adam: adam.init(),
            accumulated: GradientsAccumulator::new(),
            accumulation: config.accumulation,
            clip_norm: config.clip_norm,
            ema_decay: config.ema_decay,
            step: 0,
        }
    }

    /// Resumes from a saved state: `model` with its weights, `average` likewise, `adam` with its moments.
    pub(crate) fn restore(&mut self, model: M, average: Option<M>, adam: ModuleOptimizer, step: u64) {
        self.model = model;
        self.average = average;
        self.adam = adam;
        self.accumulated = GradientsAccumulator::new();
        self.step = step;
    }

    /// The network being trained.
    pub fn model(&self) -> &M {
        &self.model
    }

    /// The moving average of the weights, when there is one.
    pub(crate) fn average(&self) -> Option<&M> {
        self.average.as_ref()
    }

    /// The network to use: with the average of the weights when there is one, without autodiff, in inference mode.
    pub(crate) fn deployed(&self) -> M {
        self.average.as_ref().unwrap_or(&self.model).valid()
    }

    /// Optimizer with its moments.
    pub(crate) fn adam(&self) -> &ModuleOptimizer {
        &self.adam
    }

    /// Optimizer steps taken.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// Adds the gradients of one pass, weighted so that `accumulation` passes give their mean. `loss` is `[1]`.
    pub fn accumulate(&mut self, loss: Tensor<1>) {
        let loss = if self.accumulation > 1 { loss.div_scalar(self.accumulation as f64) } else { loss };
        self.add(GradientsParams::from_grads(loss.backward(), &self.model));
    }

    /// Adds gradients (or a part of them) as they are.
    pub fn add(&mut self, gradients: GradientsParams) {
        self.accumulated.accumulate(&self.model, gradients);
    }

    /// Takes an optimizer step with the accumulated gradients; returns their L2 norm before clipping.
    pub fn apply(&mut self, learning_rate: f64) -> f64 {
        let mut gradients = self.accumulated.grads();
        let mut norm = gradients::norm(&self.model, &gradients);
        if !norm.is_finite() {
            gradients::clean(&self.model, &mut gradients);
            norm = gradients::norm(&self.model, &gradients);
        }
        if self.clip_norm > 0.0 && norm > self.clip_norm {
            gradients::scale(&self.model, &mut gradients, self.clip_norm / (norm + 1e-6));
        }
        self.model = self.adam.step(learning_rate, self.model.clone(), gradients);
        self.step += 1;
        if let Some(average) = self.average.take() {
            self.average = Some(ema::update(average, &self.model, self.ema_decay, self.step));
        }
        norm
    }
}

/// Gives parameters their position as identity, so that saved moments find them again in another process.
struct NumberParameters {
    next: u64,
}

impl NumberParameters {
    fn id(&mut self) -> ParamId {
        self.next += 1;
        ParamId::from(self.next)
    }
}

impl ModuleMapper for NumberParameters {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (_, tensor, mapper) = param.consume();
        Param::from_mapped_value(self.id(), tensor, mapper)
    }

    fn map_int<const D: usize>(&mut self, param: Param<Tensor<D, Int>>) -> Param<Tensor<D, Int>> {
        let (_, tensor, mapper) = param.consume();
        Param::from_mapped_value(self.id(), tensor, mapper)
    }

    fn map_bool<const D: usize>(&mut self, param: Param<Tensor<D, Bool>>) -> Param<Tensor<D, Bool>> {
        let (_, tensor, mapper) = param.consume();
        Param::from_mapped_value(self.id(), tensor, mapper)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::{
        nn::{Initializer, Linear, LinearConfig},
        tensor::Device,
    };

    fn layer(device: &Device) -> Linear {
        LinearConfig::new(1, 1)
            .with_bias(false)
            .with_initializer(Initializer::Constant { value: 1.0 })
            .init(device)
    }

    /// Loss `slope * w`: the gradient is `slope`.
    fn pass(optimization: &mut Optimization<Linear>, slope: f32) {
        let loss = optimization.model().weight.val().reshape([1]).mul_scalar(slope);
        optimization.accumulate(loss);
    }

    fn weight(model: &Linear) -> f32 {
        model.weight.val().into_scalar::<f32>()
    }

    /// Two steps of `torch.optim.Adam` by hand: m and v with bias correction, eps outside the root.
    #[test]
    fn adam_matches_the_formula_of_pytorch() {
        let config = TrainConfig { epsilon: 0.1, ..TrainConfig::default() };
        let mut optimization = Optimization::new(layer(&Device::default().autodiff()), &config);
        let (mut w, mut m, mut v) = (1.0f64, 0.0f64, 0.0f64);
        for (t, slope) in [(1, 0.3f64), (2, -0.2)] {
            pass(&mut optimization, slope as f32);
            let norm = optimization.apply(0.01);
            assert!((norm - slope.abs()).abs() < 1e-6);
            m = 0.5 * m + 0.5 * slope;
            v = 0.999 * v + 0.001 * slope * slope;
            let (m_hat, v_hat) = (m / (1.0 - 0.5f64.powi(t)), v / (1.0 - 0.999f64.powi(t)));
            w -= 0.01 * m_hat / (v_hat.sqrt() + 0.1);
            assert!((weight(optimization.model()) as f64 - w).abs() < 1e-6, "step {t}");
        }
        assert_eq!(optimization.step(), 2);
    }

    #[test]
    fn accumulated_passes_are_averaged_and_clipped() {
        let config = TrainConfig { accumulation: 2, clip_norm: 1.0, ..TrainConfig::default() };
        let mut optimization = Optimization::new(layer(&Device::default().autodiff()), &config);
        pass(&mut optimization, 2.0);
        pass(&mut optimization, 6.0);
        assert!((optimization.apply(0.01) - 4.0).abs() < 1e-6);
        // Adam's first step is the learning rate whatever the gradient's size.
        assert!((weight(optimization.model()) - 0.99).abs() < 1e-5);
    }

    #[test]
    fn a_non_finite_gradient_does_not_reach_the_weights() {
        let config = TrainConfig::default();
        let mut optimization = Optimization::new(layer(&Device::default().autodiff()), &config);
        pass(&mut optimization, f32::NAN);
        assert_eq!(optimization.apply(0.01), 0.0);
        assert_eq!(weight(optimization.model()), 1.0);
    }
}
