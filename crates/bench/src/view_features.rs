//! How well colour encoders tell the points of real views apart, without any pose network.

use std::{io::Write as _, path::Path};

use burn::tensor::{Device, Tensor};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use unopose_core::{config::ModelConfig, files::write_atomic, frame::MaskedView, geometry::Pose};
use unopose_dataset::formats::files::write_json;
use unopose_eval::metrics::{FeatureSimilarity, match_area};
use unopose_nn::{
    checkpoint::{self, load_transformer},
    model::{UnoPose, ViewTensors, VisionTransformer},
};
use unopose_pairs::data::{CloudInput, PreparedReference, prepare_query, prepare_reference};

use super::{BenchError, view_list::PairViews};

/// Points per view.
const POINTS: usize = 256;
/// Points at most this far apart, in radii of the object, are the same.
const NEAR: f32 = 0.15;
/// Side of a vision transformer's crops, pixels.
const TRANSFORMER_SIZE: usize = 224;

/// What gives features of points.
pub struct FeatureSource {
    name: String,
    network: Network,
    /// With what views are prepared for it.
    config: ModelConfig,
}

enum Network {
    /// The pixels themselves.
    Colors,
    /// Of a checkpoint, a whole network's or a distilled one.
    Encoder(Box<UnoPose>),
    /// DINOv2, read after so many blocks.
    Transformer(Box<VisionTransformer>, usize),
}

/// Areas of one pair.
#[derive(Clone, Debug, Serialize)]
pub struct PairAreas {
    /// Object, reference and query of the list.
    pub object: String,
    /// Folder of the reference view.
    pub reference: String,
    /// Folder of the query view.
    pub query: String,
    /// Rotation between the views, degrees.
    pub true_rotation_deg: f64,
    /// [`match_area`] of every source, in their order; `None` where the views share no surface.
    pub areas: Vec<Option<f64>>,
}

impl FeatureSource {
    /// Colours, compared by their distance.
    pub fn colors() -> Self {
        let config = ModelConfig { image_size: TRANSFORMER_SIZE, ..small(ModelConfig::default()) };
        Self { name: "colours".into(), network: Network::Colors, config }
    }

    /// The colour encoder of a checkpoint.
    pub fn encoder(path: &Path, device: &Device) -> Result<Self, BenchError> {
        let config = checkpoint::read_config(path)?;
        let model = UnoPose::new(&config.model, config.seed, device);
        let model = checkpoint::load_encoder(path, &config.model, model)?;
        let network = Network::Encoder(Box::new(model));
        Ok(Self { name: stem(path), network, config: small(config.model) })
    }

    /// The patch tokens of DINOv2 weights after so many of their blocks, three quarters of them unless given; crops of 224 pixels.
    pub fn transformer(path: &Path, blocks: Option<usize>, device: &Device) -> Result<Self, BenchError> {
        let network = load_transformer(path, TRANSFORMER_SIZE, device)?;
        let depth = network.depth();
        let blocks = blocks.unwrap_or(depth * 3 / 4);
        if blocks > depth {
            return Err(BenchError::Blocks { path: path.to_owned(), blocks, depth });
        }
        let name = format!("{} block {blocks}", stem(path));
        Ok(Self { name, network: Network::Transformer(Box::new(network), blocks), ..Self::colors() })
    }

    /// Short name, that of the file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Features of a cloud's first points, rows of the returned number of channels.
    fn features(&self, cloud: &CloudInput, device: &Device) -> (Vec<f32>, usize) {
        let view = ViewTensors::new(&[cloud], &self.config, device);
        let choose = view.choose.first(POINTS);
        let size = self.config.image_size;
        let features: Tensor<3> = match &self.network {
            Network::Colors => {
                let pixels = view.images.permute([0, 2, 3, 1]).reshape([1, size * size, 3]);
                choose.sample_grid(pixels, size)
            }
            Network::Encoder(model) => model.feature_extraction.forward(view.images, &choose),
            Network::Transformer(network, blocks) => {
                choose.sample_grid(network.tokens_after(view.images, *blocks), size)
            }
        };
        let channels = features.dims()[2];
        (features.into_data().iter::<f32>().collect(), channels)
    }

    fn similarity(&self) -> FeatureSimilarity {
        match self.network {
            Network::Colors => FeatureSimilarity::Distance,
            _ => FeatureSimilarity::Cosine,
        }
    }

    fn area(
        &self,
        [reference, query]: [MaskedView<'_>; 2],
        truth: &Pose,
        device: &Device,
    ) -> Result<Option<f64>, BenchError> {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let PreparedReference { cloud: reference, radius, .. } =
            prepare_reference(reference.frame, reference.mask, &self.config, rng)?;
        let query = prepare_query(query.frame, query.mask, radius, &self.config, rng)?;
        let back = truth.inverse();
        let own: Vec<[f32; 3]> = metric(&query, radius).iter().map(|p| back.transform_f32(p)).collect();
        let others = metric(&reference, radius);
        let distance = |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>().sqrt();
        let distances: Vec<f32> =
            own.iter().flat_map(|p| others.iter().map(move |q| distance(p, q) / radius)).collect();
        let [(query, channels), (reference, _)] =
            [&query, &reference].map(|cloud| self.features(cloud, device));
        Ok(match_area([&query, &reference], channels, &distances, NEAR, self.similarity()))
    }
}

fn stem(path: &Path) -> String {
    path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

/// As many points as are compared, and nothing that only poses need.
fn small(config: ModelConfig) -> ModelConfig {
    ModelConfig { use_fine: false, hypotheses: Default::default(), ..config }
}

/// The first points in their camera, metres.
fn metric(cloud: &CloudInput, radius: f32) -> Vec<[f32; 3]> {
    let place = |p: &[f32; 3]| std::array::from_fn(|i| p[i] * (radius + 1e-6) + cloud.center[i]);
    cloud.points.iter().take(POINTS).map(place).collect()
}

/// Measures every source on a list of pairs (as [`run_pairs`](super::run_pairs) takes it). Writes `features.json` and
/// `features.md`.
pub fn measure_features(
    list: &Path,
    sources: &[FeatureSource],
    device: &Device,
    folder: &Path,
    progress: &dyn Fn(usize, usize),
) -> Result<Vec<PairAreas>, BenchError> {
    let mut pairs = PairViews::open(list, None)?;
    let mut measured = Vec::new();
    for index in 0..pairs.len() {
        progress(index, pairs.len());
        let pair = pairs.pair(index)?;
        // None are to be found, so the list's masks are there.
        let Ok(mask) = &pair.query_mask else { continue };
        let (frame, reference_mask) = &pair.reference;
        let views = [MaskedView { frame, mask: reference_mask }, MaskedView { frame: &pair.query, mask }];
        let areas = sources.iter().map(|source| source.area(views, &pair.truth, device));
        measured.push(PairAreas {
            object: pair.listed.object.clone(),
            reference: pair.listed.reference.clone(),
            query: pair.listed.query.clone(),
            true_rotation_deg: pair.truth.rotation_angle_deg(&Pose::identity()),
            areas: areas.collect::<Result<_, _>>()?,
        });
    }
    progress(pairs.len(), pairs.len());
    write_json(&folder.join("features.json"), &measured, true)?;
    let text = features_table(sources, &measured);
    write_atomic(&folder.join("features.md"), |out| out.write_all(text.as_bytes()))?;
    Ok(measured)
}

/// A row per pair and their mean.
pub fn features_table(sources: &[FeatureSource], pairs: &[PairAreas]) -> String {
    let names: Vec<&str> = sources.iter().map(FeatureSource::name).collect();
    let mut text = format!(
        "| object | query | rotation | {} |\n|--|--|--|{}\n",
        names.join(" | "),
        "--|".repeat(names.len())
    );
    let cell = |area: Option<f64>| area.map_or("-".into(), |area| format!("{area:.3}"));
    for pair in pairs {
        let areas: Vec<String> = pair.areas.iter().map(|&area| cell(area)).collect();
        text += &format!(
            "| {} | {} | {:.0} | {} |\n",
            pair.object,
            pair.query,
            pair.true_rotation_deg,
            areas.join(" | ")
        );
    }
    let mean = |source: usize| {
        let known: Vec<f64> = pairs.iter().filter_map(|pair| pair.areas[source]).collect();
        (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
    };
    let means: Vec<String> = (0..sources.len()).map(|source| cell(mean(source))).collect();
    text + &format!("| mean | | | {} |\n", means.join(" | "))
}
