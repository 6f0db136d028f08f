//! What two views say about a pose between them.

use unopose_core::geometry::Pose;

use super::AppearanceView;

/// Standard deviation of a colour that noise, focus and light explain, in the unit of the channels (0 to 1).
const NOISE: f64 = 0.02;

/// Which colours are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Those of single cells, for poses that are nearly right.
    Fine,
    /// Blurred ones, for poses that are off by some degrees.
    Blurred,
}

/// How far two views agree under a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Share of the samples of both views that lie on the other view's surface.
    pub on_surface: f64,
    /// Share of the samples of both views that lie in space that the other camera sees through.
    pub in_front: f64,
    /// Correlation of the colours of the surface that both see, times [`Self::on_surface`], in [-1, 1]: near 0 without
    /// colours that could agree. A gain of all channels and an offset of each have no influence.
    pub color: f64,
    /// The correlation alone.
    pub correlation: f64,
    /// Shares of the query's samples, then of the reference's.
    pub sides: [SideAgreement; 2],
}

/// Where the samples of one view lie under a pose, as shares of them; the rest is seen by nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SideAgreement {
    /// On the other view's object.
    pub on_surface: f64,
    /// In space that the other camera sees through.
    pub in_front: f64,
    /// Behind a surface that the other camera sees.
    pub hidden: f64,
}

/// Sums for the correlation of one channel.
#[derive(Clone, Copy, Default)]
struct Moments {
    a: f64,
    b: f64,
    aa: f64,
    bb: f64,
    ab: f64,
}

impl Agreement {
    /// Of two views under a pose (reference to query camera, metres). `tolerance`: distance along the optical axis up to
    /// which a point lies on the surface, metres.
    pub fn of(
        query: &AppearanceView,
        reference: &AppearanceView,
        t_query_reference: &Pose,
        tolerance: f32,
        detail: Detail,
    ) -> Self {
        let mut tally = Tally::default();
        tally.add(query, reference, &t_query_reference.inverse(), tolerance, detail, false);
        tally.add(reference, query, t_query_reference, tolerance, detail, true);
        let counts = [query.samples.len(), reference.samples.len()];
        let total = (counts[0] + counts[1]).max(1) as f64;
        let share = |of: fn(&Side) -> u32| f64::from(tally.sides.iter().map(of).sum::<u32>()) / total;
        let (on_surface, correlation) = (share(|side| side.on_surface), tally.correlation());
        Self {
            on_surface,
            in_front: share(|side| side.in_front),
            // Without the factor a small common surface would win, whose colours correlate by chance.
            color: correlation * on_surface,
            correlation,
            sides: [0, 1].map(|i| {
                let share = |count: u32| f64::from(count) / counts[i].max(1) as f64;
                let Side { on_surface, in_front, hidden } = tally.sides[i];
                SideAgreement {
                    on_surface: share(on_surface),
                    in_front: share(in_front),
                    hidden: share(hidden),
                }
            }),
        }
    }
}

#[derive(Clone, Copy, Default)]
struct Side {
    on_surface: u32,
    in_front: u32,
    hidden: u32,
}

#[derive(Default)]
struct Tally {
    sides: [Side; 2],
    moments: [Moments; 3],
}

impl Tally {
    /// Compares the samples of `from`, moved into the camera of `to`, with what `to` sees there. `swapped` when `from` is
    /// the reference.
    fn add(
        &mut self,
        from: &AppearanceView,
        to: &AppearanceView,
        t_to_from: &Pose,
        tolerance: f32,
        detail: Detail,
        swapped: bool,
    ) {
        let level = match detail {
            Detail::Fine => 0,
            Detail::Blurred => 1,
        };
        let (own, theirs) = (&from.colors[level], &to.colors[level]);
        let [fx, fy, cx, cy] =
            [to.camera.fx, to.camera.fy, to.camera.cx, to.camera.cy].map(|value| value as f32);
        let height = to.height() as f32;
        let side = &mut self.sides[usize::from(swapped)];
        let rotation = t_to_from.rotation.map(|x| x as f32);
        let shift = t_to_from.translation.map(|x| x as f32);
        for sample in &from.samples {
            let [x, y, z] = sample.point;
            let moved: [f32; 3] = std::array::from_fn(|i| {
                rotation[(i, 0)] * x + rotation[(i, 1)] * y + rotation[(i, 2)] * z + shift[i]
            });
            if moved[2] <= 0.0 {
                continue;
            }
            let (u, v) = (fx * moved[0] / moved[2] + cx + 0.5, fy * moved[1] / moved[2] + cy + 0.5);
            if !(u >= 0.0 && v >= 0.0 && u < to.width as f32 && v < height) {
                continue;
            }
            let cell = v as usize * to.width + u as usize;
            let seen = to.depth[cell];
            if seen <= 0.0 {
                continue;
            }
            let behind = moved[2] - seen;
            if behind < -tolerance {
                side.in_front += 1;
            } else if behind > tolerance {
                side.hidden += 1;
            } else if to.object[cell] {
                side.on_surface += 1;
                let (a, b) = (&own[sample.cell], &theirs[cell]);
                let (a, b) = if swapped { (b, a) } else { (a, b) };
                for (m, (&a, &b)) in self.moments.iter_mut().zip(a.iter().zip(b)) {
                    let (a, b) = (f64::from(a), f64::from(b));
                    m.a += a;
                    m.b += b;
                    m.aa += a * a;
                    m.bb += b * b;
                    m.ab += a * b;
                }
            }
        }
    }

    fn correlation(&self) -> f64 {
        let n: f64 = self.sides.iter().map(|side| f64::from(side.on_surface)).sum();
        if n < 2.0 {
            return 0.0;
        }
        let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
        for m in &self.moments {
            aa += (m.aa - m.a * m.a / n).max(0.0);
            bb += (m.bb - m.b * m.b / n).max(0.0);
            ab += m.ab - m.a * m.b / n;
        }
        ab / ((aa * bb).sqrt() + n * NOISE * NOISE)
    }
}
