//! The host side of the network's input: normalised clouds with everything that needs no gradient.

use nalgebra::Vector3;
use rand::Rng;
use unopose_core::{
    config::ModelConfig,
    frame::{Mask, MaskedView, RgbdFrame},
    geometry::{
        BallGroups, LocalFrames, Pose, StructureIndices, ball_groups, farthest_point_sampling,
        global_reference_frame, radius_about_mean, structure_indices,
    },
};

use crate::appearance::AppearanceView;

use super::{
    DataError,
    selection::{SampledView, SelectionOptions, select_query, select_reference},
};

/// Fewest query points at inference.
const MIN_POINTS: usize = 8;

/// One cloud of a pair as the network takes it.
#[derive(Clone, Debug)]
pub struct CloudInput {
    /// Masked, normalised crop, `[3, S, S]`.
    pub rgb: Vec<f32>,
    /// Index of every dense point in the S x S crop, `[N]`.
    pub choose: Vec<u32>,
    /// Dense points in the matching frame, radii, `[N]`.
    pub points: Vec<[f32; 3]>,
    /// Indices of the sparse points in `points`, `[M]`.
    pub sparse: Vec<u32>,
    /// Of the background point and the sparse points.
    pub structure: StructureIndices,
    /// Subtracted before the division by the radius, metres; zero with the quirk `uncentred_clouds`.
    pub center: [f32; 3],
    /// What poses are judged by besides the points, where the configuration asks for it.
    pub view: Option<AppearanceView>,
}

/// A reference view, prepared once for all its queries.
#[derive(Clone, Debug)]
pub struct PreparedReference {
    /// The view as the network takes it.
    pub cloud: CloudInput,
    /// Largest distance of the sampled reference points to their mean, metres.
    pub radius: f32,
    /// Neighbourhoods of the dense points at both scales of the positional encoding.
    pub groups: [BallGroups; 2],
}

/// Prepares a reference view.
pub fn prepare_reference(
    frame: &RgbdFrame,
    mask: &Mask,
    config: &ModelConfig,
    rng: &mut impl Rng,
) -> Result<PreparedReference, DataError> {
    let options = SelectionOptions {
        keep_zero_depth: config.quirks.keep_zero_depth,
        min_points: MIN_POINTS,
        color_augmentation: None,
    };
    let (selection, _) = select_reference(frame, mask, config, options, rng)?;
    let mut prepared = reference_from_points(&selection.points, &selection.choose, selection.rgb, config);
    prepared.cloud.view = view_of(frame, mask, config);
    Ok(prepared)
}

/// Prepares a query view against a reference of `radius` metres. Pixels without depth never count.
pub fn prepare_query(
    frame: &RgbdFrame,
    mask: &Mask,
    radius: f32,
    config: &ModelConfig,
    rng: &mut impl Rng,
) -> Result<CloudInput, DataError> {
    let options =
        SelectionOptions { keep_zero_depth: false, min_points: MIN_POINTS, color_augmentation: None };
    let SampledView { points, choose, rgb } = select_query(frame, mask, radius, config, options, rng)?;
    let cloud = query_from_points(&points, &choose, rgb, radius, config);
    Ok(CloudInput { view: view_of(frame, mask, config), ..cloud })
}

pub(super) fn view_of(frame: &RgbdFrame, mask: &Mask, config: &ModelConfig) -> Option<AppearanceView> {
    let wanted = config.hypotheses.uses_appearance();
    wanted.then(|| AppearanceView::new(MaskedView { frame, mask })).flatten()
}

/// Reference from sampled points (metres, camera frame) and their indices in the crop `rgb` (`[3, S, S]`).
///
/// # Panics
/// When there are not as many indices as points.
pub fn reference_from_points(
    points: &[[f32; 3]],
    choose: &[u32],
    rgb: Vec<f32>,
    config: &ModelConfig,
) -> PreparedReference {
    assert_eq!(points.len(), choose.len(), "crop indices per point");
    let (mean, radius) = radius_about_mean(points);
    let center = center_of(mean, config);
    let all = normalised(points, center, radius);
    let dense = farthest_point_sampling(&all, config.fine_points);
    let at = |i: u32| i as usize;
    let dense_points: Vec<[f32; 3]> = dense.iter().map(|&i| all[at(i)]).collect();
    let sparse = farthest_point_sampling(&dense_points, config.coarse_points);
    let structure_points: Vec<[f32; 3]> = if config.use_grf {
        let frame = global_reference_frame(points, config.quirks.counted_z_sign);
        // Quirk: the release looks up sparse indices in the order before farthest point sampling.
        let misaligned = config.quirks.misaligned_reference_grf;
        sparse.iter().map(|&i| frame[at(if misaligned { i } else { dense[at(i)] })]).collect()
    } else {
        sparse.iter().map(|&i| dense_points[at(i)]).collect()
    };
    let groups = positional_groups(&dense_points, config);
    let cloud = CloudInput {
        rgb,
        choose: dense.iter().map(|&i| choose[at(i)]).collect(),
        points: dense_points,
        structure: structure_of(&structure_points, config),
        sparse,
        center,
        view: None,
    };
    PreparedReference { cloud, radius, groups }
}

/// Query from sampled points (metres, camera frame) and their indices in the crop `rgb` (`[3, S, S]`); `radius` is
/// the reference's.
///
/// # Panics
/// When there are not as many indices as points.
pub fn query_from_points(
    points: &[[f32; 3]],
    choose: &[u32],
    rgb: Vec<f32>,
    radius: f32,
    config: &ModelConfig,
) -> CloudInput {
    assert_eq!(points.len(), choose.len(), "crop indices per point");
    let center = center_of(radius_about_mean(points).0, config);
    let dense_points = normalised(points, center, radius);
    let sparse = farthest_point_sampling(&dense_points, config.coarse_points);
    let frame;
    let structure_source = if config.use_grf {
        frame = global_reference_frame(points, config.quirks.counted_z_sign);
        &frame
    } else {
        &dense_points
    };
    let structure_points: Vec<[f32; 3]> = sparse.iter().map(|&i| structure_source[i as usize]).collect();
    CloudInput {
        rgb,
        choose: choose.to_vec(),
        structure: structure_of(&structure_points, config),
        points: dense_points,
        sparse,
        center,
        view: None,
    }
}

/// Neighbourhoods of every point (radii) at both scales of the positional encoding.
pub fn positional_groups(points: &[[f32; 3]], config: &ModelConfig) -> [BallGroups; 2] {
    let fine = &config.fine;
    let frames = fine.use_lrf.then(|| LocalFrames::of(&config.quirks));
    std::array::from_fn(|i| ball_groups(points, fine.pe_radii[i], fine.pe_samples[i], frames))
}

/// Pose between the cameras (metres) of a pose between the matching frames (radii).
pub fn metric_pose(
    normalised: &Pose,
    query_center: [f32; 3],
    reference_center: [f32; 3],
    radius: f32,
) -> Pose {
    let shift = Vector3::from(query_center.map(f64::from))
        - normalised.rotation * Vector3::from(reference_center.map(f64::from));
    Pose::new(normalised.rotation, normalised.translation * scale_of(radius) as f64 + shift)
}

/// Pose between the matching frames (radii) of a pose between the cameras (metres).
pub fn normalised_pose(
    metric: &Pose,
    query_center: [f32; 3],
    reference_center: [f32; 3],
    radius: f32,
) -> Pose {
    let shift = Vector3::from(query_center.map(f64::from))
        - metric.rotation * Vector3::from(reference_center.map(f64::from));
    Pose::new(metric.rotation, (metric.translation - shift) / scale_of(radius) as f64)
}

fn scale_of(radius: f32) -> f32 {
    radius + 1e-6
}

fn center_of(mean: [f32; 3], config: &ModelConfig) -> [f32; 3] {
    if config.quirks.uncentred_clouds { [0.0; 3] } else { mean }
}

fn normalised(points: &[[f32; 3]], center: [f32; 3], radius: f32) -> Vec<[f32; 3]> {
    let scale = scale_of(radius);
    points.iter().map(|p| std::array::from_fn(|i| (p[i] - center[i]) / scale)).collect()
}

/// Structure of the sparse points with the background point (1, 1, 1) in front.
fn structure_of(points: &[[f32; 3]], config: &ModelConfig) -> StructureIndices {
    let embedding = &config.geo_embedding;
    let with_background: Vec<[f32; 3]> = std::iter::once([1.0; 3]).chain(points.iter().copied()).collect();
    structure_indices(&with_background, embedding.sigma_d, embedding.sigma_a, embedding.angle_k)
}
