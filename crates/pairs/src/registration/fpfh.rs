//! Fast point feature histograms (Rusu, Blodow, Beetz: "Fast Point Feature Histograms (FPFH) for 3D registration", ICRA
//! 2009), with the bins and weights of PCL and Open3D.

use std::f64::consts::PI;

use nalgebra::{DMatrix, Vector3};
use rayon::prelude::*;

use super::surface::{Surface, vector};

/// Bins per angle.
const BINS: usize = 11;
/// Length of a descriptor: three angles.
const FPFH_LENGTH: usize = 3 * BINS;

/// A descriptor of a point; each of the three histograms sums up to 200 (100 of the point's own neighbours, 100 of
/// theirs).
pub type Fpfh = [f32; FPFH_LENGTH];

/// Descriptors of all points of a surface from the neighbours closer than `radius` metres. A point without neighbours
/// has zeros.
pub fn fpfh(surface: &Surface, radius: f32) -> Vec<Fpfh> {
    let count = surface.points.len();
    // Both descriptors of a pair fall into the same bins, so a neighbour list of larger indices is enough.
    let forward: Vec<Vec<Pair>> = (0..count)
        .into_par_iter()
        .with_min_len(16)
        .map(|i| {
            let near = surface.within(&surface.points[i], radius);
            let later = near.into_iter().filter(|n| n.index > i && n.squared_distance > 0.0);
            later
                .map(|n| Pair {
                    other: n.index as u32,
                    weight: 1.0 / n.squared_distance,
                    bins: pair_bins(surface, i, n.index),
                })
                .collect()
        })
        .collect();
    let mut own = vec![[0.0f32; FPFH_LENGTH]; count];
    let mut degree = vec![0u32; count];
    for (i, pairs) in forward.iter().enumerate() {
        for pair in pairs {
            for at in [i, pair.other as usize] {
                degree[at] += 1;
                pair.bins.iter().for_each(|&bin| own[at][bin as usize] += 1.0);
            }
        }
    }
    for (histogram, &degree) in own.iter_mut().zip(&degree) {
        histogram.iter_mut().for_each(|h| *h *= 100.0 / degree.max(1) as f32);
    }
    let mut neighbors = vec![[0.0f32; FPFH_LENGTH]; count];
    let mut add = |to: usize, from: usize, weight: f32| {
        neighbors[to].iter_mut().zip(&own[from]).for_each(|(sum, h)| *sum += weight * h);
    };
    for (i, pairs) in forward.iter().enumerate() {
        for pair in pairs {
            add(i, pair.other as usize, pair.weight);
            add(pair.other as usize, i, pair.weight);
        }
    }
    for (sum, own) in neighbors.iter_mut().zip(&own) {
        for (sum, own) in sum.chunks_exact_mut(BINS).zip(own.chunks_exact(BINS)) {
            let total: f32 = sum.iter().sum();
            let scale = if total > 0.0 { 100.0 / total } else { 0.0 };
            sum.iter_mut().zip(own).for_each(|(s, o)| *s = *s * scale + o);
        }
    }
    neighbors
}

/// Two points near each other.
struct Pair {
    other: u32,
    /// 1 / squared distance.
    weight: f32,
    /// One bin of each histogram, offsets included.
    bins: [u8; 3],
}

/// The angles theta, alpha and phi of the Darboux frame at the point whose normal is nearer to the connecting line.
fn pair_bins(surface: &Surface, i: usize, j: usize) -> [u8; 3] {
    let line = (vector(&surface.points[j]) - vector(&surface.points[i])).normalize();
    let (ni, nj) = (surface.normals[i], surface.normals[j]);
    let (at_i, at_j) = (ni.dot(&line), nj.dot(&line));
    let (u, other, line, phi) =
        if at_i.abs() < at_j.abs() { (nj, ni, -line, -at_j) } else { (ni, nj, line, at_i) };
    let (theta, alpha) = match line.cross(&u).try_normalize(0.0) {
        Some(v) => {
            let w: Vector3<f64> = u.cross(&v);
            (w.dot(&other).atan2(u.dot(&other)), v.dot(&other))
        }
        None => return [BINS as u8 / 2, (BINS + BINS / 2) as u8, (2 * BINS + BINS / 2) as u8],
    };
    let bin = |share: f64| (share * BINS as f64).clamp(0.0, BINS as f64 - 1.0) as u8;
    let [theta, alpha, phi] = [(theta + PI) / (2.0 * PI), (alpha + 1.0) / 2.0, (phi + 1.0) / 2.0].map(bin);
    [theta, alpha + BINS as u8, phi + 2 * BINS as u8]
}

/// Index pairs (into `a`, into `b`) of every descriptor with the `count` nearest of the other list, each pair once, most
/// similar first.
pub fn nearest_features(a: &[Fpfh], b: &[Fpfh], count: usize) -> Vec<(usize, usize)> {
    let columns = |features: &[Fpfh]| {
        DMatrix::from_iterator(FPFH_LENGTH, features.len(), features.iter().flatten().copied())
    };
    let norms =
        |features: &[Fpfh]| -> Vec<f32> { features.iter().map(|f| f.iter().map(|x| x * x).sum()).collect() };
    let (norms_a, norms_b) = (norms(a), norms(b));
    // [a, b]; |x - y|^2 = |x|^2 + |y|^2 - 2 x y
    let products = columns(a).transpose() * columns(b);
    let mut of_a = vec![NearestK::new(count); a.len()];
    let mut pairs: Vec<(f32, usize, usize)> = Vec::with_capacity(count * (a.len() + b.len()));
    for (j, column) in products.column_iter().enumerate() {
        let mut of_b = NearestK::new(count);
        for (i, &product) in column.iter().enumerate() {
            let distance = norms_a[i] + norms_b[j] - 2.0 * product;
            of_b.offer(distance, i);
            of_a[i].offer(distance, j);
        }
        pairs.extend(of_b.kept.iter().map(|&(distance, i)| (distance, i, j)));
    }
    for (i, nearest) in of_a.iter().enumerate() {
        pairs.extend(nearest.kept.iter().map(|&(distance, j)| (distance, i, j)));
    }
    pairs.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    pairs.dedup_by_key(|pair| (pair.1, pair.2));
    pairs.into_iter().map(|(_, i, j)| (i, j)).collect()
}

/// The `count` nearest, unsorted.
#[derive(Clone)]
struct NearestK {
    kept: Vec<(f32, usize)>,
    count: usize,
    worst: f32,
}

impl NearestK {
    fn new(count: usize) -> Self {
        Self { kept: Vec::with_capacity(count), count, worst: f32::INFINITY }
    }

    #[inline]
    fn offer(&mut self, distance: f32, index: usize) {
        if distance >= self.worst || self.count == 0 {
            return;
        }
        if self.kept.len() == self.count {
            let farthest = (0..self.count).max_by(|&x, &y| self.kept[x].0.total_cmp(&self.kept[y].0));
            self.kept.swap_remove(farthest.unwrap_or(0));
        }
        self.kept.push((distance, index));
        if self.kept.len() == self.count {
            self.worst = self.kept.iter().map(|k| k.0).fold(f32::NEG_INFINITY, f32::max);
        }
    }
}
