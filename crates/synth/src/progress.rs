//! What a generation tells while it works, and what it did.

/// What is being made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    Objects,
    Images,
}

/// State of a running generation.
#[derive(Clone, Copy, Debug)]
pub struct GenerationProgress {
    pub stage: Stage,
    /// Items finished, those of earlier runs included.
    pub done: usize,
    pub total: usize,
}

/// What a generation did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GenerationSummary {
    /// Shards, or scenes of a BOP set.
    pub shards_written: usize,
    /// Shards that were there already.
    pub shards_kept: usize,
    pub images_written: usize,
    /// Procedural objects in place of mesh files that could not be used.
    pub meshes_replaced: usize,
}
