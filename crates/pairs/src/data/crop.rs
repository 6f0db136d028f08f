//! Square crop around a mask (`docs/network.md`, section 1): box, masked resize, index of a pixel in the resized crop.

use image::RgbImage;
use unopose_core::frame::BoundingBox;

/// Square pixel region inside an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CropBox {
    pub row: u32,
    pub col: u32,
    pub side: u32,
}

const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const STD: [f32; 3] = [0.229, 0.224, 0.225];

/// An 8-bit colour by ImageNet's mean and deviation.
pub fn imagenet_normalised(rgb: [u8; 3]) -> [f32; 3] {
    std::array::from_fn(|c| (f32::from(rgb[c]) / 255.0 - MEAN[c]) / STD[c])
}

/// The 8-bit colour that [`imagenet_normalised`] gives these values.
pub fn imagenet_restored(values: [f32; 3]) -> [u8; 3] {
    std::array::from_fn(|c| (255.0 * (values[c] * STD[c] + MEAN[c])).round().clamp(0.0, 255.0) as u8)
}

impl CropBox {
    /// Box with the larger side of `tight` (an odd side loses a pixel), centred on it and shifted into the image.
    pub fn around(tight: &BoundingBox, width: u32, height: u32) -> Self {
        let larger = (tight.row_max - tight.row_min).max(tight.col_max - tight.col_min);
        let half = larger.min(width).min(height) / 2;
        let start = |min: u32, max: u32, limit: u32| {
            ((min + max) / 2).saturating_sub(half).min(limit.saturating_sub(2 * half))
        };
        Self {
            row: start(tight.row_min, tight.row_max, height),
            col: start(tight.col_min, tight.col_max, width),
            side: 2 * half,
        }
    }

    /// Row and column inside the crop of an image pixel, `None` outside.
    pub fn local(&self, row: u32, col: u32) -> Option<(u32, u32)> {
        let (r, c) = (row.checked_sub(self.row)?, col.checked_sub(self.col)?);
        (r < self.side && c < self.side).then_some((r, c))
    }

    /// Index into the `size x size` map that shows this crop, for a pixel at (row, column) of the crop.
    pub fn choose(&self, row: u32, col: u32, size: usize) -> u32 {
        let ratio = size as f64 / self.side as f64;
        let scaled = |x: u32| ((x as f64 * ratio) as usize).min(size.saturating_sub(1));
        (scaled(row) * size + scaled(col)) as u32
    }

    /// The crop of an image.
    pub fn cut(&self, image: &RgbImage) -> RgbImage {
        image::imageops::crop_imm(image, self.col, self.row, self.side, self.side).to_image()
    }
}

/// Bilinear resize of a square crop to `size x size` (half-pixel centres, clamped at the border, rounded to 8 bits),
/// normalised with ImageNet's mean and deviation: `[3, size, size]`.
pub fn normalised_resize(crop: &RgbImage, size: usize) -> Vec<f32> {
    let side = crop.width() as usize;
    let taps: Vec<(usize, usize, f32)> = (0..size)
        .map(|i| {
            let x = (i as f64 + 0.5) * side as f64 / size as f64 - 0.5;
            let x = x.clamp(0.0, side.saturating_sub(1) as f64);
            (x as usize, (x as usize + 1).min(side.saturating_sub(1)), x.fract() as f32)
        })
        .collect();
    let pixels = crop.as_raw();
    let mut out = vec![0.0f32; 3 * size * size];
    let mut blended = vec![0.0f32; 3 * side];
    let scale: [f32; 3] = std::array::from_fn(|c| 1.0 / (255.0 * STD[c]));
    let offset: [f32; 3] = std::array::from_fn(|c| MEAN[c] / STD[c]);
    for (row, &(y0, y1, fy)) in taps.iter().enumerate() {
        let (above, below) = (&pixels[3 * side * y0..][..3 * side], &pixels[3 * side * y1..][..3 * side]);
        for ((b, &above), &below) in blended.iter_mut().zip(above).zip(below) {
            *b = above as f32 + fy * (below as f32 - above as f32);
        }
        for (col, &(x0, x1, fx)) in taps.iter().enumerate() {
            for c in 0..3 {
                let (left, right) = (blended[3 * x0 + c], blended[3 * x1 + c]);
                let value = (left + fx * (right - left) + 0.5).floor();
                out[(c * size + row) * size + col] = value * scale[c] - offset[c];
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tight(row_min: u32, row_max: u32, col_min: u32, col_max: u32) -> BoundingBox {
        BoundingBox { row_min, row_max, col_min, col_max }
    }

    #[test]
    fn boxes_follow_the_rounding_rules() {
        // 31 x 20: side 31 loses a pixel; centre row floor((10 + 41) / 2) = 25, column floor((50 + 70) / 2) = 60.
        let crop = CropBox::around(&tight(10, 41, 50, 70), 320, 240);
        assert_eq!(crop, CropBox { row: 10, col: 45, side: 30 });
        // Shifted back inside at the left border and at the bottom right corner.
        assert_eq!(CropBox::around(&tight(0, 40, 0, 6), 320, 240), CropBox { row: 0, col: 0, side: 40 });
        assert_eq!(
            CropBox::around(&tight(200, 240, 310, 320), 320, 240),
            CropBox { row: 200, col: 280, side: 40 }
        );
        // Never larger than the image.
        assert_eq!(CropBox::around(&tight(0, 240, 0, 320), 320, 240), CropBox { row: 0, col: 40, side: 240 });
    }

    #[test]
    fn choose_scales_and_floors() {
        let crop = CropBox { row: 3, col: 5, side: 30 };
        assert_eq!(crop.local(3, 34), Some((0, 29)));
        assert_eq!(crop.local(2, 6), None);
        assert_eq!(crop.local(3, 35), None);
        assert_eq!(crop.choose(29, 1, 224), (29 * 224 / 30) * 224 + 7);
    }

    #[test]
    fn resize_interpolates_at_half_pixels() {
        let mut crop = RgbImage::new(2, 2);
        crop.put_pixel(1, 0, image::Rgb([100, 0, 0]));
        crop.put_pixel(1, 1, image::Rgb([100, 0, 0]));
        let out = normalised_resize(&crop, 4);
        let red: Vec<f32> = out[..4].iter().map(|v| (v * STD[0] + MEAN[0]) * 255.0).collect();
        for (got, expected) in red.iter().zip([0.0, 25.0, 75.0, 100.0]) {
            assert!((got - expected).abs() < 1e-3, "{red:?}");
        }
    }
}
