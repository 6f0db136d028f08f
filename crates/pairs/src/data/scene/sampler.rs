//! The stream of training images.

use std::sync::Arc;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::{
    config::ProposalConfig,
    frame::{Mask, RgbdFrame},
};
use unopose_dataset::formats::{AnnotatedFrame, megapose::ShardDataset};

use super::{
    super::{DataError, color::augment_color, stream::SampleSource},
    SceneInput, SceneTarget,
};

/// Images tried for one sample.
const ATTEMPTS: usize = 16;

/// A training image.
#[derive(Clone, Debug)]
pub struct SceneSample {
    /// Number of the image in the dataset.
    pub image: u32,
    /// What the network sees.
    pub input: SceneInput,
    /// What it is to say.
    pub target: SceneTarget,
}

/// Draws and prepares images. A sample is a pure function of (seed, index).
pub struct SceneSampler {
    source: Arc<ShardDataset>,
    config: ProposalConfig,
    seed: u64,
}

impl SceneSampler {
    /// Of the images of `source`.
    pub fn new(source: Arc<ShardDataset>, config: &ProposalConfig, seed: u64) -> Self {
        Self { source, config: config.clone(), seed }
    }

    /// Number of images.
    pub fn images(&self) -> usize {
        self.source.image_keys().len()
    }

    /// The image of this number as it is, with its annotation.
    pub fn plain(&self, image: u32) -> Result<(SceneSample, AnnotatedFrame), DataError> {
        let annotated = self.source.load(image)?;
        let masks: Vec<&Mask> = annotated.instances.iter().map(|instance| &instance.mask_visib).collect();
        let sample = self.prepared(image, &annotated.frame, &masks)?;
        Ok((sample, annotated))
    }

    fn prepared(&self, image: u32, frame: &RgbdFrame, masks: &[&Mask]) -> Result<SceneSample, DataError> {
        let input = SceneInput::new(frame, self.config.width, self.config.height)?;
        let target = SceneTarget::new(&input, masks);
        Ok(SceneSample { image, input, target })
    }

    /// An image drawn at random, mirrored in half of the cases, its colours changed with the configured probability.
    fn draw(&self, rng: &mut ChaCha8Rng) -> Result<SceneSample, DataError> {
        let image = rng.random_range(0..self.images().max(1)) as u32;
        let (mirrored, recolored) = (rng.random_bool(0.5), rng.random_bool(self.config.color_probability));
        let AnnotatedFrame { mut frame, instances } = self.source.load(image)?;
        let mut masks: Vec<Mask> = instances.into_iter().map(|instance| instance.mask_visib).collect();
        if recolored {
            augment_color(&mut frame.rgb, rng);
        }
        if mirrored {
            frame = mirror(&frame);
            masks.iter_mut().for_each(|mask| mirror_rows(&mut mask.data, mask.width));
        }
        self.prepared(image, &frame, &masks.iter().collect::<Vec<_>>())
    }
}

impl SampleSource for SceneSampler {
    type Sample = SceneSample;

    /// Images that cannot be used are replaced by further draws of the sample's stream.
    fn training_sample(&self, index: u64) -> Result<SceneSample, DataError> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(index);
        let mut last = DataError::NoSceneDepth;
        for _ in 0..ATTEMPTS {
            match self.draw(&mut rng) {
                Ok(sample) => return Ok(sample),
                Err(error) => {
                    tracing::debug!(index, %error, "image rejected");
                    last = error;
                }
            }
        }
        Err(DataError::UnusableImages { index, attempts: ATTEMPTS, last: Box::new(last) })
    }
}

/// Left and right exchanged, the camera with them.
fn mirror(frame: &RgbdFrame) -> RgbdFrame {
    let mut intrinsics = frame.intrinsics;
    intrinsics.cx = f64::from(frame.width()) - 1.0 - intrinsics.cx;
    let mut depth = frame.depth.clone();
    mirror_rows(&mut depth.data, frame.width());
    RgbdFrame { rgb: image::imageops::flip_horizontal(&frame.rgb), depth, intrinsics }
}

fn mirror_rows<T>(data: &mut [T], width: u32) {
    data.chunks_exact_mut(width.max(1) as usize).for_each(<[T]>::reverse);
}

#[cfg(test)]
mod tests {
    use unopose_core::{frame::DepthMap, geometry::Intrinsics};

    use super::*;

    #[test]
    fn a_mirrored_view_has_mirrored_points() {
        let mut depth = DepthMap::zeros(8, 2);
        depth.data.iter_mut().enumerate().for_each(|(i, z)| *z = 0.5 + 0.01 * i as f32);
        let intrinsics = Intrinsics { fx: 10.0, fy: 10.0, cx: 2.0, cy: 1.0 };
        let frame = RgbdFrame { rgb: image::RgbImage::new(8, 2), depth, intrinsics };
        let mirrored = mirror(&frame);
        let points = |frame: &RgbdFrame| SceneInput::new(frame, 16, 16).unwrap().points;
        let (a, b) = (SceneInput::new(&frame, 8, 2).unwrap(), SceneInput::new(&mirrored, 8, 2).unwrap());
        for row in 0..2 {
            for col in 0..8 {
                let (p, q) = (a.points[row * 8 + col], b.points[row * 8 + 7 - col]);
                assert!((p[0] + q[0]).abs() < 1e-6 && p[1..] == q[1..], "{p:?} {q:?}");
            }
        }
        assert_eq!(points(&frame).len(), 256);
    }
}
