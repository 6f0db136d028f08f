//! Weights in the formats of other programs.

mod backbone;
mod dino;
mod official;
mod sam;
mod sam_full;
