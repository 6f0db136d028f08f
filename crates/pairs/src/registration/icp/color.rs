//! The photometric part (Park, Zhou, Koltun, "Colored Point Cloud Registration Revisited", ICCV 2017): the reference's colours
//! as functions on its tangent planes, which the query's colours must meet.

use nalgebra::{Matrix2, Vector2, Vector3};
use rayon::prelude::*;
use unopose_core::geometry::Pose;

use super::super::surface::{Surface, vector};
use crate::appearance::AppearanceView;

/// Three channels, as [`AppearanceView`] has them.
pub(super) type Color = [f64; 3];
/// As averaged over the cells of the view, and blurred.
pub(super) const LEVELS: usize = 2;
/// Neighbours that a gradient is fitted to.
const NEIGHBORS: usize = 20;
/// Distance, in cells, up to which two surface points show the same place when colours are compared.
const SAME_PLACE_CELLS: f32 = 2.5;
/// Standard deviation of a colour that noise, focus and light explain.
const NOISE: f64 = 0.02;
/// A channel's gain between the views is trusted within this factor.
const MAX_GAIN: f64 = 2.0;

/// Colours of the points of a surface, `[N]`.
#[derive(Clone, Debug)]
pub(super) struct Colors(pub Vec<[Color; LEVELS]>);

/// Colours with their gradients along the surface, per metre, `[N]`.
#[derive(Clone, Debug)]
pub(super) struct ColorField {
    pub colors: Colors,
    pub gradients: Vec<[[Vector3<f64>; 3]; LEVELS]>,
}

impl Colors {
    /// From the surface's own view.
    pub fn new(surface: &Surface, view: &AppearanceView) -> Self {
        Self(surface.points.iter().map(|p| view.colors_at(p).map(|c| c.map(f64::from))).collect())
    }
}

impl ColorField {
    /// Gradients by least squares over each point's neighbours, in its tangent plane.
    pub fn new(surface: &Surface, view: &AppearanceView) -> Self {
        let colors = Colors::new(surface, view);
        let gradient = |index: usize| {
            let (point, normal) = (vector(&surface.points[index]), surface.normals[index]);
            let [u, v] = tangents(&normal);
            let neighbors = surface.nearest_n(&surface.points[index], NEIGHBORS);
            let mut normal_matrix = Matrix2::zeros();
            let mut right = [[Vector2::zeros(); 3]; LEVELS];
            for &neighbor in &neighbors {
                let offset = vector(&surface.points[neighbor]) - point;
                let row = Vector2::new(offset.dot(&u), offset.dot(&v));
                normal_matrix += row * row.transpose();
                for (level, right) in right.iter_mut().enumerate() {
                    for (channel, right) in right.iter_mut().enumerate() {
                        let step = colors.0[neighbor][level][channel] - colors.0[index][level][channel];
                        *right += row * step;
                    }
                }
            }
            let inverse = normal_matrix.try_inverse().unwrap_or_else(Matrix2::zeros);
            right.map(|channels| {
                channels.map(|right| {
                    let slope = inverse * right;
                    u * slope.x + v * slope.y
                })
            })
        };
        let gradients = (0..surface.points.len()).into_par_iter().with_min_len(64).map(gradient).collect();
        Self { colors, gradients }
    }
}

/// Two unit vectors across a unit normal.
fn tangents(normal: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let helper = if normal.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
    let u = normal.cross(&helper).normalize();
    [u, normal.cross(&u)]
}

/// Linear map of one channel from the query's colours to the reference's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gain {
    scale: f64,
    offset: f64,
}

impl Gain {
    /// That makes means and deviations of matched colours equal: light and exposure differ between views.
    pub fn between(pairs: &[(Color, Color)]) -> [Self; 3] {
        [0, 1, 2].map(|channel| {
            let n = pairs.len().max(1) as f64;
            let (mut q, mut r, mut qq, mut rr) = (0.0, 0.0, 0.0, 0.0);
            for (query, reference) in pairs {
                let (a, b) = (query[channel], reference[channel]);
                (q, r, qq, rr) = (q + a, r + b, qq + a * a, rr + b * b);
            }
            let deviation =
                |sum: f64, squares: f64| ((squares / n - (sum / n).powi(2)).max(0.0) + NOISE * NOISE).sqrt();
            let scale = (deviation(r, rr) / deviation(q, qq)).clamp(1.0 / MAX_GAIN, MAX_GAIN);
            Self { scale, offset: r / n - scale * q / n }
        })
    }

    pub fn apply(&self, value: f64) -> f64 {
        self.scale * value + self.offset
    }
}

/// Correlation of the sharp colours of both surfaces where they show the same place, times the share of the query's points
/// that do: near 0 without colours that could agree.
pub(super) fn agreement(
    query: (&Surface, &Colors),
    reference: (&Surface, &Colors),
    t_reference_query: &Pose,
) -> f64 {
    let limit = (SAME_PLACE_CELLS * reference.0.cell).powi(2);
    let pairs: Vec<(Color, Color)> = query
        .0
        .points
        .iter()
        .zip(&query.1.0)
        .filter_map(|(q, color)| {
            let nearest = reference.0.nearest(&t_reference_query.transform_f32(q));
            (nearest.squared_distance < limit).then(|| (color[0], reference.1.0[nearest.index][0]))
        })
        .collect();
    let n = pairs.len() as f64;
    if n < 2.0 {
        return 0.0;
    }
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for channel in 0..3 {
        let mean = |of: fn(&(Color, Color)) -> &Color| pairs.iter().map(|p| of(p)[channel]).sum::<f64>() / n;
        let (a, b) = (mean(|p| &p.0), mean(|p| &p.1));
        for (query, reference) in &pairs {
            let (da, db) = (query[channel] - a, reference[channel] - b);
            (aa, bb, ab) = (aa + da * da, bb + db * db, ab + da * db);
        }
    }
    ab / ((aa * bb).sqrt() + n * NOISE * NOISE) * n / query.0.points.len().max(1) as f64
}
