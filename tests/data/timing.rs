//! Pairs per second of one core at the sizes of `configs/geo.toml`:
//! `cargo test --release --test data timing -- --ignored --nocapture`.

use std::{sync::Arc, time::Instant};

use unopose_core::config::{DataConfig, FineConfig, ModelConfig};
use unopose_dataset::formats::megapose::ShardDataset;
use unopose_pairs::data::{FrameSource, PairSampler};
use unopose_tests::ellipsoid_views::EllipsoidViews;

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
    let shards = ShardDataset::open(&unopose_tests::shared("bench/megapose_example")).unwrap();
    let shards = Arc::new(shards);
    time("640 x 480 shards, augmented, cached", shards.clone(), &cached, true);
    time("640 x 480 shards, augmented, decoded every time", shards, &uncached, true);
}
