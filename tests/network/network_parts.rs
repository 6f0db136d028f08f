//! Parts of the network against plain forms of the same arithmetic, and its symmetries.

use burn::tensor::{
    Device, Int, Tensor, TensorData,
    activation::{relu, softmax},
    module::linear,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::config::{EmbeddingEvaluation, FineConfig, GeoEmbeddingConfig, MatchingConfig};
use unopose_nn::model::{
    GeometricStructureEmbedding, GroupTensors, Initializer, MultiHeadAttention, PositionalEncoding,
};

fn random<const D: usize>(seed: u64, shape: [usize; D], low: f32, high: f32, device: &Device) -> Tensor<D> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let values: Vec<f32> = (0..shape.iter().product()).map(|_| rng.random_range(low..high)).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

#[track_caller]
fn close<const D: usize>(what: &str, a: Tensor<D>, b: Tensor<D>, tolerance: f32) {
    let worst = (a.inner() - b.inner()).abs().max().into_scalar::<f32>();
    assert!(worst <= tolerance, "{what}: {worst} > {tolerance}");
}

#[test]
fn tabulated_structure_embedding_equals_the_exact_one() {
    let device = Device::flex();
    // Widths of the small and of the published network.
    for width in [32, 256] {
        let embedding = |evaluation, device: &Device| {
            let config =
                GeoEmbeddingConfig { hidden_dim: width, evaluation, ..GeoEmbeddingConfig::default() };
            GeometricStructureEmbedding::new(&config, &mut Initializer::new(5, device))
        };
        let distances = random(1, [2, 19, 19], 0.0, 14.0, &device);
        let angles = random(2, [2, 19, 19, 3], 0.0, 12.0, &device);
        let [exact, table] = [EmbeddingEvaluation::Exact, EmbeddingEvaluation::Table]
            .map(|evaluation| embedding(evaluation, &device).forward(distances.clone(), angles.clone()));
        // step^2 / 8 = 1.9e-6 for the fastest channel, frequency^2 times that for the others, twice; times |W|.
        close("inference table", exact, table, 1e-5);

        let training = device.clone().autodiff();
        let gradients = |evaluation| {
            let module = embedding(evaluation, &training);
            let loss = module.forward(distances.clone(), angles.clone()).powi_scalar(2).mean();
            let gradients = loss.backward();
            [&module.proj_d, &module.proj_a].map(|map| {
                let bias = map.bias.as_ref().unwrap().val().grad(&gradients).unwrap();
                (map.weight.val().grad(&gradients).unwrap(), bias)
            })
        };
        let exact = gradients(EmbeddingEvaluation::Exact);
        for (exact, table) in exact.into_iter().zip(gradients(EmbeddingEvaluation::Table)) {
            close("gradient of a weight", exact.0, table.0, 1e-5);
            close("gradient of a bias", exact.1, table.1, 1e-5);
        }
    }
}

#[test]
fn projecting_the_query_equals_projecting_the_embedding() {
    let device = Device::flex();
    let (n, width, heads) = (7, 16, 4);
    let attention = MultiHeadAttention::new(width, heads, true, &mut Initializer::new(1, &device));
    let x = random(2, [1, n, width], -1.0, 1.0, &device);
    let e = random(3, [1, n, n, width], -1.0, 1.0, &device);
    let split = |x: Tensor<3>| x.reshape([1, n, heads, width / heads]).swap_dims(1, 2);
    let q = split(attention.proj_q.forward(x.clone()));
    let k = split(attention.proj_k.forward(x.clone()));
    let v = split(attention.proj_v.forward(x.clone()));
    let p = attention.proj_p.as_ref().unwrap().forward(e.clone()); // [1, N, N, C]
    let p = p.reshape([1, n, n, heads, width / heads]).permute([0, 3, 1, 2, 4]);
    let position = (p * q.clone().unsqueeze_dim::<5>(3)).sum_dim(4).squeeze_dim::<4>(4);
    let scores = (q.matmul(k.swap_dims(2, 3)) + position) / ((width / heads) as f64).sqrt();
    let plain = softmax(scores, 3).matmul(v).swap_dims(1, 2).reshape([1, n, width]);
    close("attention", plain, attention.forward(x.clone(), x, Some(e)), 2e-6);
}

#[test]
fn attention_is_equivariant_to_the_order_of_points() {
    let device = Device::flex();
    let attention = MultiHeadAttention::new(16, 2, true, &mut Initializer::new(1, &device));
    let x = random(2, [1, 6, 16], -1.0, 1.0, &device);
    let e = random(3, [1, 6, 6, 16], -1.0, 1.0, &device);
    let order = Tensor::<1, Int>::from_data([3, 0, 5, 1, 4, 2], &device);
    let expected = attention.forward(x.clone(), x.clone(), Some(e.clone())).select(1, order.clone());
    let x = x.select(1, order.clone());
    let e = e.select(1, order.clone()).select(2, order);
    close("permuted attention", expected, attention.forward(x.clone(), x, Some(e)), 2e-6);
}

/// The folded batch norm against statistics taken from the mapped rows themselves, with and without padding.
#[test]
fn folded_batch_norm_equals_the_plain_one() {
    let device = Device::flex().autodiff();
    let matching = MatchingConfig { hidden_dim: 8, ..MatchingConfig::default() };
    let config = FineConfig { matching, pe_channels: [8, 8, 8], ..FineConfig::default() };
    let encoding = PositionalEncoding::new(&config, &mut Initializer::new(4, &device));
    let layer = &encoding.mlp1.layer0;
    let rows = random(6, [50, 6], -1.0, 1.0, &Device::flex());
    let counted: Vec<f32> = (0..50).map(|i| if i % 3 == 0 { 0.0 } else { 1.0 }).collect();
    let mask = Tensor::<2>::from_data(TensorData::new(counted, [50, 1]), &Device::flex());
    for mask in [None, Some(mask)] {
        let y = rows.clone().matmul(layer.conv.weight.val().inner());
        let weights = mask.clone().unwrap_or_else(|| Tensor::ones([50, 1], &Device::flex()));
        let count = weights.clone().sum_dim(0);
        let mean = (y.clone() * weights.clone()).sum_dim(0) / count.clone();
        let centred = y - mean;
        let variance = (centred.clone() * centred.clone() * weights).sum_dim(0) / count;
        let plain = (centred / (variance + 1e-5).sqrt()).clamp_min(0.0);
        let (weight, shift) = layer.normlayer.bn.fold_batch(&layer.conv, &rows, mask);
        let folded = relu(linear(rows.clone(), weight, Some(shift)));
        close("normalised rows", plain, folded, 1e-5);
    }
}

#[test]
fn positional_encoding_does_not_see_the_order_of_neighbours() {
    let device = Device::flex();
    let matching = MatchingConfig { hidden_dim: 8, ..MatchingConfig::default() };
    let config = FineConfig { matching, pe_channels: [8, 8, 16], ..FineConfig::default() };
    let encoding = PositionalEncoding::new(&config, &mut Initializer::new(4, &device));
    let features = random(5, [1, 4, 6, 6], -0.2, 0.2, &device);
    let order = Tensor::<1, Int>::from_data([5, 2, 0, 1, 4, 3], &device);
    let forward = |features: Tensor<4>| {
        let group = GroupTensors { features, counts: vec![6; 4], mask: None };
        encoding.forward(&[group.clone(), group])
    };
    close("shuffled neighbours", forward(features.clone()), forward(features.select(2, order)), 1e-6);
}
