//! Pictures for walls, floors and tables: a folder of photographs, or procedural ones.

use std::sync::Arc;

use image::RgbImage;
use rand_chacha::ChaCha8Rng;
use unopose_core::config::SynthConfig;
use unopose_dataset::render::{Finish, Surface};

use super::{SynthError, photographs::Photographs, random::Draw, texture};

/// Where surfaces of rooms come from.
#[derive(Clone, Debug, Default)]
pub(super) struct Backgrounds {
    photographs: Photographs,
}

impl Backgrounds {
    /// Lists the photographs in `synth.background_folder` where one is configured.
    pub fn new(config: &SynthConfig) -> Result<Self, SynthError> {
        Ok(Self { photographs: Photographs::open(&config.background_folder)? })
    }

    /// A surface with a repeating material; `tile` is the range of its size in metres, `smooth` its least roughness.
    pub fn material(&self, pixels: u32, tile: [f32; 2], smooth: f32, rng: &mut ChaCha8Rng) -> Surface {
        let tile = rng.log_between(tile[0], tile[1]);
        let picture = match self.photographs.draw(0.3, rng) {
            Some(photograph) => photograph,
            None => texture::tile(pixels, tile, rng),
        };
        surface(picture, tile, smooth, rng)
    }

    /// A wall: shelves, posters, windows and shadows out of focus.
    pub fn wall(&self, rng: &mut ChaCha8Rng) -> Surface {
        let tile = rng.between(1.2, 4.0);
        let picture = match self.photographs.draw(0.8, rng) {
            Some(photograph) => photograph,
            None if rng.chance(0.35) => texture::tile(128, tile, rng),
            None => texture::scenery(320, rng),
        };
        Surface { angle: 0.0, ..surface(picture, tile, 0.7, rng) }
    }

    /// A printed sheet of this size in metres: a page, a magazine, a poster.
    pub fn sheet(&self, [width, height]: [f32; 2], rng: &mut ChaCha8Rng) -> Surface {
        let picture = texture::sheet(width / height, 192, rng);
        Surface { angle: 0.0, ..surface(picture, width.max(height), 0.4, rng) }
    }

    /// One colour, as of plastic or board.
    pub fn plain(&self, rng: &mut ChaCha8Rng) -> Surface {
        surface(texture::plain(rng), 1.0, 0.3, rng)
    }
}

fn surface(picture: RgbImage, tile: f32, smooth: f32, rng: &mut ChaCha8Rng) -> Surface {
    let finish = Finish { roughness: rng.between(smooth, 1.0), metallic: 0.0 };
    Surface { picture: Arc::new(picture), tile, angle: rng.between(0.0, std::f32::consts::TAU), finish }
}
