//! Proposals from depth and colour, without weights.
//!
//! At a working resolution of 320 cells: support and background planes are removed; cells without depth follow the
//! measured ones that colour connects them to, so masks reach over holes; what is left is over-segmented by depth steps,
//! concave creases and colour; merge trees with different priorities join the regions again, and every node of every
//! tree is a candidate. The constants were chosen on synthetic scenes.

mod adjacency;
mod flood;
mod grid;
mod hierarchy;
mod planes;
mod ranking;
mod regions;

pub use grid::lab;

use super::{ImageKey, MAX_PROPOSALS, Proposal, ProposalGenerator, SegmentError};
use crate::frame::{Mask, RgbdFrame};
use grid::Grid;

/// Cells along the longer side of the image.
const SIDE: u32 = 320;

/// The generator without weights.
#[derive(Clone, Copy, Debug, Default)]
pub struct EmbeddedProposals;

impl ProposalGenerator for EmbeddedProposals {
    fn name(&self) -> String {
        "embedded".into()
    }

    fn proposals(&self, frame: &RgbdFrame, _: Option<ImageKey>) -> Result<Vec<Proposal>, SegmentError> {
        Ok(propose(frame))
    }
}

fn propose(frame: &RgbdFrame) -> Vec<Proposal> {
    let grid = Grid::new(frame, SIDE);
    let foreground = foreground(&grid);
    let (labels, count) = regions::regions(&grid, &foreground);
    if count == 0 {
        return Vec::new();
    }
    let (regions, boundaries) = adjacency::partition(&grid, &labels, count);
    let trees = hierarchy::STRATEGIES
        .iter()
        .map(|strategy| hierarchy::merge_tree(&regions, &boundaries, strategy))
        .collect();
    ranking::ranked(&grid, &labels, &regions, trees, MAX_PROPOSALS)
        .into_iter()
        .filter_map(|candidate| {
            let mask = full_mask(&grid, &labels, |region| candidate.node.members.contains(region));
            Proposal::new(mask, candidate.score)
        })
        .collect()
}

/// Everything that is not on a background plane; all cells of an image without depth.
fn foreground(grid: &Grid) -> Vec<bool> {
    let (_, on_plane) = planes::background_planes(grid);
    match flood::sources(grid) {
        Some(sources) => sources.iter().map(|&source| !on_plane[source as usize]).collect(),
        None => vec![true; grid.len()],
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
