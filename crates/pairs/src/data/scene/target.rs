//! What the proposal network is to learn of an annotated image.

use unopose_core::frame::Mask;

use super::{SceneInput, support::SupportPlane};

/// Foreground (on an object), support (the plane that the objects stand on), background.
pub const CLASSES: usize = 3;

/// Fewest cells of an instance that is learned.
const LEAST_CELLS: usize = 10;
/// Cells of an instance that weigh 1 each; those of a smaller one weigh more, by the square root of the ratio.
const UNIT_CELLS: f32 = 400.0;
/// Least and largest weight of a foreground cell.
const WEIGHTS: [f32; 2] = [0.5, 4.0];
/// Weight of the boundary's cells, of other foreground cells and of all others in the loss of the boundary.
const BOUNDARY_WEIGHTS: [f32; 3] = [3.0, 1.0, 0.3];
/// Cells around the objects whose points tell the support.
const RING: usize = 12;

/// Per cell of a [`SceneInput`], row-major; all weights are 0 in the padding.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneTarget {
    /// Number of the instance, 0 for none.
    pub instances: Vec<u32>,
    /// 0 foreground, 1 support, 2 background.
    pub classes: Vec<u8>,
    /// Weight of a cell's class and, on an instance, of its vote.
    pub weights: Vec<f32>,
    /// From the cell's point to the median of the instance's measured points, metres; zeros where there is no instance.
    pub votes: Vec<[f32; 3]>,
    /// Whether the cell is on an instance and beside a cell that is not on the same one.
    pub boundary: Vec<bool>,
    /// Weight of a cell in the loss of the boundary.
    pub boundary_weights: Vec<f32>,
}

impl SceneTarget {
    /// `masks` are the visible parts of the image's instances, as large as the image. The support is the plane that most
    /// measured cells within 12 cells around the objects lie on (of the whole image where there is no object).
    pub fn new(input: &SceneInput, masks: &[&Mask]) -> Self {
        let instances = instance_cells(input, masks);
        let count = masks.len();
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); count];
        for cell in input.cells().filter(|&cell| instances[cell] > 0) {
            members[instances[cell] as usize - 1].push(cell);
        }
        let area = input.len();
        let mut target = Self {
            classes: vec![2; area],
            weights: vec![0.0; area],
            votes: vec![[0.0; 3]; area],
            boundary: vec![false; area],
            boundary_weights: vec![0.0; area],
            instances,
        };
        let support = SupportPlane::fit(&target.ring_points(input));
        for cell in input.cells() {
            target.weights[cell] = 1.0;
            target.boundary_weights[cell] = BOUNDARY_WEIGHTS[2];
            if support.is_some_and(|plane| input.measured[cell] && plane.contains(input.points[cell])) {
                target.classes[cell] = 1;
            }
        }
        for cells in &members {
            let Some(center) = center(input, cells) else { continue };
            let weight = (UNIT_CELLS / cells.len() as f32).sqrt().clamp(WEIGHTS[0], WEIGHTS[1]);
            for &cell in cells {
                target.classes[cell] = 0;
                target.weights[cell] = weight;
                target.votes[cell] = std::array::from_fn(|i| center[i] - input.points[cell][i]);
                let own = target.instances[cell];
                target.boundary[cell] = input.neighbors(cell).any(|other| target.instances[other] != own);
                target.boundary_weights[cell] = BOUNDARY_WEIGHTS[usize::from(!target.boundary[cell])];
            }
        }
        target
    }

    fn ring_points(&self, input: &SceneInput) -> Vec<[f32; 3]> {
        let mut reached: Vec<bool> = self.instances.iter().map(|&i| i > 0).collect();
        let mut front: Vec<usize> = input.cells().filter(|&cell| reached[cell]).collect();
        let mut ring = Vec::new();
        if front.is_empty() {
            ring = input.cells().collect();
        }
        for _ in 0..RING {
            let mut next = Vec::new();
            for &cell in &front {
                for other in input.neighbors(cell) {
                    if !std::mem::replace(&mut reached[other], true) {
                        next.push(other);
                    }
                }
            }
            ring.extend_from_slice(&next);
            front = next;
        }
        ring.into_iter().filter(|&cell| input.measured[cell]).map(|cell| input.points[cell]).collect()
    }
}

/// The instance whose mask has the pixel in the middle of each cell, counted from 1; smaller ones than can be learned are
/// none.
fn instance_cells(input: &SceneInput, masks: &[&Mask]) -> Vec<u32> {
    let mut instances = vec![0; input.len()];
    for (index, mask) in masks.iter().enumerate() {
        let inside = |&cell: &usize| {
            let [col, row] = input.pixel_of(cell).map(|v| v.round().max(0.0) as u32);
            mask.get(col.min(input.source.0 - 1), row.min(input.source.1 - 1))
        };
        let cells: Vec<usize> = input.cells().filter(inside).collect();
        if cells.len() >= LEAST_CELLS {
            cells.into_iter().for_each(|cell| instances[cell] = index as u32 + 1);
        }
    }
    instances
}

/// Median per axis of the measured points (of all where none is measured); `None` without a cell.
fn center(input: &SceneInput, cells: &[usize]) -> Option<[f32; 3]> {
    let measured: Vec<usize> = cells.iter().copied().filter(|&cell| input.measured[cell]).collect();
    let used = if measured.is_empty() { cells } else { &measured };
    if used.is_empty() {
        return None;
    }
    Some(std::array::from_fn(|axis| {
        let mut values: Vec<f32> = used.iter().map(|&cell| input.points[cell][axis]).collect();
        let middle = (values.len() - 1) / 2;
        *values.select_nth_unstable_by(middle, f32::total_cmp).1
    }))
}

#[cfg(test)]
mod tests {
    use unopose_core::{
        frame::{DepthMap, RgbdFrame},
        geometry::Intrinsics,
    };

    use super::*;

    #[test]
    fn votes_classes_and_boundaries_of_a_known_scene() {
        // A table 1 m away, a block of 5 x 5 cells 10 cm above it, a wall behind the last columns.
        let (width, height) = (32u32, 32u32);
        let block = |col: u32, row: u32| (10..15).contains(&col) && (8..13).contains(&row);
        let mut depth = DepthMap::zeros(width, height);
        let mut mask = Mask::empty(width, height);
        for i in 0..(width * height) {
            let (col, row) = (i % width, i / width);
            depth.data[i as usize] = if block(col, row) {
                0.9
            } else if col >= 28 {
                1.5
            } else {
                1.0
            };
            mask.data[i as usize] = block(col, row);
        }
        let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 16.0, cy: 16.0 };
        let frame = RgbdFrame { rgb: image::RgbImage::new(width, height), depth, intrinsics };
        let input = SceneInput::new(&frame, 32, 32).unwrap();
        let target = SceneTarget::new(&input, &[&mask]);
        let at = |col: usize, row: usize| row * 32 + col;
        // The block's centre is its middle cell: columns differ by 0.9 / 50 m.
        let vote = target.votes[at(10, 12)];
        let expected = [2.0 * 0.018, -2.0 * 0.018, 0.0];
        assert!((0..3).all(|i| (vote[i] - expected[i]).abs() < 1e-6), "{vote:?}");
        assert_eq!(target.votes[at(3, 3)], [0.0; 3]);
        assert_eq!([at(12, 10), at(5, 5), at(30, 5)].map(|cell| target.classes[cell]), [0, 1, 2]);
        assert_eq!(target.boundary.iter().filter(|b| **b).count(), 16);
        assert!(!target.boundary[at(12, 10)] && target.boundary[at(10, 8)]);
        // 25 cells: sqrt(400 / 25) = 4.
        assert_eq!((target.weights[at(12, 10)], target.weights[at(3, 3)]), (4.0, 1.0));
        assert_eq!(
            [at(10, 8), at(12, 10), at(3, 3)].map(|cell| target.boundary_weights[cell]),
            [3.0, 1.0, 0.3]
        );
        // Without objects the plane of the whole image is the support.
        let empty = SceneTarget::new(&input, &[]);
        assert!(empty.classes[at(5, 5)] == 1 && empty.classes.iter().all(|&class| class > 0));
    }
}
