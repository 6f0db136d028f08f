//! One pair, learned by heart: the whole chain from images to the pose can be right.

use std::sync::Arc;

use burn::tensor::Device;
use nalgebra::Point3;
use unopose_core::{config::Config, geometry::Pose};
use unopose_dataset::formats::megapose::ShardDataset;
use unopose_infer::{Uniforms, estimate_pairs};
use unopose_nn::{
    checkpoint::{self, Meta},
    loss::pair_losses,
    model::{PairTensors, UnoPose},
};
use unopose_pairs::data::{PairSampler, metric_pose};

use unopose_train::Optimization;

#[test]
fn one_pair_is_learned_and_the_saved_network_gives_the_same_pose() {
    let folder = tempfile::tempdir().unwrap();
    let overrides = [
        "model.coarse.hidden_dim=32",
        "model.coarse.out_dim=32",
        "model.fine.matching.hidden_dim=32",
        "model.fine.matching.out_dim=32",
        "model.geo_embedding.hidden_dim=32",
        "model.coarse_points=48",
        "model.fine_points=160",
        "model.reference_points=320",
        "data.max_rotation_deg=60.0",
        "data.min_overlap=0.6",
    ];
    let config = Config::embedded("smoke", &overrides.map(str::to_owned)).unwrap();
    unopose_synth::generate(&config.synth, folder.path(), &|_| {}).unwrap();
    let source = Arc::new(ShardDataset::open(folder.path()).unwrap());
    let sampler = PairSampler::new(source, &config.data, &config.model, 1).unwrap();
    let sample = sampler.sample(0, false).unwrap();
    let (query, reference) = (sample.query.clone(), sample.reference.clone());
    let truth =
        metric_pose(&sample.t_query_reference, query.center, reference.cloud.center, reference.radius);

    let samples = [sample];
    let device = Device::default();
    let training = device.clone().autodiff();
    let batch = PairTensors::from_samples(&samples, &config.model, &training);
    let groups = PairTensors::groups_of(&samples, &config.model, &training);
    let mut optimization = Optimization::new(UnoPose::new(&config.model, 0, &training), &config.train);
    let mut losses = Vec::new();
    for _ in 0..250 {
        let outputs = optimization.model().forward_train(&batch, &groups);
        let loss = pair_losses(&config.loss, &outputs, &batch).total;
        losses.push(loss.clone().into_scalar::<f32>());
        optimization.accumulate(loss);
        optimization.apply(3e-3);
    }
    let (first, last) = (losses[0], losses[losses.len() - 1]);
    assert!(last < 0.5 * first, "loss {first} -> {last}");

    let path = folder.path().join("learned.safetensors");
    checkpoint::save(&path, optimization.model(), &config, &Meta::default()).unwrap();
    let (reloaded, _, _) = checkpoint::load(&path, &device).unwrap();
    let pose = |model: &UnoPose| {
        let pairs = [(&query, &reference)];
        estimate_pairs(model, &config.model, &pairs, Uniforms::Seed(0), &device).unwrap()[0].t_query_reference
    };
    use burn::module::Module;
    let learned = pose(&optimization.model().valid());
    let angle = learned.rotation_angle_deg(&truth);
    // Of the reference's centre: the cameras are ten times as far away.
    let [x, y, z] = reference.cloud.center.map(f64::from);
    let center = |pose: &Pose| pose.transform(&Point3::new(x, y, z));
    let shift = (center(&learned) - center(&truth)).norm();
    println!("loss {first:.2} -> {last:.2}, {angle:.2} deg, {:.2} mm", shift * 1e3);
    assert!(angle < 5.0 && shift < 0.01, "{angle} deg and {shift} m from the true pose");
    assert_eq!(pose(&reloaded), learned, "the reloaded network's pose");
}
