//! What the network finds in validation images.

use std::path::Path;

use image::{Rgb, RgbImage};
use unopose_eval::report::overlay;
use unopose_nn::model::ProposalNetwork;
use unopose_pairs::data::{GEOMETRY_CHANNELS, SceneInput, scene_instances};

use super::validation::SceneValidation;
use crate::TrainError;

/// Images on the sheet.
const SHOWN: usize = 8;
/// Least score of an instance that is drawn.
const LEAST_SCORE: f32 = 0.4;

/// One row of three tiles per image: colours, true instances, found ones, the surest on top.
pub fn write(path: &Path, network: &ProposalNetwork, validation: &SceneValidation) -> Result<(), TrainError> {
    let mut tiles = Vec::new();
    for sample in validation.shown(SHOWN)? {
        let input = &sample.input;
        let mut labels = vec![0; input.len()];
        let found = scene_instances(input, &network.maps(input));
        let sure = found.iter().enumerate().filter(|(_, instance)| instance.score >= LEAST_SCORE);
        for (number, instance) in sure.rev() {
            instance.cells.iter().for_each(|&cell| labels[cell as usize] = number as u32 + 1);
        }
        let none = vec![0; input.len()];
        for labels in [&none, &sample.target.instances, &labels] {
            tiles.push(tile(input, labels));
        }
    }
    Ok(overlay::write_png(path, &overlay::contact_sheet(&tiles, 3))?)
}

/// The colours that the network sees, half covered by the colour of the label where there is one.
fn tile(input: &SceneInput, labels: &[u32]) -> RgbImage {
    let area = input.len();
    RgbImage::from_fn(input.width as u32, input.height as u32, |col, row| {
        let cell = row as usize * input.width + col as usize;
        let seen = |channel: usize| {
            128.0 * 0.9 + 64.0 * input.values[(GEOMETRY_CHANNELS + channel) * area + cell].clamp(-1.8, 2.2)
        };
        let own = labels[cell].wrapping_mul(2_654_435_761);
        Rgb(std::array::from_fn(|channel| match labels[cell] {
            0 => seen(channel) as u8,
            _ => (0.5 * seen(channel) + 0.5 * f32::from((own >> (8 * channel + 4)) as u8)) as u8,
        }))
    })
}
