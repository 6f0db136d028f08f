//! The view at the working resolution: smoothed colour, measured points, normals.

use image::imageops;
use rayon::prelude::*;
use unopose_core::{frame::RgbdFrame, geometry::Intrinsics};

use crate::lab::lab;

/// Half side of the window of a normal, cells.
const NORMAL_REACH: i64 = 3;
/// Fewest measured cells of a window.
const NORMAL_CELLS: usize = 8;

/// Cells of equal size, row-major.
#[derive(Clone, Debug)]
pub struct Grid {
    pub width: usize,
    pub height: usize,
    /// CIE L*a*b*, smoothed.
    pub lab: Vec<[f32; 3]>,
    /// Metres, camera frame; z = 0 where nothing is measured.
    pub points: Vec<[f32; 3]>,
    /// Unit, towards the camera; zero where unknown.
    pub normals: Vec<[f32; 3]>,
    /// Pixels per cell and axis.
    pub step: f64,
    /// Source size.
    pub source: (u32, u32),
    /// Radians per cell, the angle between neighbouring rays.
    pub ray_step: f32,
}

/// Standard deviation of depth that a consumer sensor has at `z` metres, times about three.
pub fn tolerance(z: f32) -> f32 {
    0.003 + 0.005 * z * z
}

impl Grid {
    /// At most `side` cells along the longer axis, never more than pixels.
    pub fn new(frame: &RgbdFrame, side: u32) -> Self {
        let (source_width, source_height) = (frame.width(), frame.height());
        let step = (f64::from(source_width.max(source_height)) / f64::from(side.max(1))).max(1.0);
        let cells = |pixels: u32| ((f64::from(pixels) / step).round() as u32).max(1);
        let (width, height) = (cells(source_width), cells(source_height));
        let small =
            if step > 1.0 { imageops::thumbnail(&frame.rgb, width, height) } else { frame.rgb.clone() };
        let small = imageops::blur(&small, 0.8);
        let (width, height) = (width as usize, height as usize);
        let mut grid = Self {
            width,
            height,
            lab: small.pixels().map(|p| lab(p.0)).collect(),
            points: Vec::new(),
            normals: Vec::new(),
            step,
            source: (source_width, source_height),
            ray_step: (step / frame.intrinsics.fx) as f32,
        };
        grid.points = grid.measure(frame);
        grid.normals = grid.fit_normals(&frame.intrinsics);
        grid
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// Whether a cell has depth.
    pub fn measured(&self, cell: usize) -> bool {
        self.points[cell][2] > 0.0
    }

    /// Gives every cell the point and normal of its source.
    pub fn follow(&mut self, sources: &[u32]) {
        for (cell, &source) in sources.iter().enumerate() {
            if source as usize != cell {
                self.points[cell] = self.points[source as usize];
                self.normals[cell] = self.normals[source as usize];
            }
        }
    }

    /// Cell of a pixel.
    pub fn cell_of(&self, col: u32, row: u32) -> usize {
        let at = |pixel: u32, pixels: u32, cells: usize| {
            (pixel as usize * cells / pixels.max(1) as usize).min(cells - 1)
        };
        at(row, self.source.1, self.height) * self.width + at(col, self.source.0, self.width)
    }

    /// The up to four neighbours right of and below a cell that complete an 8-neighbourhood over all cells.
    pub fn forward_neighbors(&self, cell: usize) -> impl Iterator<Item = usize> + '_ {
        let (col, row) = ((cell % self.width) as i64, (cell / self.width) as i64);
        [(1, 0), (0, 1), (1, 1), (-1, 1)].into_iter().filter_map(move |(dc, dr)| self.at(col + dc, row + dr))
    }

    /// The up to four neighbours that share a side with a cell.
    pub fn side_neighbors(&self, cell: usize) -> impl Iterator<Item = usize> + '_ {
        let (col, row) = ((cell % self.width) as i64, (cell / self.width) as i64);
        [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().filter_map(move |(dc, dr)| self.at(col + dc, row + dr))
    }

    fn at(&self, col: i64, row: i64) -> Option<usize> {
        let inside = col >= 0 && row >= 0 && col < self.width as i64 && row < self.height as i64;
        inside.then(|| row as usize * self.width + col as usize)
    }

    /// The lower median of a cell's depths: no mean, which would lie between an object and what is behind it.
    fn measure(&self, frame: &RgbdFrame) -> Vec<[f32; 3]> {
        let range = |cell: usize, cells: usize, pixels: u32| {
            let pixels = pixels as usize;
            (cell * pixels / cells)..((cell + 1) * pixels / cells).max(cell * pixels / cells + 1).min(pixels)
        };
        let depth = &frame.depth;
        (0..self.len())
            .into_par_iter()
            .map_init(Vec::new, |values, cell| {
                values.clear();
                let cols = range(cell % self.width, self.width, depth.width);
                let rows = range(cell / self.width, self.height, depth.height);
                for row in rows.clone() {
                    let line = &depth.data[row * depth.width as usize..][..depth.width as usize];
                    values.extend(line[cols.clone()].iter().filter(|z| z.is_finite() && **z > 0.0));
                }
                if values.is_empty() {
                    return [0.0; 3];
                }
                let middle = (values.len() - 1) / 2;
                let z = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
                let centre = |r: std::ops::Range<usize>| (r.start + r.end - 1) as f64 / 2.0;
                let p = frame.intrinsics.back_project(centre(cols), centre(rows), z.into());
                [p.x as f32, p.y as f32, p.z as f32]
            })
            .collect()
    }

    /// Planes are linear in inverse depth over the image: 1 / z = (n / h) . (x / z, y / z, 1).
    fn fit_normals(&self, camera: &Intrinsics) -> Vec<[f32; 3]> {
        let ray = 1.0 / camera.fx.max(1e-9);
        (0..self.len())
            .into_par_iter()
            .map(|cell| {
                let [x, y, z] = self.points[cell];
                if z <= 0.0 {
                    return [0.0; 3];
                }
                let reach = 3.0 * tolerance(z) + 2.0 * z * (ray * self.step) as f32 * NORMAL_REACH as f32;
                let (col, row) = ((cell % self.width) as i64, (cell / self.width) as i64);
                let (mut count, mut s) = (0usize, [0.0f64; 8]);
                for dr in -NORMAL_REACH..=NORMAL_REACH {
                    for dc in -NORMAL_REACH..=NORMAL_REACH {
                        let Some(other) = self.at(col + dc, row + dr) else { continue };
                        let p = self.points[other];
                        if p[2] <= 0.0 || (p[2] - z).abs() > reach {
                            continue;
                        }
                        let (u, v) = (f64::from(p[0] / p[2] - x / z), f64::from(p[1] / p[2] - y / z));
                        let d = 1.0 / f64::from(p[2]);
                        count += 1;
                        for (sum, value) in s.iter_mut().zip([u, v, u * u, u * v, v * v, d, u * d, v * d]) {
                            *sum += value;
                        }
                    }
                }
                if count < NORMAL_CELLS {
                    return [0.0; 3];
                }
                let n = count as f64;
                let (mu, mv, md) = (s[0] / n, s[1] / n, s[5] / n);
                let (uu, uv, vv) = (s[2] / n - mu * mu, s[3] / n - mu * mv, s[4] / n - mv * mv);
                let (ud, vd) = (s[6] / n - mu * md, s[7] / n - mv * md);
                let determinant = uu * vv - uv * uv;
                if determinant < 1e-3 * (uu + vv) * (uu + vv) {
                    return [0.0; 3];
                }
                let a = (ud * vv - vd * uv) / determinant;
                let b = (vd * uu - ud * uv) / determinant;
                // u and v are relative to the cell's own ray.
                let c = md - a * (mu + f64::from(x / z)) - b * (mv + f64::from(y / z));
                let length = (a * a + b * b + c * c).sqrt().max(1e-12);
                [a, b, c].map(|value| (-value / length) as f32)
            })
            .collect()
    }
}

/// Scalar product.
pub fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a - b`.
pub fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Euclidean length.
pub fn norm(a: [f32; 3]) -> f32 {
    dot(a, a).sqrt()
}

#[cfg(test)]
mod tests {
    use unopose_core::frame::DepthMap;

    use super::*;

    #[test]
    fn normals_of_a_tilted_plane() {
        let intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx: 159.5, cy: 119.5 };
        let (n, h) = ([0.0f64, -0.6, -0.8], -0.64);
        let mut depth = DepthMap::zeros(320, 240);
        for (i, z) in depth.data.iter_mut().enumerate() {
            let ray = [((i % 320) as f64 - 159.5) / 300.0, ((i / 320) as f64 - 119.5) / 300.0, 1.0];
            *z = (h / (0..3).map(|k| n[k] * ray[k]).sum::<f64>()) as f32;
        }
        depth.data[100 * 320 + 100] = 0.0;
        let frame = RgbdFrame { rgb: image::RgbImage::new(320, 240), depth, intrinsics };
        let grid = Grid::new(&frame, 160);
        assert_eq!((grid.width, grid.height), (160, 120));
        assert!(grid.measured(50 * 160 + 50), "the other pixels of the cell are measured");
        for cell in [80 * 160 + 40, 3 * 160 + 2, 60 * 160 + 159] {
            let got = grid.normals[cell];
            assert!((0..3).all(|k| (f64::from(got[k]) - n[k]).abs() < 1e-3), "{got:?}");
        }
    }
}
