use image::{Rgb, RgbImage};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;

fn gradient() -> RgbImage {
    RgbImage::from_fn(60, 40, |x, y| Rgb([x as u8 * 4, y as u8 * 6, 128]))
}

#[test]
fn blur_keeps_the_mean_and_spreads_a_point() {
    let mut image = RgbImage::new(21, 21);
    image.put_pixel(10, 10, Rgb([255, 255, 255]));
    filters::blur(&mut image, 1.0);
    // 255 / (2 pi) in the middle, exp(-1/2) of it one pixel aside.
    assert!((image.get_pixel(10, 10).0[0] as f32 - 40.6).abs() < 1.0);
    assert!((image.get_pixel(11, 10).0[1] as f32 - 24.6).abs() < 1.0);
    let mut flat = RgbImage::from_pixel(5, 4, Rgb([90, 91, 92]));
    filters::blur(&mut flat, 3.0);
    assert!(flat.pixels().all(|p| p.0 == [90, 91, 92]));
}

#[test]
fn dropout_blackens_a_fifth() {
    let mut black = 0;
    for seed in 0..200 {
        let mut image = RgbImage::from_pixel(60, 60, Rgb([200, 100, 50]));
        filters::coarse_dropout(&mut image, &mut ChaCha8Rng::seed_from_u64(seed));
        black += image.pixels().filter(|p| p.0 == [0; 3]).count();
    }
    let share = black as f64 / (200.0 * 3600.0);
    // 9 cells per image, 1800 in all: deviation 0.0094.
    assert!((share - 0.2).abs() < 0.04, "{share}");
}

#[test]
fn value_changes_stay_in_their_ranges() {
    for seed in 0..300 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut image = RgbImage::from_pixel(4, 4, Rgb([100, 100, 100]));
        values::multiply(&mut image, &mut rng);
        let v = image.get_pixel(0, 0).0;
        assert!(v[0] == v[1] && (60..=140).contains(&v[0]), "{v:?}");
        let mut image = RgbImage::from_pixel(4, 4, Rgb([100, 100, 100]));
        values::add(&mut image, &mut rng);
        assert!(image.get_pixel(0, 0).0.iter().all(|v| (75..=125).contains(v)));
        let mut image = RgbImage::from_pixel(4, 4, Rgb([200, 100, 50]));
        values::greyscale(&mut image, &mut rng);
        let v = image.get_pixel(0, 0).0;
        assert!(v[0] >= v[1] && v[1] >= v[2] && v[0] <= 200 && v[2] >= 50, "{v:?}");
    }
}

#[test]
fn a_crop_is_nearly_always_changed() {
    let changed = (0..200u64)
        .filter(|&seed| {
            let mut image = gradient();
            augment_color(&mut image, &mut ChaCha8Rng::seed_from_u64(seed));
            image != gradient()
        })
        .count();
    // All 13 are left out with probability 2e-4.
    assert!(changed >= 198, "{changed}");
}

#[test]
fn the_same_stream_gives_the_same_picture() {
    let run = |seed| {
        let mut image = gradient();
        augment_color(&mut image, &mut ChaCha8Rng::seed_from_u64(seed));
        image
    };
    assert_eq!(run(5), run(5));
    assert_ne!(run(5), run(6));
}
