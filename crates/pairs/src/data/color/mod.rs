//! Colour augmentation of a crop: the release's list, each change with its own probability, in random order.

mod filters;
mod values;

use image::RgbImage;
use rand::{Rng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;

/// A random change of a crop.
type Change = fn(&mut RgbImage, &mut ChaCha8Rng);

/// Probability and change (`docs/network.md`, section 8).
const CHANGES: [(f64, Change); 13] = [
    (0.5, filters::coarse_dropout),
    (0.4, filters::gaussian_blur),
    (0.3, filters::sharpness),
    (0.3, values::contrast),
    (0.5, values::brightness),
    (0.3, values::color),
    (0.5, values::add),
    (0.3, values::invert),
    (0.5, values::multiply_channels),
    (0.5, values::multiply),
    (0.1, values::gaussian_noise),
    (0.5, values::linear_contrast),
    (0.5, values::greyscale),
];

/// Applies the changes that the stream draws.
pub fn augment_color(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let mut changes = CHANGES;
    changes.shuffle(rng);
    for (probability, change) in changes {
        if rng.random_bool(probability) {
            change(image, rng);
        }
    }
}

#[cfg(test)]
mod tests;
