//! Bilinear lookup in sRGB pictures, result in linear light.

use image::RgbImage;
use std::sync::OnceLock;

/// Linear-light value of every 8-bit sRGB code.
fn linear_table() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|code| srgb_to_linear(code as f32 / 255.0)))
}

fn srgb_to_linear(c: f32) -> f32 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// sRGB code (0..=1) of a value in linear light, which is clipped to 0..=1.
pub fn linear_to_srgb(c: f32) -> f32 {
    let c = c.clamp(0.0, 1.0);
    if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

/// 8-bit colour to linear light.
pub fn color_to_linear(color: [u8; 3]) -> [f32; 3] {
    let table = linear_table();
    color.map(|c| table[c as usize])
}

/// Colour at texture coordinates (origin bottom left), linear light; the picture repeats outside 0..1.
pub fn sample(picture: &RgbImage, uv: [f32; 2]) -> [f32; 3] {
    let (w, h) = (picture.width() as i32, picture.height() as i32);
    if w == 0 || h == 0 {
        return [0.5; 3];
    }
    let [u, v] = uv.map(|x| x - x.floor());
    let (x, y) = (u * w as f32 - 0.5, (1.0 - v) * h as f32 - 0.5);
    // Truncation after a shift is floor, without a call into libm on plain x86-64.
    let (x0, y0) = ((x + 1.0) as i32 - 1, (y + 1.0) as i32 - 1);
    let (ax, ay) = (x - x0 as f32, y - y0 as f32);
    let fit = |i: i32, n: i32| i.rem_euclid(n) as usize;
    let (cols, rows) = ([fit(x0, w), fit(x0 + 1, w)], [fit(y0, h), fit(y0 + 1, h)]);
    let (raw, table) = (picture.as_raw(), linear_table());
    let texel = |row: usize, col: usize, k: usize| table[raw[3 * (row * w as usize + col) + k] as usize];
    std::array::from_fn(|k| {
        let top = texel(rows[0], cols[0], k) * (1.0 - ax) + texel(rows[0], cols[1], k) * ax;
        let bottom = texel(rows[1], cols[0], k) * (1.0 - ax) + texel(rows[1], cols[1], k) * ax;
        top * (1.0 - ay) + bottom * ay
    })
}
