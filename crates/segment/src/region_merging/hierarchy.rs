//! Merge trees over the regions: every node is a candidate mask. Trees with different ideas of what belongs together
//! disagree where an object is ambiguous, and one of them tends to be right.

use super::{
    adjacency::{Boundaries, Boundary, Region},
    grid::{minus, norm},
};

/// Weights of what the merge of two regions costs.
#[derive(Clone, Copy, Debug)]
pub struct Strategy {
    pub step: f32,
    pub crease: f32,
    pub ridge: f32,
    /// Colour across the boundary.
    pub edge_color: f32,
    /// Colour of the whole regions.
    pub mean_color: f32,
    /// Joint size, so that small regions go first.
    pub size: f32,
    /// Unlike neighbours with a short common boundary.
    pub contact: f32,
}

/// Colour before geometry.
pub const COLOR_FIRST: Strategy = Strategy {
    step: 0.4,
    crease: 0.2,
    ridge: 0.0,
    edge_color: 0.5,
    mean_color: 1.5,
    size: 0.2,
    contact: 0.1,
};

/// Geometry first, a balance, colour first, small ones first.
pub const STRATEGIES: [Strategy; 4] = [
    Strategy {
        step: 1.0,
        crease: 1.0,
        ridge: 0.1,
        edge_color: 0.1,
        mean_color: 0.1,
        size: 0.2,
        contact: 0.3,
    },
    Strategy {
        step: 1.0,
        crease: 0.7,
        ridge: 0.2,
        edge_color: 0.5,
        mean_color: 0.5,
        size: 0.3,
        contact: 0.3,
    },
    COLOR_FIRST,
    Strategy {
        step: 0.7,
        crease: 0.5,
        ridge: 0.1,
        edge_color: 0.2,
        mean_color: 0.3,
        size: 2.0,
        contact: 0.5,
    },
];

/// Cost at which a node that is never merged would be.
const LAST_COST: f32 = 3.0;

/// A set of regions.
#[derive(Clone, Debug)]
pub struct Node {
    pub members: RegionSet,
    pub cells: f32,
    /// Costs at which it came to be and was merged into its parent; a whole component of the foreground is never
    /// merged.
    pub birth: f32,
    pub death: f32,
    /// Nothing of the foreground touches it.
    pub isolated: bool,
}

/// Bit set of region indices.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct RegionSet(Vec<u64>);

impl RegionSet {
    /// The region `index` of `count`.
    pub fn one(index: usize, count: usize) -> Self {
        let mut bits = vec![0u64; count.div_ceil(64)];
        bits[index / 64] |= 1 << (index % 64);
        Self(bits)
    }

    /// Whether a region is in the set.
    pub fn contains(&self, index: usize) -> bool {
        self.0.get(index / 64).is_some_and(|word| word >> (index % 64) & 1 == 1)
    }

    /// Regions of either set.
    pub fn union(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(&other.0).map(|(a, b)| a | b).collect())
    }

    /// Cells that both sets have, by the cells of the regions.
    pub fn shared(&self, other: &Self, regions: &[Region]) -> f32 {
        let mut cells = 0.0;
        for (word, (a, b)) in self.0.iter().zip(&other.0).enumerate() {
            let mut both = a & b;
            while both != 0 {
                cells += regions.get(word * 64 + both.trailing_zeros() as usize).map_or(0.0, |r| r.cells);
                both &= both - 1;
            }
        }
        cells
    }
}

/// The nodes of one merge tree, leaves included.
pub fn merge_tree(regions: &[Region], boundaries: &Boundaries, strategy: &Strategy) -> Vec<Node> {
    let total: f32 = regions.iter().map(|r| r.cells).sum();
    let mut tree = Tree {
        sums: regions.to_vec(),
        boundaries: boundaries.clone(),
        strategy: *strategy,
        total: total.max(1.0),
    };
    let mut nodes: Vec<Node> = regions
        .iter()
        .enumerate()
        .map(|(index, region)| Node {
            members: RegionSet::one(index, regions.len()),
            cells: region.cells,
            birth: 0.0,
            death: LAST_COST,
            isolated: true,
        })
        .collect();
    while let Some((a, b, cost)) = tree.cheapest() {
        let (first, second) = (a as usize, b as usize);
        let birth = cost.max(nodes[first].birth).max(nodes[second].birth);
        for child in [first, second] {
            nodes[child].death = birth;
            nodes[child].isolated = false;
        }
        nodes.push(Node {
            members: nodes[first].members.union(&nodes[second].members),
            cells: nodes[first].cells + nodes[second].cells,
            birth,
            death: LAST_COST.max(birth),
            isolated: true,
        });
        tree.merge(a, b);
    }
    nodes
}

/// A merge tree under construction.
struct Tree {
    sums: Vec<Region>,
    boundaries: Boundaries,
    strategy: Strategy,
    total: f32,
}

impl Tree {
    fn cheapest(&self) -> Option<(u32, u32, f32)> {
        let costs = self.boundaries.iter().map(|(&(a, b), boundary)| (a, b, self.cost(a, b, boundary)));
        costs.min_by(|x, y| x.2.total_cmp(&y.2))
    }

    fn cost(&self, a: u32, b: u32, boundary: &Boundary) -> f32 {
        let (first, second) = (&self.sums[a as usize], &self.sums[b as usize]);
        let (contrast, s) = (boundary.mean(), &self.strategy);
        let mean_color = norm(minus(first.mean_lab(), second.mean_lab())) / 25.0;
        let smaller = first.cells.min(second.cells);
        // A compact region of n cells has about 4 sqrt(n) pairs along its boundary in an 8-neighbourhood, three per cell.
        let contact = (1.0 - boundary.length() / (3.0 * smaller.sqrt())).clamp(0.0, 1.0);
        s.step * contrast.step
            + s.crease * contrast.crease
            + s.ridge * contrast.ridge
            + s.edge_color * contrast.color
            + s.mean_color * mean_color.min(2.0)
            + s.size * ((first.cells + second.cells) / self.total).sqrt()
            + s.contact * contact
    }

    /// The pair becomes a new region behind the others.
    fn merge(&mut self, a: u32, b: u32) {
        let joint = self.sums.len() as u32;
        let mut sum = self.sums[a as usize].clone();
        sum.add(&self.sums[b as usize]);
        self.sums.push(sum);
        let touching: Vec<(u32, u32)> = self
            .boundaries
            .keys()
            .copied()
            .filter(|&(x, y)| [x, y].iter().any(|&end| end == a || end == b))
            .collect();
        for key in touching {
            let Some(boundary) = self.boundaries.remove(&key) else { continue };
            let other = if key.0 == a || key.0 == b { key.1 } else { key.0 };
            if other != a && other != b {
                self.boundaries.entry((other, joint)).or_default().add(&boundary);
            }
        }
    }
}
