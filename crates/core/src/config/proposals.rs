//! The network that proposes masks of unknown objects.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The proposal network and its loss (`docs/network.md`, section 13).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ProposalConfig {
    /// Columns of the grid that images are scaled to, cells. A multiple of 16.
    pub width: usize,
    /// Rows of the grid, cells. A multiple of 16.
    pub height: usize,
    /// Channels of the network at a half (for each of the streams of depth and colour), a quarter, an eighth and a sixteenth
    /// of the grid.
    pub channels: [usize; 4],
    /// Probability of the colour changes, per image.
    pub color_probability: f64,
    /// Weight of the cross entropy of foreground, support and background.
    pub class_weight: f64,
    /// Weight of the Huber loss of the votes.
    pub vote_weight: f64,
    /// Error of a vote from which on the Huber loss is linear, metres.
    pub vote_huber: f64,
    /// Weight of the cross entropy of the instances' boundaries.
    pub boundary_weight: f64,
}

impl Default for ProposalConfig {
    fn default() -> Self {
        Self {
            width: 320,
            height: 240,
            channels: [12, 32, 64, 96],
            color_probability: 0.4,
            class_weight: 1.0,
            vote_weight: 1.0,
            vote_huber: 0.02,
            boundary_weight: 0.5,
        }
    }
}
