//! Why a view or a pair cannot be used.

use unopose_dataset::formats::FormatError;

/// Why a view or a pair cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DataError {
    /// The mask has no pixel.
    #[error("the mask is empty, expected at least one pixel of the object")]
    EmptyMask,
    /// Mask or depth image of another size than the colour image.
    #[error(
        "{what} is {found_width} x {found_height} pixels, expected {width} x {height} like the colour image"
    )]
    Size {
        /// Mask or depth image.
        what: &'static str,
        /// Its columns.
        found_width: u32,
        /// Its rows.
        found_height: u32,
        /// Columns of the colour image.
        width: u32,
        /// Rows of the colour image.
        height: u32,
    },
    /// Too few masked pixels with depth.
    #[error("the object has {count} usable pixels, expected more than {minimum}")]
    TooFewPixels {
        /// Masked pixels with depth inside the crop.
        count: usize,
        /// Number that has to be exceeded.
        minimum: usize,
    },
    /// No masked pixel has depth.
    #[error(
        "the mask has {masked} pixels but none with depth, expected a depth image registered to the colour image"
    )]
    NoDepth {
        /// Pixels of the mask.
        masked: usize,
    },
    /// An image whose objects are looked for has no depth.
    #[error("no pixel of the depth image is measured, expected a depth image registered to the colour image")]
    NoSceneDepth,
    /// Too few query points are near enough to their mean for an object of the reference's size.
    #[error(
        "{count} of the query's {total} points lie within 1.2 reference radii ({limit:.3} m) of their mean, expected \
         at least {minimum}"
    )]
    TooFewPoints {
        /// Points within the limit.
        count: usize,
        /// All points of the query.
        total: usize,
        /// Largest distance to the mean, metres.
        limit: f64,
        /// Fewest points within the limit.
        minimum: usize,
    },
    /// The reference is implausibly small or large.
    #[error(
        "the reference has a radius of {radius:.4} m and is {distance:.3} m away, expected a radius from {minimum} to \
         {maximum} m{hint}"
    )]
    Radius {
        /// Largest distance of the reference's points to their mean, metres.
        radius: f64,
        /// Distance of their mean from the camera, metres.
        distance: f64,
        /// Smallest plausible radius, metres.
        minimum: f64,
        /// Largest plausible radius, metres.
        maximum: f64,
        /// The unit of depth that would be plausible.
        hint: String,
    },
    /// A query is compared with a reference that has no size.
    #[error("the radius of the query's reference is {radius} m, expected a finite number above 0")]
    QueryRadius {
        /// Of the reference, metres.
        radius: f32,
    },
    /// The dataset has nothing to make a pair of.
    #[error("the dataset has no instance that is visible enough and has a reference view in another image")]
    NoPairs,
    /// Too many draws in a row were no usable pair.
    #[error("sample {index}: {attempts} instances in a row were rejected, the last because {last}")]
    Exhausted {
        /// Number of the sample.
        index: u64,
        /// Draws that were rejected.
        attempts: usize,
        /// Why the last one was.
        last: Box<DataError>,
    },
    /// Every reference that was tried is too far from the query view or overlaps too little with it.
    #[error("no reference of object {obj_id} fits the limits on rotation and overlap")]
    NoReference {
        /// Object of the query.
        obj_id: u32,
    },
    /// The index of the dataset and the image disagree.
    #[error("image {image} has no instance {instance} although the index lists it")]
    MissingInstance {
        /// Number of the image in the dataset.
        image: u32,
        /// Index of the instance in the image's annotation.
        instance: u32,
    },
    /// The dataset has no image that can be read.
    #[error("sample {index}: {attempts} images in a row cannot be used, the last because {last}")]
    UnusableImages {
        /// Number of the sample.
        index: u64,
        /// Images that were tried.
        attempts: usize,
        /// Why the last one could not be used.
        last: Box<DataError>,
    },
    /// A worker thread panicked.
    #[error("preparing sample {index} failed: {message}")]
    Worker {
        /// Number of the sample.
        index: u64,
        /// Message of the panic.
        message: String,
    },
    /// An image of the dataset could not be read.
    #[error(transparent)]
    Format(#[from] FormatError),
}
