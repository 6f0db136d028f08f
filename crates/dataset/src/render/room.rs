//! Rays against the analytic table, boards and room.

use nalgebra::Vector3;

use super::{
    camera::Camera,
    scene::{Block, Finish, Room, Surface},
    texture,
};

/// The surroundings at the end of a ray.
pub(super) struct RoomSurface {
    pub normal: Vector3<f32>,
    /// Linear light.
    pub albedo: [f32; 3],
    pub finish: Finish,
}

/// What a ray meets first, before its colour is looked up.
#[derive(Clone, Copy, Debug)]
pub(super) struct RoomHit {
    /// Ray parameter.
    pub t: f32,
    /// Index into the blocks; `None`: the room itself.
    block: Option<usize>,
    axis: usize,
}

impl RoomHit {
    /// Wall, floor or ceiling.
    pub(super) fn is_wall(&self) -> bool {
        self.block.is_none()
    }

    /// The same for all points of one flat side.
    pub(super) fn side(&self) -> (Option<usize>, usize) {
        (self.block, self.axis)
    }
}

/// The room as a camera sees it: every block with the part of the image it can appear in.
pub(super) struct RoomView<'a> {
    room: &'a Room,
    origin: Vector3<f32>,
    /// First and last column and row of each block, pixels.
    seen: Vec<([f32; 2], [f32; 2])>,
}

/// The blocks that can appear in a row of pixels.
pub(super) struct RoomScanline<'a> {
    view: &'a RoomView<'a>,
    blocks: Vec<usize>,
}

impl<'a> RoomView<'a> {
    pub fn new(room: &'a Room, camera: &Camera) -> Self {
        let origin = camera.t_camera_world.inverse().translation.cast();
        Self { room, origin, seen: room.blocks.iter().map(|b| window(b, camera)).collect() }
    }

    pub fn scanline(&'a self, row: u32) -> RoomScanline<'a> {
        let row = row as f32;
        let meets = |(_, rows): &&([f32; 2], [f32; 2])| (rows[0] - 1.0..=rows[1] + 1.0).contains(&row);
        let blocks = self.seen.iter().enumerate().filter(|(_, seen)| meets(seen)).map(|(i, _)| i).collect();
        RoomScanline { view: self, blocks }
    }
}

impl RoomScanline<'_> {
    /// What a ray through pixel column `col` meets before `limit`.
    pub fn meet(&self, col: u32, direction: &Vector3<f32>, limit: f32) -> Option<RoomHit> {
        let (view, col) = (self.view, col as f32);
        let mut first = RoomHit { t: limit, block: None, axis: 0 };
        if limit == f32::INFINITY {
            let (t, axis) = view.room.wall_exit(&view.origin, direction);
            first = RoomHit { t, block: None, axis };
        }
        for &i in &self.blocks {
            let [low, high] = view.seen[i].0;
            if col < low - 1.0 || col > high + 1.0 {
                continue;
            }
            if let Some((t, axis)) = view.room.blocks[i].entry(&view.origin, direction, first.t) {
                first = RoomHit { t, block: Some(i), axis };
            }
        }
        (limit == f32::INFINITY || first.block.is_some()).then_some(first)
    }
}

/// Columns and rows of the image that a block can appear in.
fn window(block: &Block, camera: &Camera) -> ([f32; 2], [f32; 2]) {
    let everywhere = [f32::NEG_INFINITY, f32::INFINITY];
    let mut bounds = [[f32::INFINITY, f32::NEG_INFINITY]; 2];
    for corner in block.corners() {
        let p = camera.t_camera_world.transform(&corner.cast::<f64>().into());
        if p.z < 1e-3 {
            return (everywhere, everywhere);
        }
        let Some(uv) = camera.intrinsics.project(&p) else { return (everywhere, everywhere) };
        for (axis, value) in [uv.x as f32, uv.y as f32].into_iter().enumerate() {
            bounds[axis] = [bounds[axis][0].min(value), bounds[axis][1].max(value)];
        }
    }
    (bounds[0], bounds[1])
}

impl Room {
    /// First surface met by `origin + t * direction` for t > 0.
    pub(super) fn meet(&self, origin: &Vector3<f32>, direction: &Vector3<f32>) -> RoomHit {
        let (t, axis) = self.wall_exit(origin, direction);
        let mut first = RoomHit { t, block: None, axis };
        for (i, block) in self.blocks.iter().enumerate() {
            if let Some((t, axis)) = block.entry(origin, direction, first.t) {
                first = RoomHit { t, block: Some(i), axis };
            }
        }
        first
    }

    /// Normal and colour there.
    pub(super) fn surface_at(
        &self,
        origin: &Vector3<f32>,
        direction: &Vector3<f32>,
        hit: &RoomHit,
    ) -> RoomSurface {
        let (p, axis) = (origin + direction * hit.t, hit.axis);
        let Some(block) = hit.block.map(|i| &self.blocks[i]) else {
            let mut normal = Vector3::zeros();
            normal[axis] = -direction[axis].signum();
            let surface = if axis == 2 && direction.z < 0.0 { &self.floor } else { &self.wall };
            return surface.at(normal, flat(axis, &p));
        };
        let (q, d) = (block.to_local(&(p - block.center)), block.to_local(direction));
        let mut normal = Vector3::zeros();
        normal[axis] = -d[axis].signum();
        block.surface.at(block.to_world(&normal), flat(axis, &q))
    }

    fn wall_exit(&self, origin: &Vector3<f32>, direction: &Vector3<f32>) -> (f32, usize) {
        let low = [-self.half, -self.half, -self.floor_drop];
        let high = [self.half, self.half, self.ceiling];
        let exit = |k: usize| {
            let bound = if direction[k] > 0.0 { high[k] } else { low[k] };
            let t = (bound - origin[k]) / direction[k];
            if direction[k] == 0.0 || t.is_nan() { f32::MAX } else { t.max(0.0) }
        };
        (0..3).map(|k| (exit(k), k)).fold((f32::MAX, 2), |a, b| if b.0 < a.0 { b } else { a })
    }
}

impl Block {
    fn to_local(&self, v: &Vector3<f32>) -> Vector3<f32> {
        let [s, c] = self.turn;
        Vector3::new(c * v.x + s * v.y, -s * v.x + c * v.y, v.z)
    }

    fn to_world(&self, v: &Vector3<f32>) -> Vector3<f32> {
        let [s, c] = self.turn;
        Vector3::new(c * v.x - s * v.y, s * v.x + c * v.y, v.z)
    }

    /// Parameter and axis where the ray enters before `limit`; rays that start inside do not.
    fn entry(&self, origin: &Vector3<f32>, direction: &Vector3<f32>, limit: f32) -> Option<(f32, usize)> {
        let (o, d) = (self.to_local(&(origin - self.center)), self.to_local(direction));
        let (mut enter, mut leave, mut axis) = (0f32, limit, 2);
        for k in 0..3 {
            let inv = 1.0 / d[k];
            let (a, b) = ((-self.half[k] - o[k]) * inv, (self.half[k] - o[k]) * inv);
            let (near, far) = if a > b { (b, a) } else { (a, b) };
            if near > enter {
                (enter, axis) = (near, k);
            }
            leave = leave.min(far);
        }
        (enter > 0.0 && enter < leave).then_some((enter, axis))
    }

    /// The eight corners, world frame.
    pub(super) fn corners(&self) -> [Vector3<f32>; 8] {
        std::array::from_fn(|i| {
            let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
            self.center + self.to_world(&Vector3::from_fn(|k, _| sign(k) * self.half[k]))
        })
    }
}

/// The two coordinates of a point on a side across `axis`.
fn flat(axis: usize, p: &Vector3<f32>) -> [f32; 2] {
    match axis {
        0 => [p.y, p.z],
        1 => [p.x, p.z],
        _ => [p.x, p.y],
    }
}

impl Surface {
    /// Colour at two coordinates in the plane of the surface, metres.
    fn at(&self, normal: Vector3<f32>, at: [f32; 2]) -> RoomSurface {
        let (s, c) = self.angle.sin_cos();
        let uv = [(c * at[0] + s * at[1]) / self.tile, (-s * at[0] + c * at[1]) / self.tile];
        RoomSurface { normal, albedo: texture::sample(&self.picture, uv), finish: self.finish }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    fn surface() -> Surface {
        let picture = Arc::new(image::RgbImage::from_pixel(1, 1, image::Rgb([128; 3])));
        Surface { picture, tile: 1.0, angle: 0.0, finish: Finish { roughness: 1.0, metallic: 0.0 } }
    }

    #[test]
    fn rays_meet_the_nearest_of_table_board_and_wall() {
        let block = |center: [f32; 3], half: [f32; 3], angle: f32| Block {
            center: center.into(),
            half,
            turn: angle.sin_cos().into(),
            surface: surface(),
            casts_shadow: false,
        };
        let room = Room {
            // A table top, and a post turned by 45 degrees whose edge looks along -x.
            blocks: vec![
                block([0.0, 0.0, -0.015], [0.5, 0.5, 0.015], 0.3),
                block([0.3, 0.0, 0.1], [0.05, 0.05, 0.1], std::f32::consts::FRAC_PI_4),
            ],
            floor: surface(),
            wall: surface(),
            floor_drop: 0.8,
            half: 3.0,
            ceiling: 2.0,
        };
        let meet = |o: [f32; 3], d: [f32; 3]| {
            let (o, d) = (o.into(), d.into());
            let hit = room.meet(&o, &d);
            (hit.t, room.surface_at(&o, &d, &hit).normal)
        };
        let down = meet([0.1, 0.1, 1.0], [0.0, 0.0, -1.0]);
        assert!((down.0 - 1.0).abs() < 1e-6 && (down.1 - Vector3::z()).norm() < 1e-6);
        // Half the diagonal of the post before its centre.
        let post = meet([-1.0, 0.001, 0.1], [1.0, 0.0, 0.0]);
        assert!((post.0 - (1.3 - 0.05 * 2f32.sqrt())).abs() < 2e-3, "{}", post.0);
        assert!((post.1.x + 0.5f32.sqrt()).abs() < 1e-5);
        let wall = meet([0.0, 0.0, 1.0], [0.0, 2.0, 0.0]);
        assert!((wall.0 - 1.5).abs() < 1e-6 && (wall.1 + Vector3::y()).norm() < 1e-6);
        let floor = meet([1.0, 1.0, 0.2], [0.0, 0.0, -1.0]);
        assert!((floor.0 - 1.0).abs() < 1e-6);
    }
}
