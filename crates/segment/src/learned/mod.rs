//! Proposals of a network that was trained on synthetic images (`docs/network.md`, section 13; `docs/segmentation.md`).
//!
//! The network's instances are candidates; with [`LearnedProposals::with_regions`] those of [`crate::RegionProposals`] are, too.
//! An [`Objectness`] in the checkpoint, the overlap with a true mask that is to be expected, ranks all of them.

mod evidence;
mod objectness;

pub use evidence::MaskEvidence;
pub use objectness::{Objectness, ObservedMask};

use std::path::Path;

use burn::tensor::Device;
use rayon::prelude::*;
use unopose_checkpoints::PROPOSALS;
use unopose_core::{
    config::ProposalConfig,
    files::read_regular,
    frame::{Mask, RgbdFrame},
};
use unopose_nn::{
    checkpoint::{self, CheckpointError},
    model::ProposalNetwork,
};
use unopose_pairs::data::{SceneInput, scene_instances};

use super::{
    ImageKey, Proposal, ProposalGenerator, SegmentError,
    region_merging::{all_candidates, distinct, propose},
};
use evidence::{Origin, SceneEvidence};

/// The network with what ranks its masks.
pub struct LearnedProposals {
    network: ProposalNetwork,
    config: ProposalConfig,
    objectness: Option<Objectness>,
    /// Whether the proposals from regions are candidates, too.
    regions: bool,
    /// CRC-32 of the weights' file.
    checksum: u32,
}

impl LearnedProposals {
    /// Whether the program has weights.
    pub fn are_embedded() -> bool {
        PROPOSALS.is_some()
    }

    /// The weights in the program.
    pub fn embedded(device: &Device) -> Result<Self, SegmentError> {
        let bytes = PROPOSALS.ok_or(SegmentError::NoProposalWeights)?;
        Ok(Self::from_bytes(bytes, "embedded proposals.safetensors", device)?)
    }

    /// The weights in a checkpoint of `unotrain proposals`.
    pub fn load(path: &Path, device: &Device) -> Result<Self, SegmentError> {
        let bytes = read_regular(path, u64::MAX)
            .map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
        Ok(Self::from_bytes(&bytes, &path.display().to_string(), device)?)
    }

    fn from_bytes(bytes: &[u8], name: &str, device: &Device) -> Result<Self, CheckpointError> {
        let (network, config, meta) = checkpoint::load_proposals(bytes, name, device)?;
        Ok(Self {
            network,
            config: config.proposals,
            objectness: Objectness::from_metadata(&meta.extra, Path::new(name))?,
            regions: false,
            checksum: crc32fast::hash(bytes),
        })
    }

    /// With the proposals from regions beside the network's.
    pub fn with_regions(self) -> Self {
        Self { regions: true, ..self }
    }

    /// All candidates of a view with depth and what is known of each, the network's first. Not yet ranked: the score is what the
    /// candidate's own source gives it.
    pub fn candidates(&self, frame: &RgbdFrame) -> Result<Vec<(Proposal, MaskEvidence)>, SegmentError> {
        let input = SceneInput::new(frame, self.config.width, self.config.height)?;
        let maps = self.network.maps(&input);
        let scene = SceneEvidence::new(&input, &maps);
        let mut all = Vec::new();
        for instance in scene_instances(&input, &maps) {
            let mask = image_mask(&input, &instance.cells);
            let evidence = scene.of(&instance.cells, Origin::Network, instance.score);
            all.extend(Proposal::new(mask, instance.score).map(|proposal| (proposal, evidence)));
        }
        if self.regions {
            let regions = all_candidates(frame).into_par_iter().map(|proposal| {
                let cells = grid_cells(&input, &proposal.mask);
                let evidence = scene.of(&cells, Origin::Regions, proposal.score);
                (proposal, evidence)
            });
            all.par_extend(regions);
        }
        Ok(all)
    }
}

impl ProposalGenerator for LearnedProposals {
    fn name(&self) -> String {
        if self.regions { "both".into() } else { "learned".into() }
    }

    /// The number counts the versions of what is proposed.
    fn fingerprint(&self) -> String {
        format!("{} 1 {:08x}", self.name(), self.checksum)
    }

    /// An image without any depth has the proposals from its colours where regions are candidates, else it is an error.
    fn proposals(&self, frame: &RgbdFrame, _: Option<ImageKey>) -> Result<Vec<Proposal>, SegmentError> {
        if self.regions && !frame.depth.data.iter().any(|z| z.is_finite() && *z > 0.0) {
            return Ok(propose(frame));
        }
        let ranked = self.candidates(frame)?.into_iter().map(|(proposal, evidence)| {
            let score = self.objectness.as_ref().map(|objectness| objectness.overlap(&evidence) as f32);
            Proposal { score: score.unwrap_or(proposal.score), ..proposal }
        });
        Ok(distinct(ranked.collect()))
    }
}

/// The pixels that the cells show.
fn image_mask(input: &SceneInput, cells: &[u32]) -> Mask {
    let mut inside = vec![false; input.len()];
    cells.iter().for_each(|&cell| inside[cell as usize] = true);
    let (width, height) = input.source;
    let columns: Vec<usize> = (0..width).map(|col| input.cell_of(col, 0)).collect();
    let mut data = Vec::with_capacity(width as usize * height as usize);
    for row in 0..height {
        let first = input.cell_of(0, row);
        data.extend(columns.iter().map(|&col| inside[first + col]));
    }
    Mask { width, height, data }
}

/// The cells whose middle pixel is in the mask, ascending.
fn grid_cells(input: &SceneInput, mask: &Mask) -> Vec<u32> {
    let inside = |&cell: &usize| {
        let [col, row] = input.pixel_of(cell).map(|v| v.round().max(0.0) as u32);
        mask.get(col.min(mask.width - 1), row.min(mask.height - 1))
    };
    input.cells().filter(inside).map(|cell| cell as u32).collect()
}

#[cfg(test)]
mod tests {
    use unopose_core::{config::Config, frame::DepthMap, geometry::Intrinsics};
    use unopose_nn::checkpoint::Meta;

    use super::*;

    fn frame(z: f32) -> RgbdFrame {
        let mut depth = DepthMap::zeros(64, 48);
        depth.data.fill(z);
        let intrinsics = Intrinsics { fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
        RgbdFrame { rgb: image::RgbImage::new(64, 48), depth, intrinsics }
    }

    #[test]
    fn masks_and_cells_are_those_of_each_other() {
        let input = SceneInput::new(&frame(1.0), 32, 32).unwrap();
        let cells = [33, 34, 65];
        let mask = image_mask(&input, &cells);
        assert_eq!(mask.count(), 12, "four pixels per cell");
        assert!(mask.get(2, 2) && mask.get(5, 3) && !mask.get(6, 2));
        assert_eq!(grid_cells(&input, &mask), cells);
    }

    #[test]
    fn without_depth_the_network_refuses_and_regions_remain() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.safetensors");
        let device = Device::flex();
        let proposals =
            ProposalConfig { width: 32, height: 32, channels: [2, 4, 4, 4], ..ProposalConfig::default() };
        let config = Config { proposals, ..Config::default() };
        let network = ProposalNetwork::new(&config.proposals, 1, &device);
        checkpoint::save(&path, &network, &config, &Meta::default()).unwrap();
        let learned = LearnedProposals::load(&path, &device).unwrap();
        let message = learned.proposals(&frame(0.0), None).unwrap_err().to_string();
        assert!(message.contains("no pixel of the depth image is measured"), "{message}");
        let both = LearnedProposals::load(&path, &device).unwrap().with_regions();
        assert_eq!(both.proposals(&frame(0.0), None).unwrap(), propose(&frame(0.0)));
        assert!(learned.proposals(&frame(1.0), None).is_ok());
        assert_ne!(learned.fingerprint(), both.fingerprint());
        // Half precision keeps the answers to three digits.
        let half = folder.path().join("half.safetensors");
        checkpoint::TensorFile::read(&path).unwrap().write_half(&half).unwrap();
        assert!(std::fs::metadata(&half).unwrap().len() < std::fs::metadata(&path).unwrap().len());
        let rounded = LearnedProposals::load(&half, &device).unwrap();
        let input = SceneInput::new(&frame(1.0), 32, 32).unwrap();
        let (a, b) = (learned.network.maps(&input), rounded.network.maps(&input));
        assert!(a.foreground.iter().zip(&b.foreground).all(|(a, b)| (a - b).abs() < 2e-3));
        // Weights of another network.
        let other = folder.path().join("other.safetensors");
        let linear = burn::nn::LinearConfig::new(2, 2).init(&device);
        checkpoint::save(&other, &linear, &config, &Meta::default()).unwrap();
        let message = LearnedProposals::load(&other, &device).err().unwrap().to_string();
        assert!(message.contains("other.safetensors") && message.contains("depth_stem.weight"), "{message}");
    }
}
