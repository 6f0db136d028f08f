//! The depth channel of an OpenEXR file.

use std::{io::Cursor, path::Path};

use exr::{
    image::{AnyChannel, FlatSamples},
    prelude::{ReadChannels, ReadLayers, read as reader},
};

use super::{
    FormatError,
    decode::{check_size, image_error},
    samples::{Samples, Values},
};

/// All channels of all parts are decoded, four bytes each.
const MAX_NUMBERS: u64 = 400_000_000;

pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Samples, FormatError> {
    let error = |source: exr::error::Error| {
        let format = image::error::ImageFormatHint::Name("OpenEXR".to_owned());
        image_error(path, image::ImageError::Decoding(image::error::DecodingError::new(format, source)))
    };
    let chunks = exr::block::read(Cursor::new(bytes), false).map_err(error)?;
    let mut numbers = 0;
    for header in chunks.headers() {
        let (size, channels) = (header.layer_size, header.channels.list.len().max(1) as u64);
        let [width, height] = [size.width() as u64, size.height() as u64];
        check_size(path, [width, height], bytes.len() as u64 / channels)?;
        numbers += width * height * channels;
    }
    if numbers > MAX_NUMBERS {
        let expected = format!("at most {MAX_NUMBERS} in all channels");
        return Err(FormatError::field(path.display(), "number of values", numbers, expected));
    }
    let file =
        reader().no_deep_data().largest_resolution_level().all_channels().all_layers().all_attributes();
    let image = file.non_parallel().from_chunks(chunks).map_err(error)?;
    let mut channels = Vec::new();
    for layer in image.layer_data {
        let part = layer.attributes.layer_name.map(|name| format!("{name}.")).unwrap_or_default();
        let named = layer.channel_data.list.into_iter().map(|c| (format!("{part}{}", c.name), layer.size, c));
        channels.extend(named);
    }
    let names: Vec<&str> = channels.iter().map(|(name, ..)| name.as_str()).collect();
    let chosen = depth_channels(&names);
    let equal = chosen.windows(2).all(|pair| same(&channels[pair[0]].2, &channels[pair[1]].2));
    let (Some(&index), true) = (chosen.first(), equal) else {
        let expected = "one channel, or one named Z or Depth, or equal R, G and B";
        return Err(FormatError::field(path.display(), "channels", names.join(", "), expected));
    };
    let (_, size, channel) = channels.swap_remove(index);
    let values = match channel.sample_data {
        FlatSamples::F16(values) => Values::Floats(values.into_iter().map(|v| v.to_f32()).collect()),
        FlatSamples::F32(values) => Values::Floats(values),
        FlatSamples::U32(values) => Values::Integers(values, 32),
    };
    Ok(Samples { width: size.width() as u32, height: size.height() as u32, values })
}

/// Which channels hold the depth (copies of each other where there are several): the only one; those with `Z` as their name
/// or with `depth` in it; gray as three colours.
fn depth_channels(names: &[&str]) -> Vec<usize> {
    let of = |wanted: &dyn Fn(&str) -> bool| -> Vec<usize> {
        (0..names.len()).filter(|&i| wanted(&names[i].to_ascii_lowercase())).collect()
    };
    let by_name = of(&|name| name == "z" || name.split('.').any(|part| part == "depth"));
    match (names, by_name.as_slice()) {
        ([_], _) => vec![0],
        (_, []) => of(&|name| ["r", "g", "b"].contains(&name)),
        _ => by_name,
    }
}

fn same(a: &AnyChannel<FlatSamples>, b: &AnyChannel<FlatSamples>) -> bool {
    // NaN is equal to itself here.
    let bits = |channel: &AnyChannel<FlatSamples>| {
        channel.sample_data.values_as_f32().map(f32::to_bits).collect::<Vec<_>>()
    };
    bits(a) == bits(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_depth_channel_is_found_by_its_name() {
        for (names, expected) in [
            (vec!["Y"], vec![0]),
            (vec!["A", "B", "G", "R"], vec![1, 2, 3]),
            (vec!["B", "G", "R", "Z"], vec![3]),
            (vec!["ViewLayer.Combined.R", "ViewLayer.Depth.Z", "ViewLayer.Normal.Z"], vec![1]),
            (vec!["X", "Y"], vec![]),
        ] {
            assert_eq!(depth_channels(&names), expected, "{names:?}");
        }
    }
}
