use super::*;
use burn::{
    nn::{BatchNorm, BatchNormConfig, Linear, LinearConfig},
    tensor::Tensor,
};

#[derive(Module, Debug)]
struct Net {
    in_proj: Linear,
    norm: BatchNorm,
}

fn net(width: usize, device: &Device) -> Net {
    Net { in_proj: LinearConfig::new(2, width).init(device), norm: BatchNormConfig::new(width).init(device) }
}

fn config(width: usize) -> Config {
    let mut config = Config::default();
    config.model.coarse.out_dim = width;
    config
}

#[test]
fn names_and_layouts_are_those_of_pytorch() {
    let device = Device::default();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let model = net(3, &device);
    let extra: BTreeMap<String, String> = [("note".to_owned(), "x".to_owned())].into();
    let meta = Meta { step: 12, extra };
    save(&path, &model, &config(3), &meta).unwrap();

    let file = TensorFile::read(&path).unwrap();
    let names: Vec<&str> = file.tensors.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "in_proj.bias",
            "in_proj.weight",
            "norm.bias",
            "norm.running_mean",
            "norm.running_var",
            "norm.weight"
        ]
    );
    let stored = &file.tensors["in_proj.weight"];
    assert_eq!(stored.shape()[..], [3, 2]);
    let own = model.in_proj.weight.val().transpose().into_data();
    assert_eq!(stored.as_slice::<f32>().unwrap(), own.as_slice::<f32>().unwrap());

    let (read, read_meta) = load_into(&path, net(3, &device), &config(3).model).unwrap();
    assert_eq!(read_meta, meta);
    let x = Tensor::<2>::from_floats([[0.5, -2.0]], &device);
    let [a, b] = [model, read].map(|m| m.in_proj.forward(x.clone()).into_data());
    assert_eq!(a, b);
    assert_eq!(config_of(&file, &path).unwrap(), Some(config(3)));
}

#[test]
fn a_checkpoint_of_another_size_names_both_values() {
    let device = Device::default();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    save(&path, &net(3, &device), &config(3), &Meta::default()).unwrap();
    let error = load_into(&path, net(4, &device), &config(4).model).unwrap_err().to_string();
    assert!(error.contains("model.coarse.out_dim is 3 in the checkpoint, 4 here"), "{error}");
    assert!(
        error.contains("in_proj.weight has shape [3, 2] in the checkpoint, [4, 2] in the network"),
        "{error}"
    );
}

#[test]
fn missing_unknown_and_damaged_tensors_are_refused() {
    let device = Device::default();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let load = || load_into(&path, net(3, &device), &config(3).model).unwrap_err().to_string();
    save(&path, &net(3, &device), &config(3), &Meta::default()).unwrap();
    let good = std::fs::read(&path).unwrap();

    let mut file = TensorFile::read(&path).unwrap();
    let bias = file.tensors.remove("in_proj.bias").unwrap();
    file.tensors.insert("in_proj.offset".into(), bias);
    file.write(&path).unwrap();
    let error = load();
    assert!(
        error.contains("in_proj.bias is missing") && error.contains("in_proj.offset is unknown"),
        "{error}"
    );

    let mut file = TensorFile::from_bytes(&good, &path).unwrap();
    file.tensors.insert("norm.weight".into(), TensorData::from([1.0f32, f32::NAN, 0.0]));
    file.write(&path).unwrap();
    assert!(load().contains("tensor norm.weight: contains NaN"));

    std::fs::write(&path, &good[..good.len() - 5]).unwrap();
    assert!(load().contains("is not a safetensors file"));
    std::fs::write(&path, b"").unwrap();
    assert!(load().contains("is not a safetensors file"));
    std::fs::remove_file(&path).unwrap();
    assert!(load().contains("cannot read checkpoint"));
}

#[test]
fn a_changed_bit_is_found_and_files_without_a_checksum_are_read() {
    let device = Device::default();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    save(&path, &net(3, &device), &config(3), &Meta::default()).unwrap();
    let load = || load_into(&path, net(3, &device), &config(3).model).map(|_| ()).map_err(|e| e.to_string());
    load().unwrap();
    assert_eq!(read_meta(&path).unwrap(), Meta::default(), "the checksum is no entry of the writer");
    let good = std::fs::read(&path).unwrap();
    // The lowest bit of every stored number, and a digit of the configuration.
    let values = 8 + u64::from_le_bytes(good[..8].try_into().unwrap()) as usize;
    let digit = good.windows(7).position(|w| w == b"seed = ").unwrap() + 7;
    for position in (values..good.len()).step_by(4).chain([digit]) {
        let mut bad = good.clone();
        bad[position] ^= 1;
        std::fs::write(&path, bad).unwrap();
        let error = load().unwrap_err();
        assert!(error.contains("a.safetensors is damaged: its checksum is crc32:"), "{position}: {error}");
    }
    // Another name of the entry, as files of other programs and earlier versions have none.
    let entry = good.windows(8).position(|w| w == b"checksum").unwrap();
    let mut other = good;
    other[entry] = b'k';
    std::fs::write(&path, other).unwrap();
    load().unwrap();
}
