//! Distributions of what the images show, small enough to be kept for sets of any size.

/// Bins of every histogram.
const BINS: usize = 400;

/// Counts over `[low, high]`, evenly or logarithmically divided; values outside fall into the first or last bin.
#[derive(Clone, Debug)]
pub struct Histogram {
    low: f64,
    high: f64,
    logarithmic: bool,
    counts: Vec<u64>,
    sum: f64,
}

impl Histogram {
    fn new(low: f64, high: f64, logarithmic: bool) -> Self {
        Self { low, high, logarithmic, counts: vec![0; BINS], sum: 0.0 }
    }

    fn scaled(&self, value: f64) -> f64 {
        if self.logarithmic {
            (value.max(self.low) / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    pub(super) fn add(&mut self, value: f64) {
        if value.is_finite() {
            let bin = (self.scaled(value) * BINS as f64).clamp(0.0, (BINS - 1) as f64) as usize;
            self.counts[bin] += 1;
            self.sum += value;
        }
    }

    fn merge(&mut self, other: &Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(a, b)| *a += b);
        self.sum += other.sum;
    }

    /// Values counted.
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Mean of the values; NaN without values.
    pub fn mean(&self) -> f64 {
        self.sum / self.count() as f64
    }

    /// Value below which the share `q` lies, to a bin's width (1/400 of the range, or 3 % of a logarithmic one); NaN
    /// without values.
    pub fn quantile(&self, q: f64) -> f64 {
        let total = self.count();
        if total == 0 {
            return f64::NAN;
        }
        let (mut below, rank) = (0, (q * total as f64).ceil() as u64);
        let bin = self.counts.iter().position(|c| {
            below += c;
            below >= rank.max(1)
        });
        let t = (bin.unwrap_or(BINS - 1) as f64 + 0.5) / BINS as f64;
        if self.logarithmic {
            self.low * (self.high / self.low).powf(t)
        } else {
            self.low + t * (self.high - self.low)
        }
    }
}

/// Distributions over the decoded images and their instances.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Statistics {
    /// Mean luminance of an image, 0..1, sRGB-coded.
    pub brightness: Histogram,
    /// Standard deviation of the luminance in an image.
    pub contrast: Histogram,
    /// Mean difference between the largest and smallest channel in an image, 0..1.
    pub colorfulness: Histogram,
    /// Share of an image's pixels without depth.
    pub image_holes: Histogram,
    /// Share of an instance's visible pixels without depth.
    pub holes: Histogram,
    /// Distance between measured depth and the posed model, metres.
    pub depth_error: Histogram,
    /// The same divided by the squared depth, 1/metres.
    pub depth_error_per_z2: Histogram,
    /// Depth of the object's origin, metres.
    pub distance: Histogram,
    /// Visible share of an instance.
    pub visib_fract: Histogram,
    /// Share of the image that an instance's visible part covers.
    pub area: Histogram,
    /// Intersection over union of a silhouette and the drawn model.
    pub silhouette_iou: Histogram,
    /// Annotated instances of an image.
    pub instances: Histogram,
}

impl Default for Statistics {
    fn default() -> Self {
        let share = || Histogram::new(0.0, 1.0, false);
        Self {
            brightness: share(),
            contrast: share(),
            colorfulness: share(),
            image_holes: share(),
            holes: share(),
            depth_error: Histogram::new(1e-5, 1.0, true),
            depth_error_per_z2: Histogram::new(1e-5, 1.0, true),
            distance: Histogram::new(0.0, 4.0, false),
            visib_fract: share(),
            area: Histogram::new(1e-6, 1.0, true),
            silhouette_iou: share(),
            instances: Histogram::new(-0.5, 399.5, false),
        }
    }
}

impl Statistics {
    pub(super) fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.all_mut().into_iter().zip(other.all()) {
            mine.merge(theirs.1);
        }
    }

    /// Every distribution with its name and unit.
    pub fn all(&self) -> [(&'static str, &Histogram); 12] {
        [
            ("image brightness (0..1)", &self.brightness),
            ("image contrast (standard deviation)", &self.contrast),
            ("image colourfulness (max - min channel)", &self.colorfulness),
            ("image share without depth", &self.image_holes),
            ("instance share without depth", &self.holes),
            ("depth error against the model (m)", &self.depth_error),
            ("depth error / z^2 (1/m)", &self.depth_error_per_z2),
            ("object distance (m)", &self.distance),
            ("visible share", &self.visib_fract),
            ("visible area / image", &self.area),
            ("silhouette IoU with the model", &self.silhouette_iou),
            ("instances per image", &self.instances),
        ]
    }

    fn all_mut(&mut self) -> [&mut Histogram; 12] {
        [
            &mut self.brightness,
            &mut self.contrast,
            &mut self.colorfulness,
            &mut self.image_holes,
            &mut self.holes,
            &mut self.depth_error,
            &mut self.depth_error_per_z2,
            &mut self.distance,
            &mut self.visib_fract,
            &mut self.area,
            &mut self.silhouette_iou,
            &mut self.instances,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_known_values() {
        let mut even = Histogram::new(0.0, 1.0, false);
        let mut log = Histogram::new(1e-5, 1.0, true);
        (0..1000).for_each(|i| even.add(f64::from(i) / 1000.0));
        (0..1000).for_each(|i| log.add(1e-4 * 10f64.powf(f64::from(i) / 500.0)));
        let mut twice = even.clone();
        twice.merge(&even);
        assert!((even.quantile(0.25) - 0.25).abs() < 0.003 && (even.mean() - 0.4995).abs() < 1e-9);
        assert_eq!((twice.count(), twice.quantile(0.9)), (2000, even.quantile(0.9)));
        assert!((log.quantile(0.5) / 1e-3 - 1.0).abs() < 0.03, "{}", log.quantile(0.5));
        assert!(Histogram::new(0.0, 1.0, false).quantile(0.5).is_nan());
    }
}
