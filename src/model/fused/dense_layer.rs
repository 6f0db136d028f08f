//! Focused linear attention from the dense to the sparse tokens without gradients: one context of the sparse tokens,
//! then everything else for a few rows of the dense ones at a time.

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::{
    FocusedMaps, TokenMaps,
    focus::focus_rows,
    rows::{Map, Tail, columns},
    tape::{Values, plain},
};
use crate::simd::{add_product, add_transposed_product};

/// Rows of dense tokens per task.
const ROWS: usize = 48;

pub fn dense_layer(
    maps: &FocusedMaps,
    tail: &TokenMaps,
    dense: &Tensor<3>,
    sparse: &Tensor<3>,
) -> Option<Tensor<3>> {
    let ([batch, tokens, width], [_, memory, _]) = (dense.dims(), sparse.dims());
    let layer = Layer {
        query: Map::of(maps.query)?,
        key: Map::of(maps.key)?,
        value: Map::of(maps.value)?,
        scale: Values::of(maps.scale)?,
        tail: Tail::of(tail)?,
        heads: maps.heads,
        epsilon: maps.epsilon as f32,
    };
    let (dense, sparse) = (Values::of(dense)?, Values::of(sparse)?);
    let contexts: Vec<Vec<Context>> = sparse
        .par_chunks_exact((memory * width).max(1))
        .map(|sparse| layer.contexts(&sparse[width..]))
        .collect();
    let mut out = vec![0.0f32; batch * tokens * width];
    let mut tasks = Vec::with_capacity(batch * tokens.div_ceil(ROWS));
    for (pair, out) in out.chunks_exact_mut((tokens * width).max(1)).enumerate() {
        let (background, points) = out.split_at_mut(width);
        background.copy_from_slice(&sparse[pair * memory * width..][..width]);
        let blocks = points.chunks_mut(ROWS * width).enumerate();
        tasks.extend(blocks.map(|(block, out)| (pair, pair * tokens + 1 + block * ROWS, out)));
    }
    tasks.into_par_iter().for_each(|(pair, first, out)| {
        let x = &dense[first * width..][..out.len()];
        layer.tail.write(out, x, &layer.read(x, &contexts[pair]));
    });
    Some(plain(out, [batch, tokens, width]))
}

struct Layer {
    query: Map,
    key: Map,
    value: Map,
    scale: Values,
    tail: Tail,
    heads: usize,
    epsilon: f32,
}

/// What a head reads from: sums over the tokens of focused keys times values `[d, d]`, and of focused keys `[d]`.
struct Context {
    products: Vec<f32>,
    keys: Vec<f32>,
}

impl Layer {
    fn focused(&self, map: &Map, x: &[f32]) -> Vec<f32> {
        let x = map.apply(x);
        let mut y = vec![0.0f32; x.len()];
        focus_rows(&mut y, &x, &self.scale, self.epsilon);
        y
    }

    /// Of a memory `[M, C]`, one per head.
    fn contexts(&self, memory: &[f32]) -> Vec<Context> {
        let (width, m) = (self.key.outputs(), memory.len() / self.key.inputs());
        let d = width / self.heads;
        let (keys, values) = rayon::join(|| self.focused(&self.key, memory), || self.value.apply(memory));
        let context = |head: usize| {
            let [keys, values] = [&keys, &values].map(|rows| columns(rows, width, head * d, d));
            let mut products = vec![0.0f32; d * d];
            add_transposed_product(&mut products, &keys, &values, m);
            let mut sums = vec![0.0f32; d];
            keys.chunks_exact(d).for_each(|row| sums.iter_mut().zip(row).for_each(|(s, k)| *s += k));
            Context { products, keys: sums }
        };
        (0..self.heads).into_par_iter().map(context).collect()
    }

    /// What queries `[R, C]` read: `[R, C]`.
    fn read(&self, x: &[f32], contexts: &[Context]) -> Vec<f32> {
        let queries = self.focused(&self.query, x);
        let width = self.query.outputs();
        let d = width / self.heads;
        let mut read = vec![0.0f32; queries.len()];
        for (head, context) in contexts.iter().enumerate() {
            let queries = columns(&queries, width, head * d, d);
            let mut part = vec![0.0f32; queries.len()];
            add_product(&mut part, &queries, &context.products, d);
            let rows = part.chunks_exact(d).zip(queries.chunks_exact(d));
            for (read, (part, query)) in read.chunks_exact_mut(width).zip(rows) {
                let sum: f32 = query.iter().zip(&context.keys).map(|(q, k)| q * k).sum();
                let scale = 1.0 / (sum + self.epsilon);
                read[head * d..][..d].iter_mut().zip(part).for_each(|(r, p)| *r = p * scale);
            }
        }
        read
    }
}
