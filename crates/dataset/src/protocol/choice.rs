//! How a protocol chooses the reference of a target.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{BIN_DEG, BINS, MAIN_DEG, ProtocolError, REFERENCE_COUNTS};

/// A choice of reference views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Any view at most 50 degrees away.
    Rot50,
    /// At most 50 degrees away, from another scene.
    CrossScene,
    /// From another scene, between 10 i and 10 (i + 1) degrees away.
    Bin(usize),
    /// From another scene, up to 90 degrees away; the bins are drawn evenly.
    Rot90,
    /// The same view for all targets of an object, however far.
    OnePerObject,
    /// From this many views per object: one within 50 degrees if there is any, else the nearest.
    FewPerObject(usize),
}

/// A view that can be a target's reference.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    /// Number of the view.
    pub view: usize,
    /// Angle to the target's view, up to symmetry.
    pub degrees: f64,
    /// Whether it is from another scene than the target.
    pub other_scene: bool,
}

impl Protocol {
    /// Those that `unogen` writes lists for.
    pub fn all() -> Vec<Self> {
        let few = REFERENCE_COUNTS.into_iter().map(Self::FewPerObject);
        let main = [Self::CrossScene, Self::Rot50, Self::Rot90, Self::OnePerObject];
        main.into_iter().chain((0..BINS).map(Self::Bin)).chain(few).collect()
    }

    /// The middle of `test_ref_targets_NAME.json`.
    pub fn name(self) -> String {
        match self {
            Self::Rot50 => "rot50".into(),
            Self::CrossScene => "crossscene_rot50".into(),
            Self::Bin(bin) => format!("crossscene_rot{:02}-{:02}", bin * 10, (bin + 1) * 10),
            Self::Rot90 => "crossscene_rot90".into(),
            Self::OnePerObject => "one_per_object".into(),
            Self::FewPerObject(count) => format!("{count}_per_object"),
        }
    }

    /// By the name of a list.
    pub fn by_name(name: &str) -> Result<Self, ProtocolError> {
        let count = name.strip_suffix("_per_object").and_then(|count| count.parse().ok());
        let known = Self::all().into_iter().find(|protocol| protocol.name() == name);
        known.or(count.filter(|&count| count > 0).map(Self::FewPerObject)).ok_or_else(|| {
            let expected = Self::all().into_iter().map(Self::name).collect();
            ProtocolError::Name { name: name.to_owned(), expected }
        })
    }

    /// Views per object when they are drawn before the targets are looked at.
    fn pool(self) -> Option<usize> {
        match self {
            Self::OnePerObject => Some(1),
            Self::FewPerObject(count) => Some(count),
            _ => None,
        }
    }

    /// The reference of target number `item`; `drawn` are the object's views in the order of the draw.
    pub(super) fn choose(
        self,
        candidates: &[Candidate],
        drawn: &[usize],
        seed: u64,
        item: u64,
    ) -> Option<usize> {
        let mut rng = self.stream(seed, item);
        let elsewhere = |low: f64, high: f64| -> Vec<&Candidate> {
            let within = |c: &&Candidate| c.other_scene && c.degrees >= low && c.degrees < high;
            candidates.iter().filter(within).collect()
        };
        let bin = |b: usize| elsewhere(b as f64 * BIN_DEG, (b + 1) as f64 * BIN_DEG);
        let near = |c: &&Candidate| c.degrees < MAIN_DEG;
        let among: Vec<&Candidate> = match self {
            Self::Rot50 => candidates.iter().filter(near).collect(),
            Self::CrossScene => elsewhere(0.0, MAIN_DEG),
            Self::Bin(b) => bin(b),
            Self::Rot90 => {
                let bins: Vec<_> = (0..BINS).map(bin).filter(|views| !views.is_empty()).collect();
                pick(&bins, &mut rng).cloned().unwrap_or_default()
            }
            Self::OnePerObject | Self::FewPerObject(_) => {
                let pool = &drawn[..drawn.len().min(self.pool()?)];
                let some = || candidates.iter().filter(|c| pool.contains(&c.view));
                match some().filter(near).collect::<Vec<_>>() {
                    none if none.is_empty() => {
                        some().min_by(|a, b| a.degrees.total_cmp(&b.degrees)).into_iter().collect()
                    }
                    near => near,
                }
            }
        };
        pick(&among, &mut rng).map(|candidate| candidate.view)
    }

    fn stream(self, seed: u64, item: u64) -> ChaCha8Rng {
        let list = match self {
            Self::Rot50 => 1,
            Self::CrossScene => 2,
            Self::Rot90 => 3,
            Self::OnePerObject => 4,
            Self::Bin(bin) => 16 + bin as u64,
            Self::FewPerObject(count) => 1024 + count as u64,
        };
        stream(seed, list, item)
    }
}

/// The views of an object in random order.
pub(super) fn drawn(views: &[usize], seed: u64, obj_id: u32) -> Vec<usize> {
    let mut rng = stream(seed, 0, obj_id.into());
    rand::seq::index::sample(&mut rng, views.len(), views.len()).iter().map(|i| views[i]).collect()
}

fn stream(seed: u64, list: u64, item: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ list.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    rng.set_stream(item);
    rng
}

fn pick<'a, T>(items: &'a [T], rng: &mut ChaCha8Rng) -> Option<&'a T> {
    (!items.is_empty()).then(|| &items[rng.random_range(0..items.len())])
}
