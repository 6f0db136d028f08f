//! What the transformer sees of a mask.

use image::RgbImage;
use unopose_core::frame::Mask;
use unopose_pairs::data::imagenet_normalised;

/// Side of the square that the transformer sees, pixels.
pub const SIDE: usize = 224;

/// The box of a mask, its longer side brought to [`SIDE`] by the nearest pixels, in the middle of a square of zeros.
#[derive(Clone, Debug, PartialEq)]
pub struct Crop {
    /// Normalised colours, zero (the mean colour) outside the mask, `[3, SIDE, SIDE]`.
    pub pixels: Vec<f32>,
    /// The mask, `[SIDE, SIDE]`.
    pub inside: Vec<bool>,
}

impl Crop {
    /// `None` for a mask without pixels in the image.
    pub fn new(rgb: &RgbImage, mask: &Mask) -> Option<Self> {
        let bounds = mask.bounding_box()?;
        let extent = |first: u32, last: u32| last.checked_sub(first).filter(|&side| side > 0);
        let width = extent(bounds.col_min, bounds.col_max.min(rgb.width()))?;
        let height = extent(bounds.row_min, bounds.row_max.min(rgb.height()))?;
        let longest = width.max(height) as usize;
        let scaled = |side: u32| (side as usize * SIDE / longest).max(1);
        let (columns, rows) = (scaled(width), scaled(height));
        let (left, top) = ((SIDE - columns) / 2, (SIDE - rows) / 2);
        // The first pixel of those that make up pixel i, as PyTorch's "nearest" takes it.
        let source = |i: usize, first: u32, side: u32| first + ((i * longest / SIDE) as u32).min(side - 1);
        let mut crop = Self { pixels: vec![0.0; 3 * SIDE * SIDE], inside: vec![false; SIDE * SIDE] };
        for row in 0..rows {
            let y = source(row, bounds.row_min, height);
            for col in 0..columns {
                let x = source(col, bounds.col_min, width);
                if mask.get(x, y) {
                    let place = (top + row) * SIDE + left + col;
                    crop.inside[place] = true;
                    for (channel, value) in imagenet_normalised(rgb.get_pixel(x, y).0).into_iter().enumerate()
                    {
                        crop.pixels[channel * SIDE * SIDE + place] = value;
                    }
                }
            }
        }
        Some(crop)
    }

    /// Which patches of `patch` pixels are more than half inside the mask, row-major.
    pub fn patches(&self, patch: usize) -> Vec<bool> {
        let side = SIDE / patch;
        let mut counts = vec![0usize; side * side];
        for (place, _) in self.inside.iter().enumerate().filter(|(_, inside)| **inside) {
            let (row, col) = (place / SIDE / patch, place % SIDE / patch);
            counts[row * side + col] += 1;
        }
        counts.into_iter().map(|count| 2 * count > patch * patch).collect()
    }
}
