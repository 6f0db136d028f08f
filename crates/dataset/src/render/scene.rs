//! What the colour renderer draws. World frame: z up, table top at z = 0, metres.

use std::sync::Arc;

use image::RgbImage;
use nalgebra::Vector3;
use unopose_core::geometry::Pose;

use crate::mesh::TriangleMesh;

/// Reflection properties of a whole object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finish {
    /// 0 mirror .. 1 matt.
    pub roughness: f32,
    /// 0 dielectric .. 1 metal.
    pub metallic: f32,
}

/// A posed mesh. The mesh carries normals, and texture or vertex colours.
#[derive(Clone, Debug)]
pub struct PosedMesh {
    /// Object frame, metres.
    pub mesh: Arc<TriangleMesh>,
    /// Of the whole surface.
    pub finish: Finish,
    /// Object to world, metres.
    pub t_world_object: Pose,
}

/// A spherical light.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// Centre in the world, metres.
    pub position: Vector3<f32>,
    /// Metres; a larger light casts softer shadows.
    pub radius: f32,
    /// Irradiance at the scene's centre on a surface facing the light, linear RGB.
    pub color: [f32; 3],
}

/// A repeating picture on a flat surface.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Surface colour, sRGB.
    pub picture: Arc<RgbImage>,
    /// Side of the picture, metres.
    pub tile: f32,
    /// Direction of the picture's rows, radians.
    pub angle: f32,
    /// Of the whole surface.
    pub finish: Finish,
}

/// A box of the surroundings: table top, board of a shelf, wall of a bin, furniture.
#[derive(Clone, Debug)]
pub struct Block {
    /// Centre in the world, metres.
    pub center: Vector3<f32>,
    /// Half extents along its own axes, metres.
    pub half: [f32; 3],
    /// Sine and cosine of its angle about z.
    pub turn: [f32; 2],
    /// On all sides.
    pub surface: Surface,
    /// Near enough to the objects to throw shadows on them.
    pub casts_shadow: bool,
}

/// A box-shaped room with blocks in it.
#[derive(Clone, Debug)]
pub struct Room {
    /// Furniture and boards, which hide each other and the walls.
    pub blocks: Vec<Block>,
    /// Surface below everything.
    pub floor: Surface,
    /// Surface of the walls and the ceiling.
    pub wall: Surface,
    /// Floor below the table top, metres.
    pub floor_drop: f32,
    /// Half side of the square floor plan, metres.
    pub half: f32,
    /// Height of the ceiling above the table top, metres.
    pub ceiling: f32,
}

/// Everything in front of the camera.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Meshes that get ids, masks and poses.
    pub objects: Vec<PosedMesh>,
    /// Surroundings of the objects.
    pub room: Room,
    /// Lights with shadows.
    pub lights: Vec<Light>,
    /// Ambient radiance from above, linear RGB.
    pub sky: [f32; 3],
    /// Ambient radiance from below, linear RGB.
    pub ground: [f32; 3],
}
