//! Closed surfaces from rings of points.

use std::f32::consts::TAU;

use nalgebra::Vector3;

use super::solid::Solid;

type Ring = Vec<Vector3<f32>>;

/// Joins consecutive rings (equal lengths, counter-clockwise seen against the direction of travel) by a skin and closes
/// both ends with fans to `start` and `end`.
pub(super) fn capped(rings: &[Ring], start: Vector3<f32>, end: Vector3<f32>, part: u8) -> Solid {
    let n = rings[0].len() as u32;
    let mut solid = skin(rings, part);
    let (first, last) = (solid.push(start, part), solid.push(end, part));
    let top = (rings.len() as u32 - 1) * n;
    for i in 0..n {
        let j = (i + 1) % n;
        solid.mesh.faces.push([first, j, i]);
        solid.mesh.faces.push([last, top + i, top + j]);
    }
    solid
}

/// Like [`capped`], but the last ring joins the first: a surface with a hole (torus).
pub(super) fn cyclic(rings: &[Ring], part: u8) -> Solid {
    let mut solid = skin(rings, part);
    let n = rings[0].len() as u32;
    strip(&mut solid, (rings.len() as u32 - 1) * n, 0, n);
    solid
}

fn skin(rings: &[Ring], part: u8) -> Solid {
    let mut solid = Solid::default();
    for point in rings.iter().flatten() {
        solid.push(*point, part);
    }
    let n = rings[0].len() as u32;
    for k in 0..rings.len() as u32 - 1 {
        strip(&mut solid, k * n, (k + 1) * n, n);
    }
    solid
}

fn strip(solid: &mut Solid, below: u32, above: u32, n: u32) {
    for i in 0..n {
        let j = (i + 1) % n;
        solid.mesh.faces.push([below + i, below + j, above + j]);
        solid.mesh.faces.push([below + i, above + j, above + i]);
    }
}

/// Points of a superellipse |x/a|^e + |y/b|^e = 1: e = 2 ellipse, large e rectangle with round corners.
pub(super) fn superellipse(n: usize, a: f32, b: f32, exponent: f32) -> Vec<[f32; 2]> {
    (0..n)
        .map(|i| {
            let (s, c) = (TAU * i as f32 / n as f32).sin_cos();
            // Radial form: evenly spread angles keep corners sampled.
            let r = (c.abs().powf(exponent) + s.abs().powf(exponent)).powf(-1.0 / exponent);
            [a * r * c, b * r * s]
        })
        .collect()
}

/// Outline in the plane z.
pub(super) fn lift(outline: &[[f32; 2]], z: f32, scale: f32) -> Ring {
    outline.iter().map(|p| Vector3::new(p[0] * scale, p[1] * scale, z)).collect()
}

/// Rotational sweep about z of a profile [(radius, z)] from bottom to top; both ends are closed on the axis.
pub(super) fn revolve(profile: &[[f32; 2]], segments: usize, part: impl Fn(usize) -> u8) -> Solid {
    let circle = superellipse(segments, 1.0, 1.0, 2.0);
    let rings: Vec<Ring> = profile.iter().map(|p| lift(&circle, p[1], p[0])).collect();
    let axis = |p: &[f32; 2]| Vector3::new(0.0, 0.0, p[1]);
    let mut solid = capped(&rings, axis(&profile[0]), axis(&profile[profile.len() - 1]), 0);
    for (i, p) in solid.parts.iter_mut().enumerate() {
        *p = part((i / segments).min(profile.len() - 1));
    }
    let last = solid.parts.len() - 2;
    solid.parts[last] = part(0);
    solid
}

/// Cross-section of a sweep: half axes and superellipse exponent.
#[derive(Clone, Copy)]
pub(super) struct Section {
    pub a: f32,
    pub b: f32,
    pub exponent: f32,
}

/// Tube along a path with a section per path point; ends are rounded off over `round` x the end section's size.
pub(super) fn sweep(path: &[Vector3<f32>], sections: &[Section], n: usize, round: f32, part: u8) -> Solid {
    let tangent = |i: usize| {
        let (a, b) = (path[i.saturating_sub(1)], path[(i + 1).min(path.len() - 1)]);
        (b - a).normalize()
    };
    let first = tangent(0);
    let helper = if first.y.abs() < 0.9 { Vector3::y() } else { Vector3::x() };
    let mut x = helper.cross(&first).normalize();
    let mut rings: Vec<Ring> = Vec::new();
    let mut ends = [path[0], path[path.len() - 1]];
    for i in 0..path.len() {
        let t = tangent(i);
        // Parallel transport: the frame turns no more than the path does.
        x = (x - t * t.dot(&x)).normalize();
        let y = t.cross(&x);
        let s = sections[i];
        let outline = superellipse(n, s.a, s.b, s.exponent);
        let ring = |shrink: f32, shift: f32| -> Ring {
            outline.iter().map(|p| path[i] + t * shift + (x * p[0] + y * p[1]) * shrink).collect()
        };
        let reach = round * s.a.min(s.b);
        if i == 0 {
            ends[0] = path[0] - t * reach;
            rings.extend(
                [75f32, 55.0, 30.0].map(|d| ring(d.to_radians().cos(), -reach * d.to_radians().sin())),
            );
        }
        rings.push(ring(1.0, 0.0));
        if i + 1 == path.len() {
            ends[1] = path[i] + t * reach;
            rings.extend(
                [30f32, 55.0, 75.0].map(|d| ring(d.to_radians().cos(), reach * d.to_radians().sin())),
            );
        }
    }
    capped(&rings, ends[0], ends[1], part)
}
