//! Pairs per second of one core at the sizes of `configs/geo.toml`:
//! `cargo test --release --test data_timing -- --ignored --nocapture`.

mod ellipsoid_views;

use std::{io::Cursor, sync::Arc, time::Instant};

use ellipsoid_views::EllipsoidViews;
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma};
use unopose::{
    config::{DataConfig, FineConfig, ModelConfig},
    data::PairSampler,
};

#[test]
#[ignore = "a measurement, not a check"]
fn one_core() {
    let model = ModelConfig {
        image_size: 112,
        reference_points: 1024,
        fine_points: 512,
        coarse_points: 96,
        fine: FineConfig { pe_samples: [16, 32], ..FineConfig::default() },
        ..ModelConfig::default()
    };
    let views = EllipsoidViews::new(20, 1);
    let frame = &views.frames[0].frame;
    let mut jpeg = Cursor::new(Vec::new());
    frame.rgb.write_to(&mut jpeg, ImageFormat::Jpeg).unwrap();
    let depth = frame.depth.data.iter().map(|d| (d * 10_000.0) as u16).collect();
    let depth = ImageBuffer::<Luma<u16>, _>::from_raw(320, 240, depth).unwrap();
    let mut png = Cursor::new(Vec::new());
    DynamicImage::from(depth).write_to(&mut png, ImageFormat::Png).unwrap();
    let start = Instant::now();
    for _ in 0..50 {
        image::load_from_memory(jpeg.get_ref()).unwrap();
        image::load_from_memory(png.get_ref()).unwrap();
    }
    println!("decode of jpeg + 16-bit png, 320 x 240: {:.2} ms", start.elapsed().as_secs_f64() * 20.0);

    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let sampler = PairSampler::new(Arc::new(views), &DataConfig::default(), &model, 1).unwrap();
    for augment in [false, true] {
        let mut best = f64::INFINITY;
        for round in 0..5 {
            let start = Instant::now();
            pool.install(|| (0..40).for_each(|i| drop(sampler.sample(round * 40 + i, augment).unwrap())));
            best = best.min(start.elapsed().as_secs_f64() / 40.0);
        }
        println!("pair, augment {augment}: {:.2} ms, {:.0} pairs/s", best * 1e3, 1.0 / best);
    }
}
