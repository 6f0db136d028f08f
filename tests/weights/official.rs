//! Official weights: both containers, strictness, conversions, and the way back. Files of the official implementation
//! come from the shared folder.

use std::path::{Path, PathBuf};

use burn::tensor::{DType, Device, TensorData};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use unopose_core::config::{ColorConfig, Config, ModelConfig, Quirks};
use unopose_nn::{
    checkpoint::{OfficialState, export_official, load, load_official, official_tensors},
    model::UnoPose,
};
use unopose_tests::pytorch_file::Pickled;

fn fixtures() -> (PathBuf, ModelConfig) {
    let folder = unopose_tests::shared("fixtures");
    let config = Config::load_official(&folder.join("config.json")).unwrap();
    (folder, config.model)
}

fn bits(model: &UnoPose) -> Vec<(String, Vec<usize>, Vec<u32>)> {
    let tensors = official_tensors(model).unwrap();
    let bits = |data: TensorData| (data.shape().to_vec(), data.iter::<f32>().map(f32::to_bits).collect());
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
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn both_containers_hold_the_same_bits_and_export_returns_them() {
    let (folder, config) = fixtures();
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
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn missing_extra_and_wrong_tensors_are_all_listed() {
    let (folder, config) = fixtures();
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

/// Values of a little-endian f32 tensor.
fn floats(view: &TensorView<'_>) -> Vec<f32> {
    floats_of(view.data())
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn other_precisions_are_converted_with_a_notice() {
    let (folder, config) = fixtures();
    let scratch = tempfile::tempdir().unwrap();
    let source = folder.join("weights.safetensors");
    let (model, _) = load_official(&source, &config, &Device::flex()).unwrap();
    // Double precision holds the same numbers; the halves hold 11 and 8 binary digits.
    let forms = [
        ("F64", Dtype::F64, "DoubleStorage", DType::F64, 0.0),
        ("F16", Dtype::F16, "HalfStorage", DType::F16, 2f32.powi(-11)),
        ("BF16", Dtype::BF16, "BFloat16Storage", DType::BF16, 2f32.powi(-8)),
    ];
    for (name, dtype, storage, precision, relative) in forms {
        let chosen = |name: &str| name.starts_with("geo_embedding.proj");
        let encode = |view: &TensorView<'_>| {
            let values = floats(view);
            let count = values.len();
            TensorData::new(values, [count]).convert_dtype(precision).as_bytes().to_vec()
        };
        // A safetensors file by content, whatever it is called, and a pickled one.
        let (safe, pickled) = (scratch.path().join("w.pth"), scratch.path().join("w.safetensors"));
        rewrite(&source, &safe, |name, view| match chosen(name) {
            true => Some((dtype, view.shape().to_vec(), encode(view))),
            false => same(view),
        });
        let content = std::fs::read(&source).unwrap();
        let file = SafeTensors::deserialize(&content).unwrap();
        let list: Vec<Pickled> = file
            .iter()
            .map(|(name, view)| {
                let (storage, bytes) = match (chosen(name), view.dtype()) {
                    (true, _) => (storage, encode(&view)),
                    (false, Dtype::I64) => ("LongStorage", view.data().to_vec()),
                    (false, _) => ("FloatStorage", view.data().to_vec()),
                };
                Pickled { name: name.into(), shape: view.shape().to_vec(), storage, bytes }
            })
            .collect();
        unopose_tests::pytorch_file::write(&pickled, Some("model"), &list, b"");
        for path in [&safe, &pickled] {
            let state = OfficialState::read(path).unwrap();
            assert_eq!(
                state.notices,
                [format!("4 tensors converted from {name} to F32")],
                "{}",
                path.display()
            );
            let converted = state.into_model(&config, &Device::flex()).unwrap();
            for ((name, _, a), (_, _, b)) in bits(&converted).iter().zip(&bits(&model)) {
                let close = |(a, b): (&u32, &u32)| {
                    let [a, b] = [a, b].map(|&x| f32::from_bits(x));
                    (a - b).abs() <= relative * b.abs() + 1e-7 * f32::from(relative > 0.0)
                };
                assert!(a.iter().zip(b).all(close), "{name}");
            }
        }
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn objects_of_other_classes_beside_the_weights_do_no_harm() {
    let (folder, config) = fixtures();
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("checkpoint.pt");
    let content = std::fs::read(folder.join("weights.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&content).unwrap();
    let floats = file.iter().filter(|(_, view)| view.dtype() == Dtype::F32);
    let list: Vec<Pickled> = floats.map(|(n, v)| Pickled::f32(n, v.shape(), &floats_of(v.data()))).collect();
    // {"model": {...}, "args": argparse.Namespace()} as training scripts leave it.
    unopose_tests::pytorch_file::write(
        &path,
        Some("model"),
        &list,
        b"X\x04\x00\x00\x00argscargparse\nNamespace\n)\x81",
    );
    let (model, _) = load_official(&path, &config, &Device::flex()).unwrap();
    let (expected, _) = load_official(&folder.join("weights.pth"), &config, &Device::flex()).unwrap();
    assert_eq!(bits(&model), bits(&expected));
}

fn floats_of(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks(4).map(|c| f32::from_le_bytes(c.try_into().unwrap())).collect()
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn a_checkpoint_reader_takes_official_files_too() {
    let (folder, config) = fixtures();
    let device = Device::flex();
    let (expected, _) = load_official(&folder.join("weights.pth"), &config, &device).unwrap();
    let (model, found, _) = load(&folder.join("weights.pth"), &device).unwrap();
    assert_eq!(bits(&model), bits(&expected));
    assert_eq!(found.model.quirks, Quirks::release());
    // Without the configuration beside it, a transformer 48 wide could have any number of heads.
    let scratch = tempfile::tempdir().unwrap();
    let alone = scratch.path().join("weights.safetensors");
    std::fs::copy(folder.join("weights.safetensors"), &alone).unwrap();
    let error = load(&alone, &device).unwrap_err().to_string();
    assert!(error.contains("48 wide") && error.contains("config.json"), "{error}");
    // Cut in half, under either name.
    let good = std::fs::read(folder.join("weights.pth")).unwrap();
    std::fs::write(&alone, &good[..good.len() / 2]).unwrap();
    let error = load(&alone, &device).unwrap_err().to_string();
    assert!(error.contains("PyTorch"), "{error}");
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
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
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn half_a_file_is_refused() {
    let (folder, _) = fixtures();
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("w.pth");
    for (name, part) in [("weights.pth", "PyTorch"), ("weights.safetensors", "is not a safetensors file")] {
        let whole = std::fs::read(folder.join(name)).unwrap();
        std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        let error = OfficialState::read(&path).unwrap_err().to_string();
        assert!(error.contains("w.pth") && error.contains(part), "{error}");
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
