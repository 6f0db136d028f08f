//! Where depth jumps from a near surface to a farther one.

use unopose_core::frame::{DepthMap, RgbdFrame};

/// Unmeasured pixels that a jump may span.
const GAP: usize = 8;
/// Two neighbours of one surface differ at most by `ROUGH` + `NOISE` z² (metres) and the slope of a surface that is seen at
/// `SLOPE` (tangent) against the optical axis.
const ROUGH: f64 = 0.003;
const NOISE: f64 = 0.003;
const SLOPE: f64 = 3.0;

/// A border of a near surface between two measured pixels of a row or column.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Jump {
    /// Along the line, of the near pixel.
    pub near: usize,
    /// +1 when the far surface follows in the line, -1 when it comes before.
    pub towards: i8,
}

impl Jump {
    /// The border, half a pixel from the near pixel's centre.
    pub fn at(&self) -> f64 {
        self.near as f64 + 0.5 * f64::from(self.towards)
    }
}

/// A row (axis 0) or a column (axis 1) of a depth image with its jumps in order.
pub(crate) struct Lines {
    /// Jumps of every row.
    pub rows: Vec<Vec<Jump>>,
    /// Jumps of every column.
    pub columns: Vec<Vec<Jump>>,
}

/// Whether two measured pixels `gap` apart lie on one surface; `per_pixel` is 1 / focal length.
pub(crate) fn is_smooth(a: f32, b: f32, gap: usize, per_pixel: f64) -> bool {
    let z = f64::from(a.min(b));
    let limit = ROUGH + NOISE * z * z + (SLOPE + gap as f64) * z * per_pixel;
    f64::from((a - b).abs()) <= limit
}

/// Has the pixel a depth?
pub(crate) fn measured(z: f32) -> bool {
    z.is_finite() && z > 0.0
}

impl Lines {
    pub fn of(frame: &RgbdFrame) -> Self {
        let DepthMap { width, height, .. } = frame.depth;
        let (k, get) = (&frame.intrinsics, |col: usize, row: usize| frame.depth.get(col as u32, row as u32));
        let (width, height) = (width as usize, height as usize);
        Self {
            rows: (0..height).map(|row| jumps(width, 1.0 / k.fx, |col| get(col, row))).collect(),
            columns: (0..width).map(|col| jumps(height, 1.0 / k.fy, |row| get(col, row))).collect(),
        }
    }
}

fn jumps(length: usize, per_pixel: f64, depth: impl Fn(usize) -> f32) -> Vec<Jump> {
    let mut found = Vec::new();
    let mut last: Option<(usize, f32)> = None;
    for at in 0..length {
        let z = depth(at);
        if !measured(z) {
            continue;
        }
        if let Some((before, z_before)) = last.filter(|(before, _)| at - before <= GAP)
            && !is_smooth(z_before, z, at - before, per_pixel)
        {
            found.push(match z_before < z {
                true => Jump { near: before, towards: 1 },
                false => Jump { near: at, towards: -1 },
            });
        }
        last = Some((at, z));
    }
    found
}

/// The next measured pixel from `(col, row)` in a direction, at most [`GAP`] pixels away: column, row, distance.
pub(crate) fn next_measured(
    depth: &DepthMap,
    (col, row): (u32, u32),
    (dc, dr): (i32, i32),
) -> Option<(u32, u32, usize)> {
    (1..=GAP).find_map(|step| {
        let c = col.checked_add_signed(dc * step as i32).filter(|c| *c < depth.width)?;
        let r = row.checked_add_signed(dr * step as i32).filter(|r| *r < depth.height)?;
        measured(depth.get(c, r)).then_some((c, r, step))
    })
}
