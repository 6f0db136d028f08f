//! What a generation reports while it works and when it is done.

/// What is being made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The objects' meshes and textures.
    Objects,
    /// The rendered and measured images.
    Images,
}

/// How far a generation is.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct GenerationProgress {
    /// What is being made.
    pub stage: Stage,
    /// Items finished, those of earlier runs included.
    pub done: usize,
    /// Items of the stage.
    pub total: usize,
}

/// What a generation did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct GenerationSummary {
    /// Shards, or scenes of a BOP set.
    pub shards_written: usize,
    /// Shards that were there already.
    pub shards_kept: usize,
    /// Images in the shards or scenes written by this call.
    pub images_written: usize,
    /// Procedural objects in place of mesh files that could not be used.
    pub meshes_replaced: usize,
}
