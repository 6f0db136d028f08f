//! A block of the vision transformer without gradients. Between its linear maps everything stays in panels of columns as
//! wide as a head: each product's panels are the next one's blocks, and three of the joint projection's are what a head
//! attends with.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{PANEL, gelu, vectorised};

use super::{
    super::VisionMaps,
    panels::{mapped, normalised, onto, some_mapped},
    rows::{Map, Norm},
    self_attention::{Bias, Rows, head},
    tape::{Values, plain},
};

pub fn vision_block(maps: &VisionMaps, x: &Tensor<3>) -> Option<Tensor<3>> {
    let [batch, tokens, width] = x.dims();
    let every: Vec<usize> = (0..batch * tokens).collect();
    Some(plain(block(maps, x, &every)?, [batch, tokens, width]))
}

pub fn vision_block_at(maps: &VisionMaps, x: &Tensor<3>, wanted: &[usize]) -> Option<Tensor<2>> {
    Some(plain(block(maps, x, wanted)?, [wanted.len(), x.dims()[2]]))
}

/// The `wanted` ones of the tokens `[B * T]` after the block, image by image.
fn block(maps: &VisionMaps, x: &Tensor<3>, wanted: &[usize]) -> Option<Vec<f32>> {
    let [batch, tokens, width] = x.dims();
    if width != maps.heads * PANEL || !wanted.is_sorted_by_key(|row| row / tokens) {
        return None;
    }
    let [qkv, proj, fc1, fc2] = [maps.qkv, maps.proj, maps.fc1, maps.fc2].map(Map::of);
    let [norm1, norm2] = [maps.norm1, maps.norm2].map(|norm| Norm::of(norm, maps.epsilon));
    let [scale1, scale2] = maps.scales.each_ref().map(Values::of);
    let (qkv, scale1, scale2) = (qkv?, scale1?, scale2?);
    let x = Values::of(x)?;

    let normed = normalised(&x, &norm1?)?;
    let all = wanted.len() == batch * tokens;
    let chosen: Vec<_> = match all {
        true => Vec::new(),
        false => normed.par_iter().map(|panel| selected(panel, wanted, PANEL)).collect(),
    };
    let queries = some_mapped(if all { &normed } else { &chosen }, &qkv, 0..maps.heads, |_| {})?;
    let memory = some_mapped(&normed, &qkv, maps.heads..3 * maps.heads, |_| {})?;
    let read: Vec<Vec<f32>> = (0..maps.heads)
        .into_par_iter()
        .map(|index| {
            let mut read = Vec::with_capacity(wanted.len() * PANEL);
            for image in 0..batch {
                let [first, end] = [image, image + 1].map(|i| wanted.partition_point(|row| row / tokens < i));
                let own = image * tokens * PANEL..(image + 1) * tokens * PANEL;
                let parts = [
                    &queries[index][first * PANEL..end * PANEL],
                    &memory[index][own.clone()],
                    &memory[maps.heads + index][own],
                ];
                let rows = Rows { parts, stride: PANEL, d: PANEL, counts: [end - first, tokens] };
                read.append(&mut head(&rows, index, &Bias::None));
            }
            read
        })
        .collect();
    let attended = mapped(&read, &proj?, |_| {})?;
    let chosen = if all { Vec::new() } else { selected(&x, wanted, width) };
    let x = onto(if all { &x } else { &chosen }, &attended, &scale1);

    let normed = normalised(&x, &norm2?)?;
    let activated = |panel: &mut [f32]| vectorised!(panel.iter_mut().for_each(|y| *y = gelu(*y)));
    let hidden = mapped(&normed, &fc1?, activated)?;
    let output = mapped(&hidden, &fc2?, |_| {})?;
    Some(onto(&x, &output, &scale2))
}

/// Some rows of `[R, width]`.
fn selected(x: &[f32], rows: &[usize], width: usize) -> Vec<f32> {
    let mut chosen = Vec::with_capacity(rows.len() * width);
    rows.iter().for_each(|row| chosen.extend_from_slice(&x[row * width..][..width]));
    chosen
}
