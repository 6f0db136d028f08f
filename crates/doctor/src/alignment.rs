//! Shift between the borders in the depth image and the edges in the colour image, by correlation.

use image::GrayImage;
use unopose_core::frame::{BoundingBox, Mask, RgbdFrame};

use super::{Check, Finding, Level, jumps::Lines};

/// Shifts that are tried in each direction, pixels of an image 640 wide.
const REACH: f64 = 15.0;
/// Borders that a shift is measured by.
const FEWEST: usize = 150;
/// The region around the mask, sides of the mask's box.
const AROUND: f64 = 0.75;
/// A colour edge of this many times the region's root mean square counts half as much as the strongest.
const HALF: f64 = 2.0;
/// Shift, pixels of an image 640 wide.
const SHIFT: [f64; 2] = [3.5, 9.0];
/// A shift counts from this evidence on: by what share the edges agree better with it than without, times the standard
/// deviations by which it stands out beyond those that the best of many shifts always has. Less than twice of it is never
/// called wrong: prints and shadows can imitate a shift.
const CLEAR: f64 = 0.2;
const ALWAYS: f64 = 1.5;

/// How colour edges lie against depth borders.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeShift {
    /// Columns and rows by which the colour image lies to the right of and below the depth image.
    pub shift: [i32; 2],
    /// Agreement with the shift over agreement without.
    pub gain: f64,
    /// Standard deviations by which the best agreement is above the mean of all shifts.
    pub distinct: f64,
}

/// The best shift near a mask, or in the whole image; `None` with too few borders or without colour edges.
pub(crate) fn edge_shift(frame: &RgbdFrame, lines: &Lines, mask: Option<&Mask>) -> Option<EdgeShift> {
    let whole = BoundingBox { col_min: 0, row_min: 0, col_max: frame.width(), row_max: frame.height() };
    let near = mask.and_then(Mask::bounding_box).map(|b| grown(&b, &whole));
    near.and_then(|region| shift_in(frame, lines, &region)).or_else(|| shift_in(frame, lines, &whole))
}

fn shift_in(frame: &RgbdFrame, lines: &Lines, region: &BoundingBox) -> Option<EdgeShift> {
    let reach = (REACH * f64::from(frame.width()) / 640.0).ceil().max(4.0) as i32;
    let gradients = Gradients::of(frame);
    let (cols, rows) = (region.col_min..region.col_max, region.row_min..region.row_max);
    let across = rows.clone().flat_map(|row| {
        let inside = lines.rows[row as usize].iter().filter(|j| cols.contains(&(j.near as u32)));
        inside.map(move |jump| (0, jump.at(), f64::from(row)))
    });
    let down = cols.clone().flat_map(|col| {
        let inside = lines.columns[col as usize].iter().filter(|j| rows.contains(&(j.near as u32)));
        inside.map(move |jump| (1, f64::from(col), jump.at()))
    });
    let borders: Vec<(usize, f64, f64)> = across.chain(down).collect();
    if borders.len() < FEWEST {
        return None;
    }
    let half = gradients.half(region);
    let agreement = |dc: i32, dr: i32| -> f64 {
        let at = |&(axis, col, row): &(usize, f64, f64)| {
            let edge = gradients.at(axis, col + f64::from(dc), row + f64::from(dr));
            edge / (edge + half[axis])
        };
        borders.iter().map(at).sum::<f64>() / borders.len() as f64
    };
    let shifts = (-reach..=reach).flat_map(|dr| (-reach..=reach).map(move |dc| [dc, dr]));
    let scores: Vec<([i32; 2], f64)> = shifts.map(|shift| (shift, agreement(shift[0], shift[1]))).collect();
    let count = scores.len() as f64;
    let mean = scores.iter().map(|s| s.1).sum::<f64>() / count;
    let deviation = (scores.iter().map(|s| (s.1 - mean).powi(2)).sum::<f64>() / count).sqrt();
    let none = scores.iter().find(|s| s.0 == [0, 0])?.1;
    let &(shift, best) = scores.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    (deviation > 0.0).then_some(EdgeShift {
        shift,
        gain: best / none.max(1e-9),
        distinct: (best - mean) / deviation,
    })
}

/// The region around a box inside the image.
fn grown(b: &BoundingBox, whole: &BoundingBox) -> BoundingBox {
    let margin = |from: u32, to: u32| (AROUND * f64::from(to - from)) as u32 + 20;
    let (across, down) = (margin(b.col_min, b.col_max), margin(b.row_min, b.row_max));
    BoundingBox {
        col_min: b.col_min.saturating_sub(across),
        row_min: b.row_min.saturating_sub(down),
        col_max: (b.col_max + across).min(whole.col_max),
        row_max: (b.row_max + down).min(whole.row_max),
    }
}

/// Differences between neighbours of the smoothed colour image, along rows and along columns.
struct Gradients {
    gray: GrayImage,
}

impl Gradients {
    fn of(frame: &RgbdFrame) -> Self {
        Self { gray: image::imageops::fast_blur(&image::imageops::grayscale(&frame.rgb), 0.8) }
    }

    /// Across a border along `axis` at a position between two pixels of it.
    fn at(&self, axis: usize, col: f64, row: f64) -> f64 {
        let [c, r] = if axis == 0 {
            [(col - 0.5, row), (col + 0.5, row)]
        } else {
            [(col, row - 0.5), (col, row + 0.5)]
        };
        match (self.value(c), self.value(r)) {
            (Some(a), Some(b)) => (a - b).abs(),
            _ => 0.0,
        }
    }

    fn value(&self, (col, row): (f64, f64)) -> Option<f64> {
        if col < 0.0 || row < 0.0 {
            return None;
        }
        self.gray.get_pixel_checked(col.round() as u32, row.round() as u32).map(|p| f64::from(p.0[0]))
    }

    /// The edge of either axis that counts half: without a bound, a strong print would hide all borders.
    fn half(&self, region: &BoundingBox) -> [f64; 2] {
        [0, 1].map(|axis| {
            let (mut squares, mut count) = (0.0, 0usize);
            for row in region.row_min..region.row_max {
                for col in region.col_min..region.col_max {
                    let beside = |i: usize| if i == axis { 0.5 } else { 0.0 };
                    squares += self.at(axis, f64::from(col) + beside(0), f64::from(row) + beside(1)).powi(2);
                    count += 1;
                }
            }
            (HALF * (squares / count.max(1) as f64).sqrt()).max(1.0)
        })
    }
}

/// Are colour and depth registered?
pub(crate) fn alignment_finding(frame: &RgbdFrame, lines: &Lines, mask: Option<&Mask>) -> Finding {
    let Some(found) = edge_shift(frame, lines, mask) else {
        let text = "too few borders in the depth image to compare it with the colour image";
        return Finding::new(Check::Alignment, Level::Ok, text);
    };
    let [across, down] = found.shift;
    let pixels = f64::from(across).hypot(down.into());
    let evidence = (found.gain - 1.0) * (found.distinct - ALWAYS);
    let clear = evidence >= CLEAR;
    let scale = f64::from(frame.width()) / 640.0;
    let level = match Level::of(pixels / scale.clamp(0.4, 1.0), SHIFT) {
        _ if !clear => Level::Ok,
        Level::Wrong if evidence < 2.0 * CLEAR => Level::Look,
        level => level,
    };
    let text = match clear {
        true => format!("colour edges lie ({across}, {down}) pixels from those of depth (right, down)"),
        false => "no shift between the edges of colour and depth stands out".into(),
    };
    let shift = if clear { [f64::from(across), f64::from(down)] } else { [0.0; 2] };
    Finding::new(Check::Alignment, level, text)
        .with_values([("right_px", shift[0]), ("down_px", shift[1]), ("evidence", evidence)])
        .advise("register the depth image to the colour image (align to color), with both taken at the same moment")
}
