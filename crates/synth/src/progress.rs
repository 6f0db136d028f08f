//! What a generation reports while it works and when it is done.

use std::sync::atomic::{AtomicBool, Ordering};

use super::SynthError;

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
pub struct GenerationProgress<'a> {
    /// What is being made.
    pub stage: Stage,
    /// Items finished, those of earlier runs included.
    pub done: usize,
    /// Items of the stage.
    pub total: usize,
    stopped: &'a AtomicBool,
}

impl GenerationProgress<'_> {
    /// Asks the generation to end with [`SynthError::Stopped`] before it begins another scene.
    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }
}

/// Tells the caller of a generation, and whether it wants to stop.
pub(super) struct Reporter<'a> {
    tell: &'a (dyn Fn(GenerationProgress) + Sync),
    stopped: AtomicBool,
}

impl<'a> Reporter<'a> {
    pub fn new(tell: &'a (dyn Fn(GenerationProgress) + Sync)) -> Self {
        Self { tell, stopped: AtomicBool::new(false) }
    }

    pub fn report(&self, stage: Stage, done: usize, total: usize) {
        (self.tell)(GenerationProgress { stage, done, total, stopped: &self.stopped });
    }

    /// An error when the caller wants to stop.
    pub fn go_on(&self) -> Result<(), SynthError> {
        if self.stopped.load(Ordering::Relaxed) { Err(SynthError::Stopped) } else { Ok(()) }
    }
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
