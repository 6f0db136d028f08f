//! What the network's maps say of a mask.

use serde::{Deserialize, Serialize};
use unopose_pairs::data::{ProposalMaps, SceneInput};

/// Steps from the mask that the ring around it reaches, cells.
const RING: u8 = 3;
/// Votes within this share of a mask's radius from its centre agree with it.
const AGREE: f32 = 0.5;

/// Where a candidate comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// An instance of the network.
    Network,
    /// A node of a merge tree.
    Regions,
}

/// What speaks for a mask being one whole object. Shares and probabilities are in [0, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MaskEvidence {
    /// Mean probability of foreground inside.
    pub inside: f64,
    /// The same in the ring of three cells around the mask.
    pub ring: f64,
    /// Mean probability of a boundary on the mask's outermost cells.
    pub edge: f64,
    /// The same on all its other cells.
    pub interior: f64,
    /// Share of the mask's votes that lie within half its radius of their median.
    pub agreement: f64,
    /// Share of the ring's cells that are foreground and vote for the same place: the object goes on outside.
    pub outside: f64,
    /// Distance of the votes' median from that of the points, radii, at most 2.
    pub shift: f64,
    /// Logarithm of the number of cells.
    pub size: f64,
    /// Score of the network's instance, 0 for a candidate from regions.
    pub network: f64,
    /// Score of the candidate from regions, 0 for the network's.
    pub regions: f64,
}

impl MaskEvidence {
    /// How many numbers there are.
    pub const COUNT: usize = 10;

    /// All of them, in the order of the fields.
    pub fn values(&self) -> [f64; Self::COUNT] {
        [
            self.inside,
            self.ring,
            self.edge,
            self.interior,
            self.agreement,
            self.outside,
            self.shift,
            self.size,
            self.network,
            self.regions,
        ]
    }
}

/// The maps of an image with the places that its cells vote for.
pub struct SceneEvidence<'a> {
    input: &'a SceneInput,
    maps: &'a ProposalMaps,
    centers: Vec<[f32; 3]>,
}

impl<'a> SceneEvidence<'a> {
    pub fn new(input: &'a SceneInput, maps: &'a ProposalMaps) -> Self {
        let center = |(p, v): (&[f32; 3], &[f32; 3])| std::array::from_fn(|i| p[i] + v[i]);
        let centers = input.points.iter().zip(&maps.votes).map(center).collect();
        Self { input, maps, centers }
    }

    /// Of a mask on these cells, in ascending order.
    pub fn of(&self, cells: &[u32], origin: Origin, score: f32) -> MaskEvidence {
        if cells.is_empty() {
            return MaskEvidence::default();
        }
        let mut steps = vec![u8::MAX; self.input.len()];
        cells.iter().for_each(|&cell| steps[cell as usize] = 0);
        let mut front: Vec<usize> = cells.iter().map(|&cell| cell as usize).collect();
        let mut ring = Vec::new();
        for step in 1..=RING {
            let mut next = Vec::new();
            for &cell in &front {
                for other in self.input.neighbors(cell) {
                    if steps[other] == u8::MAX {
                        steps[other] = step;
                        next.push(other);
                    }
                }
            }
            ring.extend_from_slice(&next);
            front = next;
        }
        let cells: Vec<usize> = cells.iter().map(|&cell| cell as usize).collect();
        let (edge, interior): (Vec<usize>, Vec<usize>) =
            cells.iter().partition(|&&cell| self.input.neighbors(cell).any(|other| steps[other] != 0));
        let middle = median(cells.iter().map(|&cell| self.input.points[cell]));
        let voted = median(cells.iter().map(|&cell| self.centers[cell]));
        let distances = cells.iter().map(|&cell| distance(self.input.points[cell], middle));
        let radius = (distances.map(|d| d * d).sum::<f32>() / cells.len() as f32).sqrt().max(5e-3);
        let agrees = |cell: &usize| distance(self.centers[*cell], voted) <= AGREE * radius;
        let goes_on = |cell: &usize| self.maps.foreground[*cell] >= 0.5 && agrees(cell);
        let score = f64::from(score);
        MaskEvidence {
            inside: mean(&self.maps.foreground, &cells),
            ring: mean(&self.maps.foreground, &ring),
            edge: mean(&self.maps.boundary, &edge),
            interior: mean(&self.maps.boundary, &interior),
            agreement: share(&cells, agrees),
            outside: share(&ring, goes_on),
            shift: f64::from((distance(voted, middle) / radius).min(2.0)),
            size: (cells.len() as f64).ln(),
            network: if origin == Origin::Network { score } else { 0.0 },
            regions: if origin == Origin::Regions { score } else { 0.0 },
        }
    }
}

/// 0 over no cells.
fn mean(values: &[f32], cells: &[usize]) -> f64 {
    cells.iter().map(|&cell| f64::from(values[cell])).sum::<f64>() / cells.len().max(1) as f64
}

fn share(cells: &[usize], holds: impl Fn(&usize) -> bool) -> f64 {
    cells.iter().filter(|cell| holds(cell)).count() as f64 / cells.len().max(1) as f64
}

/// Lower median per axis; zeros of none.
fn median(points: impl Iterator<Item = [f32; 3]>) -> [f32; 3] {
    let points: Vec<[f32; 3]> = points.collect();
    std::array::from_fn(|axis| {
        let mut values: Vec<f32> = points.iter().map(|p| p[axis]).collect();
        match values.len() {
            0 => 0.0,
            count => *values.select_nth_unstable_by((count - 1) / 2, f32::total_cmp).1,
        }
    })
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use unopose_core::{
        frame::{DepthMap, RgbdFrame},
        geometry::Intrinsics,
    };

    use super::*;

    #[test]
    fn a_whole_object_and_its_half_by_hand() {
        let mut depth = DepthMap::zeros(32, 32);
        depth.data.fill(1.0);
        // A cell every centimetre.
        let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 16.0, cy: 16.0 };
        let frame = RgbdFrame { rgb: image::RgbImage::new(32, 32), depth, intrinsics };
        let input = SceneInput::new(&frame, 32, 32).unwrap();
        // The object: columns 8..16, rows 8..12; all votes at its middle.
        let object = |cell: &usize| (8..16).contains(&(cell % 32)) && (8..12).contains(&(cell / 32));
        let cells: Vec<u32> = (0..1024).filter(object).map(|cell| cell as u32).collect();
        let mut maps = ProposalMaps {
            foreground: vec![0.0; 1024],
            votes: vec![[0.0; 3]; 1024],
            boundary: vec![0.25; 1024],
        };
        for &cell in &cells {
            let p = input.points[cell as usize];
            maps.foreground[cell as usize] = 1.0;
            maps.votes[cell as usize] = [-0.045 - p[0], -0.065 - p[1], 0.0];
        }
        let scene = SceneEvidence::new(&input, &maps);
        let whole = scene.of(&cells, Origin::Network, 0.5);
        assert_eq!((whole.inside, whole.ring, whole.agreement, whole.outside), (1.0, 0.0, 1.0, 0.0));
        assert_eq!((whole.edge, whole.interior, whole.network, whole.regions), (0.25, 0.25, 0.5, 0.0));
        assert!((whole.size - 32f64.ln()).abs() < 1e-12 && whole.shift < 0.5);
        let left: Vec<u32> = cells.iter().copied().filter(|cell| cell % 32 < 12).collect();
        let half = scene.of(&left, Origin::Regions, 0.5);
        // The ring of three steps around 4 x 4 cells has 3 * 4 * 4 + 4 * 3 = 60 cells, 12 of them in the other half.
        assert!((half.ring - 0.2).abs() < 1e-6 && (half.outside - 0.2).abs() < 1e-6, "{half:?}");
        assert!(half.shift > 1.0 && half.regions == 0.5, "{half:?}");
        assert_eq!(scene.of(&[], Origin::Network, 1.0), MaskEvidence::default());
    }
}
