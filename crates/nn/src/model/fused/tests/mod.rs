//! The fused operations against their plain forms: values and gradients.

mod attention;

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
fn ends_of_linear_maps_equal_their_plain_forms() {
    let device = Device::default();
    let map = burn::nn::LinearConfig::new(30, 50).init(&device);
    let (x, residual) = (random([2, 400, 30], &device), random([2, 400, 50], &device));
    let gamma = random([50], &device);
    let mapped = map.forward(x.clone());
    close(linear_gelu(x.clone(), &map), activation::gelu(mapped.clone()), 2e-6, "gelu");
    let expected = residual.clone() + mapped * gamma.clone().unsqueeze();
    let before = residual.clone().into_data();
    close(linear_onto(residual.clone(), x, &map, gamma), expected, 1e-6, "scaled residual");
    residual.into_data().assert_eq(&before, true);
}

/// Value of `f` and the gradients of `sum(f * probe)` with respect to both inputs.
fn two_gradients<const A: usize, const B: usize, const O: usize>(
    (a, b): (&Tensor<A>, &Tensor<B>),
    f: impl Fn(Tensor<A>, Tensor<B>) -> Tensor<O>,
) -> (Tensor<O>, Tensor<A>, Tensor<B>) {
    let (a, b) = (a.clone().autodiff().require_grad(), b.clone().autodiff().require_grad());
    let y = f(a.clone(), b.clone());
    let probe = (y.clone().inner() * 3.7).cos();
    let grads = (y.clone() * probe).sum().backward();
    (y.inner(), a.grad(&grads).unwrap(), b.grad(&grads).unwrap())
}

#[test]
fn interpolation_equals_its_plain_form() {
    let device = Device::default();
    let tables = (random([9, 40], &device), random([6, 40], &device));
    let distances = Tensor::random([150], Distribution::Uniform(0.0, 7.9), &device);
    let angles: Tensor<2> = Tensor::random([150, 3], Distribution::Uniform(0.0, 4.9), &device);
    // Linear interpolation as a product with the hat functions of the rows.
    let hats = |positions: Tensor<1>, entries: usize| {
        let rows = Tensor::<1, burn::tensor::Int>::arange(0..entries as i64, &device).float();
        let offset = positions.unsqueeze_dim::<2>(1) - rows.unsqueeze_dim::<2>(0);
        (offset.abs().neg() + 1.0).clamp_min(0.0)
    };
    let plain = |d: Tensor<2>, a: Tensor<2>| {
        let a = hats(angles.clone().reshape([450]), 6).matmul(a).reshape([150, 3, 40]).max_dim(1);
        hats(distances.clone(), 9).matmul(d) + a.squeeze_dim::<2>(1)
    };
    let fused = |d, a| interpolated_embedding([d, a], distances.clone(), angles.clone());
    let got = two_gradients((&tables.0, &tables.1), fused);
    let expected = two_gradients((&tables.0, &tables.1), plain);
    close(fused(tables.0, tables.1), expected.0.clone(), 1e-5, "off the tape");
    close(got.0, expected.0, 1e-5, "value");
    close(got.1, expected.1, 1e-3, "distance table");
    close(got.2, expected.2, 1e-3, "angle table");
}

#[test]
fn focusing_equals_its_plain_form() {
    let device = Device::default();
    let (x, scale) = (random([2, 70, 40], &device), random([1, 1, 40], &device).abs() + 0.3);
    let plain = |x: Tensor<3>, scale: Tensor<3>| {
        let y = (activation::relu(x) + 1e-6) / scale;
        let cube = y.clone() * y.clone() * y.clone();
        let norm = |y: Tensor<3>| (y.clone() * y).sum_dim(2).sqrt();
        cube.clone() * norm(y) / norm(cube)
    };
    let fused = |x, scale| focus_cubed(x, scale, 1e-6);
    let (got, expected) = (two_gradients((&x, &scale), fused), two_gradients((&x, &scale), plain));
    close(fused(x, scale), expected.0.clone(), 1e-5, "off the tape");
    close(got.0, expected.0, 1e-5, "value");
    close(got.1, expected.1, 1e-4, "gradient of x");
    close(got.2, expected.2, 2e-3, "gradient of the scale");
}

#[test]
fn gelu_in_place_and_after_a_norm() {
    let device = Device::default();
    let x = random([3, 70, 24], &device) * 4.0;
    let kept = x.clone();
    close(gelu(x.clone()), activation::gelu(x.clone()), 1e-6, "gelu");
    let (gamma, beta) = (random([24], &device), random([24], &device));
    let expected = activation::gelu(layer_norm(x.clone(), gamma.clone(), Some(beta.clone()), 1e-6));
    close(layer_norm_gelu(x.clone(), gamma, beta, 1e-6), expected, 1e-5, "gelu of the norm");
    close(x, kept, 1e-12, "the input of others");
}

/// The layers' own forms run on the tape.
#[test]
fn matching_layers_equal_their_plain_forms() {
    use crate::model::{Initializer, LinearTransformerLayer, TransformerLayer};
    let device = Device::default();
    let init = &mut Initializer::new(3, &device);
    // Four heads at once and another number; counts beyond one block of rows and not a multiple of the vectors.
    for (width, heads, n, m) in [(64, 4, 61, 37), (48, 3, 25, 16), (40, 2, 5, 3)] {
        let layer = TransformerLayer::new(width, heads, true, init);
        let (x, memory) = (random([2, n, width], &device), random([2, m, width], &device));
        let embedding = random([2, n, m, width], &device);
        let plain = layer.forward(x.clone().autodiff(), memory.clone().autodiff(), Some(embedding.clone()));
        close(layer.forward(x, memory, Some(embedding)), plain.inner(), 2e-5, "relative");
        let layer = TransformerLayer::new(width, heads, false, init);
        let (x, memory) = (random([2, n, width], &device), random([2, m, width], &device));
        let plain = layer.forward(x.clone().autodiff(), memory.clone().autodiff(), None);
        close(layer.forward(x, memory, None), plain.inner(), 2e-5, "cross");
        let layer = LinearTransformerLayer::new(width, heads, 3.0, init);
        let (dense, sparse) = (random([2, 3 * n, width], &device), random([2, m, width], &device));
        let plain = layer.attend(dense.clone().autodiff(), sparse.clone().autodiff());
        close(layer.attend(dense, sparse), plain.inner(), 2e-5, "dense");
    }
}

#[test]
fn cosines_equal_their_plain_form() {
    let device = Device::default();
    let map = burn::nn::LinearConfig::new(30, 48).init(&device);
    // Counts beyond a block of rows and one of columns.
    for (n, m) in [(101, 530), (7, 3)] {
        let (a, b) = (random([2, n, 30], &device), random([2, m, 30], &device));
        let on_tape = |x: &Tensor<3>| x.clone().autodiff();
        let plain = cosines(on_tape(&a), on_tape(&b), &map, 0.1).inner();
        close(cosines(a, b, &map, 0.1), plain, 1e-4, "cosines");
    }
}

#[test]
fn samples_of_a_linear_map_equal_their_plain_form() {
    let device = Device::default();
    let map = burn::nn::LinearConfig::new(128, 3 * 64).init(&device);
    let x = random([9, 128], &device);
    let rows: Vec<i32> = (0..40).map(|i| (i * 11) % 27).collect();
    let weights: Vec<f32> = (0..40).map(|i| (i % 5) as f32 / 4.0).collect();
    let sampled = |x: Tensor<2>| sampled_linear(x, &map, 64, rows.clone(), weights.clone());
    close(sampled(x.clone()), sampled(x.autodiff()).inner(), 1e-5, "samples");
}
