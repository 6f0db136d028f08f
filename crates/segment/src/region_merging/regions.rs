//! Over-segmentation of the foreground: graph-based merging of neighbouring cells (Felzenszwalb and Huttenlocher 2004)
//! over depth steps, concave creases and colour.

use super::grid::{Grid, dot, minus, norm, tolerance};

/// Scale of observation: larger values make larger regions.
const SCALE: f32 = 6.0;
/// Cells of the smallest region.
const MIN_CELLS: u32 = 24;

/// How different two neighbouring cells are, each part about 1 at a clear boundary.
#[derive(Clone, Copy, Debug, Default)]
pub struct Contrast {
    /// Distance of each from the other's tangent plane.
    pub step: f32,
    /// Angle of the normals where the surface is concave.
    pub crease: f32,
    /// Angle of the normals where it is convex.
    pub ridge: f32,
    pub color: f32,
}

impl Contrast {
    /// Between cells; cells without a measurement have colour alone.
    pub fn between(grid: &Grid, a: usize, b: usize) -> Self {
        let color = (norm(minus(grid.lab[a], grid.lab[b])) / 20.0).min(2.0);
        let (p, q, n, m) = (grid.points[a], grid.points[b], grid.normals[a], grid.normals[b]);
        if p[2] <= 0.0 || q[2] <= 0.0 {
            return Self { color, ..Self::default() };
        }
        let offset = minus(q, p);
        let depth = p[2].min(q[2]);
        let (known_n, known_m) = (n != [0.0; 3], m != [0.0; 3]);
        let off_plane = match (known_n, known_m) {
            (true, true) => 0.5 * (dot(n, offset).abs() + dot(m, offset).abs()),
            (true, false) => dot(n, offset).abs(),
            (false, true) => dot(m, offset).abs(),
            (false, false) => offset[2].abs(),
        };
        let step = (off_plane / (1.5 * tolerance(depth))).min(3.0);
        let (mut crease, mut ridge) = (0.0, 0.0);
        if known_n && known_m {
            let angle = dot(n, m).clamp(-1.0, 1.0).acos() / 0.5;
            if dot(minus(m, n), offset) < 0.0 { crease = angle } else { ridge = angle }
        }
        Self { step, crease: crease.min(2.0), ridge: ridge.min(2.0), color }
    }

    fn weight(&self, color: f32) -> f32 {
        self.step + self.crease + 0.3 * self.ridge + color * self.color
    }
}

/// Region of every cell, `u32::MAX` outside the foreground, and the number of regions; `color` is the weight of colour
/// beside geometry.
pub fn regions(grid: &Grid, foreground: &[bool], color: f32) -> (Vec<u32>, usize) {
    let mut edges: Vec<(f32, u32, u32)> = Vec::with_capacity(4 * grid.len());
    for cell in (0..grid.len()).filter(|&c| foreground[c]) {
        for next in grid.forward_neighbors(cell).filter(|&n| foreground[n]) {
            edges.push((Contrast::between(grid, cell, next).weight(color), cell as u32, next as u32));
        }
    }
    edges.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut sets = DisjointSets::new(grid.len());
    for &(weight, a, b) in &edges {
        let (a, b) = (sets.root(a), sets.root(b));
        if a != b && weight <= sets.limit(a).min(sets.limit(b)) {
            sets.join(a, b, weight);
        }
    }
    for &(weight, a, b) in &edges {
        let (a, b) = (sets.root(a), sets.root(b));
        if a != b && sets.size[a as usize].min(sets.size[b as usize]) < MIN_CELLS {
            sets.join(a, b, weight);
        }
    }
    let mut numbers = vec![u32::MAX; grid.len()];
    let mut labels = vec![u32::MAX; grid.len()];
    let mut count = 0;
    for cell in (0..grid.len()).filter(|&c| foreground[c]) {
        let root = sets.root(cell as u32) as usize;
        if numbers[root] == u32::MAX {
            numbers[root] = count;
            count += 1;
        }
        labels[cell] = numbers[root];
    }
    (labels, count as usize)
}

/// Disjoint sets with the largest weight inside each.
struct DisjointSets {
    parent: Vec<u32>,
    size: Vec<u32>,
    inside: Vec<f32>,
}

impl DisjointSets {
    fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect(), size: vec![1; count], inside: vec![0.0; count] }
    }

    fn root(&mut self, mut a: u32) -> u32 {
        while self.parent[a as usize] != a {
            let above = self.parent[self.parent[a as usize] as usize];
            self.parent[a as usize] = above;
            a = above;
        }
        a
    }

    fn limit(&self, root: u32) -> f32 {
        self.inside[root as usize] + SCALE / self.size[root as usize] as f32
    }

    fn join(&mut self, a: u32, b: u32, weight: f32) {
        let (large, small) = if self.size[a as usize] >= self.size[b as usize] { (a, b) } else { (b, a) };
        self.parent[small as usize] = large;
        self.size[large as usize] += self.size[small as usize];
        let inside = self.inside[large as usize].max(self.inside[small as usize]).max(weight);
        self.inside[large as usize] = inside;
    }
}
