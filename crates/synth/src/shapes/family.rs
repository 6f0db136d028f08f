//! Names of the object families.

use serde::{Deserialize, Serialize};

/// Object families of the procedural library.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// Bevelled boxes, cartons with lids, tapered blocks.
    Box,
    /// Boxes of pages with overhanging covers.
    Book,
    /// L, T, U and Z brackets, blocks with holes for screws left out.
    Bracket,
    Bottle,
    /// Tins, jars, rolls.
    Can,
    Bowl,
    Mug,
    /// Gears, knobs, stars and rings.
    Gear,
    Superquadric,
    /// Displaced spheres: fruit, stones, bread-like lumps.
    Organic,
    /// Handles with heads.
    Tool,
    /// Remote controls and game controllers with buttons.
    Controller,
    /// Lofts with a sole.
    Shoe,
    /// Unions of primitives.
    Toy,
    /// Smoothly blended primitives, meshed from a signed distance.
    Blend,
    /// Bent tubes, handles and hooks.
    Tube,
}

impl Family {
    pub const ALL: [Family; 16] = [
        Family::Box,
        Family::Book,
        Family::Bracket,
        Family::Bottle,
        Family::Can,
        Family::Bowl,
        Family::Mug,
        Family::Gear,
        Family::Superquadric,
        Family::Organic,
        Family::Tool,
        Family::Controller,
        Family::Shoe,
        Family::Toy,
        Family::Blend,
        Family::Tube,
    ];

    /// Lower-case name, also used in object names.
    pub fn name(self) -> &'static str {
        match self {
            Family::Box => "box",
            Family::Book => "book",
            Family::Bracket => "bracket",
            Family::Bottle => "bottle",
            Family::Can => "can",
            Family::Bowl => "bowl",
            Family::Mug => "mug",
            Family::Gear => "gear",
            Family::Superquadric => "superquadric",
            Family::Organic => "organic",
            Family::Tool => "tool",
            Family::Controller => "controller",
            Family::Shoe => "shoe",
            Family::Toy => "toy",
            Family::Blend => "blend",
            Family::Tube => "tube",
        }
    }
}
