//! Local refinement of a pose: iterative closest points between the full masked clouds, with the point-to-plane metric
//! (Chen, Medioni 1992) or the plane-to-plane metric of generalised ICP (Segal, Haehnel, Thrun, RSS 2009).
//!
//! Every iteration matches the query's points to the reference surface, weighs them down smoothly to zero at a
//! distance limit that shrinks from iteration to iteration, and solves for a small motion. Directions of motion that
//! the surface does not determine (a plane slides on itself, a cylinder turns) stay as they are. The result is
//! taken only when it stays near its start and explains the query better than noise would; otherwise the start is
//! returned.

mod iterate;
mod motion;
mod residual;
mod settings;
#[cfg(test)]
mod tests;

use unopose_core::geometry::Pose;

use super::surface::{self, Surface};
use iterate::iterate;
use motion::{MAX_ROTATION_DEG, MAX_TRANSLATION, motion};
use residual::residual;
pub use settings::IcpSettings;

/// Cells along the reference's extent: about 2500 points of a filled view.
const CELLS: f64 = 70.0;

/// A reference cloud as refinement needs it, in the reference camera's frame, metres. Kept for all queries.
pub struct IcpReference {
    surface: Surface,
}

impl IcpReference {
    /// From all points of a masked view (metres, camera frame); `None` when too few are left to make a surface.
    pub fn new(points: &[[f32; 3]]) -> Option<Self> {
        let extent = surface::extent(points, "reference").ok()?;
        let surface = Surface::new(points, (extent / CELLS) as f32, "reference").ok()?;
        Some(Self { surface })
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
    let reference = &reference.surface;
    let pixels = query.len().max(1) as f64;
    let unchanged =
        IcpOutcome { t_query_reference: *start, accepted: false, residual: [0.0; 2], motion: [0.0; 2] };
    let Ok(query) = Surface::new(query, reference.cell, "query") else { return unchanged };
    let start_inverse = start.inverse();
    let before = residual(&query, reference, &start_inverse);
    let refined = settings
        .first_limits
        .iter()
        .map(|&first| iterate(&query, reference, start_inverse, first, settings))
        .map(|pose| (residual(&query, reference, &pose), pose))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((after, refined)) = refined else { return unchanged };
    let refined = refined.inverse();
    let motion = motion(start, &refined, &reference.center);
    // Comparisons with NaN are false: nothing that is not a number is accepted.
    let is_local = motion[0] <= MAX_TRANSLATION && motion[1] <= MAX_ROTATION_DEG;
    let is_clear = before * before > after * after * (1.0 + settings.noise / pixels.sqrt());
    let accepted = is_local && is_clear && after < settings.gain * before;
    IcpOutcome {
        t_query_reference: if accepted { refined } else { *start },
        accepted,
        residual: [before, after],
        motion,
    }
}
