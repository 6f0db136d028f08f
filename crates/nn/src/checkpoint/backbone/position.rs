//! Learned position embeddings on another grid of patches, as each distributor resamples them (518 to 224 pixels: 37 x 37
//! to 16 x 16 patches).
//!
//! | source | kernel | step |
//! |---|---|---|
//! | Meta, without registers | cubic, a = -0.75, no antialias | 1 / ((new + 0.1) / old) |
//! | Meta, with registers | antialiased cubic, a = -0.5 | old / new |
//! | timm | antialiased cubic, a = -0.5 | old / new |
//! | Hugging Face, without registers | cubic, a = -0.75, no antialias | old / new |
//! | Hugging Face, with registers | antialiased cubic, a = -0.5 | old / new |
//! | the release of UNOPose, whatever the file | cubic, a = -0.75, no antialias | old / new |
//!
//! The two kernels are those of PyTorch's `interpolate(mode = "bicubic", align_corners = False)`.

use unopose_core::config::PositionResampling;

use super::Naming;

/// One way of resampling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Resampling {
    /// Cubic convolution over the four nearest patches; `offset` enlarges the new side when the step is computed.
    Plain {
        /// Added to the new side, patches.
        offset: f64,
    },
    /// The kernel is widened by the step, so that every old patch counts.
    Antialiased,
}

impl Resampling {
    /// What the distributor of a file does, or the release of UNOPose.
    pub fn of(choice: PositionResampling, naming: Naming, registers: bool) -> Self {
        match (choice, naming) {
            (PositionResampling::Release, _) => Self::Plain { offset: 0.0 },
            (PositionResampling::Source, Naming::Meta) if !registers => Self::Plain { offset: 0.1 },
            (PositionResampling::Source, Naming::HuggingFace) if !registers => Self::Plain { offset: 0.0 },
            (PositionResampling::Source, _) => Self::Antialiased,
        }
    }

    /// Row-major embeddings `[old * old, channels]` of a square grid on `[new * new, channels]`.
    ///
    /// # Panics
    /// When `values` is not `old * old * channels` long.
    pub fn resample(self, values: &[f32], old: usize, new: usize, channels: usize) -> Vec<f32> {
        assert_eq!(values.len(), old * old * channels, "embeddings of a {old} x {old} grid");
        if old == new {
            return values.to_vec();
        }
        let taps: Vec<Vec<(usize, f64)>> = (0..new).map(|i| self.taps(i, old, new)).collect();
        let row = old * channels;
        // Columns first, then rows, as PyTorch does.
        let mut narrow = vec![0.0f64; old * new * channels];
        for (source, target) in values.chunks_exact(row).zip(narrow.chunks_exact_mut(new * channels)) {
            for (taps, out) in taps.iter().zip(target.chunks_exact_mut(channels)) {
                for &(column, weight) in taps {
                    let from = &source[column * channels..(column + 1) * channels];
                    out.iter_mut().zip(from).for_each(|(o, &v)| *o += weight * v as f64);
                }
            }
        }
        let mut result = Vec::with_capacity(new * new * channels);
        for taps in &taps {
            let mut out = vec![0.0f64; new * channels];
            for &(r, weight) in taps {
                let from = &narrow[r * new * channels..(r + 1) * new * channels];
                out.iter_mut().zip(from).for_each(|(o, &v)| *o += weight * v);
            }
            result.extend(out.into_iter().map(|v| v as f32));
        }
        result
    }

    /// Old positions that make up new position `i`, with their weights.
    fn taps(self, i: usize, old: usize, new: usize) -> Vec<(usize, f64)> {
        match self {
            Self::Plain { offset } => {
                let step = old as f64 / (new as f64 + offset);
                let x = (i as f64 + 0.5) * step - 0.5;
                let low = x.floor();
                let clamped = |k: f64| k.clamp(0.0, (old - 1) as f64) as usize;
                (-1..=2).map(|k| low + k as f64).map(|k| (clamped(k), cubic(x - k, -0.75))).collect()
            }
            Self::Antialiased => {
                let step = old as f64 / new as f64;
                let widening = step.max(1.0);
                let (center, support) = (step * (i as f64 + 0.5), 2.0 * widening);
                let first = (center - support + 0.5).max(0.0) as usize;
                let end = ((center + support + 0.5) as usize).min(old);
                let weight = |k: usize| cubic((k as f64 + 0.5 - center) / widening, -0.5);
                let total: f64 = (first..end).map(weight).sum();
                (first..end).map(|k| (k, weight(k) / total)).collect()
            }
        }
    }
}

/// The cubic convolution kernel with parameter `a` (Keys 1981).
fn cubic(x: f64, a: f64) -> f64 {
    let x = x.abs();
    if x < 1.0 {
        ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0
    } else if x < 2.0 {
        (((x - 5.0) * x + 8.0) * x - 4.0) * a
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 37 x 37 numbers without structure.
    fn grid() -> Vec<f32> {
        (0..37 * 37).map(|k| ((k / 37 * 29 + k % 37 * 13) % 37) as f32 / 37.0).collect()
    }

    #[test]
    fn antialiased_values_are_those_of_pillow() {
        // Pillow's `resize((16, 16), BICUBIC)` in mode F: the kernel that PyTorch follows.
        let got = Resampling::Antialiased.resample(&grid(), 37, 16, 1);
        let expected = [
            (0, 0.430_878_07),
            (1, 0.485_877_72),
            (2, 0.507_102_3),
            (3, 0.490_301_07),
            (7 * 16 + 9, 0.485_804_26),
            (255, 0.518_641_3),
            (3 * 16, 0.497_495_95),
        ];
        for (k, value) in expected {
            assert!((got[k] - value).abs() < 1e-6, "[{k}] {} {value}", got[k]);
        }
    }

    #[test]
    fn metas_offset_moves_every_patch() {
        // One row of a cubic: by hand for new position 5 of 16 with and without 0.1.
        let values: Vec<f32> = (0..37 * 37).map(|k| ((k % 37) as f32 / 10.0).powi(3)).collect();
        for (offset, step) in [(0.0, 37.0 / 16.0), (0.1, 37.0 / 16.1)] {
            let got = Resampling::Plain { offset }.resample(&values, 37, 16, 1)[5];
            // 5.5 * 37 / 16 - 0.5 = 12.21875 and 5.5 * 37 / 16.1 - 0.5 = 12.13975...; Catmull-like weights, a = -3/4.
            let x: f64 = 5.5 * step - 0.5;
            let t = x - 12.0;
            let (a, u) = (-0.75, 1.0 - t);
            let weights = [
                a * t * u * u,
                1.0 - (a + 3.0) * t * t + (a + 2.0) * t * t * t,
                1.0 - (a + 3.0) * u * u + (a + 2.0) * u * u * u,
                a * u * t * t,
            ];
            let expected: f64 = (11..15).zip(weights).map(|(k, w)| w * (k as f64 / 10.0).powi(3)).sum();
            assert!((got as f64 - expected).abs() < 1e-6, "offset {offset}: {got} {expected}");
        }
        let [plain, moved] = [0.0, 0.1].map(|o| Resampling::Plain { offset: o }.resample(&values, 37, 16, 1));
        let apart = plain.iter().zip(&moved).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart > 0.3, "{apart}");
    }

    #[test]
    fn each_source_has_its_own_way() {
        let source = |naming, registers| Resampling::of(PositionResampling::Source, naming, registers);
        assert_eq!(source(Naming::Meta, false), Resampling::Plain { offset: 0.1 });
        assert_eq!(source(Naming::HuggingFace, false), Resampling::Plain { offset: 0.0 });
        for naming in [Naming::Meta, Naming::Timm, Naming::HuggingFace] {
            assert_eq!(source(naming, true), Resampling::Antialiased);
            let release = Resampling::of(PositionResampling::Release, naming, true);
            assert_eq!(release, Resampling::Plain { offset: 0.0 });
        }
        assert_eq!(source(Naming::Timm, false), Resampling::Antialiased);
    }
}
