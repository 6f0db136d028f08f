//! Procedural object shapes. Every family turns a random stream into a closed surface; [`build`] brings it to size.

mod assembled;
mod blend;
mod boxes;
mod extruded;
mod loft;
mod revolved;
mod smooth;

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use unopose_dataset::mesh::TriangleMesh;

use super::random::Draw;

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

/// Rotations about z (and half turns) that map a shape onto itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Symmetry {
    /// Every rotation about z.
    pub continuous: bool,
    /// Rotations by multiples of 360 / folds degrees about z; 0 and 1 mean none.
    pub folds: u32,
    /// The half turn about x.
    pub flip: bool,
}

impl Symmetry {
    fn axis(flip: bool) -> Self {
        Self { continuous: true, folds: 0, flip }
    }

    fn folds(folds: u32) -> Self {
        Self { continuous: false, folds, flip: false }
    }

    fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// A closed surface with shared vertices (no normals, no texture coordinates yet).
#[derive(Clone, Debug, Default)]
pub struct Solid {
    pub mesh: TriangleMesh,
    /// Part number per vertex, for colouring.
    pub parts: Vec<u8>,
    pub symmetry: Symmetry,
}

impl Solid {
    fn push(&mut self, point: Vector3<f32>, part: u8) -> u32 {
        self.mesh.vertices.push(point.into());
        self.parts.push(part);
        self.parts.len() as u32 - 1
    }

    /// Adds another closed surface; the two may overlap.
    fn append(&mut self, other: &Solid) {
        let offset = self.mesh.vertices.len() as u32;
        self.mesh.vertices.extend(&other.mesh.vertices);
        self.mesh.faces.extend(other.mesh.faces.iter().map(|f| f.map(|i| i + offset)));
        self.parts.extend(&other.parts);
    }

    fn map(mut self, f: impl Fn(Vector3<f32>) -> Vector3<f32>) -> Self {
        for v in &mut self.mesh.vertices {
            *v = f(Vector3::from(*v)).into();
        }
        self
    }

    fn moved(self, by: Vector3<f32>) -> Self {
        self.map(|p| p + by)
    }

    fn turned(self, axis: Vector3<f32>, degrees: f32) -> Self {
        let r: Matrix3<f32> = *Rotation3::from_scaled_axis(axis * degrees.to_radians()).matrix();
        self.map(|p| r * p)
    }
}

/// A shape of the family with the given diameter (metres), centred; symmetry axes stay on z through the origin.
pub fn build(family: Family, diameter: f32, rng: &mut ChaCha8Rng) -> Solid {
    let mut solid = match family {
        Family::Box => boxes::carton(rng),
        Family::Book => boxes::book(rng),
        Family::Bracket => boxes::bracket(rng),
        Family::Bottle => revolved::bottle(rng),
        Family::Can => revolved::can(rng),
        Family::Bowl => revolved::bowl(rng),
        Family::Mug => revolved::mug(rng),
        Family::Gear => extruded::gear(rng),
        Family::Superquadric => smooth::superquadric(rng),
        Family::Organic => smooth::organic(rng),
        Family::Tool => assembled::tool(rng),
        Family::Controller => assembled::controller(rng),
        Family::Shoe => smooth::shoe(rng),
        Family::Toy => assembled::toy(rng),
        Family::Blend => blend::blend(rng),
        Family::Tube => assembled::tube(rng),
    };
    // Squeezing one axis multiplies the variety; it would break most symmetries.
    if solid.symmetry.is_none() {
        let squeeze = [rng.between(0.8, 1.25), rng.between(0.8, 1.25), 1.0];
        solid = solid.map(|p| Vector3::new(p.x * squeeze[0], p.y * squeeze[1], p.z));
    }
    let mut center = Vector3::from(solid.mesh.bounds().center());
    if !solid.symmetry.is_none() {
        (center.x, center.y) = (0.0, 0.0);
    }
    let scale = diameter / solid.mesh.diameter().max(1e-6);
    solid = solid.map(|p| (p - center) * scale);
    if solid.mesh.volume() < 0.0 {
        solid.mesh.faces.iter_mut().for_each(|f| f.swap(1, 2));
    }
    solid
}

#[cfg(test)]
mod tests;
