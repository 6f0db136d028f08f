//! Prepared pairs as tensors on a device. Everything here is constant: no gradient flows into it.

use burn::tensor::{Device, Int, Tensor, TensorData};
use unopose_core::{
    config::ModelConfig,
    geometry::{BallGroups, Pose},
};
use unopose_pairs::data::{CloudInput, TrainSample};

use super::{feature_extraction::PixelChoice, positional_encoding::GroupTensors};

/// One cloud of each pair of a batch.
#[derive(Clone, Debug)]
pub struct CloudTensors {
    /// Masked, normalised crops `[B, 3, S, S]`.
    pub images: Tensor<4>,
    pub choose: PixelChoice,
    /// Dense points in the matching frame `[B, N, 3]`, radii.
    pub points: Tensor<3>,
    /// Dense rows of the sparse points in the flattened `[B * N]` list, `[B * M]`.
    pub sparse_points: Tensor<1, Int>,
    /// Token rows of background and sparse points in the flattened `[B * (1 + N)]` list, `[B * (1 + M)]`.
    pub sparse_tokens: Tensor<1, Int>,
    /// `[B, 1 + M, 1 + M]`.
    pub distances: Tensor<3>,
    /// `[B, 1 + M, 1 + M, k]`.
    pub angles: Tensor<4>,
}

/// Rotations `[B, 3, 3]` and translations `[B, 1, 3]` that map reference to query points (radii, matching frames).
#[derive(Clone, Debug)]
pub struct PoseTensors {
    pub rotation: Tensor<3>,
    pub translation: Tensor<3>,
}

/// A training batch without its neighbourhoods ([`Self::groups_of`]).
#[derive(Clone, Debug)]
pub struct PairTensors {
    pub query: CloudTensors,
    pub reference: CloudTensors,
    /// True pose.
    pub pose: PoseTensors,
}

impl CloudTensors {
    /// What the colour network reads of `clouds` of equal sizes: [`Self::images`] and [`Self::choose`].
    pub fn views(clouds: &[&CloudInput], config: &ModelConfig, device: &Device) -> (Tensor<4>, PixelChoice) {
        let shape = [clouds.len(), 3, config.image_size, config.image_size];
        (
            float(shape, clouds.iter().map(|c| c.rgb.as_slice()), device),
            PixelChoice::new(clouds.iter().map(|c| c.choose.as_slice())),
        )
    }

    /// `clouds` of equal sizes.
    pub fn from_clouds(clouds: &[&CloudInput], config: &ModelConfig, device: &Device) -> Self {
        let batch = clouds.len();
        let n = clouds.first().map_or(0, |c| c.points.len());
        let m = clouds.first().map_or(0, |c| c.sparse.len());
        let (size, k) = clouds.first().map_or((0, 0), |c| (c.structure.size, c.structure.k));
        // Quirk: the release gathers from the list with the background in front without shifting the indices.
        let shift = if config.quirks.sparse_off_by_one { 0 } else { 1 };
        let mut sparse_points = Vec::with_capacity(batch * m);
        let mut sparse_tokens = Vec::with_capacity(batch * (m + 1));
        for (b, cloud) in clouds.iter().enumerate() {
            sparse_points.extend(cloud.sparse.iter().map(|&i| (b * n) as i32 + i as i32));
            sparse_tokens.push((b * (n + 1)) as i32);
            sparse_tokens.extend(cloud.sparse.iter().map(|&i| (b * (n + 1)) as i32 + i as i32 + shift));
        }
        let (images, choose) = Self::views(clouds, config, device);
        Self {
            images,
            choose,
            points: float([batch, n, 3], clouds.iter().map(|c| c.points.as_flattened()), device),
            sparse_points: int(sparse_points, device),
            sparse_tokens: int(sparse_tokens, device),
            distances: float(
                [batch, size, size],
                clouds.iter().map(|c| c.structure.distances.as_slice()),
                device,
            ),
            angles: float(
                [batch, size, size, k],
                clouds.iter().map(|c| c.structure.angles.as_slice()),
                device,
            ),
        }
    }
}

impl PoseTensors {
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
        let clouds = |pick: fn(&TrainSample) -> &CloudInput| {
            CloudTensors::from_clouds(&samples.iter().map(pick).collect::<Vec<_>>(), config, device)
        };
        Self {
            query: clouds(|s| &s.query),
            reference: clouds(|s| &s.reference.cloud),
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
