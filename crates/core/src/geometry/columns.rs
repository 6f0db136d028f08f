//! A cloud as padded coordinate columns, the layout in which distance loops vectorise.

use crate::simd::vectorised;

/// Points per vector step.
pub(super) const LANES: usize = 16;

/// Coordinates by axis, in runs of [`LANES`] points. Padding lies at infinity, so that it is farther than every point.
pub(super) struct Columns {
    x: Vec<[f32; LANES]>,
    y: Vec<[f32; LANES]>,
    z: Vec<[f32; LANES]>,
}

impl Columns {
    pub fn new(points: &[[f32; 3]]) -> Self {
        let axis = |axis: usize| {
            let run = |points: &[[f32; 3]]| {
                let mut run = [f32::INFINITY; LANES];
                run.iter_mut().zip(points).for_each(|(x, p)| *x = p[axis]);
                run
            };
            points.chunks(LANES).map(run).collect()
        };
        Self { x: axis(0), y: axis(1), z: axis(2) }
    }

    pub fn runs(&self) -> usize {
        self.x.len()
    }

    /// Squared distances of `p` to the points of a run, in index order.
    #[inline(always)]
    pub fn squared_distances(&self, p: [f32; 3], run: usize) -> [f32; LANES] {
        let (x, y, z) = (&self.x[run], &self.y[run], &self.z[run]);
        let mut squared = [0.0; LANES];
        for l in 0..LANES {
            let (dx, dy, dz) = (x[l] - p[0], y[l] - p[1], z[l] - p[2]);
            squared[l] = dx * dx + dy * dy + dz * dz;
        }
        squared
    }

    /// Squared distance to the nearest point; infinite for an empty cloud.
    #[inline]
    pub fn nearest_squared(&self, p: [f32; 3]) -> f32 {
        let best = vectorised!({
            let mut best = [f32::INFINITY; LANES];
            for run in 0..self.runs() {
                let distances = self.squared_distances(p, run);
                for l in 0..LANES {
                    best[l] = if distances[l] < best[l] { distances[l] } else { best[l] };
                }
            }
            best
        });
        best.into_iter().fold(f32::INFINITY, f32::min)
    }
}
