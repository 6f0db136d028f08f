//! Exponential moving average of weights and batch statistics.

use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param, ParamId},
    tensor::{Tensor, container::TensorContainer},
};

/// `average <- decay * average + (1 - decay) * model`, without autodiff.
///
/// The decay grows as `(1 + step) / (10 + step)` up to `decay`, so that the first average is not the random start.
pub fn update<M: Module>(average: M, model: &M, decay: f64, step: u64) -> M {
    let decay = decay.min((1.0 + step as f64) / (10.0 + step as f64));
    let mut collect = Collect(TensorContainer::new());
    model.visit(&mut collect);
    average.map(&mut Blend { current: collect.0, decay })
}

/// The current weights and statistics by parameter.
struct Collect(TensorContainer<ParamId>);

impl ModuleVisitor for Collect {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.0.register(param.id, param.val().without_autodiff());
    }
}

/// Blends them into the average.
struct Blend {
    current: TensorContainer<ParamId>,
    decay: f64,
}

impl ModuleMapper for Blend {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(current) = self.current.remove::<Tensor<D>>(&param.id) else { return param };
        let decay = self.decay;
        param.map(|average| average.mul_scalar(decay) + current.mul_scalar(1.0 - decay))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::{
        nn::{BatchNormConfig, Initializer, LinearConfig},
        tensor::Device,
    };

    #[test]
    fn averages_weights_with_growing_decay() {
        let device = Device::default().autodiff();
        let of =
            |value| LinearConfig::new(2, 2).with_initializer(Initializer::Constant { value }).init(&device);
        let (zero, mut one) = (of(0.0), of(1.0));
        one.weight.id = zero.weight.id;
        let average = zero.valid();
        // decay = min(0.5, (1 + 5) / (10 + 5)) = 0.4
        let average = update(average, &one, 0.5, 5);
        let weight = average.weight.val().into_data().try_into_vec::<f32>().unwrap();
        assert!(weight.iter().all(|w| (w - 0.6).abs() < 1e-6), "{weight:?}");
        let average = update(average, &one, 0.5, 1_000_000);
        let weight = average.weight.val().into_data().try_into_vec::<f32>().unwrap();
        assert!(weight.iter().all(|w| (w - 0.8).abs() < 1e-6), "{weight:?}");
    }

    #[test]
    fn the_average_does_not_share_statistics_with_the_model() {
        let device = Device::default().autodiff();
        let model = BatchNormConfig::new(1).init(&device);
        let average = model.valid();
        model.forward(Tensor::<2>::from_floats([[1.0], [3.0]], &device));
        // Running mean 0.1 * 2 = 0.2, merged by `valid`.
        let model_mean = model.valid().running_mean.value().into_scalar::<f32>();
        let average = update(average, &model, 0.0, 0);
        let average_mean = average.running_mean.value().into_scalar::<f32>();
        assert!((model_mean - 0.2).abs() < 1e-6 && (average_mean - 0.2).abs() < 1e-6);
        update(average, &BatchNormConfig::new(1).init(&device), 0.0, 0);
        assert!((model.running_mean.value().into_scalar::<f32>() - 0.2).abs() < 1e-6);
    }
}
