//! Several materials in one picture, as OBJ and GLB files of product scans and ShapeNet have them.

use std::{path::Path, sync::Arc};

use image::{Rgb, RgbImage, imageops};

use super::TriangleMesh;

/// What a face is painted with.
#[derive(Clone, Debug, Default)]
pub(super) struct Material {
    pub picture: Option<Arc<RgbImage>>,
    /// sRGB, where there is no picture.
    pub color: [u8; 3],
}

/// Longest side of an atlas, pixels.
const SIDE: u32 = 2048;
/// Texels around a picture that repeat its border.
const BORDER: u32 = 2;

impl TriangleMesh {
    /// Gives the mesh its materials; `of_face` holds one index per face. One picture stays as it is; several pictures,
    /// or pictures beside plain colours, become one; colours alone become vertex colours where the vertices of the
    /// file at `path` have none. Expects `uvs` for every vertex where there are pictures.
    pub(super) fn paint(&mut self, path: &Path, materials: &[Material], of_face: &[u32]) {
        let mut used: Vec<u32> = of_face.to_vec();
        used.sort_unstable();
        used.dedup();
        let material = |m: u32| materials.get(m as usize).cloned().unwrap_or_default();
        let with_uvs = self.uvs.len() == self.vertices.len();
        let pictures = used.iter().filter(|&&m| material(m).picture.is_some()).count();
        let colored = !self.colors.is_empty();
        if pictures > 0 && with_uvs {
            if self.colors.iter().any(|color| *color != [255; 3]) {
                tracing::warn!("{}: vertex colours beside a texture are not used", path.display());
            }
            self.colors.clear();
        }
        match used.as_slice() {
            _ if pictures == 0 || !with_uvs => {
                if colored {
                    return;
                }
                self.colors = vec![[176; 3]; self.vertices.len()];
                for (face, &m) in self.faces.iter().zip(of_face) {
                    face.iter().for_each(|&v| self.colors[v as usize] = material(m).color);
                }
            }
            [only] => self.texture = material(*only).picture,
            _ => self.pack(&used, &material, of_face),
        }
    }

    fn pack(&mut self, used: &[u32], material: &dyn Fn(u32) -> Material, of_face: &[u32]) {
        let columns = (used.len() as f64).sqrt().ceil() as u32;
        let largest =
            used.iter().filter_map(|&m| material(m).picture).map(|p| p.width().max(p.height())).max();
        let cell = largest.unwrap_or(16).min(SIDE / columns).max(2 * BORDER + 2);
        let inner = cell - 2 * BORDER;
        let side = columns * cell;
        let mut atlas = RgbImage::new(side, side);
        for (k, &m) in used.iter().enumerate() {
            let (material, corner) = (material(m), [k as u32 % columns * cell, k as u32 / columns * cell]);
            let picture = match material.picture {
                Some(picture) if picture.dimensions() == (inner, inner) => (*picture).clone(),
                Some(picture) => imageops::resize(&*picture, inner, inner, imageops::FilterType::Triangle),
                None => RgbImage::from_pixel(inner, inner, Rgb(material.color)),
            };
            for row in 0..cell {
                for col in 0..cell {
                    let at = |x: u32| x.saturating_sub(BORDER).min(inner - 1);
                    atlas.put_pixel(corner[0] + col, corner[1] + row, *picture.get_pixel(at(col), at(row)));
                }
            }
        }
        // Corners get vertices of their own: coordinates move into the cell of their face's material.
        let source = std::mem::take(self);
        for (face, &m) in source.faces.iter().zip(of_face) {
            let k = used.binary_search(&m).unwrap_or(0) as u32;
            let uvs = face.map(|v| source.uvs[v as usize]);
            // A repeated picture starts at the whole number below the face.
            let base = [0, 1].map(|axis| uvs.iter().map(|uv| uv[axis]).fold(f32::MAX, f32::min).floor());
            let first = self.vertices.len() as u32;
            for (&v, uv) in face.iter().zip(uvs) {
                let inside =
                    |axis: usize| (uv[axis] - base[axis]).clamp(0.0, 1.0) * inner as f32 + BORDER as f32;
                let x = (k % columns * cell) as f32 + inside(0);
                // Rows count downwards, texture coordinates upwards.
                let y = (k / columns * cell + cell) as f32 - inside(1);
                self.vertices.push(source.vertices[v as usize]);
                self.normals.extend(source.normals.get(v as usize));
                self.uvs.push([x / side as f32, 1.0 - y / side as f32]);
            }
            self.faces.push([first, first + 1, first + 2]);
        }
        self.texture = Some(Arc::new(atlas));
    }
}
