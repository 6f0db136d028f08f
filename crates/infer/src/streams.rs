//! Streams of the random numbers of one seed: every purpose has its own.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Triplets of the coarse hypotheses.
pub const HYPOTHESES: u64 = 0;
/// Points of a reference.
pub const REFERENCE_POINTS: u64 = 1;
/// Points of a query.
pub const QUERY_POINTS: u64 = 2;
/// Points of a mask whose colours are compared.
pub const COLOR_POINTS: u64 = 3;
/// Places of shuffled reference colours.
pub const SHUFFLED_COLORS: u64 = 4;

/// The numbers of one purpose.
pub fn stream(seed: u64, purpose: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(purpose);
    rng
}
