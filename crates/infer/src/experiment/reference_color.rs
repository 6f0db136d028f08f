//! Reference views without their colours, to measure what colour contributes.

use std::{borrow::Cow, fmt, str::FromStr};

use image::{Rgb, RgbImage};
use rand::{Rng, seq::SliceRandom};
use unopose_core::frame::{Mask, RgbdFrame};

/// The colours of the reference that the network sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReferenceColor {
    /// As they are.
    #[default]
    Keep,
    /// Brightness only.
    Gray,
    /// The colours of the masked pixels in random order: their histogram without their places.
    Shuffled,
}

impl ReferenceColor {
    /// The view with changed colours.
    pub(crate) fn apply<'a>(
        self,
        frame: &'a RgbdFrame,
        mask: &Mask,
        rng: &mut impl Rng,
    ) -> Cow<'a, RgbdFrame> {
        let rgb = match self {
            Self::Keep => return Cow::Borrowed(frame),
            Self::Gray => {
                let gray = image::imageops::grayscale(&frame.rgb);
                RgbImage::from_fn(gray.width(), gray.height(), |x, y| Rgb([gray.get_pixel(x, y).0[0]; 3]))
            }
            Self::Shuffled => {
                let mut rgb = frame.rgb.clone();
                let inside = |&(x, y): &(u32, u32)| x < rgb.width() && y < rgb.height();
                let pixels: Vec<(u32, u32)> = mask.pixels().filter(inside).collect();
                let mut colors: Vec<Rgb<u8>> = pixels.iter().map(|&(x, y)| *rgb.get_pixel(x, y)).collect();
                colors.shuffle(rng);
                pixels.iter().zip(colors).for_each(|(&(x, y), color)| rgb.put_pixel(x, y, color));
                rgb
            }
        };
        Cow::Owned(RgbdFrame { rgb, ..frame.clone() })
    }
}

impl FromStr for ReferenceColor {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "keep" => Ok(Self::Keep),
            "gray" => Ok(Self::Gray),
            "shuffled" => Ok(Self::Shuffled),
            _ => Err(format!("{name:?}, expected keep, gray or shuffled")),
        }
    }
}

impl fmt::Display for ReferenceColor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Keep => "keep",
            Self::Gray => "gray",
            Self::Shuffled => "shuffled",
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use unopose_core::{frame::DepthMap, geometry::Intrinsics};

    use super::*;

    #[test]
    fn shuffling_keeps_the_histogram_of_the_mask_and_all_else() {
        let rgb = RgbImage::from_fn(16, 12, |x, y| Rgb([(16 * x) as u8, (20 * y) as u8, 77]));
        let intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 8.0, cy: 6.0 };
        let frame = RgbdFrame { rgb, depth: DepthMap::zeros(16, 12), intrinsics };
        let mut mask = Mask::empty(16, 12);
        mask.data.iter_mut().enumerate().for_each(|(i, m)| *m = i % 16 < 9);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let shuffled = ReferenceColor::Shuffled.apply(&frame, &mask, &mut rng).into_owned();
        let histogram = |frame: &RgbdFrame| {
            let mut colors: Vec<[u8; 3]> = mask.pixels().map(|(x, y)| frame.rgb.get_pixel(x, y).0).collect();
            colors.sort();
            colors
        };
        assert_eq!(histogram(&shuffled), histogram(&frame));
        let moved = mask.pixels().filter(|&(x, y)| shuffled.rgb.get_pixel(x, y) != frame.rgb.get_pixel(x, y));
        assert!(moved.count() > 80);
        assert!((9..16).all(|x| (0..12).all(|y| shuffled.rgb.get_pixel(x, y) == frame.rgb.get_pixel(x, y))));
        let gray = ReferenceColor::Gray.apply(&frame, &mask, &mut rng).into_owned();
        assert!(gray.rgb.pixels().all(|p| p.0[0] == p.0[1] && p.0[1] == p.0[2]));
        assert!(matches!(ReferenceColor::Keep.apply(&frame, &mask, &mut rng), Cow::Borrowed(_)));
    }
}
