//! Training pairs: two views of the same object with the pose between them (`docs/network.md`, section 8).

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use rand::{Rng, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use unopose_core::{
    config::{DataConfig, ModelConfig},
    geometry::{BallGroups, Pose},
};
use unopose_dataset::formats::{
    AnnotatedFrame, FormatError, ObjectSymmetries,
    megapose::{InstanceRef, ShardDataset},
};

use super::{
    CloudInput, DataError, PreparedReference, SampleSource,
    augmentation::{AugmentedPair, augmented_pair},
    frame_cache::{CachedFrame, CachedInstance, FrameCache},
    label::{overlap_share, relative_pose},
    normalised_pose,
    pose_noise::{PoseNoise, draw_rotation_std},
    positional_groups,
    prepare::view_of,
    query_from_points, reference_from_points,
};

/// Rejected draws before a sample is given up.
const ATTEMPTS: usize = 64;
/// References tried per query.
const REFERENCE_ATTEMPTS: usize = 16;
/// Samples that share one deviation of the rotation noise, as in the release.
const NOISE_GROUP: u64 = 8;
/// Random stream of the noise groups, apart from the samples' streams.
const NOISE_STREAM: u64 = 1 << 63;

/// One prepared training pair.
#[derive(Clone, Debug)]
pub struct TrainSample {
    /// The query view; its dense points are in radii of the reference.
    pub query: CloudInput,
    /// The reference view with its neighbourhoods.
    pub reference: PreparedReference,
    /// Between the normalised matching frames: q = R p + t.
    pub t_query_reference: Pose,
    /// The same with noise: where the fine stage starts in training.
    pub t_init: Pose,
    /// Neighbourhoods of the query points moved by the inverse of `t_init`.
    pub query_groups: [BallGroups; 2],
    /// The instances that make the pair.
    pub key: PairKey,
}

/// Where a pair came from: image and instance numbers of the dataset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PairKey {
    /// Sample number.
    pub index: u64,
    /// Object that both views show.
    pub obj_id: u32,
    /// Number of the query's image in the dataset.
    pub query_image: u32,
    /// Index of the query in its image's annotation.
    pub query_instance: u32,
    /// Number of the reference's image in the dataset.
    pub reference_image: u32,
    /// Index of the reference in its image's annotation.
    pub reference_instance: u32,
}

/// Annotated images with an index of their instances.
pub trait FrameSource: Send + Sync {
    /// All instances that may be a query or a reference.
    fn instances(&self) -> &[InstanceRef];
    /// Indices into [`Self::instances`] of the views of an object that may serve as reference.
    fn references(&self, obj_id: u32) -> &[usize];
    /// Reads and decodes an image by its number in the dataset.
    fn load(&self, image: u32) -> Result<AnnotatedFrame, FormatError>;
    /// Symmetries of an object; none for an unknown one.
    fn symmetries(&self, obj_id: u32) -> &ObjectSymmetries;
}

impl FrameSource for ShardDataset {
    fn instances(&self) -> &[InstanceRef] {
        self.instances()
    }

    fn references(&self, obj_id: u32) -> &[usize] {
        self.references(obj_id)
    }

    fn load(&self, image: u32) -> Result<AnnotatedFrame, FormatError> {
        self.load(image)
    }

    fn symmetries(&self, obj_id: u32) -> &ObjectSymmetries {
        self.symmetries(obj_id)
    }
}

/// Draws and prepares pairs. A sample is a pure function of (seed, index, augment).
pub struct PairSampler {
    source: Arc<dyn FrameSource>,
    data: DataConfig,
    model: ModelConfig,
    seed: u64,
    /// Usable query instances of every image that has one.
    images: Vec<Vec<usize>>,
    cache: FrameCache,
    rejected: AtomicU64,
}

impl PairSampler {
    /// Fails when no instance has a reference.
    pub fn new(
        source: Arc<dyn FrameSource>,
        data: &DataConfig,
        model: &ModelConfig,
        seed: u64,
    ) -> Result<Self, DataError> {
        let mut sampler = Self {
            cache: FrameCache::new(data.cache_mib << 20),
            data: data.clone(),
            model: model.clone(),
            seed,
            images: Vec::new(),
            rejected: AtomicU64::new(0),
            source,
        };
        let mut by_image = std::collections::BTreeMap::<u32, Vec<usize>>::new();
        for (i, instance) in sampler.source.instances().iter().enumerate() {
            let visible = instance.visib_fract >= data.min_visible_fraction
                && instance.px_count_visib >= data.min_visible_pixels;
            if visible && sampler.reference_candidates(instance).next().is_some() {
                by_image.entry(instance.image).or_default().push(i);
            }
        }
        sampler.images = by_image.into_values().collect();
        if sampler.images.is_empty() { Err(DataError::NoPairs) } else { Ok(sampler) }
    }

    /// Number of images with a usable query.
    pub fn images(&self) -> usize {
        self.images.len()
    }

    /// Instances rejected so far (and replaced by others).
    pub fn rejected(&self) -> u64 {
        self.rejected.load(Ordering::Relaxed)
    }

    /// Pair number `index`; unusable instances and unreadable images are replaced by further draws of its stream.
    pub fn sample(&self, index: u64, augment: bool) -> Result<TrainSample, DataError> {
        let mut rng = self.stream(index);
        let mut last = DataError::NoPairs;
        for _ in 0..ATTEMPTS {
            match self.draw(index, augment, &mut rng) {
                Ok(sample) => return Ok(sample),
                Err(error) => {
                    tracing::debug!(index, %error, "instance rejected");
                    self.rejected.fetch_add(1, Ordering::Relaxed);
                    last = error;
                }
            }
        }
        Err(DataError::Exhausted { index, attempts: ATTEMPTS, last: Box::new(last) })
    }

    fn stream(&self, stream: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(stream);
        rng
    }

    fn reference_candidates<'a>(&'a self, query: &'a InstanceRef) -> impl Iterator<Item = &'a InstanceRef> {
        let instances = self.source.instances();
        let same_image = self.model.quirks.same_image_reference;
        let (least, pixels) = (self.data.min_reference_visible_fraction, self.data.min_visible_pixels);
        self.source
            .references(query.obj_id)
            .iter()
            .filter_map(|&i| instances.get(i))
            .filter(move |r| r.visib_fract >= least && r.px_count_visib >= pixels)
            .filter(move |r| same_image || r.image != query.image)
    }

    fn draw(&self, index: u64, augment: bool, rng: &mut ChaCha8Rng) -> Result<TrainSample, DataError> {
        let of_image = &self.images[rng.random_range(0..self.images.len())];
        let query = &self.source.instances()[of_image[rng.random_range(0..of_image.len())]];
        let query_frame = self.frame(query.image)?;
        let mut candidates: Vec<&InstanceRef> = self.reference_candidates(query).collect();
        let (tried, _) = candidates.partial_shuffle(rng, REFERENCE_ATTEMPTS);
        let mut problem = DataError::NoReference { obj_id: query.obj_id };
        for reference in tried {
            let reference_frame = self.frame(reference.image)?;
            let views = [instance(&query_frame, query)?, instance(&reference_frame, reference)?];
            let pose = self.label(views, query.obj_id);
            if pose.rotation_angle_deg(&Pose::identity()) > self.data.max_rotation_deg {
                continue;
            }
            let key = PairKey {
                index,
                obj_id: query.obj_id,
                query_image: query.image,
                query_instance: query.instance,
                reference_image: reference.image,
                reference_instance: reference.instance,
            };
            let frames = [&query_frame.frame, &reference_frame.frame];
            match augmented_pair(frames, views, pose, &self.data, &self.model, augment, rng) {
                Ok(pair) if self.overlaps(&pair) => {
                    let mut sample = self.prepare(pair, key, rng);
                    // Augmented points and colours are no longer those of the frames.
                    if !augment {
                        sample.query.view = view_of(frames[0], &views[0].mask(), &self.model);
                        sample.reference.cloud.view = view_of(frames[1], &views[1].mask(), &self.model);
                    }
                    return Ok(sample);
                }
                Ok(_) => {}
                Err(error) => problem = error,
            }
        }
        Err(problem)
    }

    fn frame(&self, image: u32) -> Result<Arc<CachedFrame>, FormatError> {
        self.cache.get(image, || self.source.load(image))
    }

    /// Reference camera to query camera, metres.
    fn label(&self, [query, reference]: [&CachedInstance; 2], obj_id: u32) -> Pose {
        let none = ObjectSymmetries::default();
        let ignored = self.model.quirks.same_image_reference;
        let symmetries = if ignored { &none } else { self.source.symmetries(obj_id) };
        relative_pose(&query.t_camera_object, &reference.t_camera_object, symmetries)
    }

    fn overlaps(&self, pair: &AugmentedPair) -> bool {
        let needed = self.data.min_overlap;
        let within = self.data.overlap_distance * pair.radius;
        needed <= 0.0
            || overlap_share(&pair.query.points, &pair.reference.points, &pair.pose, within) >= needed
    }

    fn prepare(&self, pair: AugmentedPair, key: PairKey, rng: &mut ChaCha8Rng) -> TrainSample {
        let AugmentedPair { query, reference, pose, .. } = pair;
        let reference =
            reference_from_points(&reference.points, &reference.choose, reference.rgb, &self.model);
        let query = query_from_points(&query.points, &query.choose, query.rgb, reference.radius, &self.model);
        let t_query_reference =
            normalised_pose(&pose, query.center, reference.cloud.center, reference.radius);
        let config = &self.data.pose_noise;
        let std = draw_rotation_std(config, &mut self.stream(NOISE_STREAM | (key.index / NOISE_GROUP)));
        let noise = PoseNoise::draw(config, std, rng);
        let t_init = noise.apply(&t_query_reference, config, self.model.quirks.clamp_noisy_translation);
        let t_reference_init = t_init.inverse();
        let moved: Vec<[f32; 3]> = query.points.iter().map(|p| t_reference_init.transform_f32(p)).collect();
        let query_groups = positional_groups(&moved, &self.model);
        TrainSample { query, reference, t_query_reference, t_init, query_groups, key }
    }
}

impl SampleSource for PairSampler {
    type Sample = TrainSample;

    fn training_sample(&self, index: u64) -> Result<TrainSample, DataError> {
        self.sample(index, true)
    }
}

fn instance<'a>(frame: &'a CachedFrame, wanted: &InstanceRef) -> Result<&'a CachedInstance, DataError> {
    frame
        .instances
        .get(wanted.instance as usize)
        .filter(|i| i.obj_id == wanted.obj_id)
        .ok_or(DataError::MissingInstance { image: wanted.image, instance: wanted.instance })
}
