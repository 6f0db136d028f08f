//! Loss terms on cases worked out by hand, and their gradients against finite differences.

use burn::tensor::{Device, Tensor, TensorData};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::{config::LossConfig, geometry::Pose};
use unopose_nn::{
    loss::{MatchLabels, info_nce, soft_correspondence, weighted_bce},
    model::{BlockOutput, PoseTensors},
};

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as::<f32>().unwrap()
}

/// Three query points on the x axis; the reference has the first two, shifted by the pose, and one far away.
fn labels(device: &Device) -> MatchLabels {
    let shift = nalgebra::Vector3::new(0.0, 0.0, 2.0);
    let pose = PoseTensors::new([Pose::new(nalgebra::Matrix3::identity(), shift)].iter(), device);
    let query = tensor(vec![0.0, 0.0, 2.0, 1.0, 0.0, 2.0, 2.0, 0.0, 2.0], [1, 3, 3], device);
    let reference = tensor(vec![1.02, 0.0, 0.0, 0.0, 0.2, 0.0, 9.0, 9.0, 9.0], [1, 3, 3], device);
    MatchLabels::new(query, reference, &pose, 0.3, 0.15)
}

#[test]
fn labels_follow_the_two_thresholds() {
    let labels = labels(&Device::flex());
    // 0.2 apart is a match (<= 0.3) but no overlap (> 0.15); 0.02 apart is both; the third of each side is neither.
    assert_eq!(labels.query.try_into_vec_as::<i64>().unwrap(), [2, 1, 0]);
    assert_eq!(labels.reference.try_into_vec_as::<i64>().unwrap(), [2, 1, 0]);
    assert_eq!(values(labels.overlap), [0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
}

#[test]
fn info_nce_of_a_perfect_and_of_a_blind_prediction() {
    let device = Device::flex();
    let labels = labels(&device);
    let config = LossConfig::default();
    // Blind: equal similarities, cross entropy ln 4 in both directions.
    let blind = info_nce(&Tensor::zeros([1, 4, 4], &device), &labels, &config);
    assert!((values(blind)[0] - 4f32.ln()).abs() < 1e-6);
    // Perfect: 10 at the true pairs and at the background of the third points, -10 elsewhere.
    let mut s = vec![-10.0; 16];
    for (row, column) in [(1, 2), (2, 1), (3, 0), (0, 3)] {
        s[row * 4 + column] = 10.0;
    }
    let perfect = values(info_nce(&tensor(s, [1, 4, 4], &device), &labels, &config))[0];
    assert!(perfect < 1e-6, "loss of a perfect prediction {perfect}");
    let sum = LossConfig { halve_info_nce: false, ..config };
    let summed = info_nce(&Tensor::zeros([1, 4, 4], &device), &labels, &sum);
    assert!((values(summed)[0] - 2.0 * 4f32.ln()).abs() < 1e-6);
}

#[test]
fn weighted_bce_balances_the_classes() {
    let device = Device::flex();
    // One positive in four with probability 1/2 everywhere: 3/4 ln 2 + 3 * 1/4 ln 2, over 4 points.
    let target = tensor(vec![1.0, 0.0, 0.0, 0.0], [1, 4], &device);
    let loss = values(weighted_bce(Tensor::zeros([1, 4], &device), target.clone()))[0];
    assert!((loss - 1.5 * 2f32.ln() / 4.0).abs() < 1e-6, "{loss}");
    // Hopeless logits are clamped: -log 0 counts 100.
    let loss = values(weighted_bce(tensor(vec![-500.0, -500.0, -500.0, -500.0], [1, 4], &device), target))[0];
    assert!((loss - 0.75 * 100.0 / 4.0).abs() < 1e-4, "{loss}");
}

/// Analytic against central differences, every entry.
fn check_gradient(what: &str, loss: impl Fn(&Tensor<3>) -> Tensor<1>) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let start: Vec<f32> = (0..16).map(|_| rng.random_range(-2.0..2.0)).collect();
    let device = Device::flex().autodiff();
    let s = tensor(start.clone(), [1, 4, 4], &device).require_grad();
    let gradient = values(s.grad(&loss(&s).sum().backward()).unwrap());
    let plain = Device::flex();
    for i in 0..16 {
        let at = |delta: f32| {
            let mut moved = start.clone();
            moved[i] += delta;
            values(loss(&tensor(moved, [1, 4, 4], &plain)))[0] as f64
        };
        let numeric = (at(1e-2) - at(-1e-2)) / 2e-2;
        // f32 losses of about 2 differ by 1e-7 / 2e-2 from rounding, and by h^2 from curvature.
        assert!(
            (numeric - gradient[i] as f64).abs() < 2e-4,
            "{what}, entry {i}: {numeric} != {}",
            gradient[i]
        );
    }
}

#[test]
fn written_down_gradients_are_the_derivatives() {
    let labels = labels(&Device::flex());
    let config = LossConfig::default();
    check_gradient("InfoNCE", |s| info_nce(s, &labels, &config));
    check_gradient("soft correspondence", |s| {
        let output = BlockOutput { similarity: s.clone(), overlap: None, background_overlap: None };
        soft_correspondence(&output, &labels, &config)
    });
}
