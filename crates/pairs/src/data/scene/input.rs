//! An image on the network's grid.

use std::collections::VecDeque;

use unopose_core::frame::RgbdFrame;

use super::super::DataError;

/// Channels that depth gives: the point, whether it is measured, the normal, the height over the surroundings twice.
pub const GEOMETRY_CHANNELS: usize = 9;
/// All channels: those of depth, then red, green and blue.
pub const INPUT_CHANNELS: usize = GEOMETRY_CHANNELS + 3;

/// Largest coordinate that the network sees, metres.
const REACH: f32 = 1.5;
/// Half sides of the windows of the surroundings, cells, and what one metre above them counts.
const RELIEFS: [(usize, f32); 2] = [(3, 60.0), (10, 25.0)];
/// Half side of the window that smooths points before their normal, cells.
const SMOOTH: usize = 1;
/// Cells on both sides between which a normal's tangents reach.
const TANGENT: usize = 2;
/// Mean and deviation of colour values from 0 to 1.
const COLOR: [f32; 2] = [0.45, 0.25];

/// An image scaled to fit into the grid; what lies right of it and below is padding.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneInput {
    /// Columns of the grid.
    pub width: usize,
    /// Rows of the grid.
    pub height: usize,
    /// Columns and rows that show the image.
    pub shown: [usize; 2],
    /// Pixels of the image per cell and axis.
    pub step: f64,
    /// Columns and rows of the image.
    pub source: (u32, u32),
    /// `[INPUT_CHANNELS, height, width]`, 0 in the padding. Coordinates are in metres, the depth relative to the image's
    /// median.
    pub values: Vec<f32>,
    /// Points in metres, camera frame; cells without depth have that of the nearest measured cell. Zeros in the padding.
    pub points: Vec<[f32; 3]>,
    /// Whether a cell has depth of its own.
    pub measured: Vec<bool>,
}

impl SceneInput {
    /// Of a view with at least one measured pixel. A cell's depth is the lower median of its pixels', its colour their mean.
    pub fn new(frame: &RgbdFrame, width: usize, height: usize) -> Result<Self, DataError> {
        let source = (frame.width(), frame.height());
        let depth_size = (frame.depth.width, frame.depth.height);
        if depth_size != source {
            return Err(DataError::Size {
                what: "the depth image",
                found_width: depth_size.0,
                found_height: depth_size.1,
                width: source.0,
                height: source.1,
            });
        }
        let step = (f64::from(source.0) / width as f64).max(f64::from(source.1) / height as f64);
        let cells = |pixels: u32, most: usize| ((f64::from(pixels) / step).round() as usize).clamp(1, most);
        let shown = [cells(source.0, width), cells(source.1, height)];
        let mut input = Self {
            width,
            height,
            shown,
            step,
            source,
            values: vec![0.0; INPUT_CHANNELS * width * height],
            points: vec![[0.0; 3]; width * height],
            measured: vec![false; width * height],
        };
        let depths = input.depths(frame);
        let filled = input.filled(&depths).ok_or(DataError::NoSceneDepth)?;
        let mut known: Vec<f32> = depths.iter().copied().filter(|z| *z > 0.0).collect();
        let middle = known.len() / 2;
        let median = *known.select_nth_unstable_by(middle, f32::total_cmp).1;
        for cell in input.cells() {
            let z = filled[cell];
            input.measured[cell] = depths[cell] > 0.0;
            let [col, row] = input.pixel_of(cell);
            let p = frame.intrinsics.back_project(col, row, z.into());
            input.points[cell] = [p.x as f32, p.y as f32, p.z as f32];
        }
        input.write_geometry(&filled, median);
        input.write_colors(frame);
        Ok(input)
    }

    /// Number of cells of the grid.
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// Whether the grid has no cells.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The cells that show the image, row by row.
    pub fn cells(&self) -> impl Iterator<Item = usize> + use<> {
        let ([columns, rows], width) = (self.shown, self.width);
        (0..rows).flat_map(move |row| (0..columns).map(move |col| row * width + col))
    }

    /// The cell that shows a pixel.
    pub fn cell_of(&self, col: u32, row: u32) -> usize {
        let at =
            |pixel: u32, axis: usize| ((f64::from(pixel) / self.step) as usize).min(self.shown[axis] - 1);
        at(row, 1) * self.width + at(col, 0)
    }

    /// The up to four cells of the image that share a side with a cell.
    pub fn neighbors(&self, cell: usize) -> impl Iterator<Item = usize> + use<> {
        let ([columns, rows], width) = (self.shown, self.width);
        let (col, row) = (cell % width, cell / width);
        let left = (col > 0).then(|| cell - 1);
        let right = (col + 1 < columns).then(|| cell + 1);
        let up = (row > 0).then(|| cell - width);
        let down = (row + 1 < rows).then(|| cell + width);
        [left, right, up, down].into_iter().flatten()
    }

    /// The pixel in the middle of a cell, column and row.
    pub fn pixel_of(&self, cell: usize) -> [f64; 2] {
        let middle = |index: usize| (index as f64 + 0.5) * self.step - 0.5;
        [middle(cell % self.width), middle(cell / self.width)]
    }

    /// The pixels of a cell along one axis, at least one.
    fn range(&self, index: usize, pixels: u32) -> std::ops::Range<u32> {
        let first = ((index as f64 * self.step) as u32).min(pixels.saturating_sub(1));
        let last = (((index + 1) as f64 * self.step) as u32).clamp(first + 1, pixels.max(1));
        first..last
    }

    fn depths(&self, frame: &RgbdFrame) -> Vec<f32> {
        let mut depths = vec![0.0; self.len()];
        let mut values = Vec::new();
        for cell in self.cells() {
            values.clear();
            for row in self.range(cell / self.width, self.source.1) {
                for col in self.range(cell % self.width, self.source.0) {
                    let z = frame.depth.get(col, row);
                    if z.is_finite() && z > 0.0 {
                        values.push(z);
                    }
                }
            }
            if !values.is_empty() {
                let middle = (values.len() - 1) / 2;
                depths[cell] = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
            }
        }
        depths
    }

    /// Depth of every shown cell, where there is none that of the nearest cell by steps along the axes; `None` without any.
    fn filled(&self, depths: &[f32]) -> Option<Vec<f32>> {
        let mut filled = depths.to_vec();
        let mut queue: VecDeque<usize> = self.cells().filter(|&cell| depths[cell] > 0.0).collect();
        if queue.is_empty() {
            return None;
        }
        while let Some(cell) = queue.pop_front() {
            for other in self.neighbors(cell) {
                if filled[other] <= 0.0 {
                    filled[other] = filled[cell];
                    queue.push_back(other);
                }
            }
        }
        Some(filled)
    }

    fn write_geometry(&mut self, filled: &[f32], median: f32) {
        let area = self.len();
        let smooth: Vec<Vec<f32>> = (0..3)
            .map(|axis| {
                let values: Vec<f32> = self.points.iter().map(|p| p[axis]).collect();
                self.box_mean(&values, SMOOTH)
            })
            .collect();
        let reliefs = RELIEFS.map(|(half, _)| self.box_mean(filled, half));
        for cell in self.cells() {
            let p = self.points[cell];
            let normal = self.normal(&smooth, cell);
            let relative = [p[0], p[1], p[2] - median].map(|v| v.clamp(-REACH, REACH));
            let heights: [f32; 2] =
                std::array::from_fn(|i| (RELIEFS[i].1 * (reliefs[i][cell] - filled[cell])).clamp(-1.0, 1.0));
            let channels: [f32; GEOMETRY_CHANNELS] = [
                relative[0],
                relative[1],
                relative[2],
                f32::from(u8::from(self.measured[cell])),
                normal[0],
                normal[1],
                normal[2],
                heights[0],
                heights[1],
            ];
            for (channel, value) in channels.into_iter().enumerate() {
                self.values[channel * area + cell] = value;
            }
        }
    }

    /// Unit, towards the camera.
    fn normal(&self, smooth: &[Vec<f32>], cell: usize) -> [f32; 3] {
        let (col, row) = (cell % self.width, cell / self.width);
        let tangent =
            |a: usize, b: usize| -> [f32; 3] { std::array::from_fn(|i| smooth[i][b] - smooth[i][a]) };
        let (left, right) = (col.saturating_sub(TANGENT), (col + TANGENT).min(self.shown[0] - 1));
        let (up, down) = (row.saturating_sub(TANGENT), (row + TANGENT).min(self.shown[1] - 1));
        let u = tangent(row * self.width + left, row * self.width + right);
        let v = tangent(up * self.width + col, down * self.width + col);
        // Rows go down, so this order points towards the camera.
        let n = [v[1] * u[2] - v[2] * u[1], v[2] * u[0] - v[0] * u[2], v[0] * u[1] - v[1] * u[0]];
        let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
        if length > 0.0 { n.map(|c| c / length) } else { [0.0; 3] }
    }

    /// Mean of the shown cells in a window of `2 half + 1` cells.
    fn box_mean(&self, values: &[f32], half: usize) -> Vec<f32> {
        let [columns, rows] = self.shown;
        let stride = columns + 1;
        let mut sums = vec![0.0f64; stride * (rows + 1)];
        for row in 0..rows {
            let mut line = 0.0;
            for col in 0..columns {
                line += f64::from(values[row * self.width + col]);
                sums[(row + 1) * stride + col + 1] = sums[row * stride + col + 1] + line;
            }
        }
        let mut means = vec![0.0; values.len()];
        for row in 0..rows {
            let (top, bottom) = (row.saturating_sub(half), (row + half + 1).min(rows));
            for col in 0..columns {
                let (left, right) = (col.saturating_sub(half), (col + half + 1).min(columns));
                let sum =
                    sums[bottom * stride + right] - sums[top * stride + right] - sums[bottom * stride + left]
                        + sums[top * stride + left];
                means[row * self.width + col] = (sum / ((bottom - top) * (right - left)) as f64) as f32;
            }
        }
        means
    }

    fn write_colors(&mut self, frame: &RgbdFrame) {
        let area = self.len();
        for cell in self.cells() {
            let (mut sum, mut count) = ([0u32; 3], 0u32);
            for row in self.range(cell / self.width, self.source.1) {
                for col in self.range(cell % self.width, self.source.0) {
                    let pixel = frame.rgb.get_pixel(col, row);
                    sum.iter_mut().zip(pixel.0).for_each(|(s, v)| *s += u32::from(v));
                    count += 1;
                }
            }
            for (channel, total) in sum.into_iter().enumerate() {
                let value = total as f32 / (255.0 * count.max(1) as f32);
                self.values[(GEOMETRY_CHANNELS + channel) * area + cell] = (value - COLOR[0]) / COLOR[1];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use unopose_core::{frame::DepthMap, geometry::Intrinsics};

    use super::*;

    fn frame(width: u32, height: u32, z: impl Fn(u32, u32) -> f32) -> RgbdFrame {
        let mut depth = DepthMap::zeros(width, height);
        for (i, value) in depth.data.iter_mut().enumerate() {
            *value = z(i as u32 % width, i as u32 / width);
        }
        let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 31.5, cy: 15.5 };
        RgbdFrame {
            rgb: image::RgbImage::from_pixel(width, height, image::Rgb([51, 102, 255])),
            depth,
            intrinsics,
        }
    }

    #[test]
    fn a_plane_keeps_its_points_and_normal_through_scaling_and_padding() {
        // 64 x 32 pixels into 32 x 32 cells: two pixels per cell, the lower half is padding.
        let (n, h) = ([0.6f32, 0.0, -0.8], -0.8);
        let plane = |col: u32, row: u32| {
            let ray = [(col as f32 - 31.5) / 100.0, (row as f32 - 15.5) / 100.0, 1.0];
            h / (0..3).map(|i| n[i] * ray[i]).sum::<f32>()
        };
        let hole = |col: u32, row: u32| if col < 8 && row < 8 { 0.0 } else { plane(col, row) };
        let input = SceneInput::new(&frame(64, 32, hole), 32, 32).unwrap();
        assert_eq!((input.shown, input.step), ([32, 16], 2.0));
        let area = input.len();
        let at = |channel: usize, cell: usize| input.values[channel * area + cell];
        let cell = 8 * 32 + 20;
        let p = input.points[cell];
        assert!(((0..3).map(|i| n[i] * p[i]).sum::<f32>() - h).abs() < 5e-3, "{p:?}");
        for (axis, n) in n.into_iter().enumerate() {
            assert!((at(4 + axis, cell) - n).abs() < 5e-3, "axis {axis}: {}", at(4 + axis, cell));
        }
        assert!((at(9, cell) - (0.2 - 0.45) / 0.25).abs() < 1e-5 && (at(11, cell) - 2.2).abs() < 1e-5);
        assert_eq!((at(3, 0), at(3, cell), input.measured[0]), (0.0, 1.0, false));
        assert!(input.points[0][2] > 0.5, "the hole has the depth beside it");
        assert!(input.cells().count() == 512 && at(2, 16 * 32) == 0.0);
        assert_eq!((input.cell_of(41, 17), input.cell_of(63, 31)), (8 * 32 + 20, 15 * 32 + 31));
    }

    #[test]
    fn a_step_stands_above_its_surroundings() {
        let raised = |col: u32, _: u32| if (31..34).contains(&col) { 0.79 } else { 0.8 };
        let input = SceneInput::new(&frame(64, 32, raised), 64, 32).unwrap();
        let relief = input.values[7 * input.len() + 16 * 64 + 32];
        // Three of the window's seven columns are a centimetre nearer: 60 (4/7 cm).
        assert!((relief - 60.0 * 0.01 * 4.0 / 7.0).abs() < 1e-4, "{relief}");
    }

    #[test]
    fn no_depth_and_other_sizes_are_errors() {
        let message = SceneInput::new(&frame(64, 32, |_, _| 0.0), 32, 32).unwrap_err().to_string();
        assert!(message.contains("no pixel of the depth image is measured"), "{message}");
        let mut other = frame(64, 32, |_, _| 1.0);
        other.depth = DepthMap::zeros(32, 32);
        let message = SceneInput::new(&other, 32, 32).unwrap_err().to_string();
        assert!(message.contains("32 x 32") && message.contains("64 x 32"), "{message}");
    }
}
