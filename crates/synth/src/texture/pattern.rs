//! Solid patterns: colour as a function of the position on the object, so that no seams show.

use nalgebra::{Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;

use crate::{noise, random::Draw};

/// sRGB, 0..1.
pub(crate) type Color = Vector3<f32>;

/// From hue (turns), saturation and value.
pub(crate) fn hsv(h: f32, s: f32, v: f32) -> Color {
    let channel = |offset: f32| {
        let k = (offset + h * 6.0).rem_euclid(6.0);
        v * (1.0 - s * k.min(4.0 - k).clamp(0.0, 1.0))
    };
    Vector3::new(channel(5.0), channel(3.0), channel(1.0))
}

/// Hues of dyes and pigments in use, turns: red, orange, yellow, green, blue.
const HUES: [(f32, f32); 6] =
    [(0.985, 0.02), (0.06, 0.02), (0.13, 0.02), (0.34, 0.06), (0.58, 0.04), (0.64, 0.03)];

/// Most dyed things have one of a few hues.
fn hue(rng: &mut ChaCha8Rng) -> f32 {
    if rng.chance(0.3) {
        return rng.between(0.0, 1.0);
    }
    let (middle, width) = *rng.pick(&HUES);
    middle + width * rng.normal().clamp(-2.0, 2.0)
}

/// A colour as objects have them: many are grey, white or black, some are vivid.
pub(crate) fn object_color(rng: &mut ChaCha8Rng) -> Color {
    match rng.count(0, 11) {
        0 | 1 => hsv(0.0, 0.0, rng.between(0.75, 0.97)),
        2 => hsv(rng.between(0.0, 1.0), rng.between(0.0, 0.1), rng.between(0.08, 0.25)),
        3 | 4 => hsv(rng.between(0.0, 1.0), rng.between(0.0, 0.12), rng.between(0.3, 0.75)),
        5 => hsv(rng.between(0.04, 0.13), rng.between(0.2, 0.6), rng.between(0.4, 0.9)),
        6 | 7 => hsv(hue(rng), rng.between(0.15, 0.5), rng.between(0.4, 0.95)),
        _ => hsv(hue(rng), rng.between(0.55, 0.95), rng.between(0.3, 0.9)),
    }
}

/// The kinds of patterns.
#[derive(Clone, Debug)]
enum Kind {
    Plain,
    /// Rings around a distant axis, stretched along it.
    Wood,
    /// Fine streaks along one direction.
    Brushed,
    /// Fine isotropic grain with a share of dots.
    Speckle(f32),
    Weave,
    /// Fractal clouds through a palette: marble, camouflage, photo-like blotches.
    Clouds(u32),
    /// Cells with own colours: terrazzo, pebbles, scales.
    Cells,
    Stripes,
    Checks,
    /// Colour changes once or several times along a direction.
    Bands(Vec<f32>),
    Gradient,
    Dots,
}

/// One surface material of an object.
#[derive(Clone, Debug)]
pub(crate) struct Pattern {
    kind: Kind,
    palette: [Color; 4],
    /// Metres to pattern units, with orientation.
    frame: Rotation3<f32>,
    frequency: f32,
    seed: u32,
    /// Strength of the unevenness every surface has.
    grain: f32,
}

impl Pattern {
    /// A uniform colour.
    pub fn plain(rng: &mut ChaCha8Rng) -> Self {
        Self::new(Kind::Plain, rng)
    }

    /// Any pattern. `size` is the object's diameter, metres.
    pub fn any(size: f32, rng: &mut ChaCha8Rng) -> Self {
        let kind = match rng.count(0, 15) {
            0 | 1 => Kind::Plain,
            2 => Kind::Wood,
            3 => Kind::Brushed,
            4 => Kind::Speckle(rng.between(0.02, 0.3)),
            5 => Kind::Weave,
            6..=8 => Kind::Clouds(rng.count(2, 5) as u32),
            9 => Kind::Cells,
            10 => Kind::Stripes,
            11 => Kind::Checks,
            12 | 13 => {
                let mut cuts: Vec<f32> =
                    (0..rng.count(1, 6)).map(|_| rng.between(-0.45, 0.45) * size).collect();
                cuts.sort_by(f32::total_cmp);
                Kind::Bands(cuts)
            }
            14 => Kind::Gradient,
            _ => Kind::Dots,
        };
        let mut pattern = Self::new(kind, rng);
        // Three to thirty features across the object; finer ones would drown in the pixels.
        pattern.frequency = match pattern.kind {
            Kind::Speckle(_) => rng.between(60.0, 120.0),
            Kind::Weave | Kind::Brushed => rng.log_between(25.0, 60.0),
            _ => rng.log_between(3.0, 16.0),
        } / size;
        if matches!(pattern.kind, Kind::Bands(_) | Kind::Gradient) {
            pattern.frequency = 1.0 / size;
        }
        pattern
    }

    /// Looks the same (but for grain finer than the pixels) after rotations about z.
    pub fn is_axial(&self) -> bool {
        let upright = self.frame.matrix().is_identity(1e-6);
        self.is_even() || upright && matches!(self.kind, Kind::Bands(_) | Kind::Gradient)
    }

    /// Looks the same everywhere, but for grain finer than the pixels.
    pub fn is_even(&self) -> bool {
        matches!(self.kind, Kind::Plain | Kind::Brushed | Kind::Weave | Kind::Speckle(_))
    }

    fn new(kind: Kind, rng: &mut ChaCha8Rng) -> Self {
        let first = object_color(rng);
        let related = rng.chance(0.4);
        let palette = std::array::from_fn(|i| match i {
            0 => first,
            _ if related => first.map(|c| (c * rng.between(0.5, 1.4)).clamp(0.02, 0.98)),
            _ => object_color(rng),
        });
        let frame = match rng.count(0, 2) {
            0 => Rotation3::identity(),
            1 => Rotation3::from_axis_angle(&Vector3::x_axis(), std::f32::consts::FRAC_PI_2),
            _ => Rotation3::from_scaled_axis(rng.unit_vector() * rng.between(0.0, 3.1)),
        };
        let grain = rng.between(0.0, 0.05);
        Self { kind, palette, frame, frequency: 20.0, seed: rng.count(0, 1 << 30) as u32, grain }
    }

    /// sRGB colour at a point of the object (metres).
    pub fn color(&self, p: &Vector3<f32>) -> Color {
        let q = self.frame * p;
        let s = q * self.frequency;
        let [a, b, c, d] = &self.palette;
        let mix = |x: &Color, y: &Color, t: f32| x.lerp(y, t.clamp(0.0, 1.0));
        let seed = self.seed;
        let color = match &self.kind {
            Kind::Plain => *a,
            Kind::Wood => {
                let warp = Vector3::new(s.x + 3.0, s.y + 1.5, 0.0)
                    + Vector3::repeat(noise::fractal(&(s * 0.4), 2, seed));
                let ring = (warp.xy().norm() * 3.0).fract();
                let fiber = noise::value(&Vector3::new(s.x * 9.0, s.y * 9.0, s.z * 0.7), seed);
                mix(&mix(a, b, ring * 0.8), c, 0.2 + 0.2 * fiber)
            }
            Kind::Brushed => {
                let streak = noise::fractal(&Vector3::new(s.x, s.y, s.z * 0.04), 3, seed);
                a * (1.0 + 0.35 * streak)
            }
            Kind::Speckle(share) => {
                let cell = s.map(|x| x.floor() as i32);
                let h = noise::hash(cell.x, cell.y, cell.z, seed);
                if h < *share { mix(b, c, h / share) } else { a * (0.92 + 0.16 * h) }
            }
            Kind::Weave => {
                let wave = (s.x * 3.1).sin() * (s.y * 3.1).sin() * (s.z * 3.1).cos();
                mix(a, b, 0.35 + 0.3 * wave + 0.25 * noise::fractal(&(s * 0.12), 2, seed))
            }
            Kind::Clouds(octaves) => {
                let t = 1.5 + 2.6 * noise::fractal(&s, *octaves, seed);
                let t = t.clamp(0.0, 2.999);
                let stops = [a, b, c, d];
                mix(stops[t as usize], stops[t as usize + 1], (t.fract() * 3.0 - 1.0).clamp(0.0, 1.0))
            }
            Kind::Cells => {
                let (near, far, id) = noise::cells(&s, seed);
                let fill = mix(&mix(a, b, id), c, (id * 7.0).fract());
                if far - near < 0.08 { *d } else { fill }
            }
            Kind::Stripes => {
                let t = (s.z + 0.15 * noise::value(&(s * 0.5), seed)).rem_euclid(3.0);
                if t < 1.0 {
                    *a
                } else if t < 1.6 {
                    *b
                } else if t < 2.2 {
                    *a
                } else {
                    *c
                }
            }
            Kind::Checks => {
                let odd = (s.x.floor() + s.y.floor() + s.z.floor()).rem_euclid(2.0) > 0.5;
                if odd { *a } else { *b }
            }
            Kind::Bands(cuts) => {
                let level = cuts.iter().filter(|cut| q.z > **cut).count();
                self.palette[level % 4]
            }
            Kind::Gradient => mix(a, b, s.z + 0.5),
            Kind::Dots => {
                let cell = s - s.map(|x| x.floor()).add_scalar(0.5);
                if cell.norm() < 0.36 { *b } else { *a }
            }
        };
        let uneven = self.grain * noise::fractal(&(p * 90.0), 3, seed ^ 0x55);
        (color * (1.0 + uneven)).map(|x| x.clamp(0.0, 1.0))
    }
}
