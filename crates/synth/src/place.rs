//! Where the objects lie: on a table, in a bin or on a shelf, in a room with furniture.

use std::f32::consts::{FRAC_PI_2, TAU};

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use unopose_core::config::SynthConfig;
use unopose_dataset::render::{Block, Room, Surface};

use super::{background::Backgrounds, random::Draw};

/// What the objects lie on or in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Place {
    /// The visible table ends farther out than the objects lie.
    Table,
    /// Inner half extents, height of the walls and their thickness, metres.
    Bin { half: [f32; 2], height: f32, thick: f32 },
    /// Half extents and thickness of the board, open towards -y.
    Shelf { half: [f32; 2], thick: f32 },
}

/// A wall that objects collide with: centre and half extents along the axes, metres.
pub(super) type Wall = (Vector3<f32>, [f32; 3]);

/// Directions that cameras look from.
pub(super) struct ViewZone {
    /// Middle and half width, radians.
    pub azimuth: [f32; 2],
    pub elevation_deg: [f32; 2],
    /// Lowest camera, metres above the table.
    pub lowest: f32,
    /// Cameras stay on this side of y.
    pub front: Option<f32>,
}

impl Place {
    /// A place large enough for `count` objects, `mean` and `largest` their sizes in metres.
    pub fn draw(config: &SynthConfig, count: usize, mean: f32, largest: f32, rng: &mut ChaCha8Rng) -> Self {
        let dice = rng.between(0.0, 1.0);
        let base = mean * (count as f32).sqrt() * rng.between(0.35, 0.55);
        if dice < config.bins {
            let least = 0.62 * largest;
            let half = [(base * rng.between(0.9, 1.3)).max(least), (base * rng.between(0.7, 1.0)).max(least)];
            let height = (mean * rng.between(0.5, 1.2)).clamp(0.06, 0.25);
            Self::Bin { half, height, thick: rng.log_between(0.003, 0.02) }
        } else if dice < config.bins + config.shelves {
            let width = (base * rng.between(1.1, 1.9)).max(0.8 * largest);
            let depth = (base * rng.between(0.5, 0.9)).max(0.55 * largest);
            Self::Shelf { half: [width, depth], thick: rng.between(0.01, 0.03) }
        } else {
            Self::Table
        }
    }

    /// What keeps the objects in: thick walls, so that nothing tunnels through, with their inner faces in place.
    pub fn walls(&self) -> Vec<Wall> {
        const THICK: f32 = 0.05;
        let (half, height) = match *self {
            Place::Table => return Vec::new(),
            Place::Bin { half, height, .. } => (half, height),
            Place::Shelf { half, .. } => (half, 0.6),
        };
        let [a, b] = half;
        let side = |sign: f32| -> Wall {
            (Vector3::new(sign * (a + THICK), 0.0, 0.5 * height), [THICK, b + 2.0 * THICK, 0.5 * height])
        };
        let end = |sign: f32| -> Wall {
            (Vector3::new(0.0, sign * (b + THICK), 0.5 * height), [a, THICK, 0.5 * height])
        };
        let mut walls = vec![side(-1.0), side(1.0), end(1.0)];
        if matches!(self, Place::Bin { .. }) {
            walls.push(end(-1.0));
        }
        walls
    }

    /// Half extents of the area objects are dropped in and may rest in; `None`: anywhere on the table.
    pub fn area(&self) -> Option<[f32; 2]> {
        match *self {
            Place::Table => None,
            Place::Bin { half, .. } | Place::Shelf { half, .. } => Some(half),
        }
    }

    /// Directions from which the objects can be seen, within the configured elevations (degrees).
    pub fn views(&self, elevation_deg: [f32; 2]) -> ViewZone {
        let [low, high] = elevation_deg;
        let around = [0.0, std::f32::consts::PI];
        match *self {
            Place::Table => ViewZone { azimuth: around, elevation_deg, lowest: 0.05, front: None },
            // Steep enough to see the floor.
            Place::Bin { height, .. } => {
                let elevation_deg = [low.max(42.0), high.max(60.0)];
                ViewZone { azimuth: around, elevation_deg, lowest: height + 0.1, front: None }
            }
            Place::Shelf { half, .. } => ViewZone {
                azimuth: [-FRAC_PI_2, 0.7],
                elevation_deg: [low.min(5.0), high.min(38.0)],
                lowest: 0.05,
                front: Some(-half[1] - 0.15),
            },
        }
    }

    /// The room around it; `reach` is how far from the middle the objects reach, `top` how high, `far` how far away
    /// cameras are, so that all stand inside.
    pub fn room(&self, [reach, top, far]: [f32; 3], backgrounds: &Backgrounds, rng: &mut ChaCha8Rng) -> Room {
        let floor_drop = rng.between(0.4, 0.9);
        let half = rng.between(2.0, 4.0).max(far + reach + 0.2);
        let mut blocks = match *self {
            Place::Table => {
                let mut blocks = vec![table(reach, backgrounds, rng)];
                papers(&mut blocks, reach, backgrounds, rng);
                blocks
            }
            Place::Bin { half, height, thick } => bin(half, height, thick, backgrounds, rng),
            Place::Shelf { half, thick } => shelf(half, thick, top, backgrounds, rng),
        };
        furniture(&mut blocks, floor_drop, half, backgrounds, rng);
        Room {
            blocks,
            floor: backgrounds.material(128, [0.8, 2.0], 0.6, rng),
            wall: backgrounds.wall(rng),
            floor_drop,
            half,
            ceiling: rng.between(2.0, 2.6).max(far + top + 0.2),
        }
    }
}

/// Thickness of a table top, metres.
const TABLE_THICKNESS: f32 = 0.03;

fn table(reach: f32, backgrounds: &Backgrounds, rng: &mut ChaCha8Rng) -> Block {
    let mut side = || rng.log_between(0.45, 1.4).max(reach);
    let half = [side(), side(), 0.5 * TABLE_THICKNESS];
    let surface = backgrounds.material(320, [0.5, 1.2], 0.3, rng);
    let turn = rng.between(0.0, TAU).sin_cos().into();
    Block { center: Vector3::z() * (-0.5 * TABLE_THICKNESS), half, turn, surface, casts_shadow: false }
}

/// Printed sheets on a table, thin enough to lie under the objects: the physics has its ground half a millimetre above
/// the table.
fn papers(blocks: &mut Vec<Block>, reach: f32, backgrounds: &Backgrounds, rng: &mut ChaCha8Rng) {
    const THICKNESS: f32 = 8e-5;
    let count = if rng.chance(0.4) { rng.count(1, 5) } else { 0 };
    for k in 0..count {
        let long = rng.between(0.1, 0.32);
        let size = [long, long * rng.between(0.55, 0.8)];
        let (s, c) = rng.between(0.0, TAU).sin_cos();
        let distance = 0.9 * reach * rng.between(0.0, 1.0).sqrt();
        let top = THICKNESS * (k + 1) as f32;
        let center = Vector3::new(distance * c, distance * s, 0.5 * top);
        let turn = rng.between(0.0, TAU).sin_cos().into();
        let surface = backgrounds.sheet(size, rng);
        let half = [0.5 * size[0], 0.5 * size[1], 0.5 * top];
        blocks.push(Block { center, half, turn, surface, casts_shadow: false });
    }
}

fn board(center: [f32; 3], half: [f32; 3], surface: &Surface) -> Block {
    Block { center: center.into(), half, turn: [0.0, 1.0], surface: surface.clone(), casts_shadow: true }
}

/// Walls and floor standing on a table.
fn bin(
    [a, b]: [f32; 2],
    height: f32,
    thick: f32,
    backgrounds: &Backgrounds,
    rng: &mut ChaCha8Rng,
) -> Vec<Block> {
    let surface = match rng.chance(0.6) {
        true => backgrounds.plain(rng),
        false => backgrounds.material(160, [0.2, 0.8], 0.4, rng),
    };
    let (t, z) = (0.5 * thick, 0.5 * height);
    let mut blocks = vec![table(a.hypot(b) + thick, backgrounds, rng)];
    for sign in [-1.0, 1.0] {
        blocks.push(board([sign * (a + t), 0.0, z], [t, b + thick, z], &surface));
        blocks.push(board([0.0, sign * (b + t), z], [a, t, z], &surface));
    }
    // A hair above the table, where the physics has its ground.
    let floor = board([0.0, 0.0, -0.0012], [a, b, 0.0015], &surface);
    blocks.push(Block { casts_shadow: false, ..floor });
    blocks
}

/// The board the objects stand on, sides, back, and a board above them.
fn shelf(
    [a, b]: [f32; 2],
    thick: f32,
    top: f32,
    backgrounds: &Backgrounds,
    rng: &mut ChaCha8Rng,
) -> Vec<Block> {
    let surface = match rng.chance(0.4) {
        true => backgrounds.plain(rng),
        false => backgrounds.material(256, [0.4, 1.2], 0.4, rng),
    };
    let back =
        if rng.chance(0.5) { surface.clone() } else { backgrounds.material(160, [0.4, 1.2], 0.5, rng) };
    let (t, height) = (0.5 * thick, (top + rng.between(0.03, 0.15)).max(0.2));
    let wide = a + thick;
    let mut blocks = vec![
        board([0.0, 0.0, -t], [wide, b, t], &surface),
        board([0.0, b + t, 0.5 * height], [wide, t, 0.5 * height], &back),
        board([0.0, 0.0, height + t], [wide, b, t], &surface),
    ];
    for sign in [-1.0, 1.0] {
        blocks.push(board([sign * (a + t), 0.0, 0.5 * height], [t, b, 0.5 * height], &surface));
    }
    blocks
}

/// Things as large as chairs and cupboards on the floor.
fn furniture(
    blocks: &mut Vec<Block>,
    floor_drop: f32,
    room: f32,
    backgrounds: &Backgrounds,
    rng: &mut ChaCha8Rng,
) {
    for _ in 0..rng.count(0, 5) {
        let half = [rng.between(0.12, 0.6), rng.between(0.1, 0.4), rng.between(0.15, 0.8)];
        let (s, c) = rng.between(0.0, TAU).sin_cos();
        let distance = rng.between(1.5, room.max(1.6));
        let surface = match rng.count(0, 2) {
            0 => backgrounds.plain(rng),
            1 => backgrounds.wall(rng),
            _ => backgrounds.material(128, [0.3, 1.2], 0.4, rng),
        };
        let center = Vector3::new(c * distance, s * distance, half[2] - floor_drop);
        let turn = rng.between(0.0, TAU).sin_cos().into();
        blocks.push(Block { center, half, turn, surface, casts_shadow: false });
    }
}
