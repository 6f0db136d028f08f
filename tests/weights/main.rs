//! Weights in the formats of other programs.

mod backbone;
mod dino;
mod dinov2;
mod official;
mod sam;
mod sam_full;
