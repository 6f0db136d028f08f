//! Regions and what separates neighbouring ones.

use std::collections::BTreeMap;

use super::{grid::Grid, regions::Contrast};

/// Sums over the cells of a region.
#[derive(Clone, Debug, Default)]
pub struct Region {
    pub cells: f32,
    pub lab: [f32; 3],
}

/// Sums over the pairs of cells along a boundary.
#[derive(Clone, Copy, Debug, Default)]
pub struct Boundary {
    pairs: f32,
    measured: f32,
    step: f32,
    crease: f32,
    ridge: f32,
    color: f32,
}

/// Neighbouring regions, `(smaller index, larger index)`.
pub type Boundaries = BTreeMap<(u32, u32), Boundary>;

impl Region {
    pub fn add(&mut self, other: &Self) {
        self.cells += other.cells;
        (0..3).for_each(|i| self.lab[i] += other.lab[i]);
    }

    /// Mean colour, CIE L*a*b*.
    pub fn mean_lab(&self) -> [f32; 3] {
        self.lab.map(|sum| sum / self.cells.max(1.0))
    }
}

impl Boundary {
    pub fn add(&mut self, other: &Self) {
        self.pairs += other.pairs;
        self.measured += other.measured;
        self.step += other.step;
        self.crease += other.crease;
        self.ridge += other.ridge;
        self.color += other.color;
    }

    /// Mean contrast along the boundary.
    pub fn mean(&self) -> Contrast {
        let measured = self.measured.max(1.0);
        Contrast {
            step: self.step / measured,
            crease: self.crease / measured,
            ridge: self.ridge / measured,
            color: self.color / self.pairs.max(1.0),
        }
    }

    /// Pairs of cells.
    pub fn length(&self) -> f32 {
        self.pairs
    }
}

/// Regions and boundaries of a partition.
pub fn partition(grid: &Grid, labels: &[u32], count: usize) -> (Vec<Region>, Boundaries) {
    let mut regions = vec![Region::default(); count];
    let mut boundaries = Boundaries::new();
    for cell in 0..grid.len() {
        let label = labels[cell];
        let Some(region) = regions.get_mut(label as usize) else { continue };
        region.add(&Region { cells: 1.0, lab: grid.lab[cell] });
        for next in grid.forward_neighbors(cell) {
            let other = labels[next];
            if other == label || other == u32::MAX {
                continue;
            }
            let contrast = Contrast::between(grid, cell, next);
            let measured = grid.measured(cell) && grid.measured(next);
            boundaries.entry((label.min(other), label.max(other))).or_default().add(&Boundary {
                pairs: 1.0,
                measured: f32::from(u8::from(measured)),
                step: contrast.step,
                crease: contrast.crease,
                ridge: contrast.ridge,
                color: contrast.color,
            });
        }
    }
    (regions, boundaries)
}
