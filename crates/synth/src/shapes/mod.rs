//! Procedural object shapes. Every family turns a random stream into a closed surface; [`build`] brings it to size.

mod assembled;
mod blend;
mod boxes;
mod extruded;
mod family;
mod loft;
mod revolved;
mod smooth;
mod solid;

pub(super) use family::Family;
pub(super) use solid::{Solid, Symmetry};

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::random::Draw;

/// A shape of the family with the given diameter (metres), centred; symmetry axes stay on z through the origin.
pub(super) fn build(family: Family, diameter: f32, rng: &mut ChaCha8Rng) -> Solid {
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
