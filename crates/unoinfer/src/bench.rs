//! `unoinfer bench`.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    sync::Mutex,
};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use unopose_bench::{
    DetectionSource, INGREDIENTS, ListRequest, Method, Network, OwnMasks, PreparedList, Suite, UnoSegMasks,
    pairs_table, run_pairs, run_sequence, sequence_table,
};
use unopose_cli::{DeviceOption, print_text, say, tell};
use unopose_dataset::{
    formats::PhoneSequence,
    protocol::{Protocol, REFERENCE_COUNTS},
};
use unopose_infer::{PoseEstimator, Refinement};
use unopose_pairs::registration::{CLASSICAL_METHODS, classical_method};
use unopose_segment::{AnyMatcher, Matcher, ProposalGenerator};

use super::{
    options::SplitOptions,
    progress::ProgressDisplay,
    proposals::{FOR_UNOSEG, check_sam_points, default_source, generator},
    score::print_unused,
    segment_dataset::{DatasetFiles, NOT_SCORED, segment_dataset},
};

/// Name of the network among the methods.
const NETWORK: &str = "unopose";

/// Which view is the reference of which target.
#[derive(Clone, Copy, ValueEnum)]
enum ProtocolName {
    /// A view at most 50 degrees away (the main experiment)
    Rot50,
    /// At most 50 degrees away, from another scene
    CrossScene,
    /// Up to 90 degrees away in nine bins, with the overlap ratio
    RotationBins,
    /// One view for all targets of an object
    OnePerObject,
    /// The nearest of 8, 12, 16, 32 and 42 views per object (--counts), one table each
    References,
    /// As rot50, with the reference images rendered from the models
    Rendered,
    /// A phone sequence (WildRGB-D layout) as --dataset: one frame is the reference of the others
    Sequence,
    /// Single pairs of views with known relative poses, without models (--list)
    Pairs,
}

#[derive(Args)]
pub struct BenchArguments {
    /// Protocol
    #[arg(value_enum, default_value = "rot50")]
    protocol: ProtocolName,
    /// BOP dataset folder, or the folder of a sequence
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    dataset: Option<PathBuf>,
    /// Pairs of the protocol pairs: JSON with object, reference, query (folders beside it with rgb, depth, camera.json and
    /// mask_OBJECT) and T_query_reference (R row by row, t in metres); with `+` in symmetry only the shape counts
    #[arg(long, value_name = "JSON", conflicts_with = "dataset")]
    list: Option<PathBuf>,
    /// Targets with their reference views: scene_id, im_id, obj_id, ref_scene_id, ref_im_id [default: the dataset's
    /// test_ref_targets_PROTOCOL.json, else a list that is built and written to --out]
    #[arg(long, value_name = "JSON")]
    targets: Option<PathBuf>,
    /// Masks: gt (annotated visible masks), unoseg (found for --targets as `segment` does, by --descriptor or the first
    /// checkpoint; kept in OUT/segmentation; with --list found in each query), or a file with scene_id, image_id, category_id, bbox, score, time, segmentation
    #[arg(long, value_name = "gt|unoseg|JSON", default_value = "gt")]
    detections: DetectionSource,
    /// Proposals of unoseg, several separated by commas for a table of each in OUT/PROPOSALS: embedded (from depth and
    /// colour), learned (of a network), both, weights of Segment Anything or MobileSAM, or a list of masks of another
    /// segmenter in the COCO/BOP form [default: both]
    #[arg(long, value_name = "SOURCES", value_delimiter = ',')]
    proposals: Vec<String>,
    /// With weights of Segment Anything: clicks per side of its grid [default: 32]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=128))]
    sam_points: Option<u16>,
    /// DINOv2 weights by which unoseg compares proposals with the reference [default: the first checkpoint compares]
    #[arg(long, value_name = "FILE")]
    descriptor: Option<PathBuf>,
    /// Methods, separated by commas: aligncenter, fpfh-ransac, fpfh-mac, ppf, unopose; or all
    #[arg(long, value_delimiter = ',', default_value = "all")]
    methods: Vec<String>,
    /// Refinements after every method, separated by commas: none, icp, gicp (local, at most 30 mm and 15 degrees)
    #[arg(long, value_delimiter = ',', default_value = "none")]
    refine: Vec<Refinement>,
    /// Folder for the tables, the page and the results from which a later call resumes
    #[arg(long, value_name = "DIR", default_value = "bench")]
    out: PathBuf,
    #[command(flatten)]
    splits: SplitOptions,
    /// Targets that recall counts [default: those of the list]
    #[arg(long, value_name = "JSON")]
    score_targets: Option<PathBuf>,
    /// Only the first N entries of every list
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    /// Numbers of references per object of the protocol references
    #[arg(long, value_delimiter = ',', default_values_t = REFERENCE_COUNTS)]
    counts: Vec<usize>,
    /// Reference frame of a sequence [default: the first]
    #[arg(long, value_name = "ID")]
    reference_frame: Option<u32>,
    /// Use every N-th frame of a sequence as a query
    #[arg(long, value_name = "N", default_value_t = 1)]
    frame_step: usize,
    /// Weights of the network, several separated by commas [default: as for estimate]
    #[arg(long, value_name = "FILE", value_delimiter = ',')]
    checkpoint: Vec<PathBuf>,
    /// A table of the networks with these ingredients as columns, separated by commas: grf, lrf, fine, overlap
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = INGREDIENTS)]
    ablation: Vec<String>,
    #[command(flatten)]
    device: DeviceOption,
    /// Seed of the references' choice, the network's sampling and the confidence intervals
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

impl BenchArguments {
    fn dataset(&self) -> anyhow::Result<&Path> {
        self.dataset.as_deref().context("--dataset is missing")
    }
}

pub fn run(arguments: &BenchArguments) -> anyhow::Result<()> {
    let methods = methods(arguments)?;
    let pairs = matches!(arguments.protocol, ProtocolName::Pairs);
    match (&arguments.list, pairs) {
        (Some(list), true) => return view_pairs(arguments, list, &methods),
        (None, true) => bail!("the protocol pairs needs its pairs as --list"),
        (Some(list), false) => bail!("--list {}: for the protocol pairs", list.display()),
        (None, false) => {}
    }
    if matches!(arguments.protocol, ProtocolName::Sequence) {
        return sequence(arguments, &methods);
    }
    let shown: Mutex<Option<(String, ProgressDisplay)>> = Mutex::new(None);
    let suite = Suite {
        methods: &methods,
        refinements: &arguments.refine,
        ablation: &arguments.ablation,
        cache: &arguments.out.join("results"),
        score_targets: arguments.score_targets.as_deref(),
        seed: arguments.seed,
        progress: &|label, done, total| show(&shown, label, done, total),
    };
    let (unoseg, sources) = detection_sources(arguments)?;
    for detections in sources {
        let folder = match &detections {
            DetectionSource::UnoSeg(masks) if unoseg.len() > 1 => arguments.out.join(&masks.proposals),
            _ => arguments.out.clone(),
        };
        let request = ListRequest {
            splits: arguments.splits.of(arguments.dataset()?),
            targets: arguments.targets.clone(),
            detections,
            limit: arguments.limit,
            seed: arguments.seed,
            rendered: matches!(arguments.protocol, ProtocolName::Rendered),
        };
        let mut lists = request.prepare(&protocols(arguments), &folder)?;
        lists.iter_mut().for_each(|prepared| prepared.facts.unoseg_masks = unoseg.clone());
        run_lists(&suite, &lists, &folder)?;
    }
    Ok(())
}

/// All methods on every list; several have folders of their own.
fn run_lists(suite: &Suite<'_>, lists: &[PreparedList], folder: &Path) -> anyhow::Result<()> {
    for prepared in lists {
        let name = &prepared.facts.list;
        tell!("{name}: {} targets", prepared.list.targets.len());
        print_unused(&prepared.list);
        let folder = if lists.len() > 1 { folder.join(name) } else { folder.to_owned() };
        suite.run(&prepared.list, &prepared.facts, &folder)?;
        for table in ["table.md", "ablation.md"] {
            let path = folder.join(table);
            if path.is_file() {
                say!("{}", std::fs::read_to_string(path)?);
            }
        }
        say!("{}", folder.join("index.html").display());
    }
    Ok(())
}

/// Masks of UNOSeg where they are asked for, and the sources of detections to run with, one after the other.
fn detection_sources(
    arguments: &BenchArguments,
) -> anyhow::Result<(Vec<UnoSegMasks>, Vec<DetectionSource<UnoSegMasks>>)> {
    let given = match &arguments.detections {
        DetectionSource::GroundTruth => DetectionSource::GroundTruth,
        DetectionSource::File(path) => DetectionSource::File(path.clone()),
        DetectionSource::UnoSeg(()) => {
            let masks = unoseg_masks(arguments)?;
            let sources = masks.iter().cloned().map(DetectionSource::UnoSeg).collect();
            return Ok((masks, sources));
        }
    };
    if arguments.descriptor.is_some() || !arguments.proposals.is_empty() || arguments.sam_points.is_some() {
        bail!(FOR_UNOSEG);
    }
    Ok((Vec::new(), vec![given]))
}

/// Detections of the targets by UNOSeg with every source of proposals, from the references and splits that
/// the poses get.
fn unoseg_masks(arguments: &BenchArguments) -> anyhow::Result<Vec<UnoSegMasks>> {
    let targets = arguments.targets.clone().context("--detections unoseg needs the list as --targets")?;
    if matches!(arguments.protocol, ProtocolName::Rendered) {
        bail!("--detections unoseg takes the real reference images, not those of the protocol rendered");
    }
    let sources: Vec<&str> = match arguments.proposals.as_slice() {
        [] => vec![default_source()],
        sources => sources.iter().map(String::as_str).collect(),
    };
    check_sam_points(arguments.sam_points, &sources)?;
    let device = arguments.device.choice();
    let sources = sources.into_iter().map(|source| generator(source, arguments.sam_points, device));
    let sources: Vec<_> = sources.collect::<Result<_, _>>()?;
    let names: BTreeSet<String> = sources.iter().map(|source| source.name()).collect();
    if names.len() < sources.len() {
        bail!("--proposals has several sources of one name among {names:?}, expected different ones");
    }
    let mut splits = arguments.splits.of(arguments.dataset()?);
    if splits.reference_split.is_none() {
        splits.reference_split = splits.open()?.reference_split_name().map(str::to_owned);
    }
    let files = DatasetFiles { splits, targets, limit: arguments.limit, templates: None };
    let estimator = first_estimator(arguments)?;
    let matcher = AnyMatcher::choose(arguments.descriptor.as_deref(), &estimator)?;
    let dataset = arguments.dataset()?;
    let found = |source: &dyn ProposalGenerator| {
        let out = arguments.out.join("segmentation").join(source.name());
        let (detections, scores) = segment_dataset(&files, source, &matcher, &out)?;
        let scores = scores.with_context(|| format!("{}: {NOT_SCORED}", dataset.display()))?;
        Ok(UnoSegMasks { proposals: source.name(), matcher: matcher.name(), scores, detections })
    };
    sources.iter().map(|source| found(source.as_ref())).collect()
}

/// The network that compares proposals with references.
fn first_estimator(arguments: &BenchArguments) -> anyhow::Result<PoseEstimator> {
    let device = arguments.device.choice();
    let estimator = match arguments.checkpoint.first() {
        Some(path) => PoseEstimator::load(path, device)?,
        None => PoseEstimator::load_default(device)?,
    };
    Ok(estimator.with_seed(arguments.seed))
}

fn sequence(arguments: &BenchArguments, methods: &[Method]) -> anyhow::Result<()> {
    let sequence = PhoneSequence::open(arguments.dataset()?)?;
    let first = sequence.frame_ids().next().unwrap_or_default();
    let reference = arguments.reference_frame.unwrap_or(first);
    let step = arguments.frame_step;
    let runs = run_sequence(&sequence, reference, step, methods, &arguments.refine, &arguments.out)?;
    print_text(&sequence_table(&sequence.name(), reference, &runs));
    Ok(())
}

fn view_pairs(arguments: &BenchArguments, list: &Path, methods: &[Method]) -> anyhow::Result<()> {
    let shown: Mutex<Option<(String, ProgressDisplay)>> = Mutex::new(None);
    let progress = |label: &str, done, total| show(&shown, label, done, total);
    let run = |own_masks: Option<&OwnMasks<'_>>| -> anyhow::Result<()> {
        let runs = run_pairs(list, own_masks, methods, &arguments.refine, &arguments.out, &progress)?;
        print_text(&pairs_table(&runs));
        Ok(())
    };
    match &arguments.detections {
        DetectionSource::GroundTruth => run(None),
        DetectionSource::File(path) => {
            bail!("--detections {}: expected gt or unoseg for pairs", path.display())
        }
        DetectionSource::UnoSeg(()) => {
            let source = match arguments.proposals.as_slice() {
                [] => default_source(),
                [source] => source,
                several => bail!("--proposals has {} sources, expected one for pairs", several.len()),
            };
            check_sam_points(arguments.sam_points, &[source])?;
            let generator = generator(source, arguments.sam_points, arguments.device.choice())?;
            let estimator = first_estimator(arguments)?;
            let matcher = AnyMatcher::choose(arguments.descriptor.as_deref(), &estimator)?;
            run(Some(&OwnMasks { generator: generator.as_ref(), matcher: &matcher }))
        }
    }
}

fn protocols(arguments: &BenchArguments) -> Vec<Protocol> {
    match arguments.protocol {
        ProtocolName::Rot50 | ProtocolName::Rendered | ProtocolName::Sequence | ProtocolName::Pairs => {
            vec![Protocol::Rot50]
        }
        ProtocolName::CrossScene => vec![Protocol::CrossScene],
        ProtocolName::RotationBins => vec![Protocol::Rot90],
        ProtocolName::OnePerObject => vec![Protocol::OnePerObject],
        ProtocolName::References => arguments.counts.iter().map(|&n| Protocol::FewPerObject(n)).collect(),
    }
}

/// One bar at a time, a new one when the label changes.
fn show(shown: &Mutex<Option<(String, ProgressDisplay)>>, label: &str, done: usize, total: usize) {
    let Ok(mut shown) = shown.lock() else { return };
    if shown.as_ref().is_none_or(|(current, _)| current != label) {
        if let Some((_, bar)) = shown.take() {
            bar.finish();
        }
        *shown = Some((label.to_owned(), ProgressDisplay::new(label)));
    }
    if let Some((_, bar)) = shown.as_ref() {
        bar.set(done, total);
        if done == total {
            bar.finish();
        }
    }
}

fn methods(arguments: &BenchArguments) -> anyhow::Result<Vec<Method>> {
    let all = arguments.methods.iter().any(|name| name == "all");
    let names: Vec<&str> = if all {
        CLASSICAL_METHODS.into_iter().chain([NETWORK]).collect()
    } else {
        arguments.methods.iter().map(String::as_str).collect()
    };
    let mut methods = Vec::new();
    for name in names {
        if name != NETWORK {
            methods.push(Method { estimator: classical_method(name)?, switches: None });
            continue;
        }
        let paths: Vec<_> = arguments.checkpoint.iter().map(|path| Some(path.as_path())).collect();
        let paths = if paths.is_empty() { vec![None] } else { paths };
        for path in &paths {
            let network = Network::load(*path, arguments.device.choice(), arguments.seed, paths.len() > 1)?;
            let switches = Some(network.switches());
            methods.push(Method { estimator: Box::new(network), switches });
        }
    }
    Ok(methods)
}
