//! `unoinfer verify`.

use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;
use unopose_bench::verify::{Kind, ReferenceTensors, Subject, Tolerances, fit_config, guess_config, verify};
use unopose_cli::{DeviceOption, say, tell};
use unopose_core::config::{Config, EmbeddingEvaluation, Quirks};
use unopose_nn::checkpoint::{self, OfficialState};

#[derive(Args)]
pub struct VerifyArguments {
    /// Weights: official state (safetensors, or PyTorch .pth/.pt), or a checkpoint of unotrain
    #[arg(long, value_name = "FILE")]
    weights: PathBuf,
    /// Inputs and expected tensors of an evaluation or a training step (safetensors)
    #[arg(long, value_name = "FILE")]
    tensors: PathBuf,
    /// Configuration: TOML, or the official config.json [default: the one inside the weights, else config.json beside
    /// them, else the release's with the sizes of weights and tensors]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Bounds by tensor name, before the built-in ones: {"pred_t": 1e-5, "grad.*": {"relative_l2": 0.05, "cosine":
    /// 0.999}}
    #[arg(long, value_name = "JSON")]
    tolerances: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceOption,
}

pub fn run(arguments: &VerifyArguments) -> anyhow::Result<()> {
    let tensors = ReferenceTensors::read(&arguments.tensors)?;
    let tolerances = match &arguments.tolerances {
        Some(path) => Tolerances::with_file(path)?,
        None => Tolerances::built_in(),
    };
    let (device, backend) = arguments.device.choice().open()?;
    let tolerances = tolerances.for_backend(backend);
    let device = match Kind::of(&tensors)? {
        Kind::Evaluation => device,
        Kind::Training => device.autodiff(),
    };
    let inside = checkpoint::read_config(&arguments.weights).ok();
    let beside = arguments.weights.with_file_name("config.json");
    let official = OfficialState::read(&arguments.weights)?;
    official.notices.iter().for_each(|notice| tell!("{notice}"));
    let mut config = match (&arguments.config, inside) {
        (Some(path), _) => read_config(path)?,
        (None, Some(inside)) => inside,
        (None, None) if beside.exists() => {
            tell!("configuration: {}", beside.display());
            read_config(&beside)?
        }
        (None, None) => {
            tell!("no configuration: the release's, with the sizes of weights and tensors");
            let mut config = Config::default();
            config.model.quirks = Quirks::release();
            official.sizes().apply(&mut config.model);
            guess_config(&mut config.model, &tensors);
            config
        }
    };
    // Reference tensors are those of the plain formula.
    config.model.geo_embedding.evaluation = EmbeddingEvaluation::Exact;
    let model_config = fit_config(&config.model, &tensors)?;
    if !official.unused.is_empty() {
        tell!("stored but not used: {}", official.unused.join(", "));
    }
    let batches_tracked = official.batches_tracked.clone();
    let model = official.into_model(&model_config, &device)?;
    let subject = Subject {
        model: &model,
        config: &model_config,
        loss: &config.loss,
        batches_tracked: &batches_tracked,
    };
    let report = verify(&subject, &tensors, &tolerances, &device)?;
    say!("{report}");
    if !report.passes() {
        bail!("{} does not reproduce {}", arguments.weights.display(), arguments.tensors.display());
    }
    Ok(())
}

fn read_config(path: &Path) -> anyhow::Result<Config> {
    let is_json = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
    Ok(if is_json { Config::load_official(path)? } else { Config::load(path, &[])? })
}
