//! The network against reference tensors, its losses, its switches.

mod loss_fixtures;
mod loss_terms;
mod matching_e2e;
mod module_fixtures;
mod network_fixtures;
mod network_parts;
mod official;
mod overlap_modes;
mod precision;
mod quirks;
