//! Where proposals come from.

use std::path::Path;

use anyhow::bail;
use clap::Args;
use unopose_nn::device::{DeviceChoice, keep_freed_memory};
use unopose_segment::{
    LearnedProposals, ListedProposals, ProposalGenerator, RegionProposals, SamProposals, sam::POINTS_PER_SIDE,
};

/// The source without weights.
const EMBEDDED: &str = "embedded";

/// The network's proposals, alone and with those of [`EMBEDDED`]; a file of weights may follow after a colon.
const LEARNED: &str = "learned";
const BOTH: &str = "both";

/// The source when none is named: [`BOTH`] where the program has the network's weights.
pub fn default_source() -> &'static str {
    if LearnedProposals::are_embedded() { BOTH } else { EMBEDDED }
}

/// Why options of UNOSeg are refused beside other sources of masks.
pub const FOR_UNOSEG: &str = "--descriptor, --proposals and --sam-points are for --detections unoseg";

/// Source of the proposals in which an object is looked for.
#[derive(Args)]
pub struct ProposalOptions {
    /// Proposals: embedded (from depth and colour), learned (of a network, embedded too, or learned:FILE of unotrain
    /// proposals), both (those together, or both:FILE), weights of Segment Anything or MobileSAM (.pth, .pt, .safetensors), or
    /// a list of masks of another segmenter (JSON of BOP, COCO or SamAutomaticMaskGenerator) [default: both]
    #[arg(long, value_name = "SOURCE")]
    proposals: Option<String>,
    /// With weights of Segment Anything: clicks per side of its grid [default: 32]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=128))]
    sam_points: Option<u16>,
}

impl ProposalOptions {
    /// Whether any of them stands on the command line.
    pub fn are_given(&self) -> bool {
        self.proposals.is_some() || self.sam_points.is_some()
    }

    pub fn generator(&self, device: DeviceChoice) -> anyhow::Result<Box<dyn ProposalGenerator>> {
        let source = self.proposals.as_deref().unwrap_or(default_source());
        check_sam_points(self.sam_points, &[source])?;
        generator(source, self.sam_points, device)
    }
}

/// Refuses a grid of clicks that no source has use for.
pub fn check_sam_points(sam_points: Option<u16>, sources: &[&str]) -> anyhow::Result<()> {
    if sam_points.is_some() && !sources.iter().any(|source| is_weights(source)) {
        bail!(
            "--sam-points is for weights of Segment Anything in --proposals, which is {}",
            sources.join(",")
        );
    }
    Ok(())
}

fn is_weights(source: &str) -> bool {
    !is_learned(source)
        && Path::new(source).extension().is_some_and(|e| ["pth", "pt", "safetensors"].iter().any(|w| e == *w))
}

fn is_learned(source: &str) -> bool {
    let name = source.split_once(':').map_or(source, |(name, _)| name);
    name == LEARNED || name == BOTH
}

/// The network's proposals that a source names.
fn learned(source: &str, device: DeviceChoice) -> anyhow::Result<LearnedProposals> {
    let device = device.open()?.0;
    let (name, file) = source.split_once(':').map_or((source, None), |(name, file)| (name, Some(file)));
    let proposals = match file {
        Some(file) => LearnedProposals::load(Path::new(file), &device)?,
        None => LearnedProposals::embedded(&device)?,
    };
    Ok(if name == BOTH { proposals.with_regions() } else { proposals })
}

/// The generator that a source names; `sam_points` is for weights of Segment Anything.
pub fn generator(
    source: &str,
    sam_points: Option<u16>,
    device: DeviceChoice,
) -> anyhow::Result<Box<dyn ProposalGenerator>> {
    let path = Path::new(source);
    Ok(match source {
        EMBEDDED => Box::new(RegionProposals),
        _ if is_learned(source) => Box::new(learned(source, device)?),
        _ if is_weights(source) => {
            // Every batch of clicks takes and frees hundreds of megabytes.
            keep_freed_memory();
            let sam = SamProposals::load(path, &device.open()?.0)?;
            Box::new(sam.with_points_per_side(sam_points.map_or(POINTS_PER_SIDE, usize::from)))
        }
        _ => Box::new(ListedProposals::read(path)?),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_learned_source_is_no_file() {
        assert!(is_learned("both") && is_learned("learned:x/p.safetensors") && !is_learned("learned.json"));
        assert!(!is_weights("both:p.safetensors") && is_weights("sam.pth"));
        let device = "flex".parse().unwrap();
        let message = generator("learned:missing.safetensors", None, device).err().unwrap().to_string();
        assert!(message.contains("missing.safetensors"), "{message}");
    }
}
