//! What cells without a measurement belong to: the measured cell that is nearest along a path over few colour edges.

use std::{cmp::Reverse, collections::BinaryHeap};

use super::grid::{Grid, minus, norm};

/// Price of a step, in units of colour difference.
const STEP: f32 = 2.0;

/// For every cell the measured cell that it follows (itself when it is measured); `None` when nothing is measured.
pub fn sources(grid: &Grid) -> Option<Vec<u32>> {
    let mut source = vec![u32::MAX; grid.len()];
    let mut price = vec![u32::MAX; grid.len()];
    let mut open: BinaryHeap<Reverse<(u32, u32)>> = BinaryHeap::new();
    for cell in (0..grid.len()).filter(|&c| grid.measured(c)) {
        source[cell] = cell as u32;
        price[cell] = 0;
        if grid.side_neighbors(cell).any(|n| !grid.measured(n)) {
            open.push(Reverse((0, cell as u32)));
        }
    }
    if open.is_empty() && source.first().is_none_or(|&s| s == u32::MAX) {
        return None;
    }
    while let Some(Reverse((spent, cell))) = open.pop() {
        let cell = cell as usize;
        if spent > price[cell] {
            continue;
        }
        for next in grid.side_neighbors(cell) {
            let edge = STEP + norm(minus(grid.lab[cell], grid.lab[next]));
            // Whole sixteenths keep the order exact.
            let total = spent.saturating_add((edge * 16.0) as u32);
            if total < price[next] {
                (price[next], source[next]) = (total, source[cell]);
                open.push(Reverse((total, next as u32)));
            }
        }
    }
    Some(source)
}
