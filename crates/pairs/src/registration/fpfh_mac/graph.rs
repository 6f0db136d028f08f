//! Which matches can be true together.

use super::super::feature_pair::Match;

/// Second order compatibility graph (Zhang et al., section 3.2): two matches are joined when a rigid motion can explain
/// both, with a weight that counts how many third matches agree with both.
pub struct CompatibilityGraph {
    size: usize,
    /// `[size, size]`, 0 without an edge.
    weights: Vec<f32>,
    neighbors: Vec<BitSet>,
}

/// Indices of matches.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BitSet(Vec<u64>);

impl CompatibilityGraph {
    /// `width` is that of the Gaussian score, in metres; scores below `threshold` are no edge.
    pub fn new(matches: &[Match], width: f32, threshold: f32) -> Self {
        let size = matches.len();
        let distance = |a: [f32; 3], b: [f32; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>().sqrt();
        let mut first = vec![0.0f32; size * size];
        for i in 0..size {
            for j in i + 1..size {
                let (a, b) = (&matches[i], &matches[j]);
                let difference = distance(a.query, b.query) - distance(a.reference, b.reference);
                let score = (-difference * difference / (2.0 * width * width)).exp();
                if score >= threshold {
                    first[i * size + j] = score;
                    first[j * size + i] = score;
                }
            }
        }
        let matrix = nalgebra::DMatrix::from_row_slice(size, size, &first);
        let paths = &matrix * &matrix;
        let weights: Vec<f32> = first.iter().zip(paths.iter()).map(|(edge, paths)| edge * paths).collect();
        let neighbors = weights
            .chunks(size.max(1))
            .map(|row| {
                let mut set = BitSet::empty(size);
                (0..size).filter(|&j| row[j] > 0.0).for_each(|j| set.insert(j));
                set
            })
            .collect();
        Self { size, weights, neighbors }
    }

    pub fn len(&self) -> usize {
        self.size
    }

    pub fn neighbors(&self, i: usize) -> &BitSet {
        &self.neighbors[i]
    }

    /// Sum of the weights of all edges between the members.
    pub fn weight(&self, members: &[usize]) -> f32 {
        let edges = members.iter().enumerate().flat_map(|(k, &i)| members[..k].iter().map(move |&j| (i, j)));
        edges.map(|(i, j)| self.weights[i * self.size + j]).sum()
    }
}

impl BitSet {
    pub fn empty(size: usize) -> Self {
        Self(vec![0; size.div_ceil(64)])
    }

    pub fn insert(&mut self, i: usize) {
        self.0[i / 64] |= 1 << (i % 64);
    }

    pub fn remove(&mut self, i: usize) {
        self.0[i / 64] &= !(1 << (i % 64));
    }

    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|&word| word == 0)
    }

    pub fn len(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }

    pub fn and(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(&other.0).map(|(a, b)| a & b).collect())
    }

    pub fn without(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(&other.0).map(|(a, b)| a & !b).collect())
    }

    pub fn common(&self, other: &Self) -> usize {
        self.0.iter().zip(&other.0).map(|(a, b)| (a & b).count_ones() as usize).sum()
    }

    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        self.0.iter().enumerate().flat_map(|(index, &word)| {
            let mut rest = word;
            std::iter::from_fn(move || {
                (rest != 0).then(|| {
                    let bit = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    index * 64 + bit
                })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matched(query: [f32; 3], reference: [f32; 3]) -> Match {
        Match { query, reference, query_normal: [0.0; 3], reference_normal: [0.0; 3] }
    }

    #[test]
    fn second_order_weights_count_common_neighbours() {
        // Three matches of one shift and a stray one that keeps its distance to the first only.
        let at = |x: f32, y: f32| [x, y, 1.0];
        let shifted = |p: [f32; 3]| matched([p[0] + 0.3, p[1], p[2]], p);
        let mut matches = [at(0.0, 0.0), at(0.1, 0.0), at(0.0, 0.1), at(0.1, 0.1)].map(shifted).to_vec();
        matches[3].query = [0.3 - 0.1 * 2f32.sqrt(), 0.0, 1.0];
        let graph = CompatibilityGraph::new(&matches, 0.01, 0.9);
        // 0-1, 0-2, 1-2 and 0-3; only the triangle survives, each edge with one common neighbour.
        assert!((graph.weight(&[0, 1]) - 1.0).abs() < 1e-3);
        assert!((graph.weight(&[0, 1, 2]) - 3.0).abs() < 1e-3);
        assert_eq!(graph.weight(&[0, 3]), 0.0);
        assert_eq!(graph.neighbors(0).iter().collect::<Vec<_>>(), [1, 2]);
    }
}
