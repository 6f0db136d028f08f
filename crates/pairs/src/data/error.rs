//! Why a view or a pair cannot be used.

use unopose_dataset::formats::FormatError;

/// Error of the `data` room.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    #[error("the mask is empty, expected at least one pixel of the object")]
    EmptyMask,
    #[error(
        "{what} is {found_width} x {found_height} pixels, expected {width} x {height} like the colour image"
    )]
    Size { what: &'static str, found_width: u32, found_height: u32, width: u32, height: u32 },
    #[error("the object has {count} usable pixels, expected more than {minimum}")]
    TooFewPixels { count: usize, minimum: usize },
    #[error(
        "the mask has {masked} pixels but none with depth, expected a depth image registered to the colour image"
    )]
    NoDepth { masked: usize },
    #[error(
        "{count} of the query's {total} points lie within 1.2 reference radii ({limit:.3} m) of their mean, expected \
         at least {minimum}"
    )]
    TooFewPoints { count: usize, total: usize, limit: f64, minimum: usize },
    #[error(
        "the reference's radius is {radius} m, expected between {minimum} and {maximum} m: is depth_scale (depth unit to \
         millimetres) right?"
    )]
    Radius { radius: f32, minimum: f32, maximum: f32 },
    #[error("the dataset has no instance that is visible enough and has a reference view in another image")]
    NoPairs,
    #[error("sample {index}: {attempts} instances in a row were rejected, the last because {last}")]
    Exhausted { index: u64, attempts: usize, last: Box<DataError> },
    #[error("no reference of object {obj_id} fits the limits on rotation and overlap")]
    NoReference { obj_id: u32 },
    #[error("image {image} has no instance {instance} although the index lists it")]
    MissingInstance { image: u32, instance: u32 },
    #[error("preparing sample {index} failed: {message}")]
    Worker { index: u64, message: String },
    #[error(transparent)]
    Format(#[from] FormatError),
}
