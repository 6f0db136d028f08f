//! bf16 products against single precision: the same network on the same pairs.

use std::sync::Arc;

use burn::{
    module::{Module, ModuleVisitor, Param},
    optim::GradientsParams,
    tensor::{DType, FloatDType, Tensor},
};
use unopose_core::config::{Config, Precision};
use unopose_nn::{
    loss::pair_losses,
    model::{PairTensors, UnoPose},
};
use unopose_pairs::data::{PairSampler, TrainSample};
use unopose_tests::ellipsoid_views::EllipsoidViews;

fn samples(config: &Config) -> Vec<TrainSample> {
    let source = Arc::new(EllipsoidViews::new(6, 3));
    let sampler = PairSampler::new(source, &config.data, &config.model, 1).unwrap();
    (0..2).map(|index| sampler.sample(index, false).unwrap()).collect()
}

/// Gradients of all parameters that have one, which must be in single precision.
struct Collect<'a> {
    gradients: &'a GradientsParams,
    values: Vec<f32>,
}

impl ModuleVisitor for Collect<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.get::<D>(param.id) {
            assert_eq!(gradient.dtype(), DType::F32);
            self.values.extend(gradient.into_data().try_into_vec::<f32>().unwrap());
        }
    }
}

#[test]
fn losses_and_gradients_stay_near_those_of_single_precision() {
    let config = Config::embedded("smoke", &["data.max_rotation_deg=60.0".into()]).unwrap();
    let device = unopose_tests::test_device::test_device().autodiff();
    // The CPU computes in bf16, too, if more slowly: enough for the comparison.
    if !device.clone().inner().supports_dtype(FloatDType::BF16) {
        println!("skipped: this device does not compute in bf16");
        return;
    }
    let samples = samples(&config);
    let batch = PairTensors::from_samples(&samples, &config.model, &device);
    let groups = PairTensors::groups_of(&samples, &config.model, &device);
    let model = UnoPose::new(&config.model, 7, &device);
    let [single, half] = [Precision::F32, Precision::Bf16].map(|precision| {
        let computing = model.clone().in_precision(precision);
        let features = computing.encode(&batch.query);
        // Kept references, read back in single precision, are joined with new ones.
        assert_eq!((features.dense.dtype(), features.embedding.dtype()), (DType::F32, DType::F32));
        let outputs = computing.forward_train(&batch, &groups);
        let similarity = outputs.fine[0].similarity.clone().inner();
        assert_eq!(similarity.dtype(), DType::F32);
        let loss = pair_losses(&config.loss, &outputs, &batch).total;
        let value = loss.clone().into_scalar::<f32>();
        let gradients = GradientsParams::from_grads(loss.backward(), &model);
        let mut collect = Collect { gradients: &gradients, values: Vec::new() };
        model.visit(&mut collect);
        (value, similarity.into_data().try_into_vec::<f32>().unwrap(), collect.values)
    });
    assert_eq!(single.2.len(), half.2.len(), "parameters with a gradient");
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum::<f64>();
    let norm = |a: &[f32]| dot(a, a).sqrt();
    let cosine = dot(&single.2, &half.2) / (norm(&single.2) * norm(&half.2));
    let difference = single.1.iter().zip(&half.1).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("loss {} and {}, cosine of the gradients {cosine}, similarity {difference}", single.0, half.0);
    // Similarities are ten cosines; bf16 rounds to 1 in 256.
    assert!(difference > 1e-4 && difference < 0.5, "similarity: {difference}");
    assert!((half.0 / single.0 - 1.0).abs() < 0.02, "loss {} and {}", single.0, half.0);
    assert!(cosine > 0.98, "cosine of the gradients: {cosine}");
}
