//! The release's quirks, one switch each (`docs/network.md`, section 10).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Behaviours of the official release that differ from what it means to compute. `true` reproduces the release
/// (its weights need that), `false` is the corrected form.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Quirks {
    /// The reference's coordinates in its global frame are gathered with the indices of another point order.
    pub misaligned_reference_grf: bool,
    /// The sparse tokens of the fine stage are those of the previous dense point.
    pub sparse_off_by_one: bool,
    /// The coarse overlap scores of both clouds are split at the reference's number of points. Corrected: at the query's.
    pub score_split_at_reference: bool,
    /// The translation of the noisy training pose is clamped to z >= 1e-6.
    pub clamp_noisy_translation: bool,
    /// Clouds stay in their camera frames. Corrected: each is centred on its own mean.
    pub uncentred_clouds: bool,
    /// The sign of a frame's z axis comes from counting points beyond 1e-3 on both sides. Corrected: the sign of the sum of
    /// cubes.
    pub counted_z_sign: bool,
    /// Triplets of the coarse pose's hypotheses may repeat points or be collinear.
    pub degenerate_triplets: bool,
    /// Training rotates the reference by three uniform Euler angles. Corrected: uniformly on SO(3).
    pub euler_reference_rotation: bool,
    /// Masked reference and training pixels without depth become the point (0, 0, 0).
    pub keep_zero_depth: bool,
    /// The reference may come from the query's image, and labels ignore the symmetries of objects.
    pub same_image_reference: bool,
    /// BatchNorm of the positional encoding counts padded neighbours.
    pub batchnorm_counts_padding: bool,
    /// The axes of local frames count padded neighbours, so that in a sparse neighbourhood they follow one neighbour.
    pub local_frames_count_padding: bool,
}

impl Quirks {
    /// Everything as the release does it.
    pub fn release() -> Self {
        Self {
            misaligned_reference_grf: true,
            sparse_off_by_one: true,
            score_split_at_reference: true,
            clamp_noisy_translation: true,
            uncentred_clouds: true,
            counted_z_sign: true,
            degenerate_triplets: true,
            euler_reference_rotation: true,
            keep_zero_depth: true,
            same_image_reference: true,
            batchnorm_counts_padding: true,
            local_frames_count_padding: true,
        }
    }

    /// Everything corrected.
    pub fn corrected() -> Self {
        Self {
            misaligned_reference_grf: false,
            sparse_off_by_one: false,
            score_split_at_reference: false,
            clamp_noisy_translation: false,
            uncentred_clouds: false,
            counted_z_sign: false,
            degenerate_triplets: false,
            euler_reference_rotation: false,
            keep_zero_depth: false,
            same_image_reference: false,
            batchnorm_counts_padding: false,
            local_frames_count_padding: false,
        }
    }
}

impl Default for Quirks {
    fn default() -> Self {
        Self::corrected()
    }
}
