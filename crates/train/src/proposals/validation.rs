//! How well the network's instances cover the objects of images that it is not trained on.

use std::sync::Arc;

use unopose_core::config::Config;
use unopose_dataset::formats::megapose::ShardDataset;
use unopose_nn::{
    loss::{SceneBatch, proposal_losses},
    model::ProposalNetwork,
};
use unopose_pairs::data::{ProposalMaps, SceneInstance, SceneSample, SceneSampler, scene_instances};

use crate::{
    TrainError,
    journal::{ProposalRecall, ValidationRecord},
    observer::{Phase, PhaseExtent},
    options::TrainOptions,
};

/// Smallest visible share of an object that counts.
const LEAST_VISIBLE: f64 = 0.1;

/// Images spread evenly over the validation set, read when they are needed.
pub struct SceneValidation {
    sampler: SceneSampler,
    images: Vec<u32>,
}

impl SceneValidation {
    /// `train.validation_pairs` images of `source`, all where there are fewer.
    pub fn new(config: &Config, source: Arc<ShardDataset>) -> Result<Self, TrainError> {
        let sampler = SceneSampler::new(source, &config.proposals, config.seed);
        let (all, count) = (sampler.images(), config.train.validation_pairs.min(sampler.images()));
        let images = (0..count).map(|i| (i * all / count.max(1)) as u32).collect();
        Ok(Self { sampler, images })
    }

    /// The images that pictures show.
    pub fn shown(&self, count: usize) -> Result<Vec<SceneSample>, TrainError> {
        self.images.iter().take(count).map(|&image| Ok(self.sampler.plain(image)?.0)).collect()
    }

    /// Losses and recall of a network without autodiff; `None` when interrupted.
    pub fn run(
        &self,
        network: &ProposalNetwork,
        config: &Config,
        options: &TrainOptions,
    ) -> Result<Option<ValidationRecord>, TrainError> {
        options.observer.begin(Phase::Validation, PhaseExtent::new(0, self.images.len() as u64));
        let (mut loss, mut overlaps, mut proposals) = (0.0, Vec::new(), 0);
        for (done, &image) in self.images.iter().enumerate() {
            if options.interrupt.is_requested() {
                options.observer.end(Phase::Validation);
                return Ok(None);
            }
            let (sample, annotated) = self.sampler.plain(image)?;
            let (value, maps) = judged(network, &sample, config, options);
            let found = scene_instances(&sample.input, &maps);
            let objects: Vec<u32> = (1u32..)
                .zip(&annotated.instances)
                .filter_map(|(number, instance)| (instance.visib_fract >= LEAST_VISIBLE).then_some(number))
                .collect();
            loss += value;
            proposals += found.len();
            overlaps.extend(best_overlaps(&sample.target.instances, &objects, &found));
            options.observer.advance(Phase::Validation, (done + 1) as u64, "");
        }
        options.observer.end(Phase::Validation);
        let images = self.images.len().max(1) as f64;
        Ok(Some(ValidationRecord {
            pairs: self.images.len(),
            loss: loss / images,
            proposals: Some(recall(&overlaps, proposals as f64 / images)),
            ..ValidationRecord::default()
        }))
    }
}

fn judged(
    network: &ProposalNetwork,
    sample: &SceneSample,
    config: &Config,
    options: &TrainOptions,
) -> (f64, ProposalMaps) {
    let batch = SceneBatch::new(std::iter::once((&sample.input, &sample.target)), &options.device);
    let output = network.forward(batch.input.clone());
    let losses = proposal_losses(&config.proposals, &output, &batch);
    (f64::from(losses.total.into_scalar::<f32>()), output.maps(0))
}

/// Largest overlap of each object that is on the grid with any candidate.
fn best_overlaps(instances: &[u32], objects: &[u32], found: &[SceneInstance]) -> Vec<f64> {
    let of_object = |&object: &u32| {
        let size = instances.iter().filter(|&&i| i == object).count();
        let overlap = |candidate: &SceneInstance| {
            let common = candidate.cells.iter().filter(|&&cell| instances[cell as usize] == object).count();
            common as f64 / (size + candidate.cells.len() - common) as f64
        };
        (size > 0).then(|| found.iter().map(overlap).fold(0.0, f64::max))
    };
    objects.iter().filter_map(of_object).collect()
}

fn recall(overlaps: &[f64], proposals: f64) -> ProposalRecall {
    let count = overlaps.len().max(1) as f64;
    let share = |least: f64| overlaps.iter().filter(|&&overlap| overlap >= least).count() as f64 / count;
    ProposalRecall {
        objects: overlaps.len(),
        recall_50: share(0.5),
        recall_75: share(0.75),
        mean_iou: overlaps.iter().sum::<f64>() / count,
        proposals,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recall_of_known_overlaps() {
        // Object 1 on cells 0..4, object 2 on 4..6, object 3 nowhere.
        let instances = [1, 1, 1, 1, 2, 2, 0, 0];
        let candidate = |cells: &[u32]| SceneInstance { cells: cells.to_vec(), score: 1.0 };
        let found = [candidate(&[0, 1, 2]), candidate(&[0, 1]), candidate(&[3, 4, 5, 6])];
        let overlaps = best_overlaps(&instances, &[1, 2, 3], &found);
        assert_eq!(overlaps, [0.75, 0.5]);
        let recall = recall(&overlaps, 3.0);
        assert_eq!(
            (recall.objects, recall.recall_50, recall.recall_75, recall.mean_iou),
            (2, 1.0, 0.5, 0.625)
        );
    }
}
