//! Ball queries with local reference frames, and nearest neighbours.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::{
    columns::Columns,
    columns::LANES,
    procrustes::vector,
    reference_frame::{COUNTED_HEIGHT, FrameAxes, local_axes},
};
use crate::{config::Quirks, simd::vectorised};

/// How the axes of local frames are formed; the release's form has both.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LocalFrames {
    /// The sign of z by counting, see [`GlobalReferenceFrame`](super::GlobalReferenceFrame).
    pub counted_sign: bool,
    /// The entries that pad a short list count as often as they stand there: the first neighbour, whichever it is,
    /// then outweighs the others.
    pub count_padding: bool,
}

impl LocalFrames {
    /// As in the official release.
    pub const RELEASE: Self = Self { counted_sign: true, count_padding: true };

    /// The form that a network with these quirks takes.
    pub fn of(quirks: &Quirks) -> Self {
        Self { counted_sign: quirks.counted_z_sign, count_padding: quirks.local_frames_count_padding }
    }

    /// Axes from the offsets of a list of `samples` before its padding.
    fn axes(self, offsets: &[Vector3<f64>], samples: usize, radius: f32) -> FrameAxes {
        local_axes(offsets, self.padding(offsets, samples), radius as f64, self.counted_sign)
    }

    /// How often the first offset counts beside itself.
    fn padding(self, offsets: &[Vector3<f64>], samples: usize) -> usize {
        if self.count_padding { samples - offsets.len() } else { 0 }
    }
}

/// Neighbours of every centre in index order, `[centres, samples]`.
#[derive(Clone, Debug)]
pub struct BallQuery {
    /// Short lists repeat their first entry; a centre without neighbours has zeros.
    pub indices: Vec<u32>,
    /// Neighbours before padding.
    pub counts: Vec<u32>,
}

/// Neighbourhood features of every point for the positional encoding.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BallGroups {
    /// Entries per point, padding included.
    pub samples: usize,
    /// `[N, samples, 6]` (`[N, samples, 3]` without local frames): offset to the neighbour in radii of the object,
    /// then its coordinates in the local frame in ball radii. Padded entries repeat the first.
    pub features: Vec<f32>,
    /// Neighbours before padding, `[N]`.
    pub counts: Vec<u32>,
}

/// For each centre the first `samples` points with distance strictly below `radius`.
pub fn ball_query(centres: &[[f32; 3]], points: &[[f32; 3]], radius: f32, samples: usize) -> BallQuery {
    let columns = Columns::new(points);
    let mut indices = vec![0u32; centres.len() * samples];
    let counts = indices
        .par_chunks_mut(samples.max(1))
        .zip(centres)
        .with_min_len(64)
        .map(|(row, &centre)| {
            let count = ball_of(&columns, centre, radius * radius, row);
            let first = row.first().copied().unwrap_or(0);
            row[count..].fill(if count == 0 { 0 } else { first });
            count as u32
        })
        .collect();
    BallQuery { indices, counts }
}

/// Fills `row` with the points inside the ball and returns their number (at most the row's length).
fn ball_of(columns: &Columns, centre: [f32; 3], squared_radius: f32, row: &mut [u32]) -> usize {
    let mut count = 0;
    vectorised!({
        for run in 0..columns.runs() {
            if count == row.len() {
                break;
            }
            let distances = columns.squared_distances(centre, run);
            let mut any = false;
            for d in distances {
                any |= d < squared_radius;
            }
            if !any {
                continue;
            }
            for (l, d) in distances.into_iter().enumerate() {
                if d < squared_radius && count < row.len() {
                    row[count] = (run * LANES + l) as u32;
                    count += 1;
                }
            }
        }
    });
    count
}

/// Ball queries around every point of a cloud (in object radii) with the offsets and, with `frames`, the local
/// frame coordinates of the neighbours.
pub fn ball_groups(
    points: &[[f32; 3]],
    radius: f32,
    samples: usize,
    frames: Option<LocalFrames>,
) -> BallGroups {
    let channels = if frames.is_some() { 6 } else { 3 };
    let columns = Columns::new(points);
    let mut features = vec![0.0f32; points.len() * samples * channels];
    let counts = features
        .par_chunks_mut((samples * channels).max(1))
        .zip(points)
        .with_min_len(32)
        .map_init(
            || (vec![0u32; samples], Vec::new()),
            |(row, offsets): &mut (Vec<u32>, Vec<Vector3<f64>>), (group, centre)| {
                let count = ball_of(&columns, *centre, radius * radius, row);
                let at = |i: u32| &points[i as usize];
                for (entry, &i) in group.chunks_exact_mut(channels).zip(&row[..count]) {
                    (0..3).for_each(|axis| entry[axis] = at(i)[axis] - centre[axis]);
                }
                if let Some(frames) = frames {
                    offsets.clear();
                    offsets.extend(row[..count].iter().map(|&i| vector(at(i)) - vector(centre)));
                    let axes = frames.axes(offsets, samples, radius);
                    for (entry, d) in group.chunks_exact_mut(channels).zip(offsets.iter()) {
                        let local = axes.coordinates(d) / radius as f64;
                        (0..3).for_each(|axis| entry[3 + axis] = local[axis] as f32);
                    }
                }
                let (found, padding) = group.split_at_mut(count * channels);
                if let Some(first) = found.get(..channels) {
                    padding.chunks_exact_mut(channels).for_each(|entry| entry.copy_from_slice(first));
                }
                count as u32
            },
        )
        .collect();
    BallGroups { samples, features, counts }
}

/// The local frame of every point, as [`ball_groups`] uses it.
pub fn local_frames(points: &[[f32; 3]], radius: f32, samples: usize, frames: LocalFrames) -> Vec<FrameAxes> {
    let columns = Columns::new(points);
    let axes = |centre: &[f32; 3]| {
        frames.axes(&ball_offsets(&columns, points, centre, radius, samples), samples, radius)
    };
    points.par_iter().with_min_len(32).map(axes).collect()
}

/// Offsets of a point's neighbours before padding.
fn ball_offsets(
    columns: &Columns,
    points: &[[f32; 3]],
    centre: &[f32; 3],
    radius: f32,
    samples: usize,
) -> Vec<Vector3<f64>> {
    let mut row = vec![0u32; samples];
    let count = ball_of(columns, *centre, radius * radius, &mut row);
    row[..count].iter().map(|&i| vector(&points[i as usize]) - vector(centre)).collect()
}

/// Distance of every point of `from` to its nearest point of `to`; infinite when `to` is empty.
pub fn nearest_distances(from: &[[f32; 3]], to: &[[f32; 3]]) -> Vec<f32> {
    let columns = Columns::new(to);
    from.par_iter().with_min_len(64).map(|&p| columns.nearest_squared(p).sqrt()).collect()
}

/// Number (from 1) of each point's nearest point of `to`, 0 when that is farther than `limit`.
pub fn nearest_match(from: &[[f32; 3]], to: &[[f32; 3]], limit: f32) -> Vec<u32> {
    let squared = |p: &[f32; 3], q: &[f32; 3]| (0..3).map(|i| (p[i] - q[i]).powi(2)).sum::<f32>();
    from.par_iter()
        .with_min_len(64)
        .map(|p| {
            let nearest = (0..to.len()).min_by(|&a, &b| squared(p, &to[a]).total_cmp(&squared(p, &to[b])));
            nearest.filter(|&j| squared(p, &to[j]).sqrt() <= limit).map_or(0, |j| j as u32 + 1)
        })
        .collect()
}

/// The statistic of the release's counted sign for one neighbourhood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignCount {
    /// Neighbours behind minus those in front of the plane of the local frame (with padding, where it counts), before the
    /// sign of the normal is chosen.
    pub count: i64,
    /// Neighbours so near to the counting threshold that rounding decides about them.
    pub undecided: i64,
}

/// [`SignCount`] of every point's ball; heights within `margin` of the threshold are undecided.
pub fn local_sign_counts(
    points: &[[f32; 3]],
    radius: f32,
    samples: usize,
    count_padding: bool,
    margin: f64,
) -> Vec<SignCount> {
    let columns = Columns::new(points);
    points
        .par_iter()
        .with_min_len(32)
        .map(|centre| {
            let offsets = ball_offsets(&columns, points, centre, radius, samples);
            let frames = LocalFrames { counted_sign: true, count_padding };
            let axes = frames.axes(&offsets, samples, radius);
            let padding = frames.padding(&offsets, samples);
            let undecided = offsets
                .iter()
                .enumerate()
                .filter(|(_, d)| (axes.z.dot(d).abs() - COUNTED_HEIGHT).abs() < margin)
                .map(|(i, _)| if i == 0 { 1 + padding } else { 1 })
                .sum::<usize>();
            SignCount { count: axes.sign_count, undecided: undecided as i64 }
        })
        .collect()
}
