//! A cloud as padded coordinate columns, the layout in which distance loops vectorise.

/// Points per vector step; the columns are padded to a multiple of it.
pub(super) const LANES: usize = 16;

/// Coordinates by axis. Padding lies at infinity, so that it is farther than every point.
pub(super) struct Columns {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
}

impl Columns {
    pub fn new(points: &[[f32; 3]]) -> Self {
        let padded = points.len().next_multiple_of(LANES);
        let axis = |i: usize| {
            let mut column: Vec<f32> = points.iter().map(|p| p[i]).collect();
            column.resize(padded, f32::INFINITY);
            column
        };
        Self { x: axis(0), y: axis(1), z: axis(2) }
    }

    /// Squared distances of `p` to consecutive runs of [`LANES`] points, in index order.
    #[inline(always)]
    pub fn squared_distances(&self, p: [f32; 3]) -> impl Iterator<Item = [f32; LANES]> + '_ {
        let runs = self.x.as_chunks::<LANES>().0.iter().zip(self.y.as_chunks::<LANES>().0);
        runs.zip(self.z.as_chunks::<LANES>().0).map(move |((x, y), z)| {
            std::array::from_fn(|l| {
                let (dx, dy, dz) = (x[l] - p[0], y[l] - p[1], z[l] - p[2]);
                dx * dx + dy * dy + dz * dz
            })
        })
    }

    /// Squared distance to the nearest point; infinite for an empty cloud.
    #[inline]
    pub fn nearest_squared(&self, p: [f32; 3]) -> f32 {
        let mut best = [f32::INFINITY; LANES];
        for distances in self.squared_distances(p) {
            for (b, d) in best.iter_mut().zip(distances) {
                *b = if d < *b { d } else { *b };
            }
        }
        best.into_iter().fold(f32::INFINITY, f32::min)
    }
}
