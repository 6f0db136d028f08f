//! Streams of the random numbers that sample hypotheses.

use rand::Rng;

use super::streams;

/// Where the uniform numbers that sample the hypotheses come from.
#[derive(Clone, Copy, Debug)]
pub enum Uniforms<'a> {
    /// A stream per pair from a seed and the pair's position in the list.
    Seed(u64),
    /// The same stream for every pair: a pose does not depend on the pairs around it.
    Shared(u64),
    /// Given numbers in [0, 1), one list per pair (parity checks).
    Given(&'a [Vec<f32>]),
}

impl Uniforms<'_> {
    /// The numbers of pair `index`.
    pub(super) fn stream(&self, index: usize) -> impl FnMut() -> f32 {
        let (seed, stream) = match self {
            Self::Seed(seed) => (*seed, index as u64),
            Self::Shared(seed) => (*seed, streams::HYPOTHESES),
            Self::Given(_) => (0, 0),
        };
        let mut rng = streams::stream(seed, stream);
        let mut given = match self {
            Self::Seed(_) | Self::Shared(_) => None,
            Self::Given(lists) => Some(lists.get(index).into_iter().flatten().copied()),
        };
        move || match &mut given {
            None => rng.random(),
            Some(list) => list.next().unwrap_or(0.0),
        }
    }
}
