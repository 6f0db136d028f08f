//! Pairs per second of one core at the sizes of `configs/geo.toml`:
//! `cargo test --release --test data_timing -- --ignored --nocapture`.

mod ellipsoid_views;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use ellipsoid_views::EllipsoidViews;
use unopose::{
    config::{DataConfig, FineConfig, ModelConfig},
    data::{FrameSource, PairSampler},
    formats::megapose::ShardDataset,
};

fn time(name: &str, source: Arc<dyn FrameSource>, data: &DataConfig, augment: bool) {
    let model = ModelConfig {
        image_size: 112,
        reference_points: 1024,
        fine_points: 512,
        coarse_points: 96,
        fine: FineConfig { pe_samples: [16, 32], ..FineConfig::default() },
        ..ModelConfig::default()
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let sampler = PairSampler::new(source, data, &model, 1).unwrap();
    let mut best = f64::INFINITY;
    for round in 0..5 {
        let start = Instant::now();
        pool.install(|| (0..40).for_each(|i| drop(sampler.sample(round * 40 + i, augment).unwrap())));
        best = best.min(start.elapsed().as_secs_f64() / 40.0);
    }
    println!("{name:50} {:6.2} ms per pair, {:.0} pairs/s", best * 1e3, 1.0 / best);
}

#[test]
#[ignore = "a measurement, not a check"]
fn one_core() {
    let cached = DataConfig::default();
    let uncached = DataConfig { cache_mib: 0, ..DataConfig::default() };
    let views = || Arc::new(EllipsoidViews::new(20, 1));
    time("320 x 240 in memory, plain", views(), &cached, false);
    time("320 x 240 in memory, augmented", views(), &cached, true);
    let shared = std::env::var_os("UNOPOSE_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let Ok(shards) = ShardDataset::open(&shared.join("bench/megapose_example")) else { return };
    let shards = Arc::new(shards);
    time("640 x 480 shards, augmented, cached", shards.clone(), &cached, true);
    time("640 x 480 shards, augmented, decoded every time", shards, &uncached, true);
}
