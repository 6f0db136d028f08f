//! Unwrapping by the six axis directions, and baking a look into the texture.

use std::sync::Arc;

use image::{Rgb, RgbImage};
use nalgebra::Vector3;
use unopose_dataset::mesh::{TriangleMesh, split_by_crease};

use super::look::Look;
use crate::shapes::Solid;

/// Normals of faces meeting at more than this are not smoothed.
const CREASE_DEG: f32 = 42.0;
/// Free border of a chart, texels.
const PADDING: f32 = 3.0;

/// Direction 0..6 (+x, -x, +y, -y, +z, -z) that a normal faces most.
fn chart_of(normal: &Vector3<f32>) -> u8 {
    let axis = normal.iamax();
    2 * axis as u8 + u8::from(normal[axis] < 0.0)
}

/// Position inside a chart, 0..1, of a point in the box `min .. min + size`.
fn chart_coordinates(p: &[f32; 3], chart: u8, min: &[f32; 3], size: &[f32; 3]) -> [f32; 2] {
    let (a, b) = match chart / 2 {
        0 => (1, 2),
        1 => (0, 2),
        _ => (0, 1),
    };
    let at = |axis: usize| ((p[axis] - min[axis]) / size[axis].max(1e-9)).clamp(0.0, 1.0);
    // The longer side lies along the taller side of the cell.
    if size[a] > size[b] { [at(b), at(a)] } else { [at(a), at(b)] }
}

/// A mesh with normals, texture coordinates and the baked texture of `resolution` x `resolution` texels.
pub(crate) fn textured(solid: &Solid, look: &Look, resolution: u32) -> TriangleMesh {
    let shared = &solid.mesh;
    let corner = |i: u32| Vector3::from(shared.vertices[i as usize]);
    let charts: Vec<u8> = shared
        .faces
        .iter()
        .map(|f| chart_of(&(corner(f[1]) - corner(f[0])).cross(&(corner(f[2]) - corner(f[0])))))
        .collect();
    let (mut mesh, origin) = split_by_crease(shared, CREASE_DEG, |face| charts[face]);
    let (bounds, side) = (shared.bounds(), resolution as f32);
    let (cell, size) = ([side / 3.0, side / 2.0], bounds.size());
    // Three columns (axes) and two rows (signs).
    let texel = |p: &[f32; 3], chart: u8| -> [f32; 2] {
        let at = chart_coordinates(p, chart, &bounds.min, &size);
        let corner = [f32::from(chart / 2) * cell[0], f32::from(chart % 2) * cell[1]];
        std::array::from_fn(|k| corner[k] + PADDING + at[k] * (cell[k] - 2.0 * PADDING))
    };
    let texels: Vec<[f32; 2]> = mesh.vertices.iter().zip(&origin).map(|(v, o)| texel(v, o.1)).collect();
    mesh.uvs = texels.iter().map(|t| [t[0] / side, 1.0 - t[1] / side]).collect();
    let part = |i: u32| solid.parts[origin[i as usize].0 as usize];
    mesh.texture = Some(Arc::new(bake(&mesh, &texels, &part, look, resolution)));
    mesh
}

fn bake(
    mesh: &TriangleMesh,
    texels: &[[f32; 2]],
    part: &dyn Fn(u32) -> u8,
    look: &Look,
    resolution: u32,
) -> RgbImage {
    let mut picture = RgbImage::new(resolution, resolution);
    let mut set = vec![false; (resolution * resolution) as usize];
    for face in &mesh.faces {
        let [a, b, c] = face.map(|i| texels[i as usize]);
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area.abs() < 1e-9 {
            continue;
        }
        let span = |k: usize| {
            let low = a[k].min(b[k]).min(c[k]).floor().max(0.0) as u32;
            let high = (a[k].max(b[k]).max(c[k]).ceil() as u32).min(resolution - 1);
            low..=high
        };
        let corner = |list: &[[f32; 3]], w: [f32; 3]| -> Vector3<f32> {
            (0..3).map(|k| Vector3::from(list[face[k] as usize]) * w[k]).sum()
        };
        let part = part(face[0]);
        for row in span(1) {
            for col in span(0) {
                let (x, y) = (col as f32 + 0.5 - a[0], row as f32 + 0.5 - a[1]);
                let wb = (x * (c[1] - a[1]) - y * (c[0] - a[0])) / area;
                let wc = (y * (b[0] - a[0]) - x * (b[1] - a[1])) / area;
                let w = [1.0 - wb - wc, wb, wc];
                // Half a texel beyond the edges, so that bilinear lookups stay inside.
                if w.iter().any(|&w| w < -1e-3) || set[(row * resolution + col) as usize] {
                    continue;
                }
                let color = look.color(&corner(&mesh.vertices, w), &corner(&mesh.normals, w), part);
                picture.put_pixel(
                    col,
                    row,
                    Rgb(color.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).into()),
                );
                set[(row * resolution + col) as usize] = true;
            }
        }
    }
    for _ in 0..3 {
        grow(&mut picture, &mut set);
    }
    picture
}

/// Copies every painted texel to its unpainted neighbours.
fn grow(picture: &mut RgbImage, set: &mut [bool]) {
    let (w, h) = (picture.width() as i64, picture.height() as i64);
    let before = set.to_vec();
    for row in 0..h {
        for col in 0..w {
            if before[(row * w + col) as usize] {
                continue;
            }
            let painted = [(0, -1), (0, 1), (-1, 0), (1, 0)]
                .into_iter()
                .map(|(dx, dy)| (col + dx, row + dy))
                .find(|&(x, y)| (0..w).contains(&x) && (0..h).contains(&y) && before[(y * w + x) as usize]);
            if let Some((x, y)) = painted {
                let color = *picture.get_pixel(x as u32, y as u32);
                picture.put_pixel(col as u32, row as u32, color);
                set[(row * w + col) as usize] = true;
            }
        }
    }
}
