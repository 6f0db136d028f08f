//! Rays against the analytic table and room.

use nalgebra::Vector3;

use super::{
    scene::{Finish, Room, Surface},
    texture::{self, Wrap},
};

/// Where a ray meets the surroundings.
pub(super) struct RoomHit {
    /// Ray parameter.
    pub t: f32,
    pub normal: Vector3<f32>,
    /// Linear light.
    pub albedo: [f32; 3],
    pub finish: Finish,
}

/// Thickness of the table top, metres.
const TABLE_THICKNESS: f32 = 0.03;

impl Room {
    /// First surface hit by `origin + t * direction` for t > 0.
    pub(super) fn cast(&self, origin: &Vector3<f32>, direction: &Vector3<f32>) -> RoomHit {
        self.cast_table(origin, direction).unwrap_or_else(|| self.cast_walls(origin, direction))
    }

    /// The parameter alone, without the colour.
    pub(super) fn distance(&self, origin: &Vector3<f32>, direction: &Vector3<f32>) -> f32 {
        match self.table_entry(origin, direction) {
            Some((t, ..)) => t,
            None => self.wall_exit(origin, direction).0,
        }
    }

    fn table_entry(
        &self,
        origin: &Vector3<f32>,
        direction: &Vector3<f32>,
    ) -> Option<(f32, usize, Vector3<f32>, Vector3<f32>)> {
        let (s, c) = self.table_angle.sin_cos();
        let turn = |v: &Vector3<f32>| Vector3::new(c * v.x + s * v.y, -s * v.x + c * v.y, v.z);
        let (o, d) = (turn(origin), turn(direction));
        let half = [self.table_half[0], self.table_half[1], 0.5 * TABLE_THICKNESS];
        let center = [0.0, 0.0, -0.5 * TABLE_THICKNESS];
        let (mut enter, mut leave, mut axis) = (0f32, f32::MAX, 2);
        for k in 0..3 {
            let inv = 1.0 / d[k];
            let (mut near, mut far) =
                ((center[k] - half[k] - o[k]) * inv, (center[k] + half[k] - o[k]) * inv);
            if near > far {
                std::mem::swap(&mut near, &mut far);
            }
            if near > enter {
                (enter, axis) = (near, k);
            }
            leave = leave.min(far);
        }
        (enter > 0.0 && enter <= leave).then(|| (enter, axis, o + d * enter, d))
    }

    fn cast_table(&self, origin: &Vector3<f32>, direction: &Vector3<f32>) -> Option<RoomHit> {
        let (t, axis, p, d) = self.table_entry(origin, direction)?;
        let (s, c) = self.table_angle.sin_cos();
        let mut local = Vector3::zeros();
        local[axis] = -d[axis].signum();
        let normal = Vector3::new(c * local.x - s * local.y, s * local.x + c * local.y, local.z);
        let at = if axis == 2 { [p.x, p.y] } else { [p.x + p.y, p.z] };
        Some(RoomHit { t, normal, albedo: self.table.albedo(at), finish: self.table.finish })
    }

    fn wall_exit(&self, origin: &Vector3<f32>, direction: &Vector3<f32>) -> (f32, usize) {
        let low = [-self.half, -self.half, -self.floor_drop];
        let high = [self.half, self.half, self.ceiling];
        let exit = |k: usize| {
            let bound = if direction[k] > 0.0 { high[k] } else { low[k] };
            let t = (bound - origin[k]) / direction[k];
            if t.is_nan() { f32::MAX } else { t.max(0.0) }
        };
        (0..3).map(|k| (exit(k), k)).fold((f32::MAX, 2), |a, b| if b.0 < a.0 { b } else { a })
    }

    fn cast_walls(&self, origin: &Vector3<f32>, direction: &Vector3<f32>) -> RoomHit {
        let (t, axis) = self.wall_exit(origin, direction);
        let p = origin + direction * t;
        let mut normal = Vector3::zeros();
        normal[axis] = -direction[axis].signum();
        let floor = axis == 2 && direction.z < 0.0;
        let surface = if floor { &self.floor } else { &self.wall };
        let at = match axis {
            0 => [p.y, p.z],
            1 => [p.x, p.z],
            _ => [p.x, p.y],
        };
        RoomHit { t, normal, albedo: surface.albedo(at), finish: surface.finish }
    }
}

impl Surface {
    fn albedo(&self, at: [f32; 2]) -> [f32; 3] {
        let (s, c) = self.angle.sin_cos();
        let uv = [(c * at[0] + s * at[1]) / self.tile, (-s * at[0] + c * at[1]) / self.tile];
        texture::sample(&self.picture, uv, Wrap::Repeat)
    }
}
