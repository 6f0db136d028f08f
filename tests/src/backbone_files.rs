//! Small random DINOv2 transformers as files of their three distributors.

use std::{collections::BTreeMap, path::Path};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::{Dtype, tensor::TensorView};

/// Shapes and values by name.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Sizes of a made transformer.
#[derive(Clone, Copy)]
pub struct Sizes {
    pub width: usize,
    pub depth: usize,
    pub patch: usize,
    /// Patches per side of the position embedding.
    pub side: usize,
    pub registers: usize,
}

/// Random parameters under Meta's names, the mask token apart.
pub fn weights(sizes: Sizes, seed: u64) -> Tensors {
    let Sizes { width, depth, patch, side, registers } = sizes;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut tensors = Tensors::new();
    let mut add = |name: String, shape: &[usize]| {
        let values = (0..shape.iter().product()).map(|_| rng.random_range(-0.5..0.5f32)).collect();
        tensors.insert(name, (shape.to_vec(), values));
    };
    add("cls_token".into(), &[1, 1, width]);
    add("pos_embed".into(), &[1, 1 + side * side, width]);
    if registers > 0 {
        add("register_tokens".into(), &[1, registers, width]);
    }
    add("patch_embed.proj.weight".into(), &[width, 3, patch, patch]);
    add("patch_embed.proj.bias".into(), &[width]);
    let mut linear = |name: &str, out: usize, input: usize| {
        add(format!("{name}.weight"), &[out, input]);
        add(format!("{name}.bias"), &[out]);
    };
    for i in 0..depth {
        linear(&format!("blocks.{i}.attn.qkv"), 3 * width, width);
        linear(&format!("blocks.{i}.attn.proj"), width, width);
        linear(&format!("blocks.{i}.mlp.fc1"), 4 * width, width);
        linear(&format!("blocks.{i}.mlp.fc2"), width, 4 * width);
    }
    for norm in (0..depth).flat_map(|i| ["norm1", "norm2"].map(|n| format!("blocks.{i}.{n}"))) {
        add(format!("{norm}.weight"), &[width]);
        add(format!("{norm}.bias"), &[width]);
    }
    add("norm.weight".into(), &[width]);
    add("norm.bias".into(), &[width]);
    for i in 0..depth {
        ["ls1", "ls2"].iter().for_each(|ls| add(format!("blocks.{i}.{ls}.gamma"), &[width]));
    }
    tensors
}

/// timm's form: with registers, the class token has its position added and the embedding lacks it.
pub fn timm(mut tensors: Tensors) -> Tensors {
    let Some(registers) = tensors.remove("register_tokens") else { return tensors };
    tensors.insert("reg_token".into(), registers);
    let (shape, position) = tensors.remove("pos_embed").unwrap();
    let class = &mut tensors.get_mut("cls_token").unwrap().1;
    class.iter_mut().zip(&position).for_each(|(c, p)| *c += p);
    let width = shape[2];
    tensors.insert("pos_embed".into(), (vec![1, shape[1] - 1, width], position[width..].to_vec()));
    tensors
}

/// Meta's form, with the mask token.
pub fn meta(mut tensors: Tensors) -> Tensors {
    tensors.insert("mask_token".into(), (vec![1, 1], vec![0.0]));
    tensors
}

/// The form of Hugging Face transformers, with query, key and value apart.
pub fn hugging_face(tensors: Tensors) -> Tensors {
    let renames = [
        ("cls_token", "embeddings.cls_token"),
        ("register_tokens", "embeddings.register_tokens"),
        ("pos_embed", "embeddings.position_embeddings"),
        ("patch_embed.proj", "embeddings.patch_embeddings.projection"),
        ("blocks.", "encoder.layer."),
        (".attn.proj.", ".attention.output.dense."),
        ("ls1.gamma", "layer_scale1.lambda1"),
        ("ls2.gamma", "layer_scale2.lambda1"),
    ];
    let mut renamed = Tensors::new();
    for (name, (shape, values)) in tensors {
        let new = renames.iter().fold(name, |name, (from, to)| name.replace(from, to));
        let new = if let Some(kind) = new.strip_prefix("norm.") { format!("layernorm.{kind}") } else { new };
        match new.split_once("attn.qkv.") {
            None => drop(renamed.insert(new, (shape, values))),
            Some((layer, kind)) => {
                let third = values.len() / 3;
                for (part, values) in ["query", "key", "value"].iter().zip(values.chunks(third)) {
                    let shape = [&[shape[0] / 3], &shape[1..]].concat();
                    let name = format!("{layer}attention.attention.{part}.{kind}");
                    renamed.insert(name, (shape, values.to_vec()));
                }
            }
        }
    }
    meta(renamed).into_iter().map(|(n, t)| (n.replace("mask_token", "embeddings.mask_token"), t)).collect()
}

pub fn safetensors(path: &Path, tensors: &Tensors) {
    let bytes: Vec<Vec<u8>> =
        tensors.values().map(|(_, v)| v.iter().flat_map(|x| x.to_le_bytes()).collect()).collect();
    let views = tensors.iter().zip(&bytes).map(|((name, (shape, _)), bytes)| {
        (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap())
    });
    std::fs::write(path, safetensors::serialize(views, None).unwrap()).unwrap();
}
