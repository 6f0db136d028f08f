//! Instances from what the proposal network says of an image (`docs/network.md`, section 13).
//!
//! Each foreground cell votes for the centre of its instance. The votes are clustered by mean shift at several bandwidths: large
//! objects scatter their votes more widely than small ones do. Cells of one cluster that hang together without the boundary
//! cells are an instance, which takes the boundary cells of its cluster beside it.

use std::collections::VecDeque;

use unopose_core::geometry::mean_shift;

use super::SceneInput;

/// Bandwidths of the clustering, metres.
const BANDWIDTHS: [f32; 3] = [0.02, 0.04, 0.07];
/// Fewest votes within a bandwidth that are a cluster, and fewest cells of an instance.
const LEAST_CELLS: usize = 15;
/// Probability from which on a cell is foreground.
const FOREGROUND: f32 = 0.5;
/// Probability from which on a cell is on a boundary.
const BOUNDARY: f32 = 0.5;
/// Overlap (intersection over union) from which on two instances are one.
const SAME: f64 = 0.9;
/// No instance.
const NONE: u32 = u32::MAX;

/// What the network says, per cell of a [`SceneInput`].
#[derive(Clone, Debug)]
pub struct ProposalMaps {
    /// Probability of foreground.
    pub foreground: Vec<f32>,
    /// From the cell's point to the centre of its instance, metres.
    pub votes: Vec<[f32; 3]>,
    /// Probability of being on the boundary of an instance.
    pub boundary: Vec<f32>,
}

/// A candidate on the grid.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneInstance {
    /// Cells in ascending order, at least one.
    pub cells: Vec<u32>,
    /// How sure the network is, in [0, 1]: mean probability of foreground times the agreement of the votes.
    pub score: f32,
}

/// The instances at all bandwidths, best first, each once.
pub fn scene_instances(input: &SceneInput, maps: &ProposalMaps) -> Vec<SceneInstance> {
    let foreground: Vec<usize> = input.cells().filter(|&cell| maps.foreground[cell] >= FOREGROUND).collect();
    let centers: Vec<[f32; 3]> = foreground
        .iter()
        .map(|&cell| std::array::from_fn(|i| input.points[cell][i] + maps.votes[cell][i]))
        .collect();
    let mut found = Vec::new();
    for bandwidth in BANDWIDTHS {
        let clusters = mean_shift(&centers, bandwidth, LEAST_CELLS);
        let mut labels = vec![NONE; input.len()];
        for (&cell, &mode) in foreground.iter().zip(&clusters.assignment) {
            labels[cell] = mode;
        }
        let parts = connected(input, &labels, &maps.boundary);
        let mut members: Vec<Vec<u32>> = Vec::new();
        for cell in input.cells().filter(|&cell| parts[cell] != NONE) {
            let part = parts[cell] as usize;
            if members.len() <= part {
                members.resize(part + 1, Vec::new());
            }
            members[part].push(cell as u32);
        }
        for cells in members.into_iter().filter(|cells| cells.len() >= LEAST_CELLS) {
            let mode = clusters.modes[labels[cells[0] as usize] as usize];
            found.push(SceneInstance { score: score(input, maps, &cells, mode), cells });
        }
    }
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<SceneInstance> = Vec::new();
    for instance in found {
        if kept.iter().all(|other| cell_iou(&other.cells, &instance.cells) < SAME) {
            kept.push(instance);
        }
    }
    kept
}

/// Numbers of the parts: cells of one label that hang together without boundary cells, then the boundary cells of that label
/// beside them. A label that has boundary cells only is a part for itself.
fn connected(input: &SceneInput, labels: &[u32], boundary: &[f32]) -> Vec<u32> {
    let mut parts = vec![NONE; labels.len()];
    let mut count = 0;
    let inner = |cell: usize| labels[cell] != NONE && boundary[cell] < BOUNDARY;
    let mut grown: VecDeque<usize> = VecDeque::new();
    for inside in [true, false] {
        for start in input.cells() {
            if parts[start] != NONE || labels[start] == NONE || inside != inner(start) {
                continue;
            }
            parts[start] = count;
            let mut queue = VecDeque::from([start]);
            while let Some(cell) = queue.pop_front() {
                grown.push_back(cell);
                for other in input.neighbors(cell) {
                    if parts[other] == NONE && labels[other] == labels[start] && inside == inner(other) {
                        parts[other] = count;
                        queue.push_back(other);
                    }
                }
            }
            count += 1;
        }
        while let Some(cell) = grown.pop_front() {
            for other in input.neighbors(cell) {
                if parts[other] == NONE && labels[other] == labels[cell] {
                    parts[other] = parts[cell];
                    grown.push_back(other);
                }
            }
        }
    }
    parts
}

/// Mean probability of foreground times `exp(-d / 5 cm)`, `d` the mean distance of the votes from their cluster's mode.
fn score(input: &SceneInput, maps: &ProposalMaps, cells: &[u32], mode: [f32; 3]) -> f32 {
    let (mut sure, mut spread) = (0.0, 0.0);
    for &cell in cells {
        let cell = cell as usize;
        sure += maps.foreground[cell];
        let error = |i: usize| (input.points[cell][i] + maps.votes[cell][i] - mode[i]).powi(2);
        spread += (0..3).map(error).sum::<f32>().sqrt();
    }
    let count = cells.len().max(1) as f32;
    (sure / count * (-spread / count / 0.05).exp()).clamp(0.0, 1.0)
}

/// Intersection over union of ascending lists.
fn cell_iou(a: &[u32], b: &[u32]) -> f64 {
    let (mut i, mut j, mut common) = (0, 0, 0usize);
    while let (Some(x), Some(y)) = (a.get(i), b.get(j)) {
        common += usize::from(x == y);
        i += usize::from(x <= y);
        j += usize::from(y <= x);
    }
    let union = a.len() + b.len() - common;
    if union == 0 { 0.0 } else { common as f64 / union as f64 }
}

#[cfg(test)]
mod tests {
    use unopose_core::{
        frame::{DepthMap, RgbdFrame},
        geometry::Intrinsics,
    };

    use super::*;

    /// A front 1 m away, a cell every centimetre.
    fn front() -> SceneInput {
        let mut depth = DepthMap::zeros(48, 32);
        depth.data.fill(1.0);
        let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 24.0, cy: 16.0 };
        let frame = RgbdFrame { rgb: image::RgbImage::new(48, 32), depth, intrinsics };
        SceneInput::new(&frame, 48, 32).unwrap()
    }

    /// Foreground whose cells vote exactly for the mean of the box that they are in.
    fn votes(input: &SceneInput, boxes: &[[usize; 4]]) -> (ProposalMaps, Vec<Vec<u32>>) {
        let area = input.len();
        let mut maps = ProposalMaps {
            foreground: vec![0.0; area],
            votes: vec![[0.0; 3]; area],
            boundary: vec![0.0; area],
        };
        let mut all = Vec::new();
        for &[left, top, right, bottom] in boxes {
            let columns = move |row: usize| (left..right).map(move |col| row * 48 + col);
            let cells: Vec<usize> = (top..bottom).flat_map(columns).collect();
            let count = cells.len() as f32;
            let mean: [f32; 3] =
                std::array::from_fn(|i| cells.iter().map(|&c| input.points[c][i]).sum::<f32>() / count);
            for &cell in &cells {
                maps.foreground[cell] = 1.0;
                maps.votes[cell] = std::array::from_fn(|i| mean[i] - input.points[cell][i]);
            }
            all.push(cells.into_iter().map(|cell| cell as u32).collect());
        }
        (maps, all)
    }

    #[test]
    fn touching_boxes_with_exact_votes_are_exactly_found() {
        let input = front();
        let (maps, expected) = votes(&input, &[[4, 4, 14, 14], [14, 4, 24, 14], [4, 14, 24, 24]]);
        let mut found: Vec<Vec<u32>> =
            scene_instances(&input, &maps).into_iter().filter(|i| i.score > 0.99).map(|i| i.cells).collect();
        found.sort();
        let mut wanted = expected;
        wanted.sort();
        assert_eq!(found, wanted);
    }

    #[test]
    fn a_boundary_splits_what_votes_for_one_centre() {
        let input = front();
        let (mut maps, all) = votes(&input, &[[4, 4, 24, 14]]);
        // Two columns of boundary; each half takes the column beside it.
        for row in 4..14 {
            maps.boundary[row * 48 + 13] = 1.0;
            maps.boundary[row * 48 + 14] = 1.0;
        }
        let found = scene_instances(&input, &maps);
        let halves: [Vec<u32>; 2] =
            [true, false].map(|left| all[0].iter().copied().filter(|c| (c % 48 < 14) == left).collect());
        assert_eq!(found.len(), 2);
        assert!(halves.iter().all(|half| found.iter().any(|instance| instance.cells == *half)));
    }

    #[test]
    fn nothing_in_front_gives_nothing() {
        let input = front();
        let (maps, _) = votes(&input, &[]);
        assert!(scene_instances(&input, &maps).is_empty());
        assert_eq!(cell_iou(&[1, 2, 3, 9], &[2, 3, 4]), 2.0 / 5.0);
    }
}
