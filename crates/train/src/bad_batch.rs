//! A batch with a loss that is not finite, kept for inspection.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use burn::tensor::TensorData;
use unopose_nn::checkpoint::TensorFile;
use unopose_pairs::data::{CloudInput, TrainSample};

use super::{
    TrainError,
    task::{SampleOf, Task},
};

/// Writes every array of the samples to `bad-batch-<step>.safetensors`; the metadata hold what identifies them and the loss
/// terms.
pub fn save<T: Task>(
    task: &T,
    run: &Path,
    step: u64,
    samples: &[SampleOf<T>],
    terms: &[(String, Vec<f32>)],
) -> Result<PathBuf, TrainError> {
    let path = run.join(format!("bad-batch-{step}.safetensors"));
    let mut file = TensorFile { tensors: BTreeMap::new(), metadata: BTreeMap::new() };
    for (index, sample) in samples.iter().enumerate() {
        task.describe(index, sample, &mut file);
    }
    for (name, values) in terms {
        file.metadata.insert(format!("loss.{name}"), format!("{values:?}"));
    }
    file.write(&path)?;
    Ok(path)
}

/// The arrays of a pair, its key and its poses.
pub fn describe_pair(index: usize, sample: &TrainSample, file: &mut TensorFile) {
    put_cloud(file, &format!("{index}.query"), &sample.query);
    put_cloud(file, &format!("{index}.reference"), &sample.reference.cloud);
    file.metadata.insert(format!("{index}.key"), format!("{:?}", sample.key));
    for (name, pose) in [("t_query_reference", &sample.t_query_reference), ("t_init", &sample.t_init)] {
        let text = format!("{:?} {:?}", pose.rotation_row_major(), pose.translation.as_slice());
        file.metadata.insert(format!("{index}.{name}"), text);
    }
}

fn put_cloud(file: &mut TensorFile, prefix: &str, cloud: &CloudInput) {
    let points: Vec<f32> = cloud.points.iter().flatten().copied().collect();
    let choose: Vec<f32> = cloud.choose.iter().map(|&i| i as f32).collect();
    let side = (cloud.rgb.len() as f64 / 3.0).sqrt().round() as usize;
    let arrays = [
        ("points", points, vec![cloud.points.len(), 3]),
        ("choose", choose, vec![cloud.choose.len()]),
        ("rgb", cloud.rgb.clone(), vec![3, side, side]),
        ("center", cloud.center.to_vec(), vec![3]),
    ];
    for (name, values, shape) in arrays {
        file.tensors.insert(format!("{prefix}.{name}"), TensorData::new(values, shape));
    }
}
