//! The network's input: an image resized so that its longest side is the input's, normalised, padded at the right and
//! below.

use burn::tensor::{Device, Tensor, TensorData};
use image::RgbImage;

use super::pillow::resized;

/// Means of the red, green and blue channel in [0, 255].
const MEAN: [f32; 3] = [123.675, 116.28, 103.53];
/// Their standard deviations.
const STANDARD_DEVIATION: [f32; 3] = [58.395, 57.12, 57.375];

/// How an image becomes the network's square input: resized until its longest side is that of the input, then padded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResizeLongestSide {
    /// Width and height of the image, pixels.
    pub image: [u32; 2],
    /// Width and height of the resized image in the padded input, pixels.
    pub resized: [u32; 2],
    /// Side of the padded input, pixels.
    pub side: u32,
}

impl ResizeLongestSide {
    /// An image of `width x height` pixels for inputs of `side` pixels.
    pub fn new(width: u32, height: u32, side: u32) -> Self {
        let scale = f64::from(side) / f64::from(width.max(height).max(1));
        let scaled = |length: u32| ((f64::from(length) * scale + 0.5) as u32).clamp(1, side);
        Self { image: [width, height], resized: [width, height].map(scaled), side }
    }

    /// Where a point of the image lies in the padded input, x and y in pixels.
    pub fn point(&self, point: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| {
            point[axis] * (f64::from(self.resized[axis]) / f64::from(self.image[axis]))
        })
    }

    /// The input of an image of this size, `[1, 3, side, side]`.
    pub fn tensor(&self, image: &RgbImage, device: &Device) -> Tensor<4> {
        let [width, height] = self.resized;
        let small = resized(image, width, height);
        let side = self.side as usize;
        let mut values = vec![0.0f32; 3 * side * side];
        for (channel, plane) in values.chunks_exact_mut(side * side).enumerate() {
            let (mean, deviation) = (MEAN[channel], STANDARD_DEVIATION[channel]);
            let rows = small.as_raw().chunks_exact(3 * width as usize);
            for (out, row) in plane.chunks_exact_mut(side).zip(rows) {
                let colors = row.as_chunks::<3>().0;
                out.iter_mut().zip(colors).for_each(|(o, c)| *o = (f32::from(c[channel]) - mean) / deviation);
            }
        }
        Tensor::from_data(TensorData::new(values, [1, 3, side, side]), device)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_side_fills_the_input() {
        let resize = ResizeLongestSide::new(640, 426, 1024);
        // 426 * 1.6 = 681.6.
        assert_eq!(resize.resized, [1024, 682]);
        assert_eq!(resize.point([320.0, 426.0]), [512.0, 682.0]);
        assert_eq!(ResizeLongestSide::new(1, 5000, 1024).resized, [1, 1024]);
        let image = RgbImage::from_pixel(4, 2, image::Rgb([255, 0, 104]));
        let device = Device::default();
        let values =
            ResizeLongestSide::new(4, 2, 8).tensor(&image, &device).to_data().try_to_vec::<f32>().unwrap();
        // Rows 0..4 hold the image, rows 4..8 are padding.
        assert!((values[0] - (255.0 - 123.675) / 58.395).abs() < 1e-6);
        assert!((values[64 + 31] + 116.28 / 57.12).abs() < 1e-6);
        assert_eq!(values[32], 0.0);
    }
}
