//! A mask from a click or a box: the proposal that it points at.

use super::{Proposal, SegmentError, assignment::box_iou};
use crate::frame::BoundingBox;

/// Boxes that overlap the best proposal's less than this point at nothing.
const MIN_BOX_OVERLAP: f64 = 0.3;

/// What the user points at, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prompt {
    /// Column and row.
    Point(u32, u32),
    Box(BoundingBox),
}

/// The proposal that a prompt means: the best one under the click, or the one whose box is most like the given one.
pub fn prompted(
    proposals: &[Proposal],
    prompt: Prompt,
    width: u32,
    height: u32,
) -> Result<&Proposal, SegmentError> {
    let size = format!("inside the image of {width} x {height} pixels");
    match prompt {
        Prompt::Point(col, row) => {
            let value = format!("{col},{row}");
            if col >= width || row >= height {
                return Err(SegmentError::Prompt { what: "point", value, expected: size });
            }
            let here = proposals.iter().filter(|p| p.mask.get(col, row));
            here.max_by(|a, b| a.score.total_cmp(&b.score)).ok_or_else(|| {
                let expected = format!("on an object: none of {} proposals covers it", proposals.len());
                SegmentError::Prompt { what: "point", value, expected }
            })
        }
        Prompt::Box(bounds) => {
            let BoundingBox { col_min, row_min, col_max, row_max } = bounds;
            let value = format!(
                "{col_min},{row_min},{},{}",
                col_max.saturating_sub(col_min),
                row_max.saturating_sub(row_min)
            );
            if col_max > width || row_max > height || col_max <= col_min || row_max <= row_min {
                return Err(SegmentError::Prompt { what: "box", value, expected: size });
            }
            let overlap = |p: &&Proposal| box_iou(&p.bounds, &bounds);
            let best = proposals.iter().max_by(|a, b| overlap(a).total_cmp(&overlap(b)));
            best.filter(|p| overlap(p) >= MIN_BOX_OVERLAP).ok_or_else(|| {
                let best = best.map_or(0.0, |p| overlap(&p));
                let expected = format!("a box around an object: the best proposal overlaps it by {best:.2}");
                SegmentError::Prompt { what: "box", value, expected }
            })
        }
    }
}
