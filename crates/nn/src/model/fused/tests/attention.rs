//! Attention and its scores.

use burn::tensor::{Device, Tensor, TensorData, activation};

use super::{super::*, close, random, two_gradients};

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

#[test]
fn relative_scores_have_the_gradient_of_the_batched_product() {
    let device = Device::default();
    // Four heads at once, and what is left over.
    for heads in [4, 6] {
        let (projected, embedding) = (random([2, heads, 5, 40], &device), random([2, 5, 7, 40], &device));
        let (y, to_projected, to_embedding) = two_gradients((&projected, &embedding), relative_scores);
        let plain = |projected: Tensor<4>, embedding: Tensor<4>| {
            let product = projected.unsqueeze_dim::<5>(3) * embedding.unsqueeze_dim::<5>(1);
            product.sum_dim(4).squeeze_dim::<4>(4)
        };
        let expected = two_gradients((&projected, &embedding), plain);
        close(y, expected.0, 1e-5, "scores");
        close(to_projected, expected.1, 1e-4, "gradient of the queries");
        close(to_embedding, expected.2, 1e-4, "gradient of the embedding");
    }
}

#[test]
fn self_attention_equals_its_plain_form() {
    let device = Device::default();
    // Tokens beyond one block of rows and not a multiple of the vectors; heads as wide as a vision transformer's and less.
    for (tokens, heads, d) in [(101, 3, 64), (7, 2, 16), (50, 2, 5), (1030, 1, 8)] {
        let qkv = random([2, tokens, 3 * heads * d], &device) * 3.0;
        let part = |index: usize| {
            let part = qkv.clone().narrow(2, index * heads * d, heads * d);
            part.reshape([2, tokens, heads, d]).swap_dims(1, 2)
        };
        let scores = part(0).matmul(part(1).swap_dims(2, 3)) / (d as f64).sqrt();
        let read = activation::softmax(scores, 3).matmul(part(2));
        let expected = read.swap_dims(1, 2).reshape([2, tokens, heads * d]);
        // Scores reach 25; the exponential turns their rounding into a relative error of 5e-6, of values up to 3.
        close(self_attention(qkv, heads), expected, 3e-5, "attention");
    }
}

#[test]
fn softmax_attention_equals_its_plain_form() {
    let device = Device::default();
    for (n, m, heads, d, with_position) in [(19, 33, 2, 16, true), (5, 16, 3, 32, false), (7, 6, 2, 5, true)]
    {
        let width = heads * d;
        let inputs =
            [random([2, n, width], &device), random([2, m, width], &device), random([2, m, width], &device)];
        let position = random::<4>([2, heads, n, m], &device) * 3.0;
        let plain = |[q, k, v]: [Tensor<3>; 3], position: Tensor<4>| {
            let [q, k, v] = [q, k, v].map(|x| split_heads(x, heads));
            let scores = q.matmul(k.swap_dims(2, 3));
            let scores = if with_position { scores + position } else { scores };
            activation::softmax(scores, 3).matmul(v).swap_dims(1, 2).reshape([2, n, width])
        };
        let fused = |[q, k, v]: [Tensor<3>; 3], position: Tensor<4>| {
            softmax_attention(q, k, v, with_position.then_some(position), heads)
        };
        let off_tape = fused(inputs.clone(), position.clone());
        let results = [&plain as &dyn Fn([Tensor<3>; 3], Tensor<4>) -> Tensor<3>, &fused].map(|f| {
            let inputs = inputs.clone().map(|x| x.autodiff().require_grad());
            let position = position.clone().autodiff().require_grad();
            let y = f(inputs.clone(), position.clone());
            let probe = (y.clone().inner() * 3.7).cos();
            let grads = (y.clone() * probe).sum().backward();
            (y.inner(), inputs.map(|x| x.grad(&grads).unwrap()), position.grad(&grads))
        });
        let [(expected, expected_grads, expected_position), (got, grads, position)] = results;
        close(off_tape, expected.clone(), 1e-5, "off the tape");
        close(got, expected, 1e-5, "value");
        for (got, (expected, what)) in grads.into_iter().zip(expected_grads.into_iter().zip(["q", "k", "v"]))
        {
            close(got, expected, 1e-4, what);
        }
        assert_eq!(position.is_some(), with_position);
        if let (Some(got), Some(expected)) = (position, expected_position) {
            close(got, expected, 1e-4, "position");
        }
    }
}

fn numbers<const D: usize>(x: &Tensor<D>) -> Vec<f32> {
    x.to_data().try_to_vec().unwrap()
}

#[test]
fn biases_by_position_are_added_to_the_scores() {
    let device = Device::default();
    // Grids of one and of two blocks of keys.
    for (h, w, heads, d) in [(5, 3, 2, 6), (24, 23, 1, 4)] {
        let tokens = h * w;
        let qkv = random([2, tokens, 3 * heads * d], &device);
        let (rows, columns) = (random([h, h, d], &device), random([w, w, d], &device));
        let [q, k, v] = of_heads(qkv.clone(), heads);
        let (by_row, by_column) = (numbers(&rows), numbers(&columns));
        let mut bias = Vec::new();
        for (index, query) in numbers(&q).chunks_exact(d).enumerate() {
            let t = index % tokens;
            let product = |e: &[f32]| query.iter().zip(e).map(|(a, b)| a * b).sum::<f32>();
            for key in 0..tokens {
                let row = product(&by_row[(t / w * h + key / w) * d..][..d]);
                bias.push(row + product(&by_column[(t % w * w + key % w) * d..][..d]));
            }
        }
        let bias = Tensor::<4>::from_data(TensorData::new(bias, [2, heads, tokens, tokens]), &device);
        let attended = |bias: Tensor<4>| {
            let scores = q.clone().matmul(k.clone().swap_dims(2, 3)) / (d as f64).sqrt() + bias;
            let read = activation::softmax(scores, 3).matmul(v.clone());
            read.swap_dims(1, 2).reshape([2, tokens, heads * d])
        };
        close(bias_of_axes(q.clone(), rows.clone(), columns.clone()), bias.clone(), 1e-5, "bias");
        let axes = PositionBias::Axes { rows: &rows, columns: &columns };
        close(positioned_self_attention(qkv.clone(), heads, axes), attended(bias), 1e-5, "axes");
        let table = random([heads, tokens, tokens], &device) * 2.0;
        let expected = attended(table.clone().unsqueeze());
        close(positioned_self_attention(qkv, heads, PositionBias::Table(&table)), expected, 1e-5, "table");
    }
}
