//! What was mended or skipped while images were read, counted.

use std::{
    collections::BTreeSet,
    fmt::{self, Display},
    path::PathBuf,
    sync::{Mutex, MutexGuard, PoisonError},
};

use super::{super::FormatError, instance_fault::InstanceFault};

/// Images and instances that were mended or skipped; each counts once however often it was read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct FaultCounts {
    /// Images that could not be read or whose members contradict each other.
    pub unreadable_images: usize,
    /// Visible masks that covered everything but the object and were inverted.
    pub mended_masks: usize,
    /// Instances whose mask or depth is not that of the object.
    pub skipped_instances: usize,
}

/// Counts faults and warns about them: about the first one of a kind with its place, then at every tenfold count, and
/// with all counts at the end.
#[derive(Debug)]
pub(super) struct FaultLog {
    folder: PathBuf,
    seen: Mutex<Seen>,
}

#[derive(Debug, Default)]
struct Seen {
    unreadable: BTreeSet<u32>,
    mended: BTreeSet<(u32, usize)>,
    skipped: BTreeSet<(u32, usize)>,
}

impl FaultLog {
    /// Without faults; `folder` stands in the warnings.
    pub fn new(folder: PathBuf) -> Self {
        Self { folder, seen: Mutex::default() }
    }

    /// An image that cannot be used at all; the error names it.
    pub fn unreadable(&self, image: u32, error: &FormatError) {
        let mut seen = self.lock();
        if seen.unreadable.insert(image) {
            self.warn(seen.unreadable.len(), "images skipped", error);
        }
    }

    /// An instance with a fault; `name` is that of the image.
    pub fn instance(&self, image: u32, name: &str, instance: usize, fault: &InstanceFault) {
        let mut seen = self.lock();
        let place = format!("{name}: instance {instance}: {fault}");
        if fault.is_mended() {
            if seen.mended.insert((image, instance)) {
                self.warn(seen.mended.len(), "inverted masks mended", &place);
            }
        } else if seen.skipped.insert((image, instance)) {
            self.warn(seen.skipped.len(), "instances skipped", &place);
        }
    }

    pub fn counts(&self) -> FaultCounts {
        let seen = self.lock();
        FaultCounts {
            unreadable_images: seen.unreadable.len(),
            mended_masks: seen.mended.len(),
            skipped_instances: seen.skipped.len(),
        }
    }

    fn warn(&self, count: usize, what: &str, example: &dyn Display) {
        if count == 10usize.pow(count.ilog10()) {
            tracing::warn!("{}: {what}: {count} so far, for example {example}", self.folder.display());
        }
    }

    fn lock(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for FaultLog {
    fn drop(&mut self) {
        let counts = self.counts();
        if counts != FaultCounts::default() {
            tracing::warn!("{}: {counts}", self.folder.display());
        }
    }
}

impl fmt::Display for FaultCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} inverted masks mended, {} instances skipped, {} images skipped",
            self.mended_masks, self.skipped_instances, self.unreadable_images
        )
    }
}
