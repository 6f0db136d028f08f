//! Distillation: the colour encoder learns the features of a vision transformer that has seen many photographs, and which
//! points of two views are the same, before it learns poses (`docs/network.md`, section 12).

mod picture;
mod teacher;
mod validation;
mod views;

use std::path::Path;

use burn::{module::Module, optim::GradientsParams};
use rayon::prelude::*;
use unopose_core::config::{ColorConfig, Config, ConfigError, ModelConfig, Precision};
use unopose_nn::{
    checkpoint::{self, TensorFile},
    model::Student,
};
use unopose_pairs::data::{PairSampler, TrainSample};

use super::{
    TrainError,
    bad_batch::describe_pair,
    datasets::Datasets,
    journal::ValidationRecord,
    options::{TrainOptions, TrainOutcome},
    replicas::{BatchGradients, join_losses, on_host, share_size, side_by_side},
    run::run,
    task::Task,
};
use teacher::Teacher;
use validation::FeatureValidation;
use views::PairViews;

/// Trains the colour encoder of `config` in `options.out` to give the features of the DINOv2 backbone in the file `teacher`,
/// or resumes the run there. `model.color.weights` of a pose network takes the result.
pub fn distil(config: &Config, options: &TrainOptions, teacher: &Path) -> Result<TrainOutcome, TrainError> {
    let wrong = |field: &str, value: String, expected: &str| {
        let (field, expected) = (field.to_owned(), expected.to_owned());
        Err(TrainError::Config(ConfigError::Range { field, value, expected }))
    };
    if !matches!(config.model.color, ColorConfig::Hybrid(_) | ColorConfig::Conv { .. }) {
        let kind = match config.model.color {
            ColorConfig::Vit(_) => "vit",
            _ => "none",
        };
        return wrong("model.color.kind", kind.into(), "hybrid or conv, an encoder that can be distilled");
    }
    if config.train.precision != Precision::F32 {
        let value = config.train.precision.to_string();
        return wrong("train.precision", value, "f32 for a distillation");
    }
    let teacher = Teacher::load(teacher, config, &options.device)?;
    run(config, options, |datasets| DistilTask::new(config, options, datasets, teacher))
}

/// The encoder with its map to the teacher.
struct DistilTask<'a> {
    config: &'a Config,
    options: &'a TrainOptions,
    datasets: Datasets,
    teacher: Teacher,
    preparation: ModelConfig,
    validation: FeatureValidation,
}

impl<'a> DistilTask<'a> {
    fn new(
        config: &'a Config,
        options: &'a TrainOptions,
        datasets: Datasets,
        teacher: Teacher,
    ) -> Result<Self, TrainError> {
        let preparation = Teacher::preparation(config);
        let sampler = datasets.validation_sampler(config, &preparation)?;
        let size = config.train.batch_size;
        let views = |first: usize| -> Result<PairViews, TrainError> {
            let last = (first + size).min(config.train.validation_pairs);
            let samples = (first..last).into_par_iter().map(|i| sampler.sample(i as u64, false));
            let samples = samples.collect::<Result<Vec<_>, _>>()?;
            Ok(PairViews::new(&samples, &teacher, &preparation, config, &options.device))
        };
        let batches =
            (0..config.train.validation_pairs).step_by(size).map(views).collect::<Result<_, _>>()?;
        let validation = FeatureValidation::new(batches);
        let [colors, features] = validation.yardsticks(config);
        options.observer.line(&format!(
            "area under the ROC curve of the validation pairs: raw colours {colors:.3}, teacher {features:.3}"
        ));
        Ok(Self { config, options, datasets, teacher, preparation, validation })
    }
}

impl Task for DistilTask<'_> {
    type Model = Student;
    type Sampler = PairSampler;

    fn network(&self) -> Student {
        let device = self.options.device.clone().autodiff();
        Student::new(&self.config.model, self.teacher.channels(), self.config.seed, &device)
    }

    fn initial_weights(&self, random: &Student) -> Result<Option<Student>, TrainError> {
        let Some(path) = &self.options.init else { return Ok(None) };
        Ok(Some(checkpoint::load_into(path, random.clone(), &self.config.model)?.0))
    }

    fn training_sampler(&self) -> Result<PairSampler, TrainError> {
        self.datasets.sampler_prepared_with(self.config, &self.preparation)
    }

    /// The teacher sees the whole batch with all threads, then each thread takes some of the pairs through a copy of the
    /// student.
    fn gradients(&self, student: &Student, samples: &[TrainSample]) -> BatchGradients {
        let device = &self.options.device;
        let all = PairViews::new(samples, &self.teacher, &self.preparation, self.config, device);
        let (count, size) = (samples.len(), share_size(samples.len(), device));
        let parts = (0..count).step_by(size).map(|first| {
            let views = all.part(first, size.min(count - first));
            (student.clone().fork(&device.clone().autodiff()), views)
        });
        let passed = side_by_side(parts.collect(), |(student, views): (Student, PairViews)| {
            let mut losses = views.losses(&student, views.features(&student), self.config);
            losses.total = losses.total * (views.len() as f64 / count as f64);
            let values = on_host(&losses);
            let gradients = (losses.total / self.config.train.accumulation as f64).backward();
            (values, GradientsParams::from_grads(gradients, &student))
        });
        let (mut losses, mut gradients) = (Vec::new(), Vec::new());
        for (values, own) in passed {
            join_losses(&mut losses, values);
            gradients.push(own);
        }
        BatchGradients { losses, gradients }
    }

    fn describe(&self, index: usize, sample: &TrainSample, file: &mut TensorFile) {
        describe_pair(index, sample, file);
    }

    fn validate(&self, student: &Student) -> Result<Option<ValidationRecord>, TrainError> {
        self.validation.run(student, self.config, self.options)
    }

    fn write_pictures(&self, student: &Student, out: &Path) -> Result<(), TrainError> {
        match self.validation.shown() {
            Some(views) => picture::write(&out.join("features.png"), student, views),
            None => Ok(()),
        }
    }
}
