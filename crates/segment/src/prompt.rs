//! A mask from a point or a box: the proposal that it selects.

use unopose_core::frame::{BoundingBox, Mask};

use super::{SegmentError, assignment::box_iou, proposal::Proposal};

/// A box around less than this of itself points at nothing.
const MIN_BOX_OVERLAP: f64 = 0.3;
/// Share of a proposal that must be inside a box.
const INSIDE: f64 = 0.9;

/// What the user points at, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prompt {
    /// Column and row of a pixel of the object.
    Point(u32, u32),
    /// A box around the object.
    Box(BoundingBox),
}

impl Prompt {
    /// Refuses a prompt that is not inside an image of this size, and an empty box.
    pub fn check(self, width: u32, height: u32) -> Result<(), SegmentError> {
        let inside = match self {
            Self::Point(col, row) => col < width && row < height,
            Self::Box(b) => {
                b.col_min < b.col_max && b.row_min < b.row_max && b.col_max <= width && b.row_max <= height
            }
        };
        let size = || format!("inside the image of {width} x {height} pixels");
        if inside { Ok(()) } else { Err(self.refused(size())) }
    }

    /// The error that names this prompt and what was expected instead.
    pub(super) fn refused(self, expected: String) -> SegmentError {
        let (what, value) = match self {
            Self::Point(col, row) => ("point", format!("{col},{row}")),
            Self::Box(BoundingBox { col_min, row_min, col_max, row_max }) => {
                let (w, h) = (col_max.saturating_sub(col_min), row_max.saturating_sub(row_min));
                ("box", format!("{col_min},{row_min},{w},{h}"))
            }
        };
        SegmentError::Prompt { what, value, expected }
    }
}

/// The mask that a prompt means: the best proposal at the point, or the union of what is inside the box.
pub fn select_by_prompt(
    proposals: &[Proposal],
    prompt: Prompt,
    width: u32,
    height: u32,
) -> Result<Proposal, SegmentError> {
    prompt.check(width, height)?;
    match prompt {
        Prompt::Point(col, row) => {
            let here = proposals.iter().filter(|p| p.mask.get(col, row));
            here.max_by(|a, b| a.score.total_cmp(&b.score)).cloned().ok_or_else(|| {
                prompt.refused(format!("on an object: none of {} proposals covers it", proposals.len()))
            })
        }
        Prompt::Box(bounds) => {
            let union = union_inside(proposals, &bounds, width, height);
            let overlap = union.as_ref().map_or(0.0, |p| box_iou(&p.bounds, &bounds));
            union.filter(|_| overlap >= MIN_BOX_OVERLAP).ok_or_else(|| {
                prompt.refused(format!("a box around an object: what is inside overlaps it by {overlap:.2}"))
            })
        }
    }
}

/// Everything that proposals inside the box cover, with the score of the best of them.
fn union_inside(proposals: &[Proposal], bounds: &BoundingBox, width: u32, height: u32) -> Option<Proposal> {
    let in_box = |col: u32, row: u32| {
        (bounds.col_min..bounds.col_max).contains(&col) && (bounds.row_min..bounds.row_max).contains(&row)
    };
    let (mut union, mut score) = (Mask::empty(width, height), 0.0f32);
    for proposal in proposals {
        let inside = proposal.mask.pixels().filter(|&(col, row)| in_box(col, row)).count();
        if inside as f64 >= INSIDE * proposal.mask.count() as f64 {
            union.data.iter_mut().zip(&proposal.mask.data).for_each(|(all, &one)| *all |= one);
            score = score.max(proposal.score);
        }
    }
    Proposal::new(union, score)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bar(cols: std::ops::Range<u32>, score: f32) -> Proposal {
        let mut mask = Mask::empty(20, 10);
        for row in 2..8 {
            cols.clone().for_each(|col| mask.data[(row * 20 + col) as usize] = true);
        }
        Proposal::new(mask, score).unwrap()
    }

    #[test]
    fn points_take_the_best_and_boxes_take_all_inside() {
        let proposals = [bar(2..6, 0.4), bar(6..9, 0.3), bar(4..18, 0.9)];
        let at = |prompt| select_by_prompt(&proposals, prompt, 20, 10);
        assert_eq!(at(Prompt::Point(3, 3)).unwrap(), proposals[0]);
        assert_eq!(at(Prompt::Point(5, 3)).unwrap(), proposals[2]);
        let bounds = BoundingBox { col_min: 1, row_min: 1, col_max: 10, row_max: 9 };
        let found = at(Prompt::Box(bounds)).unwrap();
        assert_eq!((found.mask.count(), found.score), (7 * 6, 0.4));
        for (prompt, part) in [
            (Prompt::Point(0, 0), "none of 3 proposals"),
            (Prompt::Point(20, 0), "inside the image of 20 x 10"),
            (Prompt::Box(BoundingBox { col_max: 21, ..bounds }), "inside the image"),
            (Prompt::Box(BoundingBox { row_max: 3, ..bounds }), "overlaps it by 0.00"),
        ] {
            let message = at(prompt).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
