//! Maximal cliques by Bron and Kerbosch's algorithm with Tomita's pivots, bounded in steps, and the choice of a few.

use super::graph::{BitSet, CompatibilityGraph};

/// Fewest members of a clique that makes a pose.
pub const MIN_SIZE: usize = 3;

/// Bounds of a search.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Calls of the recursion, divided evenly between the vertices it begins at; where they end, the clique that was
    /// being grown counts as it is.
    pub steps: usize,
    /// Cliques that are handed back.
    pub cliques: usize,
}

/// For every vertex the heaviest clique found that contains it (node-guided selection; Zhang et al., section 3.3), each
/// once, heaviest first.
pub fn heaviest_cliques(graph: &CompatibilityGraph, limits: Limits) -> Vec<Vec<usize>> {
    let size = graph.len();
    let mut search = Search { graph, steps: 0, clique: Vec::new(), heaviest: vec![(0.0, Vec::new()); size] };
    // Vertices of low degree first keep the candidate sets small.
    let mut order: Vec<usize> = (0..size).collect();
    order.sort_by_key(|&i| graph.neighbors(i).len());
    let mut later = BitSet::empty(size);
    order.iter().for_each(|&i| later.insert(i));
    let mut earlier = BitSet::empty(size);
    for &root in &order {
        later.remove(root);
        search.steps = (limits.steps / size.max(1)).max(1);
        search.clique.push(root);
        search.expand(graph.neighbors(root).and(&later), graph.neighbors(root).and(&earlier));
        search.clique.pop();
        earlier.insert(root);
    }
    let mut chosen: Vec<(f32, Vec<usize>)> =
        search.heaviest.into_iter().filter(|(_, clique)| clique.len() >= MIN_SIZE).collect();
    chosen.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
    chosen.dedup_by(|a, b| a.1 == b.1);
    chosen.into_iter().take(limits.cliques).map(|(_, clique)| clique).collect()
}

struct Search<'a> {
    graph: &'a CompatibilityGraph,
    /// Left for the current root.
    steps: usize,
    clique: Vec<usize>,
    /// By vertex: weight and members.
    heaviest: Vec<(f32, Vec<usize>)>,
}

impl Search<'_> {
    /// All maximal cliques that extend the current one by `candidates`; those with an `excluded` vertex were found before.
    fn expand(&mut self, mut candidates: BitSet, mut excluded: BitSet) {
        if self.steps == 0 || (candidates.is_empty() && excluded.is_empty()) {
            self.keep();
            return;
        }
        self.steps -= 1;
        let pivot = candidates
            .iter()
            .chain(excluded.iter())
            .max_by_key(|&v| self.graph.neighbors(v).common(&candidates));
        let Some(pivot) = pivot else { return };
        let branches = candidates.without(self.graph.neighbors(pivot));
        for vertex in branches.iter() {
            let neighbors = self.graph.neighbors(vertex);
            self.clique.push(vertex);
            self.expand(candidates.and(neighbors), excluded.and(neighbors));
            self.clique.pop();
            if self.steps == 0 {
                return;
            }
            candidates.remove(vertex);
            excluded.insert(vertex);
        }
    }

    fn keep(&mut self) {
        if self.clique.len() < MIN_SIZE {
            return;
        }
        let weight = self.graph.weight(&self.clique);
        let mut members = self.clique.clone();
        members.sort_unstable();
        for &vertex in &members {
            if weight > self.heaviest[vertex].0 {
                self.heaviest[vertex] = (weight, members.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{super::super::feature_pair::Match, *};

    fn matched(query: [f32; 3], reference: [f32; 3]) -> Match {
        Match { query, reference, query_normal: [0.0; 3], reference_normal: [0.0; 3] }
    }

    /// Two groups of points, each moved by its own rigid motion, so that each is a clique.
    fn two_groups() -> Vec<Match> {
        let grid =
            |n: usize| (0..n).map(|i| [0.1 * (i % 3) as f32, 0.07 * (i / 3) as f32, 0.03 * (i * i) as f32]);
        let moved = |p: [f32; 3], x: f32| matched([x + p[0], p[1], p[2]], p);
        let turned = |p: [f32; 3]| matched([-p[1] * 1.9, p[0] * 0.4, 9.0 + p[2]], p);
        let mut matches: Vec<Match> = grid(6).map(|p| moved(p, 0.5)).collect();
        matches.extend(grid(4).map(|p| [p[0] + 0.33, p[1] * 1.3, p[2] + 0.01]).map(|p| moved(p, -4.0)));
        matches.extend(grid(2).map(turned));
        matches
    }

    #[test]
    fn the_groups_are_found_heaviest_first() {
        let graph = CompatibilityGraph::new(&two_groups(), 0.005, 0.9);
        let cliques = heaviest_cliques(&graph, Limits { steps: 10_000, cliques: 10 });
        assert_eq!(cliques[0], [0, 1, 2, 3, 4, 5]);
        assert!(cliques.contains(&vec![6, 7, 8, 9]), "{cliques:?}");
        assert_eq!(heaviest_cliques(&graph, Limits { steps: 10_000, cliques: 1 }).len(), 1);
    }

    #[test]
    fn without_steps_cliques_are_still_cliques() {
        let graph = CompatibilityGraph::new(&two_groups(), 0.005, 0.9);
        for clique in heaviest_cliques(&graph, Limits { steps: 36, cliques: 50 }) {
            for (k, &i) in clique.iter().enumerate() {
                assert!(clique[..k].iter().all(|&j| graph.weight(&[i, j]) > 0.0), "{clique:?}");
            }
        }
    }
}
