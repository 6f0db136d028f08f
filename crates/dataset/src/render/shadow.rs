//! Shadow maps with soft edges. One map per light serves all views of a scene.

use nalgebra::{Matrix3, Vector3};
use unopose_core::geometry::{Intrinsics, Pose};

use super::{
    raster::{self, Window},
    scene::{Light, PosedMesh},
};

const SIZE: i32 = 512;
/// Widest filter, texels.
const MAX_FILTER_RADIUS: f32 = 32.0;
/// Side of the tiles that tell where no object is near, texels; not below the widest filter.
const TILE: i32 = 32;
const TILES: i32 = SIZE / TILE;

/// Depth of the objects as seen from a light.
pub(super) struct ShadowMap {
    rotation: Matrix3<f32>,
    translation: Vector3<f32>,
    focal: f32,
    center: f32,
    /// Nearest depth, 0 where the light meets no object.
    depth: Vec<f32>,
    /// Nearest depth in a tile and its neighbours, infinite where there is none; one more tile around the map.
    near_tile: Vec<f32>,
    light_radius: f32,
    taps: [[f32; 2]; TAPS],
}

/// Offsets of the filter taps in the unit disc, a golden spiral; the search for blockers takes every other one.
const TAPS: usize = 16;

fn taps() -> [[f32; 2]; TAPS] {
    std::array::from_fn(|k| {
        let r = ((k as f32 + 0.5) / TAPS as f32).sqrt();
        let (s, c) = (k as f32 * 2.399_963_2).sin_cos();
        [r * c, r * s]
    })
}

/// Faces of a box whose corner `i` has the signs of the bits of `i`.
const BOX_FACES: [[u32; 3]; 12] = [
    [0, 2, 1],
    [1, 2, 3],
    [4, 5, 6],
    [5, 7, 6],
    [0, 1, 4],
    [1, 5, 4],
    [2, 6, 3],
    [3, 6, 7],
    [0, 4, 2],
    [2, 4, 6],
    [1, 3, 5],
    [3, 7, 5],
];

impl ShadowMap {
    /// `center` and `radius` bound the objects; `boards` are the corners of boxes that throw shadows, too.
    pub fn new(
        light: &Light,
        objects: &[PosedMesh],
        boards: &[[Vector3<f32>; 8]],
        center: &Vector3<f32>,
        radius: f32,
    ) -> Self {
        let distance = (light.position - center).norm().max(radius * 1.05);
        let z = (center - light.position).normalize();
        let helper = if z.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
        let x = helper.cross(&z).normalize();
        let rotation = Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
        let translation = -(rotation * light.position);
        let tangent = radius / (distance * distance - radius * radius).max(1e-6).sqrt();
        let focal = (SIZE as f32 * 0.5 - 4.0) / tangent;
        let middle = SIZE as f32 * 0.5;
        let t_light_world = Pose::new(rotation.cast(), translation.cast());
        let intrinsics =
            Intrinsics { fx: focal.into(), fy: focal.into(), cx: middle.into(), cy: middle.into() };
        let window = Window { min: [0, 0], max: [SIZE, SIZE] };
        let mut inverse = vec![0f32; (SIZE * SIZE) as usize];
        let mut draw = |vertices: &[[f32; 3]], faces: &[[u32; 3]], t_light_mesh: &Pose| {
            let projected = raster::project(vertices, t_light_mesh, &intrinsics);
            for face in faces {
                raster::triangle(face.map(|i| projected[i as usize]), &window, |f| {
                    let cell = &mut inverse[(f.row * SIZE + f.col) as usize];
                    *cell = cell.max(f.inv_z);
                });
            }
        };
        for object in objects {
            draw(&object.mesh.vertices, &object.mesh.faces, &(t_light_world * object.t_world_object));
        }
        for board in boards {
            draw(&board.map(|c| c.into()), &BOX_FACES, &t_light_world);
        }
        let depth: Vec<f32> = inverse.iter().map(|&i| if i > 0.0 { 1.0 / i } else { 0.0 }).collect();
        let near_tile = near_tiles(&depth);
        Self {
            rotation,
            translation,
            focal,
            center: middle,
            depth,
            near_tile,
            light_radius: light.radius,
            taps: taps(),
        }
    }

    fn blocker(&self, u: f32, v: f32) -> f32 {
        // Truncation towards zero rounds here: negative places are outside anyway.
        let (col, row) = ((u + 0.5) as i32, (v + 0.5) as i32);
        if u < 0.0 || v < 0.0 || col >= SIZE || row >= SIZE {
            return 0.0;
        }
        self.depth[(row * SIZE + col) as usize]
    }

    /// Nearest depth within reach of the filter, infinite where there is nothing.
    fn nearest_around(&self, u: f32, v: f32) -> f32 {
        let tile = |x: f32| (x * (1.0 / TILE as f32) + 1.0) as i32;
        let (col, row) = (tile(u), tile(v));
        if u < -MAX_FILTER_RADIUS || v < -MAX_FILTER_RADIUS || col > TILES + 1 || row > TILES + 1 {
            return f32::INFINITY;
        }
        self.near_tile[(row * (TILES + 2) + col) as usize]
    }

    /// Share of the light that reaches a world point; `turn` rotates the filter taps.
    pub fn visibility(&self, point: &Vector3<f32>, normal: &Vector3<f32>, turn: [f32; 2]) -> f32 {
        // Moved off the surface by about two texels, so that a surface does not shade itself.
        let offset = 0.0015 + 2.0 / self.focal;
        let p = self.rotation * (point + normal * offset) + self.translation;
        if p.z <= 0.05 {
            return 1.0;
        }
        let (u, v) = (self.focal * p.x / p.z + self.center, self.focal * p.y / p.z + self.center);
        let bias = 0.001 + 0.002 * p.z / self.focal * SIZE as f32 / 256.0;
        if self.nearest_around(u, v) >= p.z - bias {
            return 1.0;
        }
        let search = (self.focal * self.light_radius * 0.15 / p.z).clamp(1.5, MAX_FILTER_RADIUS);
        let tap = |[x, y]: &[f32; 2], size: f32| {
            let (dx, dy) = (turn[0] * x - turn[1] * y, turn[1] * x + turn[0] * y);
            self.blocker(u + dx * size, v + dy * size)
        };
        let blocks = |depth: f32| depth > 0.0 && depth < p.z - bias;
        let (mut sum, mut count) = (0f32, 0usize);
        for offset in self.taps.iter().skip(1).step_by(2) {
            let depth = tap(offset, search);
            if blocks(depth) {
                sum += depth;
                count += 1;
            }
        }
        if count == 0 {
            return 1.0;
        }
        // Width of the penumbra from similar triangles (percentage-closer soft shadows, Fernando 2005).
        let blocker = sum / count as f32;
        let penumbra = self.light_radius * (p.z - blocker) / blocker;
        let size = (self.focal * penumbra / p.z).clamp(0.7, MAX_FILTER_RADIUS);
        if 2 * count == TAPS && size <= search {
            return 0.0;
        }
        self.taps.iter().filter(|offset| !blocks(tap(offset, size))).count() as f32 / TAPS as f32
    }
}

fn near_tiles(depth: &[f32]) -> Vec<f32> {
    let side = TILES + 2;
    let mut own = vec![f32::INFINITY; (side * side) as usize];
    for (i, &z) in depth.iter().enumerate().filter(|(_, z)| **z > 0.0) {
        let (col, row) = (i as i32 % SIZE / TILE + 1, i as i32 / SIZE / TILE + 1);
        let tile = &mut own[(row * side + col) as usize];
        *tile = tile.min(z);
    }
    let around = |i: i32| {
        let (col, row) = (i % side, i / side);
        let neighbours = (row - 1..=row + 1).flat_map(|r| (col - 1..=col + 1).map(move |c| (r, c)));
        let inside = neighbours.filter(|(r, c)| (0..side).contains(r) && (0..side).contains(c));
        inside.map(|(r, c)| own[(r * side + c) as usize]).fold(f32::INFINITY, f32::min)
    };
    (0..side * side).map(around).collect()
}
