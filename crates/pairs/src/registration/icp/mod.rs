//! Local refinement of a pose: iterative closest points between the full masked clouds, with the point-to-plane metric
//! (Chen, Medioni 1992) or the plane-to-plane metric of generalised ICP (Segal, Haehnel, Thrun, RSS 2009).
//!
//! Every iteration matches the query's points to the reference surface, weighs them down smoothly to zero at a
//! distance limit that shrinks from iteration to iteration, and solves for a small motion. Directions of motion that
//! the surface does not determine (a plane slides on itself, a cylinder turns) stay as they are. The result is
//! taken only when it stays near its start and explains the query better than noise would; otherwise the start is
//! returned.

mod color;
mod iterate;
mod motion;
mod residual;
mod settings;
#[cfg(test)]
mod tests;

use std::sync::OnceLock;

use unopose_core::geometry::Pose;

use crate::appearance::AppearanceView;
use color::{ColorField, Colors};

use super::{
    pseudo_symmetry::PseudoSymmetries,
    surface::{self, Surface},
};
use iterate::iterate;
use motion::{MAX_ROTATION_DEG, MAX_TRANSLATION, motion};
use residual::residual;
pub use settings::IcpSettings;

/// Logarithm of the residual that agreement of the colours from 0 to 1 outweighs.
const COLOR_WEIGHT: f64 = 2.0;
/// Gain of the agreement that is none of chance.
const COLOR_GAIN: f64 = 0.03;
/// Residual, in cells, that counts like none where colours are compared.
const LEAST_RESIDUAL_CELLS: f64 = 0.3;
/// Cells along the reference's extent: about 2500 points of a filled view.
const CELLS: f64 = 70.0;

/// A reference cloud as refinement needs it, in the reference camera's frame, metres. Kept for all queries.
pub struct IcpReference {
    surface: Surface,
    colors: Option<ColorField>,
    pseudo_symmetries: OnceLock<Option<PseudoSymmetries>>,
}

/// A query cloud as refinement needs it, on the grid of its reference.
pub struct IcpQuery {
    surface: Surface,
    colors: Option<Colors>,
    pixels: usize,
}

impl IcpReference {
    /// From all points of a masked view (metres, camera frame); `None` when too few are left to make a surface.
    pub fn new(points: &[[f32; 3]]) -> Option<Self> {
        let extent = surface::extent(points, "reference").ok()?;
        let surface = Surface::new(points, (extent / CELLS) as f32, "reference").ok()?;
        Some(Self { surface, colors: None, pseudo_symmetries: OnceLock::new() })
    }

    /// With the colours of the same view, so that they count in refinements of queries that have colours, too.
    pub fn with_colors(self, view: &AppearanceView) -> Self {
        Self { colors: Some(ColorField::new(&self.surface, view)), ..self }
    }

    /// A query view (all points of the mask, metres, camera frame; its colours) on the reference's grid; `None` when the points
    /// make no surface.
    pub fn query(&self, points: &[[f32; 3]], view: Option<&AppearanceView>) -> Option<IcpQuery> {
        let surface = Surface::new(points, self.surface.cell, "query").ok()?;
        let colors = view.filter(|_| self.colors.is_some()).map(|view| Colors::new(&surface, view));
        Some(IcpQuery { surface, colors, pixels: points.len() })
    }

    /// What a view of a body of revolution hardly tells apart; `None` for other shapes.
    pub fn pseudo_symmetries(&self) -> Option<&PseudoSymmetries> {
        self.pseudo_symmetries.get_or_init(|| PseudoSymmetries::of(&self.surface)).as_ref()
    }

    /// The downsampled cloud.
    pub fn points(&self) -> &[[f32; 3]] {
        &self.surface.points
    }
}

/// What a refinement did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IcpOutcome {
    /// Reference to query camera, metres: the refined pose, or the start.
    pub t_query_reference: Pose,
    /// Whether the pose is a refined one.
    pub accepted: bool,
    /// Mean robust distance between the clouds at the start and at the end, metres.
    pub residual: [f64; 2],
    /// Motion of the reference's centre, metres, and turn, degrees.
    pub motion: [f64; 2],
}

/// Refines `start` (reference to query camera, metres) with all points of the masked query view.
pub fn refine(query: &[[f32; 3]], reference: &IcpReference, start: &Pose) -> Pose {
    refine_with(query, reference, start, &IcpSettings::POINT_TO_PLANE).t_query_reference
}

/// [`refine`] with chosen constants, and the reasons.
pub fn refine_with(
    query: &[[f32; 3]],
    reference: &IcpReference,
    start: &Pose,
    settings: &IcpSettings,
) -> IcpOutcome {
    match reference.query(query, None) {
        Some(query) => refine_query(&query, reference, start, settings),
        None => IcpOutcome::unchanged(start),
    }
}

/// [`refine_with`] of a prepared query, by the colours of both views as well where the settings say so.
pub fn refine_query(
    query: &IcpQuery,
    reference: &IcpReference,
    start: &Pose,
    settings: &IcpSettings,
) -> IcpOutcome {
    let pixels = query.pixels.max(1) as f64;
    let colors = query.colors.as_ref().zip(reference.colors.as_ref()).filter(|_| settings.photometric);
    let (query, reference) = (&query.surface, &reference.surface);
    // Residual, and agreement of the colours.
    let judged = |pose: &Pose| {
        let agreement = colors
            .map_or(0.0, |(own, field)| color::agreement((query, own), (reference, &field.colors), pose));
        (residual(query, reference, pose), agreement)
    };
    // Between distances far below the noise of any camera the colours decide.
    let floor = if colors.is_some() { LEAST_RESIDUAL_CELLS * f64::from(reference.cell) } else { 0.0 };
    let cost = |(residual, agreement): (f64, f64)| residual.hypot(floor).ln() - COLOR_WEIGHT * agreement;
    let start_inverse = start.inverse();
    let before = judged(&start_inverse);
    let refined = settings
        .first_limits
        .iter()
        .map(|&first| iterate(query, reference, colors, start_inverse, first, settings))
        .map(|pose| (judged(&pose), pose))
        .min_by(|a, b| cost(a.0).total_cmp(&cost(b.0)));
    let Some((after, refined)) = refined else { return IcpOutcome::unchanged(start) };
    let refined = refined.inverse();
    let motion = motion(start, &refined, &reference.center);
    // Comparisons with NaN are false: nothing that is not a number is accepted.
    let is_local = motion[0] <= MAX_TRANSLATION && motion[1] <= MAX_ROTATION_DEG;
    let is_nearer = before.0 * before.0 > after.0 * after.0 * (1.0 + settings.noise / pixels.sqrt())
        && after.0 < settings.gain * before.0;
    let is_better = is_nearer || after.1 > before.1 + COLOR_GAIN;
    let accepted = is_local && is_better && cost(after) < cost(before);
    IcpOutcome {
        t_query_reference: if accepted { refined } else { *start },
        accepted,
        residual: [before.0, after.0],
        motion,
    }
}

impl IcpOutcome {
    fn unchanged(start: &Pose) -> Self {
        Self { t_query_reference: *start, accepted: false, residual: [0.0; 2], motion: [0.0; 2] }
    }
}
