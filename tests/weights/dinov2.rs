//! The published DINOv2 ViT-S/14 against features that an independent implementation computed with the same weights.

use burn::tensor::{Device, Tensor};
use unopose_nn::checkpoint::{TensorFile, load_transformer};

const CROPS: usize = 2;

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn real_weights_give_the_reference_features() {
    let folder = unopose_tests::shared("weights");
    let reference = TensorFile::read(&folder.join("dinov2_vits14_reference.safetensors")).unwrap();
    let device = Device::flex();
    let transformer = load_transformer(&folder.join("dinov2_vits14.safetensors"), 224, &device).unwrap();
    for crop in 1..=CROPS {
        let stored = |name: &str| reference.tensors[&format!("{name}_{crop}")].clone();
        let image = Tensor::<4>::from_data(stored("image"), &device);
        let features = transformer.forward(image);
        let class_token = features.class_token.clone().try_into_vec_as::<f32>().unwrap();
        let patches = features.patch_tokens().try_into_vec_as::<f32>().unwrap();
        for (name, found) in [("x_norm_clstoken", class_token), ("x_norm_patchtokens", patches)] {
            let expected: Vec<f32> = stored(name).iter::<f32>().collect();
            assert_eq!(found.len(), expected.len());
            let pairs = || found.iter().zip(&expected);
            let largest = pairs().map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            let spread = expected.iter().map(|v| v.abs()).fold(0.0, f32::max);
            assert!(largest < 1e-3, "{name} of crop {crop}: {largest} apart, values up to {spread}");
        }
    }
}
