//! The trained networks of this folder as bytes, so that a binary or a library needs no file beside it.

/// `geo.safetensors`: its training and scores are in `geo.md`. `None` in a tree without the file.
#[cfg(has_geo)]
pub const GEO: Option<&[u8]> = Some(include_bytes!("geo.safetensors"));
/// `geo.safetensors`: its training and scores are in `geo.md`. `None` in a tree without the file.
#[cfg(not(has_geo))]
pub const GEO: Option<&[u8]> = None;

/// `proposals.safetensors`, the network that proposes masks: its training and scores are in `proposals.md`. `None` in a tree
/// without the file.
#[cfg(has_proposals)]
pub const PROPOSALS: Option<&[u8]> = Some(include_bytes!("proposals.safetensors"));
/// `proposals.safetensors`, the network that proposes masks: its training and scores are in `proposals.md`. `None` in a tree
/// without the file.
#[cfg(not(has_proposals))]
pub const PROPOSALS: Option<&[u8]> = None;
