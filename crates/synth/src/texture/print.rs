//! Printed pictures: labels with glyph-like marks, bars, emblems, scenes of blotches.

use image::{RgbImage, Rgba, RgbaImage};
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::pattern::{Color, object_color};
use crate::{noise, photographs::Photographs, random::Draw};

/// Draws on a picture in its own 0..1 coordinates (x right, y down).
struct Canvas {
    picture: RgbaImage,
    size: [f32; 2],
}

impl Canvas {
    /// Transparent, of the given width to height ratio.
    fn new(aspect: f32, pixels: u32) -> Self {
        let (w, h) = if aspect >= 1.0 { (1.0, 1.0 / aspect) } else { (aspect, 1.0) };
        let size = [w, h].map(|s| (s * pixels as f32).max(8.0).round());
        Self { picture: RgbaImage::new(size[0] as u32, size[1] as u32), size }
    }

    /// One panel of a package between two columns.
    fn panel(
        &mut self,
        kind: usize,
        [left, right]: [f32; 2],
        [paper, ink]: [Color; 2],
        photographs: &Photographs,
        rng: &mut ChaCha8Rng,
    ) {
        let width = right - left;
        let ground = if rng.chance(0.5) { paper } else { object_color(rng) };
        let fade = if rng.chance(0.3) { object_color(rng) } else { ground };
        self.paint([left, 0.0], [right, 1.0], |_, y| Some(ground.lerp(&fade, y)));
        let seed = rng.count(0, 1 << 30) as u32;
        let writing = if rng.chance(0.4) { ink } else { contrasting(ground) };
        let at = |t: f32| left + t * width;
        match kind {
            // A picture with a name.
            0 | 1 => {
                let (top, bottom) = (rng.between(0.0, 0.3), rng.between(0.6, 1.0));
                match photographs.draw(0.8, rng) {
                    Some(picture) => self.photograph([left, top], [right, bottom], &picture, rng),
                    None => self.photo([left, top], [right, bottom], rng),
                }
                let line = rng.between(0.05, 0.75);
                self.text([at(0.08), line], [at(0.95), line + rng.between(0.1, 0.25)], 1, writing, seed);
                if kind == 1 {
                    let center = [at(rng.between(0.2, 0.8)), rng.between(0.2, 0.8)];
                    let colors = [object_color(rng), object_color(rng)];
                    self.emblem(center, rng.between(0.1, 0.25), colors, rng);
                }
            }
            // A name, an emblem, blocks of colour.
            2 => {
                for _ in 0..rng.count(1, 3) {
                    let (x, y) = (rng.between(0.0, 0.6), rng.between(0.0, 0.8));
                    let (dx, dy) = (rng.between(0.2, 0.9), rng.between(0.08, 0.4));
                    let block = object_color(rng);
                    self.paint([at(x), y], [at((x + dx).min(1.0)), (y + dy).min(1.0)], |_, _| Some(block));
                }
                let center = [at(rng.between(0.3, 0.7)), rng.between(0.25, 0.75)];
                let colors = [object_color(rng), object_color(rng)];
                self.emblem(center, rng.between(0.15, 0.35), colors, rng);
                let (line, height) = (rng.between(0.05, 0.7), rng.between(0.12, 0.28));
                self.text([at(0.05), line], [at(0.97), line + height], rng.count(1, 2), writing, seed);
            }
            // Small print and a table.
            3 => {
                self.text(
                    [at(0.06), 0.06],
                    [at(0.94), rng.between(0.4, 0.6)],
                    rng.count(5, 9),
                    writing,
                    seed,
                );
                let top = rng.between(0.62, 0.7);
                self.paint([at(0.08), top], [at(0.92), 0.95], |_, _| Some(Color::repeat(0.95)));
                self.text([at(0.12), top + 0.03], [at(0.9), 0.93], 4, Color::repeat(0.05), seed ^ 1);
            }
            // A bar code with some text.
            _ => {
                let (x, y) = (rng.between(0.05, 0.3), rng.between(0.05, 0.7));
                self.bars([at(x), y], [at(x + rng.between(0.4, 0.65)), y + rng.between(0.15, 0.28)], seed);
                let other = if y > 0.4 { 0.06 } else { y + 0.32 };
                self.text([at(0.08), other], [at(0.9), other + 0.28], rng.count(2, 5), writing, seed ^ 2);
            }
        }
    }

    /// A random part of a photograph.
    fn photograph(&mut self, min: [f32; 2], max: [f32; 2], picture: &RgbImage, rng: &mut ChaCha8Rng) {
        let aspect = (max[0] - min[0]) / (max[1] - min[1]) * self.aspect();
        let (w, h) = (picture.width() as f32, picture.height() as f32);
        let zoom = rng.between(0.5, 1.0);
        let (part_w, part_h) = if aspect > w / h { (w, w / aspect) } else { (h * aspect, h) };
        let (part_w, part_h) = (part_w * zoom, part_h * zoom);
        let (left, top) = (rng.between(0.0, w - part_w), rng.between(0.0, h - part_h));
        self.paint(min, max, |x, y| {
            let col = left + (x - min[0]) / (max[0] - min[0]) * part_w;
            let row = top + (y - min[1]) / (max[1] - min[1]) * part_h;
            let pixel = picture.get_pixel((col as u32).min(w as u32 - 1), (row as u32).min(h as u32 - 1));
            Some(Color::from(pixel.0.map(f32::from)) / 255.0)
        });
    }

    /// Paints every pixel of a box for which `color` answers.
    fn paint(&mut self, min: [f32; 2], max: [f32; 2], color: impl Fn(f32, f32) -> Option<Color>) {
        let at = |x: f32, axis: usize| (x * self.size[axis]).clamp(0.0, self.size[axis]) as u32;
        for row in at(min[1], 1)..at(max[1], 1) {
            for col in at(min[0], 0)..at(max[0], 0) {
                let (x, y) = ((col as f32 + 0.5) / self.size[0], (row as f32 + 0.5) / self.size[1]);
                if let Some(c) = color(x, y) {
                    let [r, g, b]: [u8; 3] = c.map(|v| (v.clamp(0.0, 1.0) * 255.0) as u8).into();
                    self.picture.put_pixel(col, row, Rgba([r, g, b, 255]));
                }
            }
        }
    }

    fn aspect(&self) -> f32 {
        self.size[0] / self.size[1]
    }

    /// Lines of glyph-like marks on a 5 x 7 raster, words separated by gaps.
    fn text(&mut self, min: [f32; 2], max: [f32; 2], lines: usize, color: Color, seed: u32) {
        let line_height = (max[1] - min[1]) / lines as f32;
        let glyph_width = line_height * 0.62 / self.aspect();
        for line in 0..lines {
            let top = min[1] + line as f32 * line_height;
            let ragged = 0.6 + 0.4 * noise::hash(line as i32, 0, 1, seed);
            let count = ((max[0] - min[0]) * ragged / glyph_width) as i32;
            for k in (0..count).filter(|&k| noise::hash(k, line as i32, 2, seed) > 0.16) {
                let left = min[0] + k as f32 * glyph_width;
                let letter = (noise::hash(k, line as i32, 3, seed) * 26.0) as i32;
                self.paint([left, top], [left + glyph_width * 0.8, top + line_height * 0.78], |x, y| {
                    let u = ((x - left) / (glyph_width * 0.8) * 5.0) as i32;
                    let v = ((y - top) / (line_height * 0.78) * 7.0) as i32;
                    // Half of a letter's cells are ink, and strokes prefer the left and middle.
                    let stroke =
                        noise::hash(letter, u, v, 11) < if u == 0 || v % 3 == 0 { 0.75 } else { 0.22 };
                    stroke.then_some(color)
                });
            }
        }
    }

    fn bars(&mut self, min: [f32; 2], max: [f32; 2], seed: u32) {
        let width = max[0] - min[0];
        self.paint(min, max, |x, _| {
            let k = ((x - min[0]) / width * 60.0) as i32;
            let ink = noise::hash(k, 0, 0, seed) < 0.5 && (1..59).contains(&k);
            Some(Color::repeat(if ink { 0.05 } else { 0.95 }))
        });
    }

    /// Matrix code.
    fn matrix(&mut self, min: [f32; 2], max: [f32; 2], seed: u32) {
        self.paint(min, max, |x, y| {
            let cell = |t: f32, axis: usize| ((t - min[axis]) / (max[axis] - min[axis]) * 17.0) as i32;
            let ink = noise::hash(cell(x, 0), cell(y, 1), 0, seed) < 0.5;
            Some(Color::repeat(if ink { 0.05 } else { 0.95 }))
        });
    }

    /// Disc, ring, star, shield or arrow.
    fn emblem(&mut self, center: [f32; 2], radius: f32, colors: [Color; 2], rng: &mut ChaCha8Rng) {
        let (points, depth) = (rng.count(3, 9) as f32, rng.between(0.0, 0.6));
        let (inner, turn) = (rng.between(0.3, 0.8), rng.between(0.0, 6.2));
        let aspect = self.aspect();
        let (min, max) = (
            [center[0] - radius / aspect, center[1] - radius].map(|x| x.max(0.0)),
            [center[0] + radius / aspect, center[1] + radius],
        );
        self.paint(min, max, |x, y| {
            let (dx, dy) = ((x - center[0]) * aspect / radius, (y - center[1]) / radius);
            let (r, angle) = (dx.hypot(dy), dy.atan2(dx) + turn);
            let rim = 1.0 - depth * (0.5 - 0.5 * (points * angle).cos());
            (r < rim).then(|| if r < rim * inner { colors[1] } else { colors[0] })
        });
    }

    fn photo(&mut self, min: [f32; 2], max: [f32; 2], rng: &mut ChaCha8Rng) {
        let seed = rng.count(0, 1 << 30) as u32;
        let frequency = rng.log_between(2.5, 9.0);
        let colors: Vec<Color> = (0..5).map(|_| object_color(rng)).collect();
        let aspect = self.aspect();
        self.paint(min, max, |x, y| {
            let p = Vector3::new(x * frequency * aspect, y * frequency, 0.5);
            let warp = Vector3::new(noise::value(&p, seed ^ 1), noise::value(&p, seed ^ 2), 0.0);
            let t = (2.0 + 3.2 * noise::fractal(&(p + warp), 4, seed)).clamp(0.0, 3.999);
            let i = t as usize;
            Some(colors[i].lerp(&colors[i + 1], (t.fract() * 2.0 - 0.5).clamp(0.0, 1.0)))
        });
    }
}

/// A package's print of the given width to height ratio, about `pixels` on its longer side: panels side by side, each with a
/// photograph, a name, an emblem, lines of text, a table or a bar code, no two alike. `brand`: ground and ink.
pub(crate) fn package(
    aspect: f32,
    pixels: u32,
    brand: [Color; 2],
    photographs: &Photographs,
    rng: &mut ChaCha8Rng,
) -> RgbaImage {
    let mut canvas = Canvas::new(aspect, pixels);
    let [paper, ink] = if rng.chance(0.25) { [object_color(rng), object_color(rng)] } else { brand };
    canvas.paint([0.0; 2], [1.0; 2], |_, _| Some(paper));
    // One panel per square or two of the print.
    let panels = rng.count(1, 2).max((aspect * rng.between(0.5, 1.1)).round() as usize).min(6);
    let mut cuts: Vec<f32> = (0..=panels).map(|k| k as f32 / panels as f32).collect();
    for cut in &mut cuts[1..panels] {
        *cut += rng.between(-0.25, 0.25) / panels as f32;
    }
    let mut last = usize::MAX;
    for k in 0..panels {
        let (left, right) = (cuts[k], cuts[k + 1]);
        let kind = loop {
            let kind = rng.count(0, 4);
            if kind != last {
                break kind;
            }
        };
        last = kind;
        canvas.panel(kind, [left, right], [paper, ink], photographs, rng);
    }
    // A band across all panels carries the colours of the brand.
    if rng.chance(0.4) {
        let (top, height) = (rng.between(0.0, 0.85), rng.between(0.06, 0.2));
        let band = object_color(rng);
        canvas.paint([0.0, top], [1.0, (top + height).min(1.0)], |_, _| Some(band));
        let seed = rng.count(0, 1 << 30) as u32;
        let (left, right) = (rng.between(0.0, 0.5), rng.between(0.6, 1.0));
        let contrast = contrasting(band);
        canvas.text([left, top + 0.15 * height], [right, top + 0.85 * height], 1, contrast, seed);
    }
    canvas.picture
}

/// Nearly black or nearly white.
fn contrasting(color: Color) -> Color {
    Color::repeat(if color.sum() > 1.5 { 0.08 } else { 0.93 })
}

/// A label of the given width to height ratio, about `pixels` on its longer side.
pub(crate) fn label(aspect: f32, pixels: u32, rng: &mut ChaCha8Rng) -> RgbaImage {
    let mut canvas = Canvas::new(aspect, pixels);
    let seed = rng.count(0, 1 << 30) as u32;
    let (paper, ink) = (object_color(rng), object_color(rng));
    let second = object_color(rng);
    let transparent = rng.chance(0.2);
    if !transparent {
        let fade = rng.chance(0.3);
        canvas.paint([0.0; 2], [1.0; 2], |_, y| Some(if fade { paper.lerp(&second, y) } else { paper }));
    }
    if rng.chance(0.3) {
        canvas.photo([0.0, rng.between(0.0, 0.4)], [1.0, rng.between(0.6, 1.0)], rng);
    }
    for _ in 0..rng.count(0, 3) {
        let (x, y) = (rng.between(0.0, 0.7), rng.between(0.0, 0.8));
        let (dx, dy) = (rng.between(0.2, 1.0), rng.between(0.05, 0.35));
        let block = object_color(rng);
        canvas.paint([x, y], [(x + dx).min(1.0), (y + dy).min(1.0)], |_, _| Some(block));
    }
    for _ in 0..rng.count(0, 2) {
        let center = [rng.between(0.15, 0.85), rng.between(0.15, 0.85)];
        let colors = [object_color(rng), object_color(rng)];
        canvas.emblem(center, rng.between(0.1, 0.4), colors, rng);
    }
    for k in 0..rng.count(1, 3) as u32 {
        let (x, y) = (rng.between(0.03, 0.3), rng.between(0.03, 0.75));
        let (dx, dy) = (rng.between(0.4, 0.9), rng.between(0.1, 0.4));
        let lines = if rng.chance(0.4) { 1 } else { rng.count(2, 5) };
        let color =
            if rng.chance(0.5) { ink } else { Color::repeat(if paper.sum() > 1.5 { 0.08 } else { 0.93 }) };
        canvas.text([x, y], [(x + dx).min(0.98), (y + dy).min(0.98)], lines, color, seed ^ k);
    }
    if rng.chance(0.3) {
        let (x, y) = (rng.between(0.05, 0.6), rng.between(0.05, 0.75));
        let max = [x + rng.between(0.2, 0.35), y + rng.between(0.1, 0.2)];
        canvas.bars([x, y], max, seed ^ 91);
    } else if rng.chance(0.15) {
        let (x, y, side) = (rng.between(0.05, 0.6), rng.between(0.05, 0.6), rng.between(0.15, 0.3));
        canvas.matrix([x, y], [x + side, y + side * aspect], seed ^ 92);
    }
    canvas.picture
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    /// Correlation of the brightness of a picture with itself, shifted around by a share of its width.
    fn repeated(picture: &RgbaImage, shift: f32) -> f32 {
        let (w, h) = picture.dimensions();
        let gray =
            |x: u32, y: u32| picture.get_pixel(x % w, y).0[..3].iter().map(|&c| f32::from(c)).sum::<f32>();
        let by = (shift * w as f32) as u32;
        let pairs: Vec<[f32; 2]> =
            (0..w * h).map(|i| [gray(i % w, i / w), gray(i % w + by, i / w)]).collect();
        let n = pairs.len() as f32;
        let mean = pairs.iter().map(|p| p[0]).sum::<f32>() / n;
        let (mut same, mut variance) = (0.0, 0.0);
        for [a, b] in &pairs {
            same += (a - mean) * (b - mean);
            variance += (a - mean) * (a - mean);
        }
        same / variance.max(1e-6)
    }

    #[test]
    fn a_label_around_a_package_does_not_repeat() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..12 {
            let brand = [object_color(&mut rng), object_color(&mut rng)];
            let picture = package(rng.between(1.5, 6.0), 300, brand, &Photographs::default(), &mut rng);
            assert!((repeated(&picture, 0.0) - 1.0).abs() < 1e-3, "it has a print");
            for degrees in (60..=300).step_by(30) {
                let correlation = repeated(&picture, degrees as f32 / 360.0);
                assert!(correlation < 0.7, "{correlation} after {degrees} degrees");
            }
        }
    }
}
