//! The fused operations against their plain forms: values and gradients.

use burn::tensor::{Device, Distribution, Tensor, activation, module::linear};

use super::*;

fn random<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::random(shape, Distribution::Uniform(-1.0, 1.0), device)
}

fn close<const D: usize>(got: Tensor<D>, expected: Tensor<D>, tolerance: f64, what: &str) {
    assert_eq!(got.dims(), expected.dims(), "{what}");
    let largest = (got - expected).inner().abs().max().into_scalar::<f32>();
    assert!(f64::from(largest) < tolerance, "{what}: {largest}");
}

/// Value and gradients of `sum(f(inputs) * probe)`.
fn gradients<const O: usize>(
    inputs: &(Tensor<2>, Tensor<2>, Tensor<1>),
    f: impl Fn(Tensor<2>, Tensor<2>, Tensor<1>) -> Tensor<O>,
) -> (Tensor<O>, Tensor<2>, Tensor<2>, Tensor<1>) {
    let x = inputs.0.clone().autodiff().require_grad();
    let w = inputs.1.clone().autodiff().require_grad();
    let s = inputs.2.clone().autodiff().require_grad();
    let y = f(x.clone(), w.clone(), s.clone());
    let probe = (y.clone().inner() * 3.7).cos();
    let grads = (y.clone() * probe).sum().backward();
    (y.inner(), x.grad(&grads).unwrap(), w.grad(&grads).unwrap(), s.grad(&grads).unwrap())
}

fn same_gradients<const O: usize>(
    sizes: [usize; 3],
    fused: impl Fn(Tensor<2>, Tensor<2>, Tensor<1>) -> Tensor<O>,
    plain: impl Fn(Tensor<2>, Tensor<2>, Tensor<1>) -> Tensor<O>,
) {
    let device = Device::default();
    let [rows, inner, columns] = sizes;
    let inputs =
        (random([rows, inner], &device), random([inner, columns], &device), random([columns], &device));
    let off_tape = fused(inputs.0.clone(), inputs.1.clone(), inputs.2.clone());
    let (y, dx, dw, ds) = gradients(&inputs, &fused);
    let expected = gradients(&inputs, &plain);
    close(off_tape, expected.0.clone(), 1e-5, "off the tape");
    close(y, expected.0, 1e-5, "value");
    close(dx, expected.1, 1e-4, "dx");
    close(dw, expected.2, 2e-3, "dw");
    close(ds, expected.3, 2e-3, "ds");
}

fn maximum_of_groups(y: Tensor<2>, group: usize) -> Tensor<2> {
    let [rows, columns] = y.dims();
    y.reshape([rows / group, group, columns]).max_dim(1).reshape([rows / group, columns])
}

#[test]
fn linear_relu_equals_its_plain_form() {
    for sizes in [[1300, 6, 16], [700, 32, 64], [9, 3, 5]] {
        same_gradients(sizes, linear_relu, |x, w, s| activation::relu(linear(x, w, Some(s))));
    }
}

#[test]
fn pooled_layer_equals_its_plain_form() {
    for (sizes, group) in [([1600, 6, 16], 16), ([64 * 21, 32, 64], 64), ([12, 3, 5], 4)] {
        same_gradients(
            sizes,
            |x, w, s| linear_relu_max(x, w, s, group),
            |x, w, s| maximum_of_groups(activation::relu(linear(x, w, Some(s))), group),
        );
    }
}

#[test]
fn moments_equal_their_plain_form() {
    let device = Device::default();
    let x = random([1500, 7], &device);
    let weights = random([1500, 1], &device).greater_elem(0.2).float();
    let plain = |x: Tensor<2>| {
        let (count, rows) = (weights.clone().sum_dim(0), x.clone() * weights.clone());
        let mean = rows.clone().sum_dim(0) / count.clone();
        Tensor::cat(vec![x.transpose().matmul(rows) / count, mean], 0)
    };
    let with_gradient = |f: &dyn Fn(Tensor<2>) -> Tensor<2>| {
        let x = x.clone().autodiff().require_grad();
        let y = f(x.clone());
        let probe = (y.clone().inner() * 50.0).cos();
        let grads = (y.clone() * probe).sum().backward();
        (y.inner(), x.grad(&grads).unwrap())
    };
    let (y, dx) = with_gradient(&|x| row_moments(x, Some(weights.clone())));
    let (expected, expected_dx) = with_gradient(&plain);
    close(row_moments(x.clone(), Some(weights.clone())), expected.clone(), 1e-6, "off the tape");
    close(y, expected, 1e-6, "value");
    close(dx, expected_dx, 1e-6, "gradient");
    let all = row_moments(x.clone(), None).narrow(0, 7, 1);
    close(all, x.mean_dim(0), 1e-6, "mean of all rows");
}

#[test]
fn layers_skip_the_padding_that_repeats_the_first_row() {
    let device = Device::default();
    let (groups, group) = (30, 8);
    let counts: Vec<u32> = (0..groups as u32).map(|g| g % 9).collect();
    let rows = random([groups, group, 6], &device);
    let padded: Vec<Tensor<3>> = (0..groups)
        .map(|g| {
            let count = (counts[g] as usize).clamp(1, group);
            let own = rows.clone().slice([g..g + 1, 0..count]);
            let first = rows.clone().slice([g..g + 1, 0..1]).repeat_dim(1, group - count);
            if count == group { own } else { Tensor::cat(vec![own, first], 1) }
        })
        .collect();
    let x = Tensor::cat(padded, 0).reshape([groups * group, 6]);
    let layers: Vec<_> = [(6, 16), (16, 32), (32, 20)]
        .map(|(inner, columns)| (random([inner, columns], &device), random([columns], &device)))
        .into();
    let plain =
        layers.iter().fold(x.clone(), |x, (w, s)| activation::relu(linear(x, w.clone(), Some(s.clone()))));
    close(shared_layers_max(x, &layers, group, &counts), maximum_of_groups(plain, group), 1e-4, "layers");
}

#[test]
fn gelu_leaves_a_shared_tensor_alone() {
    let device = Device::default();
    let x = random([50, 700], &device) * 4.0;
    let before = x.clone().into_data();
    close(gelu(x.clone()), activation::gelu(x.clone()), 2e-6, "gelu");
    let strided = x.clone().transpose();
    close(gelu(strided.clone()), activation::gelu(strided), 2e-6, "gelu of a transposed tensor");
    x.into_data().assert_eq(&before, true);
}

#[test]
fn relative_scores_equal_the_batched_product() {
    let device = Device::default();
    let (projected, embedding) = (random([2, 4, 5, 40], &device), random([2, 5, 7, 40], &device));
    let expected = projected
        .clone()
        .reshape([2, 4, 5, 1, 40])
        .mul(embedding.clone().reshape([2, 1, 5, 7, 40]))
        .sum_dim(4)
        .reshape([2, 4, 5, 7]);
    close(relative_scores(projected, embedding), expected, 1e-5, "scores");
}
