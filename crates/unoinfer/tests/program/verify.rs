//! `unoinfer verify`, `inspect` and `export` as processes, on the tensors of the official implementation.

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use burn::tensor::Device;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use unopose_core::config::Config;
use unopose_nn::{
    checkpoint::{self, Meta},
    model::UnoPose,
};

fn fixtures() -> PathBuf {
    unopose_tests::shared("fixtures")
}

fn unoinfer(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unoinfer")).args(arguments).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn verify(weights: &Path, tensors: &Path, more: &[&str]) -> (bool, String) {
    let device = std::env::var("UNOPOSE_TEST_DEVICE").unwrap_or_else(|_| "flex".into());
    let fixed = ["verify", "--weights", text(weights), "--tensors", text(tensors), "--device", &device];
    let output = unoinfer(&[&fixed[..], more].concat());
    let both = [output.stdout, output.stderr].concat();
    (output.status.success(), String::from_utf8(both).unwrap())
}

/// A copy of a safetensors file with one tensor's first number moved by `by`, under the name `new`.
fn changed(source: &Path, target: &Path, name: &str, new: &str, by: f32) {
    let bytes = std::fs::read(source).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let view = file.tensor(name).unwrap();
    let mut data = view.data().to_vec();
    let value = f32::from_le_bytes(data[..4].try_into().unwrap()) + by;
    data[..4].copy_from_slice(&value.to_le_bytes());
    let moved = TensorView::new(Dtype::F32, view.shape().to_vec(), &data).unwrap();
    let others = file.iter().filter(|(other, _)| *other != name);
    let views = others.map(|(n, v)| (n.to_owned(), v)).chain([(new.to_owned(), moved)]);
    std::fs::write(target, safetensors::serialize(views, None).unwrap()).unwrap();
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn every_tensor_of_both_files_from_both_weight_files() {
    let folder = fixtures();
    for (tensors, counts) in [("e2e_eval", "95 tensors"), ("e2e_train", "")] {
        for weights in ["weights.pth", "weights.safetensors"] {
            let file = folder.join(format!("{tensors}.safetensors"));
            let (passed, out) = verify(&folder.join(weights), &file, &[]);
            let last = out.lines().rfind(|line| line.contains(" tensors: ")).unwrap_or_default();
            println!("{weights} {tensors}: {last}");
            assert!(passed && last.contains(", 0 over, 0 not computed") && last.contains(counts), "{out}");
            let rows = out.lines().filter(|l| l.ends_with("ok") || l.contains("  ok  ")).count();
            assert!(last.contains(&format!(" {rows} ok")), "{rows} rows; {last}");
        }
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn a_moved_or_unknown_tensor_is_found_and_bounds_can_be_given() {
    let folder = fixtures();
    let scratch = tempfile::tempdir().unwrap();
    let weights = folder.join("weights.safetensors");
    let config = folder.join("config.json");
    let (eval, file) = (folder.join("e2e_eval.safetensors"), scratch.path().join("t.safetensors"));
    changed(&eval, &file, "pred_t", "pred_t", 1e-4);
    let (passed, out) = verify(&weights, &file, &["--config", text(&config)]);
    assert!(!passed && out.contains("1 over"), "{out}");
    let row = out.lines().find(|line| line.starts_with("pred_t ")).unwrap();
    assert!(row.contains("1.0e-4") && row.ends_with("over"), "{row}");

    let bounds = scratch.path().join("bounds.json");
    std::fs::write(&bounds, r#"{"pred_*": 2e-4}"#).unwrap();
    let (passed, out) = verify(&weights, &file, &["--tolerances", text(&bounds)]);
    assert!(passed, "{out}");
    std::fs::write(&bounds, r#"{"pred_t": "small"}"#).unwrap();
    let (passed, out) = verify(&weights, &file, &["--tolerances", text(&bounds)]);
    assert!(!passed && out.contains("bounds.json") && out.contains("relative_l2"), "{out}");

    changed(&eval, &file, "pred_t", "pred_T", 0.0);
    let (passed, out) = verify(&weights, &file, &[]);
    assert!(!passed && out.contains("1 not computed") && out.contains("pred_T"), "{out}");
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn sizes_that_disagree_are_named() {
    let folder = fixtures();
    let scratch = tempfile::tempdir().unwrap();
    let eval = folder.join("e2e_eval.safetensors");
    let json = std::fs::read_to_string(folder.join("config.json")).unwrap();
    let config = scratch.path().join("config.json");
    std::fs::write(&config, json.replace("\"fine_npoint\": 256", "\"fine_npoint\": 200")).unwrap();
    let (passed, out) = verify(&folder.join("weights.pth"), &eval, &["--config", text(&config)]);
    assert!(!passed && out.contains("fine_points is 200") && out.contains("256"), "{out}");
    std::fs::write(&config, json.replacen("\"depth\": 4", "\"depth\": 5", 1)).unwrap();
    let (passed, out) = verify(&folder.join("weights.pth"), &eval, &["--config", text(&config)]);
    assert!(!passed && out.contains("model.color.depth is 4 in the checkpoint, 5 here"), "{out}");
}

#[test]
fn export_makes_an_official_file_or_says_why_not() {
    let scratch = tempfile::tempdir().unwrap();
    let device = Device::flex();
    let out = scratch.path().join("official.safetensors");
    let save = |name: &str, overrides: &[&str]| {
        let overrides: Vec<String> = overrides.iter().map(|s| s.to_string()).collect();
        let config = Config::embedded("smoke", &overrides).unwrap();
        let model = UnoPose::new(&config.model, 1, &device);
        let path = scratch.path().join(name);
        checkpoint::save(&path, &model, &config, &Meta::default()).unwrap();
        (path, config, model)
    };
    let color = "model.color={kind=\"vit\", embed_dim=16, depth=4, heads=2, patch_size=8, out_dim=8}";
    let (own, config, model) =
        save("vit.safetensors", &[color, "model.coarse.heads=4", "model.fine.matching.heads=4"]);
    let output = unoinfer(&["export", "--to", "official", text(&own), text(&out)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (back, unused) = checkpoint::load_official(&out, &config.model, &device).unwrap();
    assert_eq!(
        checkpoint::official_tensors(&back).unwrap(),
        checkpoint::official_tensors(&model).unwrap(),
        "export then import is the identity"
    );
    assert!(
        unused.iter().all(|n| n.ends_with("num_batches_tracked") || n.ends_with("div_term")),
        "{unused:?}"
    );

    let (own, ..) = save("conv.safetensors", &[]);
    let output = unoinfer(&["export", "--to", "official", text(&own), text(&scratch.path().join("none"))]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && error.contains("model.color.kind = conv"), "{error}");
    assert!(!scratch.path().join("none").exists());

    let output = unoinfer(&["inspect", text(&own)]);
    let out = String::from_utf8(output.stdout).unwrap();
    assert!(out.contains("kind: checkpoint of unotrain") && out.contains("kind = \"conv\""), "{out}");
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn inspect_says_what_a_file_is() {
    let folder = fixtures();
    let output = unoinfer(&["inspect", text(&folder.join("weights.pth"))]);
    let out = String::from_utf8(output.stdout).unwrap();
    assert!(
        out.contains("official state") && out.contains("dis_proj") && out.contains("vit_embed_dim"),
        "{out}"
    );
    let output = unoinfer(&["inspect", text(&folder.join("README.md"))]);
    assert!(!output.status.success());
}
