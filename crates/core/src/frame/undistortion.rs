//! Images of a camera with lens distortion as its pinhole camera would have taken them.

use image::{Rgb, RgbImage};

use super::{DepthMap, Mask};
use crate::geometry::{Distortion, Intrinsics};

/// Where every pixel of the pinhole image is in the distorted image. Both images have the same size and intrinsics.
#[derive(Clone, Debug)]
pub struct Undistortion {
    width: u32,
    height: u32,
    /// Column and row in the distorted image; `None` outside it. Row by row.
    sources: Vec<Option<[f32; 2]>>,
}

impl Undistortion {
    /// For images of `width` x `height` pixels.
    pub fn new(intrinsics: &Intrinsics, distortion: &Distortion, width: u32, height: u32) -> Self {
        let Intrinsics { fx, fy, cx, cy } = *intrinsics;
        let ideal = |col: f64, row: f64| [(col - cx) / fx, (row - cy) / fy];
        let (right, bottom) = (f64::from(width) - 1.0, f64::from(height) - 1.0);
        let corners = [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]];
        let radius = |[x, y]: [f64; 2]| x.hypot(y);
        let limit = corners.map(|[col, row]| radius(ideal(col, row))).into_iter().fold(0.0, f64::max);
        let fold = distortion.fold_radius(limit);
        // The border of the outermost pixels is half a pixel outside their centres.
        let inside = |value: f64, last: f64| value >= -0.5 && value <= last + 0.5;
        let source = |col: u32, row: u32| {
            let point = ideal(col.into(), row.into());
            let [x, y] = distortion.distort(point);
            let (u, v) = (fx * x + cx, fy * y + cy);
            let seen = radius(point) <= fold && inside(u, right) && inside(v, bottom);
            seen.then(|| [u.clamp(0.0, right) as f32, v.clamp(0.0, bottom) as f32])
        };
        let sources = (0..height).flat_map(|row| (0..width).map(move |col| source(col, row))).collect();
        Self { width, height, sources }
    }

    /// Share of the pinhole image's pixels that the distorted image shows, 0 to 1.
    pub fn covered(&self) -> f64 {
        self.sources.iter().flatten().count() as f64 / self.sources.len().max(1) as f64
    }

    /// Bilinear; black where the distorted image shows nothing.
    pub fn color(&self, image: &RgbImage) -> RgbImage {
        let mut sources = self.sources.iter();
        RgbImage::from_fn(self.width, self.height, |_, _| match sources.next() {
            Some(Some(source)) => bilinear(image, *source),
            _ => Rgb([0; 3]),
        })
    }

    /// The nearest pixel's, since depth between an object and what is behind it is the depth of neither; 0 where the distorted
    /// image shows nothing.
    pub fn depth(&self, depth: &DepthMap) -> DepthMap {
        let data = self.nearest(|col, row| depth.get(col, row), 0.0);
        DepthMap { width: self.width, height: self.height, data }
    }

    /// The nearest pixel's; unset where the distorted image shows nothing.
    pub fn mask(&self, mask: &Mask) -> Mask {
        let data = self.nearest(|col, row| mask.get(col, row), false);
        Mask { width: self.width, height: self.height, data }
    }

    fn nearest<T: Copy>(&self, at: impl Fn(u32, u32) -> T, nothing: T) -> Vec<T> {
        let value = |source: &Option<[f32; 2]>| match source {
            Some([u, v]) => at(u.round() as u32, v.round() as u32),
            None => nothing,
        };
        self.sources.iter().map(value).collect()
    }
}

/// The colour at (column, row) inside the image.
fn bilinear(image: &RgbImage, [u, v]: [f32; 2]) -> Rgb<u8> {
    let (col, row) = (u.floor() as u32, v.floor() as u32);
    let (a, b) = (u - u.floor(), v - v.floor());
    let (right, below) = ((col + 1).min(image.width() - 1), (row + 1).min(image.height() - 1));
    let corners =
        [(col, row), (right, row), (col, below), (right, below)].map(|(x, y)| image.get_pixel(x, y).0);
    let weights = [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b];
    let channel = |c: usize| corners.iter().zip(weights).map(|(p, w)| f32::from(p[c]) * w).sum::<f32>();
    Rgb([0, 1, 2].map(|c| channel(c).round() as u8))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (u32, u32) = (320, 240);
    const CAMERA: Intrinsics = Intrinsics { fx: 260.0, fy: 255.0, cx: 161.3, cy: 118.2 };
    const LENSES: [Distortion; 2] = [
        Distortion { radial: [-0.25, 0.08, -0.01, 0.0, 0.0, 0.0], tangential: [0.002, -0.003] },
        Distortion { radial: [0.4, -0.1, 0.02, 0.7, -0.05, 0.01], tangential: [-0.001, 0.002] },
    ];

    /// Column and row of a pinhole image's point in the distorted image.
    fn distorted(lens: &Distortion, u: f64, v: f64) -> [f64; 2] {
        let [x, y] = lens.distort([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy]);
        [CAMERA.fx * x + CAMERA.cx, CAMERA.fy * y + CAMERA.cy]
    }

    /// Corners of a board, away from the border.
    fn grid() -> impl Iterator<Item = [f64; 2]> {
        (1..8).flat_map(|i| (1..6).map(move |j| [40.0 * f64::from(i), 40.0 * f64::from(j)]))
    }

    #[test]
    fn a_distorted_grid_comes_back_within_a_tenth_of_a_pixel() {
        for lens in &LENSES {
            let spots: Vec<[f64; 2]> = grid().map(|[u, v]| distorted(lens, u, v)).collect();
            let moved = grid().zip(&spots).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
            assert!(moved.fold(0.0, f64::max) > 5.0);
            let image = RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
                let square = |s: &[f64; 2]| (f64::from(x) - s[0]).powi(2) + (f64::from(y) - s[1]).powi(2);
                let nearest = spots.iter().map(square).fold(f64::MAX, f64::min);
                Rgb([(250.0 * (-nearest / 8.0).exp()) as u8; 3])
            });
            let map = Undistortion::new(&CAMERA, lens, SIZE.0, SIZE.1);
            let straight = map.color(&image);
            for [u, v] in grid() {
                let (mut sum, mut centre) = (0.0, [0.0; 2]);
                for (dx, dy) in (-8..=8).flat_map(|dx| (-8..=8).map(move |dy| (dx, dy))) {
                    let (x, y) = (u + f64::from(dx), v + f64::from(dy));
                    let weight = f64::from(straight.get_pixel(x as u32, y as u32).0[0]);
                    sum += weight;
                    centre = [centre[0] + weight * x, centre[1] + weight * y];
                }
                let off = (centre[0] / sum - u).hypot(centre[1] / sum - v);
                assert!(off < 0.1, "{off} px at {u}, {v}");
            }
        }
    }

    #[test]
    fn depth_and_mask_are_those_of_the_nearest_pixel() {
        let lens = &LENSES[0];
        let mut depth = DepthMap::zeros(SIZE.0, SIZE.1);
        let mut mask = Mask::empty(SIZE.0, SIZE.1);
        for (index, value) in depth.data.iter_mut().enumerate() {
            *value = index as f32;
        }
        let [u, v] = distorted(lens, 280.0, 200.0).map(|x| x.round() as u32);
        let at = (v * SIZE.0 + u) as usize;
        mask.data[at] = true;
        let map = Undistortion::new(&CAMERA, lens, SIZE.0, SIZE.1);
        assert_eq!(map.depth(&depth).get(280, 200), at as f32);
        assert!(map.mask(&mask).get(280, 200) && map.mask(&mask).count() <= 4);
    }

    #[test]
    fn what_the_lens_does_not_show_is_empty() {
        // A pincushion shows less than the pinhole camera would.
        let lens = Distortion { radial: [0.5, 0.0, 0.0, 0.0, 0.0, 0.0], tangential: [0.0; 2] };
        let map = Undistortion::new(&CAMERA, &lens, SIZE.0, SIZE.1);
        assert!(map.covered() > 0.5 && map.covered() < 0.95, "{}", map.covered());
        let white = RgbImage::from_pixel(SIZE.0, SIZE.1, Rgb([255; 3]));
        assert_eq!(map.color(&white).get_pixel(0, 0).0, [0; 3]);
        assert_eq!(map.color(&white).get_pixel(160, 120).0, [255; 3]);
        // A fold would show the middle a second time, outside.
        let fold = Distortion { radial: [-1.5, 0.0, 0.0, 0.0, 0.0, 0.0], tangential: [0.0; 2] };
        let map = Undistortion::new(&CAMERA, &fold, SIZE.0, SIZE.1);
        assert_eq!(map.color(&white).get_pixel(0, 0).0, [0; 3]);
        assert!(map.covered() < 0.7, "{}", map.covered());
    }

    #[test]
    fn absurd_coefficients_show_nothing() {
        for value in [f64::MAX, -f64::MAX, f64::NAN, 1e30, -1e30, f64::MIN_POSITIVE] {
            for index in 0..8 {
                let mut lens = LENSES[0];
                match index {
                    0..6 => lens.radial[index] = value,
                    _ => lens.tangential[index - 6] = value,
                }
                let map = Undistortion::new(&CAMERA, &lens, 32, 24);
                let share = map.covered();
                assert!(
                    (0.0..=1.0).contains(&share) && (share < 0.1 || value == f64::MIN_POSITIVE),
                    "{share}"
                );
            }
        }
    }
}
