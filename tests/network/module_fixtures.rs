//! Every module of the network, fed with stored inputs and weights, against the official implementation's outputs at the
//! unit tolerances. `UNOPOSE_TEST_DEVICE` names the device.

use burn::tensor::{Device, Int, Tensor, TensorData, activation::sigmoid};
use unopose_core::config::{
    ColorConfig, EmbeddingEvaluation, FineConfig, GeoEmbeddingConfig, MatchingConfig, ModelConfig, VitConfig,
};
use unopose_nn::{
    checkpoint::Resampling,
    loss::pairwise_distance,
    model::{
        BlockOutput, DenseTokens, FeatureExtraction, GeometricStructureEmbedding, GeometricTransformer,
        GroupTensors, Initializer, LinearTransformerLayer, PixelChoice, PositionalEncoding,
        SparseToDenseTransformer, TransformerLayer, VisionTransformer,
    },
};
use unopose_tests::reference_tensors::{ReferenceTensors, max_difference};
use unopose_tests::tensor_fixture::Fixture;

const HEADS: usize = 4;
const WIDTH: usize = 32;

fn layer(device: &Device, relative: bool) -> TransformerLayer {
    TransformerLayer::new(WIDTH, HEADS, relative, &mut Initializer::new(0, device))
}

#[test]
fn relative_position_layer_matches() {
    let f = Fixture::open("rpe_layer");
    let layer = f.weights(layer(&f.device, true), "w.");
    let x = f.tensor::<3>("in");
    f.check("mha", layer.attention.attention.forward(x.clone(), x.clone(), Some(f.tensor("embed"))), 2e-5);
    f.check("out", layer.forward(x.clone(), x, Some(f.tensor("embed"))), 2e-5);
}

#[test]
fn cross_layer_and_block_match() {
    let f = Fixture::open("cross_layer");
    let cross = f.weights(layer(&f.device, false), "w.");
    f.check("out", cross.forward(f.tensor("in"), f.tensor("memory"), None), 2e-5);
    let block = GeometricTransformer::new(WIDTH, HEADS, &mut Initializer::new(0, &f.device));
    let block = f.weights(block, "block.w.");
    let (first, second) = block.forward(
        f.tensor("block.feats0"),
        f.tensor("block.embed0"),
        f.tensor("block.feats1"),
        f.tensor("block.embed1"),
    );
    f.check("block.out0", first, 2e-5);
    f.check("block.out1", second, 2e-5);
}

#[test]
fn linear_attention_matches() {
    let f = Fixture::open("linear_attention");
    let layer = LinearTransformerLayer::new(WIDTH, HEADS, 3.0, &mut Initializer::new(0, &f.device));
    let layer = f.weights(layer, "w.");
    for case in ["small", "large"] {
        let tensor = |part: &str| f.tensor::<3>(&format!("{case}.{part}"));
        f.check(&format!("{case}.out"), layer.forward(tensor("in"), tensor("memory")), 2e-5);
    }
}

#[test]
fn sparse_to_dense_block_matches() {
    let f = Fixture::open("sparse_to_dense");
    let config = FineConfig { matching: matching(), ..FineConfig::default() };
    let block = SparseToDenseTransformer::new(&config, &mut Initializer::new(0, &f.device));
    let block = f.weights(block, "w.");
    let [first, second] = [0, 1].map(|side| {
        let features = f.tensor::<3>(&format!("feats{side}"));
        let tokens = features.dims()[1];
        let (shape, index) = f.file.int(&format!("idx{side}"));
        // The stored indices address the list with the background in front, as the release uses them.
        let rows = index.chunks(shape[1]).enumerate().flat_map(|(b, index)| {
            let base = (b * tokens) as i32;
            std::iter::once(base).chain(index.iter().map(move |&i| base + i as i32))
        });
        let rows: Vec<i32> = rows.collect();
        let count = rows.len();
        DenseTokens {
            features,
            sparse_rows: Tensor::<1, Int>::from_data(TensorData::new(rows, [count]), &f.device),
            embedding: f.tensor(&format!("embed{side}")),
            attended: None,
        }
    });
    let (first, second) = block.forward(first, second);
    f.check("out0", first.features, 5e-5);
    f.check("out1", second.features, 5e-5);
}

#[test]
fn structure_embedding_matches() {
    let f = Fixture::open("geo_embedding");
    // Sinusoids of arguments up to 60 in f32 through linear maps; tables add 1.9e-6 per channel.
    for (evaluation, tolerance) in [(EmbeddingEvaluation::Exact, 1e-4), (EmbeddingEvaluation::Table, 1e-4)] {
        let config = GeoEmbeddingConfig { hidden_dim: WIDTH, evaluation, ..GeoEmbeddingConfig::default() };
        let embedding = GeometricStructureEmbedding::new(&config, &mut Initializer::new(0, &f.device));
        let embedding = f.weights(embedding, "w.");
        f.check("out", embedding.forward(f.tensor("d_indices"), f.tensor("a_indices")), tolerance);
    }
}

#[test]
fn similarity_scores_and_saliency_match() {
    let f = Fixture::open("similarity");
    let similarity = BlockOutput::cosine_similarity(f.tensor("feat1"), f.tensor("feat2"), 0.1);
    f.check("sim", similarity.clone(), 2e-5);
    let [batch, rows, columns] = similarity.dims();
    let raw = f.tensor::<3>("raw_scores").reshape([batch, rows + columns]);
    let query = raw.clone().slice([0..batch, 1..rows]);
    let reference = raw.slice([0..batch, rows + 1..rows + columns]);
    let output = BlockOutput { similarity, overlap: Some([query, reference]), background_overlap: None };
    f.check("score", Tensor::cat(output.overlap_probability().to_vec(), 1), 2e-5);
    f.check("saliency", Tensor::cat(output.saliency().unwrap().map(sigmoid).to_vec(), 1), 2e-5);
    let distance = pairwise_distance(f.tensor("dist_a"), f.tensor("dist_b"));
    f.check("sq_dist", distance.powi_scalar(2), 3e-5);
}

#[test]
fn vision_transformer_matches() {
    let f = Fixture::open("vit");
    let config = VitConfig { embed_dim: 48, depth: 4, heads: 3, ..VitConfig::default() };
    let vit = VisionTransformer::new(&config, 224, &mut Initializer::new(0, &f.device));
    let features = f.weights(vit, "w.").forward(f.tensor("image"));
    f.check("cls", features.class_token, 2e-5);
    for level in 0..4 {
        // The stored levels have the class and register tokens in front.
        let expected = f.tensor::<3>(&format!("level{level}")).slice([0..1, 5..261]);
        let got = features.pyramid.clone().slice([0..1, 0..256, level * 48..(level + 1) * 48]);
        let worst = (got - expected).abs().max().into_scalar::<f32>();
        assert!(worst <= 2e-5, "level{level}: {worst:e}");
    }
}

#[test]
fn position_embedding_is_resampled_as_in_the_release() {
    let file = ReferenceTensors::open("pos_embed_interp");
    for (case, first) in [("cls", 1), ("reg", 0)] {
        let (shape, old) = file.f32(&format!("{case}.pos_embed_37"));
        let width = shape[2];
        let new = file.f32(&format!("{case}.pos_embed_16")).1;
        let got = Resampling::Plain { offset: 0.0 }.resample(&old[first * width..], 37, 16, width);
        let worst = max_difference(got, &new[first * width..]);
        assert!(worst <= 1e-5, "{case}: {worst:e}");
        assert_eq!(old[..first * width], new[..first * width]);
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn features_are_sampled_as_from_the_upsampled_map() {
    let f = Fixture::open("upsample_gather");
    let vit = VitConfig { embed_dim: 48, depth: 4, heads: 3, out_dim: WIDTH, ..VitConfig::default() };
    let config = ModelConfig { color: ColorConfig::Vit(vit), ..ModelConfig::default() };
    let mut net = FeatureExtraction::new(&config, &mut Initializer::new(0, &f.device)).rgb_net;
    let upscaling = net.output_upscaling.take().unwrap();
    net.output_upscaling = Some(f.weights(upscaling, "w.output_upscaling."));
    let map = net.upscaled_tokens(f.tensor("tokens"));
    f.check("grid64", map.clone(), 1e-5);
    let choose: Vec<u32> = f.file.int("choose").1.iter().map(|&i| i as u32).collect();
    let choice = PixelChoice::new(std::iter::once(choose.as_slice()));
    f.check("gathered", net.sample(map, &choice), 1e-5);
    f.check("gathered", net.sample_tokens(f.tensor("tokens"), &choice), 1e-5);
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn positional_encoding_matches_in_training() {
    let f = Fixture::open("pe");
    let config = FineConfig { matching: matching(), ..FineConfig::default() };
    let encoding = |device: &Device| {
        let module = PositionalEncoding::new(&config, &mut Initializer::new(0, device));
        f.weights(module, "w.")
    };
    let stored = [0, 1].map(|scale| {
        let features = f.tensor::<4>(&format!("group{}", scale + 1)).permute([0, 2, 3, 1]);
        let [batch, n, k, _] = features.dims();
        GroupTensors { features, counts: vec![k as u32; batch * n], mask: None }
    });
    // The stored running statistics are those after the training pass, so the stored evaluation cannot be repeated with them;
    // evaluation is covered by the whole chain.
    let training = encoding(&f.device.clone().autodiff());
    let out = training.forward(&stored);
    f.check("out_train", out.clone(), 1e-3);
    let count = out.dims().iter().product::<usize>();
    let ramp = (0..count).map(|i| 2.0 * i as f32 / (count - 1) as f32 - 1.0).collect();
    let ramp = Tensor::<3>::from_data(TensorData::new(ramp, out.dims()), &f.device);
    let gradients = (out * ramp).sum().backward();
    for (name, layer) in [("mlp1.layer0", &training.mlp1.layer0), ("mlp2.layer2", &training.mlp2.layer2)] {
        let got = layer.conv.weight.val().grad(&gradients).unwrap().transpose();
        relative(&f, &format!("train_grad.{name}.conv.weight"), got.try_into_vec_as::<f32>().unwrap());
    }
}

/// Relative L2 difference at most 1e-2, the tolerance of the positional encoding's gradients.
fn relative(f: &Fixture, name: &str, got: Vec<f32>) {
    let expected = f.file.f32(name).1;
    let norm = |v: &mut dyn Iterator<Item = f32>| v.map(|x| (x * x) as f64).sum::<f64>().sqrt();
    let difference =
        norm(&mut got.iter().zip(&expected).map(|(a, b)| a - b)) / norm(&mut expected.iter().copied());
    println!("{name}: relative L2 {difference:.1e}");
    assert!(difference <= 1e-2, "{name}: relative L2 difference {difference:e}");
}

fn matching() -> MatchingConfig {
    MatchingConfig { hidden_dim: WIDTH, out_dim: WIDTH, heads: HEADS, ..MatchingConfig::default() }
}
