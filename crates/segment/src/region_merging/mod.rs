//! Proposals from depth and colour, without weights.
//!
//! The longer side of the image is reduced to at most 320 cells. Support and background planes are removed. Cells without
//! depth follow the measured cells that colour connects them to, so that masks reach over holes. Patches of another colour
//! on a plane are candidates of their own: they may be flat objects. What is left is over-segmented by depth steps, concave
//! creases and colour, and once more with little weight on colour. Merge trees with different priorities join the regions
//! again; every node of every tree is a candidate. The constants were chosen on synthetic scenes.

mod adjacency;
mod flood;
mod grid;
mod hierarchy;
mod patches;
mod planes;
mod ranking;
mod regions;

use super::{ImageKey, MAX_PROPOSALS, Proposal, ProposalGenerator, SegmentError, assignment::box_iou};
use grid::Grid;
use hierarchy::Strategy;
use unopose_core::frame::{Mask, RgbdFrame};

/// Cells along the longer side of the image.
const SIDE: u32 = 320;
/// Weights of colour in the over-segmentation: where objects differ in colour, and where prints divide them and only their
/// shape holds them together.
const COLOR_WEIGHTS: [f32; 2] = [1.0, 0.3];
/// Masks whose boxes overlap less are different ones.
const SAME_BOX: f64 = 0.75;
/// What a patch that lies flat on a plane is worth beside a solid object.
const FLAT: f32 = 0.5;

/// Proposals from depth and colour, without weights.
#[derive(Clone, Copy, Debug, Default)]
pub struct RegionProposals;

impl ProposalGenerator for RegionProposals {
    fn name(&self) -> String {
        "embedded".into()
    }

    /// The number counts the versions of what is proposed.
    fn fingerprint(&self) -> String {
        "embedded 2".into()
    }

    fn proposals(&self, frame: &RgbdFrame, _: Option<ImageKey>) -> Result<Vec<Proposal>, SegmentError> {
        Ok(propose(frame))
    }
}

pub(crate) fn propose(frame: &RgbdFrame) -> Vec<Proposal> {
    distinct(all_candidates(frame))
}

/// The best nodes of every partition's merge trees, some of them nearly equal.
pub(crate) fn all_candidates(frame: &RgbdFrame) -> Vec<Proposal> {
    let mut grid = Grid::new(frame, SIDE);
    let background = fill_and_background(&mut grid);
    let solid: Vec<bool> = background.iter().map(|behind| !behind).collect();
    let flat = patches::flat_patches(&grid, &background);
    let mut proposals = Vec::new();
    for color in COLOR_WEIGHTS {
        proposals.extend(candidates(&grid, &solid, color, &hierarchy::STRATEGIES, 1.0));
    }
    proposals.extend(candidates(&grid, &flat, COLOR_WEIGHTS[0], &[hierarchy::COLOR_FIRST], FLAT));
    proposals
}

/// Where an image may show objects.
pub(super) struct ObjectCells {
    grid: Grid,
    cells: Vec<bool>,
}

impl ObjectCells {
    /// Everything but the background planes, and what lies on these in another colour; `None` without any measured depth.
    pub fn new(frame: &RgbdFrame) -> Option<Self> {
        let mut grid = Grid::new(frame, SIDE);
        if !(0..grid.len()).any(|cell| grid.measured(cell)) {
            return None;
        }
        let background = fill_and_background(&mut grid);
        let flat = patches::flat_patches(&grid, &background);
        let cells = background.iter().zip(flat).map(|(&behind, flat)| !behind || flat).collect();
        Some(Self { grid, cells })
    }

    /// Whether a pixel may belong to an object.
    pub fn contains(&self, col: u32, row: u32) -> bool {
        self.cells[self.grid.cell_of(col, row)]
    }
}

/// Best first, without those that a better one nearly equals.
pub(crate) fn distinct(mut proposals: Vec<Proposal>) -> Vec<Proposal> {
    proposals.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<Proposal> = Vec::new();
    for proposal in proposals {
        let same = |other: &Proposal| {
            box_iou(&other.bounds, &proposal.bounds) > SAME_BOX
                && other.mask.iou(&proposal.mask) > f64::from(ranking::SAME)
        };
        if kept.len() < MAX_PROPOSALS && !kept.iter().any(same) {
            kept.push(proposal);
        }
    }
    kept
}

/// Masks from the merge trees over some cells, whose regions see colour with the weight `color`; scores times `weight`.
fn candidates(
    grid: &Grid,
    cells: &[bool],
    color: f32,
    strategies: &[Strategy],
    weight: f32,
) -> Vec<Proposal> {
    let (labels, count) = regions::regions(grid, cells, color);
    if count == 0 {
        return Vec::new();
    }
    let (regions, boundaries) = adjacency::partition(grid, &labels, count);
    let tree = |strategy| hierarchy::merge_tree(&regions, &boundaries, strategy);
    let trees = strategies.iter().map(tree).collect();
    ranking::ranked(grid, &labels, &regions, trees, MAX_PROPOSALS)
        .into_iter()
        .filter_map(|candidate| {
            let mask = full_mask(grid, &labels, |region| candidate.node.members.contains(region));
            Proposal::new(mask, weight * candidate.score)
        })
        .collect()
}

/// Everything on a background plane; nothing in an image without depth. Cells without a measurement get that of the cell
/// that they follow.
fn fill_and_background(grid: &mut Grid) -> Vec<bool> {
    let (_, on_plane) = planes::background_planes(grid);
    match flood::sources(grid) {
        Some(sources) => {
            grid.follow(&sources);
            sources.iter().map(|&source| on_plane[source as usize]).collect()
        }
        None => vec![false; grid.len()],
    }
}

/// Pixels whose cell is in a chosen region.
fn full_mask(grid: &Grid, labels: &[u32], chosen: impl Fn(usize) -> bool) -> Mask {
    let inside: Vec<bool> = labels.iter().map(|&label| label != u32::MAX && chosen(label as usize)).collect();
    let (width, height) = grid.source;
    let columns: Vec<usize> = (0..width).map(|col| grid.cell_of(col, 0)).collect();
    let mut data = Vec::with_capacity(width as usize * height as usize);
    for row in 0..height {
        let first = grid.cell_of(0, row);
        let line = &inside[first..first + grid.width];
        data.extend(columns.iter().map(|&col| line[col]));
    }
    Mask { width, height, data }
}

#[cfg(test)]
mod tests {
    use unopose_core::{frame::DepthMap, geometry::Intrinsics};

    use super::*;

    /// Two fronts of the same colour at different distances, with nothing measured along their common edge.
    #[test]
    fn depth_steps_separate_across_unmeasured_bands() {
        let (width, height) = (320, 240);
        let mut rgb = image::RgbImage::from_pixel(width, height, image::Rgb([120; 3]));
        let mut depth = DepthMap::zeros(width, height);
        let mut masks = [Mask::empty(width, height), Mask::empty(width, height)];
        for (pixel, z) in depth.data.iter_mut().enumerate() {
            let (col, row) = (pixel as u32 % width, pixel as u32 / width);
            let front = (80..160).contains(&row) && (80..220).contains(&col);
            *z = if !front {
                1.0
            } else if col < 140 {
                0.8
            } else {
                0.7
            };
            if front {
                rgb.put_pixel(col, row, image::Rgb([200, 60, 60]));
                masks[usize::from(col >= 140)].data[pixel] = true;
                if (136..144).contains(&col) {
                    *z = 0.0;
                }
            }
        }
        let intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx: 159.5, cy: 119.5 };
        let proposals = propose(&RgbdFrame { rgb, depth, intrinsics });
        for mask in masks {
            let best = proposals.iter().map(|p| p.mask.iou(&mask)).fold(0.0, f64::max);
            assert!(best > 0.9, "{best}");
        }
    }
}
