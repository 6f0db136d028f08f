//! Prepared pairs as tensors on a device. Everything here is constant: no gradient flows into it.

use burn::tensor::{Device, Int, Tensor, TensorData};
use unopose_core::{
    config::ModelConfig,
    geometry::{BallGroups, Pose},
};
use unopose_pairs::data::{CloudInput, TrainSample};

use super::{feature_extraction::PixelChoice, positional_encoding::GroupTensors};

/// What the colour network reads of the clouds of a batch.
#[derive(Clone, Debug)]
pub struct ViewTensors {
    /// Masked, normalised crops `[B, 3, S, S]`.
    pub images: Tensor<4>,
    /// Pixels of the dense points in the crops.
    pub choose: PixelChoice,
}

/// What the structure embedding reads of the clouds of a batch: background and sparse points, radii and degrees.
#[derive(Clone, Debug)]
pub struct StructureTensors {
    /// Pairwise distances in units of `geo_embedding.sigma_d` `[B, 1 + M, 1 + M]`.
    pub distances: Tensor<3>,
    /// Triplet angles in units of `geo_embedding.sigma_a` `[B, 1 + M, 1 + M, k]`.
    pub angles: Tensor<4>,
}

/// Where the sparse points of a batch are among the dense ones.
#[derive(Clone, Debug)]
pub struct SparseRows {
    /// Rows of the sparse points in the flattened `[B * N]` list of points, `[B * M]`.
    pub points: Tensor<1, Int>,
    /// Rows of background and sparse points in the flattened `[B * (1 + N)]` list of tokens, `[B * (1 + M)]`.
    pub tokens: Tensor<1, Int>,
}

/// Everything that the network reads of one cloud of each pair of a batch.
#[derive(Clone, Debug)]
pub struct CloudTensors {
    /// Crops and pixels.
    pub view: ViewTensors,
    /// Distances and angles.
    pub structure: StructureTensors,
    /// Sparse among dense points.
    pub rows: SparseRows,
}

/// Rotations `[B, 3, 3]` and translations `[B, 1, 3]` that map reference to query points (radii, matching frames).
#[derive(Clone, Debug)]
pub struct PoseTensors {
    /// `[B, 3, 3]`.
    pub rotation: Tensor<3>,
    /// `[B, 1, 3]`, radii.
    pub translation: Tensor<3>,
}

/// A training batch without its neighbourhoods ([`Self::groups_of`]).
#[derive(Clone, Debug)]
pub struct PairTensors {
    /// The queries' clouds.
    pub query: CloudTensors,
    /// The references' clouds.
    pub reference: CloudTensors,
    /// Dense points of query and reference in the matching frames `[B, N, 3]`, radii.
    pub points: [Tensor<3>; 2],
    /// True pose.
    pub pose: PoseTensors,
}

impl ViewTensors {
    /// Of `clouds` of equal sizes.
    pub fn new(clouds: &[&CloudInput], config: &ModelConfig, device: &Device) -> Self {
        let shape = [clouds.len(), 3, config.image_size, config.image_size];
        Self {
            images: float(shape, clouds.iter().map(|c| c.rgb.as_slice()), device),
            choose: PixelChoice::new(clouds.iter().map(|c| c.choose.as_slice())),
        }
    }
}

impl StructureTensors {
    /// Of `clouds` of equal sizes.
    pub fn new(clouds: &[&CloudInput], device: &Device) -> Self {
        let batch = clouds.len();
        let (size, k) = clouds.first().map_or((0, 0), |c| (c.structure.size, c.structure.k));
        let distances = clouds.iter().map(|c| c.structure.distances.as_slice());
        let angles = clouds.iter().map(|c| c.structure.angles.as_slice());
        Self {
            distances: float([batch, size, size], distances, device),
            angles: float([batch, size, size, k], angles, device),
        }
    }

    /// The clouds of two batches of equal sizes, one after the other.
    pub fn chain(&self, other: &Self) -> Self {
        Self {
            distances: Tensor::cat(vec![self.distances.clone(), other.distances.clone()], 0),
            angles: Tensor::cat(vec![self.angles.clone(), other.angles.clone()], 0),
        }
    }
}

impl SparseRows {
    /// Of `clouds` of equal sizes.
    pub fn new(clouds: &[&CloudInput], config: &ModelConfig, device: &Device) -> Self {
        let batch = clouds.len();
        let n = clouds.first().map_or(0, |c| c.points.len());
        let m = clouds.first().map_or(0, |c| c.sparse.len());
        // Quirk: the release gathers from the list with the background in front without shifting the indices.
        let shift = if config.quirks.sparse_off_by_one { 0 } else { 1 };
        let mut points = Vec::with_capacity(batch * m);
        let mut tokens = Vec::with_capacity(batch * (m + 1));
        for (b, cloud) in clouds.iter().enumerate() {
            points.extend(cloud.sparse.iter().map(|&i| (b * n) as i32 + i as i32));
            tokens.push((b * (n + 1)) as i32);
            tokens.extend(cloud.sparse.iter().map(|&i| (b * (n + 1)) as i32 + i as i32 + shift));
        }
        Self { points: int(points, device), tokens: int(tokens, device) }
    }

    /// Those of batches with `n` dense points per cloud, one after the other; each comes with its number of clouds.
    pub(super) fn batch<'a>(items: impl Iterator<Item = (&'a Self, usize)>, n: usize) -> Option<Self> {
        let (mut points, mut tokens, mut first) = (Vec::new(), Vec::new(), 0i64);
        for (rows, clouds) in items {
            points.push(rows.points.clone() + first * n as i64);
            tokens.push(rows.tokens.clone() + first * (n + 1) as i64);
            first += clouds as i64;
        }
        (first > 0).then(|| Self { points: Tensor::cat(points, 0), tokens: Tensor::cat(tokens, 0) })
    }
}

impl CloudTensors {
    /// Of `clouds` of equal sizes.
    pub fn from_clouds(clouds: &[&CloudInput], config: &ModelConfig, device: &Device) -> Self {
        Self {
            view: ViewTensors::new(clouds, config, device),
            structure: StructureTensors::new(clouds, device),
            rows: SparseRows::new(clouds, config, device),
        }
    }
}

impl PoseTensors {
    /// Of poses between matching frames.
    pub fn new<'a>(poses: impl Iterator<Item = &'a Pose>, device: &Device) -> Self {
        let (mut rotation, mut translation, mut batch) = (Vec::new(), Vec::new(), 0);
        for pose in poses {
            rotation.extend(pose.rotation_row_major().map(|x| x as f32));
            translation.extend(pose.translation.iter().map(|&x| x as f32));
            batch += 1;
        }
        Self {
            rotation: Tensor::from_data(TensorData::new(rotation, [batch, 3, 3]), device),
            translation: Tensor::from_data(TensorData::new(translation, [batch, 1, 3]), device),
        }
    }
}

impl PairTensors {
    /// Samples of equal sizes to tensors on `device` (without autodiff: they are constants of the graph).
    pub fn from_samples(samples: &[TrainSample], config: &ModelConfig, device: &Device) -> Self {
        let device = &device.clone().inner();
        let clouds = [
            samples.iter().map(|s| &s.query).collect::<Vec<&CloudInput>>(),
            samples.iter().map(|s| &s.reference.cloud).collect(),
        ];
        let [query, reference] =
            clouds.each_ref().map(|clouds| CloudTensors::from_clouds(clouds, config, device));
        let points = clouds.each_ref().map(|clouds| {
            let n = clouds.first().map_or(0, |c| c.points.len());
            float([clouds.len(), n, 3], clouds.iter().map(|c| c.points.as_flattened()), device)
        });
        Self {
            query,
            reference,
            points,
            pose: PoseTensors::new(samples.iter().map(|s| &s.t_query_reference), device),
        }
    }

    /// Neighbourhoods of the samples' queries and references.
    pub fn groups_of(
        samples: &[TrainSample],
        config: &ModelConfig,
        device: &Device,
    ) -> [[GroupTensors; 2]; 2] {
        let device = &device.clone().inner();
        let groups = |pick: fn(&TrainSample) -> &[BallGroups; 2]| {
            group_tensors(&samples.iter().map(pick).collect::<Vec<_>>(), config, device)
        };
        [groups(|s| &s.query_groups), groups(|s| &s.reference.groups)]
    }
}

/// Both neighbourhood scales of a batch of clouds.
pub fn group_tensors(
    groups: &[&[BallGroups; 2]],
    config: &ModelConfig,
    device: &Device,
) -> [GroupTensors; 2] {
    std::array::from_fn(|scale| {
        let mut joined = groups.first().map_or_else(BallGroups::default, |first| BallGroups {
            samples: first[scale].samples,
            ..BallGroups::default()
        });
        for group in groups {
            joined.features.extend_from_slice(&group[scale].features);
            joined.counts.extend_from_slice(&group[scale].counts);
        }
        of_scale(joined, groups.len(), config, device)
    })
}

/// [`group_tensors`] of neighbourhoods that nobody needs any more: those of a single cloud are not copied.
pub fn into_group_tensors(
    groups: Vec<[BallGroups; 2]>,
    config: &ModelConfig,
    device: &Device,
) -> [GroupTensors; 2] {
    match <[_; 1]>::try_from(groups) {
        Ok([single]) => single.map(|scale| of_scale(scale, 1, config, device)),
        Err(groups) => group_tensors(&groups.iter().collect::<Vec<_>>(), config, device),
    }
}

/// One scale of `batch` clouds, one after the other.
fn of_scale(groups: BallGroups, batch: usize, config: &ModelConfig, device: &Device) -> GroupTensors {
    let BallGroups { samples: k, features, counts } = groups;
    let n = counts.len() / batch.max(1);
    let channels = features.len().checked_div(counts.len() * k).unwrap_or(6);
    let mask = (!config.quirks.batchnorm_counts_padding).then(|| {
        let mut mask = vec![0f32; batch * n * k];
        let rows = mask.chunks_exact_mut(k.max(1));
        for (row, &count) in rows.zip(&counts) {
            // A centre without neighbours still has one (zero) row that counts.
            row[..(count as usize).clamp(1, k)].fill(1.0);
        }
        Tensor::from_data(TensorData::new(mask, [batch * n * k, 1]), device)
    });
    let features = Tensor::from_data(TensorData::new(features, [batch, n, k, channels]), device);
    GroupTensors { features, counts, mask }
}

fn float<'a, const D: usize>(
    shape: [usize; D],
    items: impl Iterator<Item = &'a [f32]>,
    device: &Device,
) -> Tensor<D> {
    let mut values = Vec::with_capacity(shape.iter().product());
    items.for_each(|item| values.extend_from_slice(item));
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn int(values: Vec<i32>, device: &Device) -> Tensor<1, Int> {
    let count = values.len();
    Tensor::from_data(TensorData::new(values, [count]), device)
}
