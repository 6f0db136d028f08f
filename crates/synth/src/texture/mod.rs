//! Procedural textures: solid patterns, prints, and their baking into an object's texture map.

mod bake;
mod look;
pub(super) mod pattern;
mod print;
mod scenery;
mod tabletop;

pub(super) use bake::textured;
pub(super) use look::Look;
pub(super) use scenery::{plain, scenery, sheet};
pub(super) use tabletop::tile;
