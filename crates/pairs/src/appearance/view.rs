//! A masked view as small maps of colour and depth.

use unopose_core::{frame::MaskedView, geometry::Intrinsics};

/// Cells along the longer side of the object's box, unless the box has fewer pixels.
const CELLS: f32 = 48.0;
/// Width of the rim around the box that is kept for its depth, in shares of the longer side.
const RIM: f32 = 0.25;
/// Half the width of a blurring window, cells; it passes twice.
const BLUR: usize = 2;
/// Weight of the mean of the channels against their differences: shading changes it when an object turns, a print's
/// colours stay.
const BRIGHTNESS: f32 = 0.3;

/// An object's view as cells of equal size: the depth of the object and of what surrounds it, the object's colours.
#[derive(Clone, Debug)]
pub struct AppearanceView {
    pub(super) width: usize,
    /// In cells, cell centres at integer coordinates.
    pub(super) camera: Intrinsics,
    /// Metres along the optical axis, 0 without a measurement; of the object where `object`, else of what is there.
    pub(super) depth: Vec<f32>,
    /// Cells that mostly show the object.
    pub(super) object: Vec<bool>,
    /// Mean of the channels (weighted), red against green, both against blue; first as averaged over the cells, then blurred.
    pub(super) colors: [Vec<[f32; 3]>; 2],
    pub(super) samples: Vec<Sample>,
}

/// The surface in a cell of the object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub cell: usize,
    /// Metres, camera frame.
    pub point: [f32; 3],
}

/// Sums over the pixels of a cell.
#[derive(Clone, Copy, Default)]
struct Sums {
    object: u32,
    color: [f32; 3],
    object_depth: (f32, u32),
    other: u32,
    other_depth: (f32, u32),
}

impl AppearanceView {
    /// `None` for an empty mask.
    pub fn new(MaskedView { frame, mask }: MaskedView<'_>) -> Option<Self> {
        let tight = mask.bounding_box()?;
        let sides = [tight.col_max - tight.col_min, tight.row_max - tight.row_min];
        let longer = sides[0].max(sides[1]) as f32;
        let (size, rim) = ((longer / CELLS).max(1.0), (RIM * longer).ceil() as u32);
        let first = [tight.col_min.saturating_sub(rim), tight.row_min.saturating_sub(rim)];
        let last = [
            (tight.col_max + rim).min(mask.width).min(frame.width()),
            (tight.row_max + rim).min(mask.height).min(frame.height()),
        ];
        let cells = |axis: usize| (last[axis].saturating_sub(first[axis]) as f32 / size).ceil() as usize;
        let (width, height) = (cells(0), cells(1));
        let mut sums = vec![Sums::default(); width * height];
        for row in first[1]..last[1] {
            let line = ((row - first[1]) as f32 / size) as usize * width;
            for col in first[0]..last[0] {
                let sum = &mut sums[line + ((col - first[0]) as f32 / size) as usize];
                let depth = frame.depth.get(col, row);
                let measured = depth.is_finite() && depth > 0.0;
                let (count, depths) = if mask.get(col, row) {
                    let [r, g, b] = frame.rgb.get_pixel(col, row).0.map(|v| f32::from(v) / 255.0);
                    let opponent = [BRIGHTNESS * (r + g + b) / 3.0, r - g, (r + g) / 2.0 - b];
                    (0..3).for_each(|c| sum.color[c] += opponent[c]);
                    (&mut sum.object, &mut sum.object_depth)
                } else {
                    (&mut sum.other, &mut sum.other_depth)
                };
                *count += 1;
                if measured {
                    *depths = (depths.0 + depth, depths.1 + 1);
                }
            }
        }
        let in_cells = |x: f64, axis: usize| (x + 0.5 - f64::from(first[axis])) / f64::from(size) - 0.5;
        let camera = Intrinsics {
            fx: frame.intrinsics.fx / f64::from(size),
            fy: frame.intrinsics.fy / f64::from(size),
            cx: in_cells(frame.intrinsics.cx, 0),
            cy: in_cells(frame.intrinsics.cy, 1),
        };
        let object: Vec<bool> = sums.iter().map(|s| s.object > 0 && s.object >= s.other).collect();
        let mean = |(sum, count): (f32, u32)| if count > 0 { sum / count as f32 } else { 0.0 };
        let depth: Vec<f32> = sums
            .iter()
            .zip(&object)
            .map(|(s, &object)| mean(if object { s.object_depth } else { s.other_depth }))
            .collect();
        let colors: Vec<[f32; 3]> =
            sums.iter().map(|s| s.color.map(|sum| sum / s.object.max(1) as f32)).collect();
        Some(Self::from_maps(camera, width, depth, object, colors))
    }

    /// From stored maps, row by row: metres, cells of the object, channels of the colour.
    pub fn from_maps(
        camera: Intrinsics,
        width: usize,
        depth: Vec<f32>,
        object: Vec<bool>,
        colors: Vec<[f32; 3]>,
    ) -> Self {
        let blurred = blurred(&blurred(&colors, &object, width), &object, width);
        let sample = |(cell, &z): (usize, &f32)| {
            (object[cell] && z > 0.0).then(|| {
                let p = camera.back_project((cell % width) as f64, (cell / width) as f64, z.into());
                Sample { cell, point: [p.x as f32, p.y as f32, p.z as f32] }
            })
        };
        let samples = depth.iter().enumerate().filter_map(sample).collect();
        Self { width, camera, samples, colors: [colors, blurred], depth, object }
    }

    /// Colours of the object around where a point (camera frame, metres) is seen, between the cells: as averaged over them,
    /// then blurred. Zeros away from the object.
    pub fn colors_at(&self, point: &[f32; 3]) -> [[f32; 3]; 2] {
        let [x, y, z] = point.map(f64::from);
        let mut sums = [[0.0f32; 3]; 2];
        if z <= 0.0 {
            return sums;
        }
        let (u, v) = (self.camera.fx * x / z + self.camera.cx, self.camera.fy * y / z + self.camera.cy);
        let (left, top) = (u.floor(), v.floor());
        let (right_share, lower_share) = ((u - left) as f32, (v - top) as f32);
        let mut total = 0.0;
        for (row, row_share) in [(top, 1.0 - lower_share), (top + 1.0, lower_share)] {
            for (col, share) in [(left, 1.0 - right_share), (left + 1.0, right_share)] {
                if col < 0.0 || row < 0.0 || col >= self.width as f64 || row >= self.height() as f64 {
                    continue;
                }
                let cell = row as usize * self.width + col as usize;
                if self.object[cell] {
                    let weight = row_share * share;
                    total += weight;
                    for (sum, colors) in sums.iter_mut().zip(&self.colors) {
                        sum.iter_mut().zip(colors[cell]).for_each(|(sum, c)| *sum += weight * c);
                    }
                }
            }
        }
        if total > 0.0 { sums.map(|sum| sum.map(|c| c / total)) } else { sums }
    }

    /// sRGB around where a point (camera frame, metres) is seen, between the cells; black away from the object.
    pub fn rgb_at(&self, point: &[f32; 3]) -> [u8; 3] {
        let [[mean, red_green, yellow_blue], _] = self.colors_at(point);
        let mean = mean / BRIGHTNESS;
        let yellow = mean + yellow_blue / 3.0;
        let rgb = [yellow + red_green / 2.0, yellow - red_green / 2.0, mean - yellow_blue * 2.0 / 3.0];
        rgb.map(|v| (255.0 * v).round().clamp(0.0, 255.0) as u8)
    }

    /// The camera in cells, cell centres at integer coordinates.
    pub fn camera(&self) -> &Intrinsics {
        &self.camera
    }

    /// Cells per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Depth of every cell, metres, 0 without a measurement.
    pub fn depth(&self) -> &[f32] {
        &self.depth
    }

    /// Whether a cell mostly shows the object.
    pub fn object(&self) -> &[bool] {
        &self.object
    }

    /// Mean of the channels, red against green, both against blue, for every cell.
    pub fn colors(&self) -> &[[f32; 3]] {
        &self.colors[0]
    }

    pub(super) fn height(&self) -> usize {
        self.depth.len() / self.width.max(1)
    }
}

/// Means over square windows, of the object's cells only.
fn blurred(colors: &[[f32; 3]], object: &[bool], width: usize) -> Vec<[f32; 3]> {
    let height = colors.len() / width.max(1);
    let mut sums: Vec<[f32; 4]> = colors
        .iter()
        .zip(object)
        .map(|(c, &object)| if object { [c[0], c[1], c[2], 1.0] } else { [0.0; 4] })
        .collect();
    for (count, stride, lines, line_stride) in [(width, 1, height, width), (height, width, width, 1)] {
        for line in 0..lines {
            let at = |i: usize| line * line_stride + i * stride;
            let values: Vec<[f32; 4]> = (0..count).map(|i| sums[at(i)]).collect();
            for i in 0..count {
                let window = &values[i.saturating_sub(BLUR)..(i + BLUR + 1).min(count)];
                sums[at(i)] = window.iter().fold([0.0; 4], |s, v| std::array::from_fn(|c| s[c] + v[c]));
            }
        }
    }
    sums.iter().map(|s| [0, 1, 2].map(|c| s[c] / s[3].max(1.0))).collect()
}
