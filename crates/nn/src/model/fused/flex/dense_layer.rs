//! Focused linear attention from the dense to the sparse tokens without gradients: one context of the sparse tokens,
//! then everything else for a few rows of the dense ones at a time.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{add_product, add_transposed_product, dot, vectorised};

use super::{
    super::{FocusedMaps, TokenMaps},
    focus::focus_rows,
    rows::{Map, Tail, columns},
    tape::{Values, plain},
};

/// Rows of dense tokens per task, each of which reads all weights.
const ROWS: usize = 96;

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
    let contexts: Vec<Context> = sparse
        .par_chunks_exact((memory * width).max(1))
        .map(|sparse| layer.context(&sparse[width..]))
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
        layer.tail.write_projected(out, x, layer.attended(x, &contexts[pair]));
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

/// What the dense tokens of a pair read from.
struct Context {
    /// Per head the sums over the tokens of focused keys times values `[d, d]`, times the head's rows of the output
    /// projection: `[C, C]`.
    products: Vec<f32>,
    /// Sums of the focused keys, `[C]`.
    keys: Vec<f32>,
}

impl Layer {
    fn focused(&self, map: &Map, x: &[f32]) -> Vec<f32> {
        let x = map.apply(x);
        let mut y = vec![0.0f32; x.len()];
        focus_rows(&mut y, &x, &self.scale, self.epsilon);
        y
    }

    /// Of a memory `[M, C]`.
    fn context(&self, memory: &[f32]) -> Context {
        let (width, m) = (self.key.outputs(), memory.len() / self.key.inputs());
        let d = width / self.heads;
        let (focused, values) = rayon::join(|| self.focused(&self.key, memory), || self.value.apply(memory));
        let mut keys = vec![0.0f32; width];
        focused.chunks_exact(width).for_each(|row| keys.iter_mut().zip(row).for_each(|(s, k)| *s += k));
        let projection = self.tail.linear.weight();
        let columns_out = self.tail.linear.outputs();
        let mut products = vec![0.0f32; width * columns_out];
        products.par_chunks_exact_mut(d * columns_out).enumerate().for_each(|(head, products)| {
            let [keys, values] = [&focused, &values].map(|rows| columns(rows, width, head * d, d));
            let mut context = vec![0.0f32; d * d];
            add_transposed_product(&mut context, &keys, &values, m);
            add_product(products, &context, &projection[head * d * columns_out..][..d * columns_out], d);
        });
        Context { products, keys }
    }

    /// What the output projection makes of what queries `[R, C]` read: `[R, C]`.
    fn attended(&self, x: &[f32], context: &Context) -> Vec<f32> {
        let mut queries = self.focused(&self.query, x);
        let width = self.query.outputs();
        let d = width / self.heads;
        vectorised!({
            for row in queries.chunks_exact_mut(width) {
                for (query, keys) in row.chunks_exact_mut(d).zip(context.keys.chunks_exact(d)) {
                    let scale = 1.0 / (dot(query, keys) + self.epsilon);
                    query.iter_mut().for_each(|q| *q *= scale);
                }
            }
        });
        self.tail.linear.apply_with(&context.products, &queries, false)
    }
}
