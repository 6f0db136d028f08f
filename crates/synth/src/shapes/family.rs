//! The object families.

/// Object families of the procedural library.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Family {
    /// Bevelled boxes, cartons with lids, tapered blocks.
    Box,
    /// Boxes of pages with overhanging covers.
    Book,
    /// L, T, U and Z brackets, blocks with holes for screws left out.
    Bracket,
    /// Bodies with shoulder, neck and cap; also vases and skittles.
    Bottle,
    /// Tins, jars, rolls.
    Can,
    /// Bowls, plates and basins.
    Bowl,
    /// Vessels with handles.
    Mug,
    /// Gears, knobs, stars and rings.
    Gear,
    /// Superquadrics, some of them tapered, bent or twisted.
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
    /// Every family, in the order in which objects take turns.
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

    /// Those whose shape mostly leaves the pose open, as often as packages have them.
    pub const PACKAGES: [Family; 12] = [
        Family::Can,
        Family::Can,
        Family::Can,
        Family::Can,
        Family::Box,
        Family::Box,
        Family::Box,
        Family::Bottle,
        Family::Bottle,
        Family::Book,
        Family::Bowl,
        Family::Superquadric,
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
