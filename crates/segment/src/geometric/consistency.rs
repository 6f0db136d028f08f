//! Does a query image agree with the reference seen under a pose?
//!
//! The reference's points, moved into the query camera, are compared with what is measured at their pixels: points in
//! front of the measured surface contradict the pose, points behind it are hidden and say nothing.

use crate::lab::lab;
use nalgebra::Point3;
use unopose_core::{
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};

/// Points of the reference that are compared.
const SAMPLES: usize = 700;
/// Side of the tiles in which the mask must be covered, as a share of the mask's extent.
const TILES: f64 = 12.0;
/// Colour difference at which two pixels are half alike.
const HALF_COLOR: f32 = 22.0;

/// Points of a reference view with their colours.
#[derive(Clone, Debug)]
pub struct ColoredPoints {
    points: Vec<[f32; 3]>,
    lab: Vec<[f32; 3]>,
}

/// Shares in [0, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Consistency {
    /// Of the visible points of the reference, those that lie on the measured surface.
    pub surface: f64,
    /// Of the points on the surface, those inside the mask.
    pub inside: f64,
    /// Of the mask, what points of the reference cover.
    pub covered: f64,
    /// Mean likeness of the colours of points on the surface.
    pub color: f64,
}

impl ColoredPoints {
    /// At most [`SAMPLES`] measured pixels of the mask, evenly spread.
    pub fn new(frame: &RgbdFrame, mask: &Mask) -> Self {
        let usable: Vec<(u32, u32, f32)> = mask
            .pixels()
            .filter(|&(col, row)| col < frame.depth.width && row < frame.depth.height)
            .map(|(col, row)| (col, row, frame.depth.get(col, row)))
            .filter(|(_, _, z)| z.is_finite() && *z > 0.0)
            .collect();
        let chosen = usable.iter().step_by(usable.len().div_ceil(SAMPLES).max(1));
        let (mut points, mut colors) = (Vec::new(), Vec::new());
        for &(col, row, z) in chosen {
            let p = frame.intrinsics.back_project(col.into(), row.into(), z.into());
            points.push([p.x as f32, p.y as f32, p.z as f32]);
            colors.push(lab(frame.rgb.get_pixel(col, row).0));
        }
        Self { points, lab: colors }
    }

    /// Compares under `t_query_reference`; `reach` metres off the surface is still on it.
    pub fn consistency(
        &self,
        query: &RgbdFrame,
        mask: &Mask,
        t_query_reference: &Pose,
        reach: f32,
    ) -> Consistency {
        let Some(bounds) = mask.bounding_box() else { return Consistency::default() };
        let (width, height) = (query.width().min(mask.width), query.height().min(mask.height));
        let extent = (bounds.col_max - bounds.col_min).max(bounds.row_max - bounds.row_min);
        let tile = (f64::from(extent) / TILES).max(2.0);
        let columns = (f64::from(width) / tile) as usize + 1;
        let tile_of = |col: f64, row: f64| (row / tile) as usize * columns + (col / tile) as usize;
        let mut covered = vec![false; columns * ((f64::from(height) / tile) as usize + 1)];
        let (mut on, mut against, mut inside, mut color) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
        for (point, reference_lab) in self.points.iter().zip(&self.lab) {
            let [x, y, z] = t_query_reference.transform_f32(point);
            let moved = Point3::new(f64::from(x), f64::from(y), f64::from(z));
            let Some(at) = query.intrinsics.project(&moved) else { continue };
            let (col, row) = (at.x.round(), at.y.round());
            if !(col >= 0.0 && row >= 0.0 && col < f64::from(width) && row < f64::from(height)) {
                continue;
            }
            if let Some(tile) = covered.get_mut(tile_of(col, row)) {
                *tile = true;
            }
            let (col, row) = (col as u32, row as u32);
            let measured = query.depth.get(col, row);
            if !(measured.is_finite() && measured > 0.0) {
                continue;
            }
            if measured - z > reach {
                against += 1.0;
            } else if z - measured <= reach {
                on += 1.0;
                inside += f64::from(u8::from(mask.get(col, row)));
                let query_lab = lab(query.rgb.get_pixel(col, row).0);
                let difference: f32 =
                    (0..3).map(|i| (query_lab[i] - reference_lab[i]).powi(2)).sum::<f32>().sqrt();
                color += f64::from((-(difference / HALF_COLOR).powi(2) * std::f32::consts::LN_2).exp());
            }
        }
        let (mut of_mask, mut pixels) = (0.0f64, 0.0f64);
        let step = mask.count().div_ceil(4 * SAMPLES).max(1);
        for (col, row) in mask.pixels().step_by(step).filter(|&(c, r)| c < width && r < height) {
            pixels += 1.0;
            let hit = covered.get(tile_of(col.into(), row.into())).is_some_and(|&hit| hit);
            of_mask += f64::from(u8::from(hit));
        }
        let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        Consistency {
            surface: share(on, on + against),
            inside: share(inside, on),
            covered: share(of_mask, pixels),
            color: share(color, on),
        }
    }
}
