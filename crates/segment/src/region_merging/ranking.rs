//! Candidates of all trees without repetitions, best first.

use super::{adjacency::Region, grid::Grid, hierarchy::Node};

/// Candidates with a larger intersection over union count as the same one.
pub const SAME: f32 = 0.88;
/// Least share of the image.
const MIN_SHARE: f32 = 6e-4;
/// Largest share of the image.
const MAX_SHARE: f32 = 0.5;
/// What several trees agree on is worth this much more for each.
const AGREEMENT: f32 = 0.15;

/// A candidate and its rank.
pub struct Candidate {
    pub node: Node,
    /// In [0, 1].
    pub score: f32,
}

/// The best `count` candidates.
pub fn ranked(
    grid: &Grid,
    labels: &[u32],
    regions: &[Region],
    trees: Vec<Vec<Node>>,
    count: usize,
) -> Vec<Candidate> {
    let borders = cells_where(labels, regions.len(), |cell| {
        let (col, row) = (cell % grid.width, cell / grid.width);
        col == 0 || row == 0 || col + 1 == grid.width || row + 1 == grid.height
    });
    let cells = grid.len() as f32;
    let mut candidates: Vec<Candidate> = trees
        .into_iter()
        .flatten()
        .filter(|node| node.cells >= MIN_SHARE * cells && node.cells <= MAX_SHARE * cells)
        .map(|node| {
            let score = score(&node, &borders, cells);
            Candidate { node, score }
        })
        .collect();
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in candidates {
        let same = kept.iter_mut().find(|other| iou(&other.node, &candidate.node, regions) > SAME);
        match same {
            Some(other) => other.score += AGREEMENT * (1.0 - other.score) * candidate.score,
            None => kept.push(candidate),
        }
    }
    kept.sort_by(|a, b| b.score.total_cmp(&a.score));
    kept.truncate(count);
    kept
}

/// How long the node lasts while the cost grows, less for what the image cuts and for specks.
fn score(node: &Node, borders: &[f32], cells: f32) -> f32 {
    let contrast = ((node.death - node.birth) / (node.death + 0.3)).clamp(0.0, 1.0);
    let sum = |counts: &[f32]| -> f32 {
        counts.iter().enumerate().filter(|(i, _)| node.members.contains(*i)).map(|(_, n)| n).sum()
    };
    let cut = (sum(borders) / node.cells.sqrt()).min(2.0);
    let speck = (node.cells / (0.004 * cells)).min(1.0).sqrt();
    contrast * (1.0 - 0.35 * cut) * (0.4 + 0.6 * speck)
}

/// Cells with a property by region.
fn cells_where(labels: &[u32], count: usize, holds: impl Fn(usize) -> bool) -> Vec<f32> {
    let mut counts = vec![0.0f32; count];
    for (cell, &label) in labels.iter().enumerate() {
        if let Some(count) = counts.get_mut(label as usize).filter(|_| holds(cell)) {
            *count += 1.0;
        }
    }
    counts
}

fn iou(a: &Node, b: &Node, regions: &[Region]) -> f32 {
    let larger = a.cells.max(b.cells).max(1.0);
    if a.cells.min(b.cells) / larger <= SAME {
        return 0.0;
    }
    let shared = a.members.shared(&b.members, regions);
    shared / (a.cells + b.cells - shared).max(1.0)
}
