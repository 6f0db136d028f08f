//! DINOv2 backbones in the namings of their three distributors, on small random transformers.

use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor, TensorData};
use unopose_core::config::{ColorConfig, Config, ModelConfig, VitConfig};
use unopose_nn::{
    checkpoint::{
        Backbone, Meta, Naming, Resampling, checksum, load, load_backbone, load_with_backbone, save,
        strip_backbone,
    },
    model::UnoPose,
};
use unopose_tests::backbone_files::{Sizes, Tensors, hugging_face, meta, safetensors, timm};
use unopose_tests::pytorch_file::Pickled;

const WIDTH: usize = 24;
const DEPTH: usize = 4;
const PATCH: usize = 4;
/// Patches per side at the resolution of the files.
const SIDE: usize = 5;

/// Random parameters under Meta's names, the mask token apart.
fn weights(registers: usize) -> Tensors {
    unopose_tests::backbone_files::weights(
        Sizes { width: WIDTH, depth: DEPTH, patch: PATCH, side: SIDE, registers },
        9,
    )
}

fn pytorch(path: &Path, tensors: &Tensors) {
    let list: Vec<Pickled> = tensors.iter().map(|(n, (shape, v))| Pickled::f32(n, shape, v)).collect();
    unopose_tests::pytorch_file::write(path, None, &list, b"");
}

fn config(registers: usize, image_size: usize) -> ModelConfig {
    let vit = VitConfig {
        embed_dim: WIDTH,
        depth: DEPTH,
        heads: 3,
        patch_size: PATCH,
        register_tokens: registers,
        no_embed_class: registers > 0,
        out_dim: 8,
        ..VitConfig::default()
    };
    ModelConfig { image_size, color: ColorConfig::Vit(vit), ..Config::embedded("smoke", &[]).unwrap().model }
}

fn network(config: &ModelConfig) -> UnoPose {
    UnoPose::new(config, 1, &Device::flex())
}

/// The transformer's features of a fixed image.
fn features(path: &Path, config: &ModelConfig) -> Vec<f32> {
    let model = load_backbone(path, config, network(config)).unwrap();
    let side = config.image_size;
    let pixels = (0..3 * side * side).map(|i| ((i * 37) % 101) as f32 / 50.0 - 1.0).collect();
    let image = Tensor::<4>::from_data(TensorData::new(pixels, [1, 3, side, side]), &Device::flex());
    let vit = model.feature_extraction.rgb_net.vit.unwrap();
    vit.forward(image).pyramid.try_into_vec_as::<f32>().unwrap()
}

/// Files of all namings in both containers; they live as long as the folder.
fn files(folder: &tempfile::TempDir, registers: usize) -> Vec<(Naming, PathBuf)> {
    let forms = [
        (Naming::Meta, meta(weights(registers))),
        (Naming::Timm, timm(weights(registers))),
        (Naming::HuggingFace, hugging_face(weights(registers))),
    ];
    let mut files = Vec::new();
    for (naming, tensors) in &forms {
        let path = |extension| folder.path().join(format!("{naming:?}.{extension}"));
        safetensors(&path("safetensors"), tensors);
        pytorch(&path("pth"), tensors);
        files.extend(["safetensors", "pth"].map(|extension| (*naming, path(extension))));
    }
    files
}

#[test]
fn three_namings_of_the_same_weights_give_the_same_features() {
    for registers in [0, 4] {
        let folder = tempfile::tempdir().unwrap();
        let files = files(&folder, registers);
        let config = config(registers, SIDE * PATCH);
        let first = features(&files[0].1, &config);
        assert_eq!(first.len(), SIDE * SIDE * 4 * WIDTH);
        for (naming, path) in &files {
            assert_eq!(Backbone::read(path).unwrap().unwrap().naming, *naming);
            assert_eq!(features(path, &config), first, "{}", path.display());
        }
        // Also in a network that keeps the class token's position in the other place.
        let mut other = config.clone();
        let ColorConfig::Vit(vit) = &mut other.color else { unreachable!() };
        vit.no_embed_class = !vit.no_embed_class;
        assert_eq!(features(&files[0].1, &other), first);
    }
}

#[test]
fn positions_are_resampled_as_each_source_does_it() {
    let side = 3;
    let native = weights(0)["pos_embed"].1.clone();
    for registers in [0, 4] {
        let folder = tempfile::tempdir().unwrap();
        for (naming, path) in &files(&folder, registers) {
            let way = match (naming, registers) {
                (Naming::Meta, 0) => Resampling::Plain { offset: 0.1 },
                (Naming::HuggingFace, 0) => Resampling::Plain { offset: 0.0 },
                _ => Resampling::Antialiased,
            };
            let config = config(registers, side * PATCH);
            let model = load_backbone(path, &config, network(&config)).unwrap();
            let vit = model.feature_extraction.rgb_net.vit.unwrap();
            let got = vit.pos_embed.val().try_into_vec_as::<f32>().unwrap();
            let grid = &got[got.len() - side * side * WIDTH..];
            assert_eq!(grid, way.resample(&native[WIDTH..], SIDE, side, WIDTH), "{naming} {registers}");
        }
    }
}

#[test]
fn everything_that_does_not_fit_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.safetensors");
    let config = config(0, SIDE * PATCH);
    let error = |tensors: Tensors, config: &ModelConfig| {
        safetensors(&path, &tensors);
        load_backbone(&path, config, network(config)).unwrap_err().to_string()
    };
    let mut odd = hugging_face(weights(0));
    odd.remove("encoder.layer.2.attention.attention.key.bias");
    odd.remove("layernorm.weight");
    odd.insert("encoder.layer.1.adapter.weight".into(), (vec![1], vec![0.0]));
    odd.insert("encoder.layer.0.norm1.bias".into(), (vec![7], vec![0.0; 7]));
    let text = error(odd, &config);
    for part in [
        "encoder.layer.2.attention.attention.key.bias is missing",
        "norm.weight is missing",
        "encoder.layer.1.adapter.weight is unknown",
        "blocks.0.norm1.bias has shape [7] in the checkpoint, [24] in the network",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains("query") && !text.contains("attn.qkv"), "{text}");

    let mut larger = config.clone();
    let ColorConfig::Vit(vit) = &mut larger.color else { unreachable!() };
    (vit.depth, vit.register_tokens) = (5, 4);
    let text = error(meta(weights(0)), &larger);
    for part in [
        "model.color.depth is 4 in the checkpoint, 5 here",
        "model.color.register_tokens is 0 in the checkpoint, 4 here",
        "blocks.4.attn.qkv.weight is missing",
        "reg_token is missing",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn swiglu_and_files_without_a_backbone_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.safetensors");
    let config = config(0, SIDE * PATCH);
    let hidden = 2 * WIDTH;
    let giant = |first: &str, second: &str, form: fn(Tensors) -> Tensors| {
        let mut tensors = form(weights(0));
        tensors.retain(|name, _| !name.contains("mlp."));
        tensors.insert(format!("{first}.weight"), (vec![2 * hidden, WIDTH], vec![0.1; 2 * hidden * WIDTH]));
        tensors.insert(format!("{second}.weight"), (vec![WIDTH, hidden], vec![0.1; hidden * WIDTH]));
        tensors
    };
    for tensors in [
        giant("blocks.0.mlp.w12", "blocks.0.mlp.w3", meta),
        giant("blocks.0.mlp.fc1", "blocks.0.mlp.fc2", timm),
        giant("encoder.layer.0.mlp.weights_in", "encoder.layer.0.mlp.weights_out", hugging_face),
    ] {
        safetensors(&path, &tensors);
        let error = load_backbone(&path, &config, network(&config)).unwrap_err().to_string();
        assert!(error.contains("SwiGLU") && error.contains("ViT-L"), "{error}");
    }
    safetensors(&path, &Tensors::from([("fc.weight".into(), (vec![1], vec![0.0]))]));
    assert!(Backbone::read(&path).unwrap().is_none());
    let error = load_backbone(&path, &config, network(&config)).unwrap_err().to_string();
    assert!(error.contains("holds no DINOv2 backbone"), "{error}");

    safetensors(&path, &meta(weights(0)));
    let smoke = Config::embedded("smoke", &[]).unwrap().model;
    let error = load_backbone(&path, &smoke, network(&smoke)).unwrap_err().to_string();
    assert!(error.contains("model.color.kind is not vit"), "{error}");
}

#[test]
fn sizes_of_the_published_widths_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.safetensors");
    safetensors(&path, &meta(weights(4)));
    let sizes = Backbone::read(&path).unwrap().unwrap().sizes();
    assert_eq!(
        (sizes.embed_dim, sizes.depth, sizes.patch_size, sizes.register_tokens),
        (WIDTH, DEPTH, PATCH, 4)
    );
    assert_eq!((sizes.side, sizes.class_position), (SIDE, true));
    for (embed_dim, depth, name) in [(384, 12, "ViT-S/14"), (768, 12, "ViT-B/14"), (1024, 24, "ViT-L/14")] {
        let text =
            unopose_nn::checkpoint::BackboneSizes { embed_dim, depth, patch_size: 14, ..sizes }.to_string();
        assert!(text.starts_with(name), "{text}");
    }
}

#[test]
fn a_checkpoint_without_its_backbone_is_completed_by_the_same_one_only() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let config = Config { model: config(0, 20), ..Config::embedded("smoke", &[]).unwrap() };
    let published = weights(0);
    safetensors(&at("backbone.safetensors"), &meta(published.clone()));
    let model = load_backbone(&at("backbone.safetensors"), &config.model, network(&config.model)).unwrap();
    save(&at("whole.safetensors"), &model, &config, &Meta { step: 7, ..Meta::default() }).unwrap();
    let device = Device::flex();
    strip_backbone(&at("whole.safetensors"), &at("small.safetensors"), &device).unwrap();
    let bytes = |name: &str| std::fs::metadata(at(name)).unwrap().len();
    assert!(4 * (bytes("whole.safetensors") - bytes("small.safetensors")) > bytes("whole.safetensors"));

    let message = load(&at("small.safetensors"), &device).err().unwrap().to_string();
    assert!(message.contains("small.safetensors") && message.contains("--backbone"), "{message}");
    // Another publisher's naming of the same weights.
    safetensors(&at("hugging.safetensors"), &hugging_face(published.clone()));
    for name in ["backbone.safetensors", "hugging.safetensors"] {
        let (completed, _, read) = load_with_backbone(&at("small.safetensors"), &at(name), &device).unwrap();
        assert_eq!((checksum(&completed).unwrap(), read.step), (checksum(&model).unwrap(), 7), "{name}");
    }
    // The same weights with a tenth of one layer changed, and a checkpoint that has its own.
    let mut other = published;
    other.get_mut("blocks.0.mlp.fc1.weight").unwrap().1.iter_mut().step_by(10).for_each(|w| *w = -*w);
    safetensors(&at("other.safetensors"), &meta(other));
    let refused = |checkpoint: &str, backbone: &str| {
        load_with_backbone(&at(checkpoint), &at(backbone), &device).err().unwrap().to_string()
    };
    let message = refused("small.safetensors", "other.safetensors");
    assert!(message.contains("other.safetensors gives other features"), "{message}");
    let message = refused("whole.safetensors", "backbone.safetensors");
    assert!(message.contains("backbone_features is absent"), "{message}");
}
