//! Gradients of one optimizer step: averaged over passes, cleaned, measured, clipped.

use burn::{
    module::{Module, ModuleVisitor, Param},
    optim::GradientsParams,
    tensor::Tensor,
};

/// Global L2 norm of all gradients, 0 when there are none. One read from the device.
pub fn norm<M: Module>(model: &M, gradients: &GradientsParams) -> f64 {
    let mut squares = Squares { gradients, sums: Vec::new() };
    model.visit(&mut squares);
    if squares.sums.is_empty() {
        return 0.0;
    }
    let sums = Tensor::cat(squares.sums, 0).into_data().convert::<f64>();
    sums.iter::<f64>().sum::<f64>().sqrt()
}

/// NaN becomes 0, infinities become +-1e5, as the release does.
pub fn clean<M: Module>(model: &M, gradients: &mut GradientsParams) {
    model.visit(&mut Clean { gradients });
}

/// Multiplies every gradient.
pub fn scale<M: Module>(model: &M, gradients: &mut GradientsParams, factor: f64) {
    model.visit(&mut Scale { gradients, factor });
}

/// Sums the squares of every gradient.
struct Squares<'a> {
    gradients: &'a GradientsParams,
    sums: Vec<Tensor<1>>,
}

impl ModuleVisitor for Squares<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.get::<D>(param.id) {
            self.sums.push(gradient.square().sum());
        }
    }
}

/// Replaces NaN and infinities.
struct Clean<'a> {
    gradients: &'a mut GradientsParams,
}

impl ModuleVisitor for Clean<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.remove::<D>(param.id) {
            let nan = gradient.clone().is_nan();
            let infinite = gradient.clone().is_inf();
            // The sign of NaN is never used: those entries are filled last.
            let clean =
                gradient.clone().mask_where(infinite, gradient.sign().mul_scalar(1e5)).mask_fill(nan, 0.0);
            self.gradients.register(param.id, clean);
        }
    }
}

/// Multiplies by a factor.
struct Scale<'a> {
    gradients: &'a mut GradientsParams,
    factor: f64,
}

impl ModuleVisitor for Scale<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.remove::<D>(param.id) {
            self.gradients.register(param.id, gradient.mul_scalar(self.factor));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::{
        nn::{Linear, LinearConfig},
        tensor::Device,
    };

    fn with_gradient(values: [f32; 4]) -> (Linear, GradientsParams) {
        let layer = LinearConfig::new(4, 1).with_bias(false).init(&Device::default().autodiff());
        let mut gradients = GradientsParams::new();
        let column = Tensor::<1>::from_floats(values, &Device::default()).reshape([4, 1]);
        gradients.register(layer.weight.id, column);
        (layer, gradients)
    }

    fn values(layer: &Linear, gradients: &GradientsParams) -> Vec<f32> {
        gradients.get::<2>(layer.weight.id).unwrap().into_data().try_into_vec().unwrap()
    }

    #[test]
    fn norm_is_euclidean_over_all_parameters() {
        let (layer, gradients) = with_gradient([1.0, 2.0, -4.0, 2.0]);
        assert!((norm(&layer, &gradients) - 5.0).abs() < 1e-6);
        assert_eq!(norm(&layer, &GradientsParams::new()), 0.0);
    }

    #[test]
    fn non_finite_entries_are_replaced_and_others_kept() {
        let (layer, mut gradients) = with_gradient([f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.25]);
        assert!(!norm(&layer, &gradients).is_finite());
        clean(&layer, &mut gradients);
        assert_eq!(values(&layer, &gradients), [0.0, 1e5, -1e5, 0.25]);
    }

    #[test]
    fn scaling_is_exact_for_powers_of_two() {
        let (layer, mut gradients) = with_gradient([1.0, 2.0, -4.0, 2.0]);
        scale(&layer, &mut gradients, 0.5);
        assert_eq!(values(&layer, &gradients), [0.5, 1.0, -2.0, 1.0]);
    }
}
