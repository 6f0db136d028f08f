//! Pictures of what stands behind a table: furniture, windows, posters, shelves of things, out of focus.

use image::{Rgb, RgbImage};
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::{
    pattern::{Color, Pattern, object_color},
    print,
};
use crate::{noise, random::Draw};

/// A picture of one colour.
pub(crate) fn plain(rng: &mut ChaCha8Rng) -> RgbImage {
    RgbImage::from_pixel(2, 2, to_pixel(&object_color(rng)))
}

/// A printed sheet of the given width to height ratio, centred at the corners of a square picture that repeats: the
/// coordinates of a surface start in its middle.
pub(crate) fn sheet(aspect: f32, resolution: u32, rng: &mut ChaCha8Rng) -> RgbImage {
    let paper = if rng.chance(0.6) { Color::repeat(rng.between(0.8, 0.97)) } else { object_color(rng) };
    let print = print::label(aspect, resolution, rng);
    let half = |n: u32| (resolution - n.min(resolution)) / 2;
    let (left, top) = (half(print.width()), half(print.height()));
    RgbImage::from_fn(resolution, resolution, |x, y| {
        let middle = |k: u32| (k + resolution / 2) % resolution;
        let inside = |k: u32, before: u32, n: u32| middle(k).checked_sub(before).filter(|k| *k < n);
        let place = inside(x, left, print.width()).zip(inside(y, top, print.height()));
        match place.map(|(col, row)| print.get_pixel(col, row).0) {
            Some([r, g, b, a]) if a > 0 => Rgb([r, g, b]),
            _ => to_pixel(&paper),
        }
    })
}

/// A square picture without edges that repeat visibly.
pub(crate) fn scenery(resolution: u32, rng: &mut ChaCha8Rng) -> RgbImage {
    let muted = |rng: &mut ChaCha8Rng| {
        let color = object_color(rng);
        color.lerp(&Color::repeat(color.mean()), rng.between(0.4, 0.9))
    };
    let (top, bottom, seed) = (muted(rng), muted(rng), rng.count(0, 1 << 30) as u32);
    let side = resolution as f32;
    let mut canvas: Vec<Color> = (0..resolution * resolution)
        .map(|i| {
            let (x, y) = ((i % resolution) as f32 / side, (i / resolution) as f32 / side);
            let cloud = 0.15 * noise::fractal(&Vector3::new(4.0 * x, 4.0 * y, 0.5), 3, seed);
            top.lerp(&bottom, y) * (1.0 + cloud)
        })
        .collect();
    for _ in 0..rng.count(5, 22) {
        draw_item(&mut canvas, resolution, rng);
    }
    let picture =
        RgbImage::from_fn(resolution, resolution, |x, y| to_pixel(&canvas[(y * resolution + x) as usize]));
    match rng.between(0.0, 3.0) {
        sigma if sigma < 0.5 => picture,
        sigma => image::imageops::fast_blur(&picture, sigma),
    }
}

fn to_pixel(color: &Color) -> Rgb<u8> {
    Rgb(color.map(|v| (v.clamp(0.0, 1.0) * 255.0) as u8).into())
}

/// A board, a box, a poster or a round thing with some light and shade.
fn draw_item(canvas: &mut [Color], resolution: u32, rng: &mut ChaCha8Rng) {
    let side = resolution as f32;
    let (w, h) = match rng.count(0, 3) {
        // Boards and posts.
        0 => (rng.between(0.3, 1.0), rng.between(0.02, 0.08)),
        1 => (rng.between(0.02, 0.08), rng.between(0.3, 1.0)),
        _ => (rng.log_between(0.06, 0.5), rng.log_between(0.06, 0.5)),
    };
    let (x, y) = (rng.between(-0.1, 1.0), rng.between(-0.1, 1.0));
    let pattern = if rng.chance(0.5) { Pattern::plain(rng) } else { Pattern::any(1.0, rng) };
    let poster = rng.chance(0.3).then(|| print::label(w / h, 120, rng));
    let (round, light, shade) = (rng.chance(0.25), rng.between(0.5, 1.3), rng.between(-0.5, 0.5));
    let pixel = |t: f32| (t * side).clamp(0.0, side) as u32;
    for row in pixel(y)..pixel(y + h) {
        for col in pixel(x)..pixel(x + w) {
            let (u, v) = ((col as f32 / side - x) / w, (row as f32 / side - y) / h);
            if round && (2.0 * u - 1.0).powi(2) + (2.0 * v - 1.0).powi(2) > 1.0 {
                continue;
            }
            let printed = poster.as_ref().map(|p| {
                let at = |t: f32, n: u32| ((t * n as f32) as u32).min(n - 1);
                p.get_pixel(at(u, p.width()), at(v, p.height())).0
            });
            let color = match printed {
                Some([r, g, b, a]) if a > 0 => Vector3::new(r, g, b).map(|c| f32::from(c) / 255.0),
                _ => pattern.color(&Vector3::new(u * w, v * h, 0.01)),
            };
            canvas[(row * resolution + col) as usize] = color * (light + shade * (u - 0.5));
        }
    }
}
