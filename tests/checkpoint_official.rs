//! Official weights: both containers, strictness, conversions, and the way back. Files of the official implementation
//! come from the folder named by `UNOPOSE_SHARED`; those tests are skipped with a printed reason without it.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use unopose::{
    checkpoint::{OfficialState, export_official, load_official, official_tensors},
    config::{ColorConfig, Config, ModelConfig},
    model::UnoPose,
};

fn fixtures() -> Option<(PathBuf, ModelConfig)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let shared = std::env::var_os("UNOPOSE_SHARED").map_or_else(|| root.join("../shared"), PathBuf::from);
    let folder = shared.join("fixtures");
    match Config::load_official(&folder.join("config.json")) {
        Ok(config) => Some((folder, config.model)),
        Err(error) => {
            println!("skipped: {error} (set UNOPOSE_SHARED)");
            None
        }
    }
}

fn bits(model: &UnoPose) -> Vec<(String, Vec<usize>, Vec<u32>)> {
    let tensors = official_tensors(model).unwrap();
    let bits = |data: burn::tensor::TensorData| {
        (data.shape().to_vec(), data.iter::<f32>().map(f32::to_bits).collect())
    };
    tensors.into_iter().map(|(name, data)| (name, bits(data))).map(|(n, (s, b))| (n, s, b)).collect()
}

/// Rewrites a safetensors file: each tensor is kept, changed or dropped.
fn rewrite(
    source: &Path,
    target: &Path,
    edit: impl Fn(&str, &TensorView<'_>) -> Option<(Dtype, Vec<usize>, Vec<u8>)>,
) {
    let bytes = std::fs::read(source).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let edited: Vec<_> = file.iter().filter_map(|(n, v)| Some((n.to_owned(), edit(n, &v)?))).collect();
    let views =
        edited.iter().map(|(n, (d, shape, data))| (n, TensorView::new(*d, shape.clone(), data).unwrap()));
    std::fs::write(target, safetensors::serialize(views, None).unwrap()).unwrap();
}

fn same(view: &TensorView<'_>) -> Option<(Dtype, Vec<usize>, Vec<u8>)> {
    Some((view.dtype(), view.shape().to_vec(), view.data().to_vec()))
}

#[test]
fn both_containers_hold_the_same_bits_and_export_returns_them() {
    let Some((folder, config)) = fixtures() else { return };
    let device = Device::flex();
    let (pickled, unused) = load_official(&folder.join("weights.pth"), &config, &device).unwrap();
    let (safe, same_unused) = load_official(&folder.join("weights.safetensors"), &config, &device).unwrap();
    assert_eq!(bits(&pickled), bits(&safe));
    assert_eq!(unused, same_unused);
    assert!(unused.iter().any(|name| name == "fine_point_matching.dis_proj.weight"), "{unused:?}");

    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("out.safetensors");
    export_official(&path, &safe, &config).unwrap();
    let (back, _) = load_official(&path, &config, &device).unwrap();
    assert_eq!(bits(&back), bits(&safe));
    // Official shapes too: apart from the unused heads every stored tensor has its twin.
    let (theirs, ours) =
        (std::fs::read(folder.join("weights.safetensors")).unwrap(), std::fs::read(&path).unwrap());
    let (theirs, ours) =
        (SafeTensors::deserialize(&theirs).unwrap(), SafeTensors::deserialize(&ours).unwrap());
    for (name, view) in theirs.iter() {
        if name.contains("vit.head.") || name.contains("dis_proj") || name.ends_with("num_batches_tracked") {
            continue;
        }
        assert_eq!(ours.tensor(name).unwrap().shape(), view.shape(), "{name}");
        if name.ends_with("div_term") {
            let close = |(a, b): (&[u8], &[u8])| {
                let [a, b] = [a, b].map(|x| f32::from_le_bytes(x.try_into().unwrap()));
                (a - b).abs() <= 1e-6 * b
            };
            assert!(ours.tensor(name).unwrap().data().chunks(4).zip(view.data().chunks(4)).all(close));
        } else {
            assert_eq!(ours.tensor(name).unwrap().data(), view.data(), "{name}");
        }
    }
}

#[test]
fn missing_extra_and_wrong_tensors_are_all_listed() {
    let Some((folder, config)) = fixtures() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("w.safetensors");
    rewrite(&folder.join("weights.safetensors"), &path, |name, view| match name {
        "geo_embedding.proj_d.bias" => None,
        "coarse_point_matching.bg_token" => Some((Dtype::F32, vec![1, 32], view.data().to_vec())),
        _ => same(view),
    });
    let error = load_official(&path, &config, &Device::flex()).unwrap_err().to_string();
    assert!(error.contains("geo_embedding.proj_d.bias is missing"), "{error}");
    assert!(
        error.contains("bg_token has shape [1, 32] in the checkpoint, [1, 1, 32] in the network"),
        "{error}"
    );

    let mut shallow = config.clone();
    shallow.coarse.blocks = 2;
    let error =
        load_official(&folder.join("weights.pth"), &shallow, &Device::flex()).unwrap_err().to_string();
    assert!(error.contains("model.coarse.blocks is 3 in the checkpoint, 2 here"), "{error}");
    assert!(error.contains("coarse_point_matching.score_heads.2.weight is unknown"), "{error}");
}

#[test]
fn double_precision_is_converted_with_a_notice() {
    let Some((folder, config)) = fixtures() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("w.pth");
    rewrite(&folder.join("weights.safetensors"), &path, |name, view| {
        if !name.starts_with("geo_embedding.proj") {
            return same(view);
        }
        let values = view.data().chunks(4).map(|c| f32::from_le_bytes(c.try_into().unwrap()) as f64);
        Some((Dtype::F64, view.shape().to_vec(), values.flat_map(f64::to_le_bytes).collect()))
    });
    // A safetensors file by content, whatever it is called.
    let state = OfficialState::read(&path).unwrap();
    assert_eq!(state.notices, ["4 tensors converted from F64 to F32"]);
    let (model, _) = load_official(&folder.join("weights.pth"), &config, &Device::flex()).unwrap();
    assert_eq!(bits(&state.into_model(&config, &Device::flex()).unwrap()), bits(&model));
}

#[test]
fn broken_and_foreign_files_are_explained() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("w.pth");
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        OfficialState::read(&path).unwrap_err().to_string()
    };
    let error = read(b"hello");
    assert!(error.contains("neither a safetensors file nor a readable PyTorch checkpoint"), "{error}");
    // Protocol 2: {"model": __main__.Net()} with an empty argument tuple.
    let error = read(b"\x80\x02}X\x05\x00\x00\x00modelc__main__\nNet\n)\x81s.");
    assert!(error.contains("model: __main__.Net"), "{error}");
    if let Some((folder, _)) = fixtures() {
        let good = std::fs::read(folder.join("weights.pth")).unwrap();
        let error = read(&good[..good.len() / 2]);
        assert!(error.contains("w.pth") && error.contains("PyTorch"), "{error}");
        let good = std::fs::read(folder.join("weights.safetensors")).unwrap();
        let error = read(&good[..good.len() / 2]);
        assert!(error.contains("is not a safetensors file"), "{error}");
    }
}

#[test]
fn a_network_without_counterpart_is_refused_with_the_reason() {
    let mut config = Config::embedded("smoke", &[]).unwrap().model;
    config.color = ColorConfig::Conv { channels: [4, 8, 8], out_dim: 8 };
    let model = UnoPose::new(&config, 0, &Device::flex());
    let error = export_official(Path::new("unused.safetensors"), &model, &config).unwrap_err().to_string();
    assert!(error.contains("model.color.kind = conv"), "{error}");
}
