//! A layer of the matching transformers without gradients: keys and values of the memory, then everything else for a few
//! rows of the queries at a time.

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::{
    AttentionMaps, TokenMaps,
    rows::{Map, Tail, columns, transposed},
    self_attention::{exponentials, largest},
    tape::{Values, plain},
};
use crate::simd::{add_product, dot, dots, vectorised};

/// Rows of queries per task.
const ROWS: usize = 24;
/// Rows of scores are padded to whole vectors.
const LANES: usize = 16;

pub fn attention_layer(
    maps: &AttentionMaps,
    tail: &TokenMaps,
    x: &Tensor<3>,
    memory: &Tensor<3>,
    embedding: Option<&Tensor<4>>,
) -> Option<Tensor<3>> {
    let ([batch, n, width], [_, m, _]) = (x.dims(), memory.dims());
    let layer = Layer::new(maps, tail)?;
    let (x, memory) = (Values::of(x)?, Values::of(memory)?);
    let embedding = match embedding {
        Some(embedding) => Some(Values::of(embedding)?),
        None => None,
    };
    let relative = maps.relative.is_some() && embedding.is_some();
    let memories: Vec<Memory> = (0..batch * layer.heads)
        .into_par_iter()
        .map(|item| {
            let (pair, head) = (item / layer.heads, item % layer.heads);
            layer.memory(&memory[pair * m * width..][..m * width], head, relative)
        })
        .collect();
    let mut out = vec![0.0f32; batch * n * width];
    let mut tasks = Vec::with_capacity(batch * n.div_ceil(ROWS));
    for (pair, out) in out.chunks_exact_mut((n * width).max(1)).enumerate() {
        let blocks = out.chunks_mut(ROWS * width).enumerate();
        tasks.extend(blocks.map(|(block, out)| (pair, pair * n + block * ROWS, out)));
    }
    tasks.into_par_iter().for_each(|(pair, first, out)| {
        let x = &x[first * width..][..out.len()];
        let embedding = embedding.as_ref().filter(|_| relative);
        let rows = out.len() / width;
        let embedding = embedding.map(|e| &e[first * m * width..][..rows * m * width]);
        let memories = &memories[pair * layer.heads..][..layer.heads];
        layer.tail.write(out, x, &layer.read(x, memories, m, embedding));
    });
    Some(plain(out, [batch, n, width]))
}

struct Layer {
    query: Map,
    key: Map,
    value: Map,
    /// Projection of relative positions.
    relative: Option<Map>,
    tail: Tail,
    heads: usize,
}

/// What a head reads from.
struct Memory {
    /// `[d, columns]`.
    keys: Vec<f32>,
    /// `[columns, d]`.
    values: Vec<f32>,
    /// From the head's queries to the structure embedding, `[d, C]`.
    relative: Vec<f32>,
}

impl Layer {
    fn new(maps: &AttentionMaps, tail: &TokenMaps) -> Option<Self> {
        let relative = match maps.relative {
            Some(map) => Some(Map::of(map)?),
            None => None,
        };
        let [query, key, value] = [maps.query, maps.key, maps.value].map(Map::of);
        Some(Self {
            query: query?,
            key: key?,
            value: value?,
            relative,
            tail: Tail::of(tail)?,
            heads: maps.heads,
        })
    }

    /// Keys and values of a memory `[M, C]` in a head.
    fn memory(&self, memory: &[f32], head: usize, relative: bool) -> Memory {
        let d = self.query.outputs() / self.heads;
        let width = self.key.inputs();
        let m = memory.len() / width;
        let padded = m.next_multiple_of(LANES);
        let part = |map: &Map, padded: usize| {
            let mut y = vec![0.0f32; padded * d];
            map.write_columns(&mut y[..m * d], memory, head * d);
            y
        };
        let keys = transposed(&part(&self.key, padded), d);
        let values = part(&self.value, padded);
        let relative = match &self.relative {
            Some(map) if relative => transposed(&columns(map.weight(), map.outputs(), head * d, d), d),
            _ => Vec::new(),
        };
        Memory { keys, values, relative }
    }

    /// What queries `[R, C]` read from `m` tokens, with the structure embedding's rows `[R, M, C]`: `[R, C]`.
    ///
    /// The bias of the relative projection adds the same to all scores of a query, which the softmax does not see.
    fn read(&self, x: &[f32], memories: &[Memory], m: usize, embedding: Option<&[f32]>) -> Vec<f32> {
        let width = self.query.outputs();
        let (d, rows) = (width / self.heads, x.len() / self.query.inputs());
        let padded = m.next_multiple_of(LANES);
        let scale = (d as f32).powf(-0.5);
        let mut projected = self.query.apply(x);
        vectorised(|| projected.iter_mut().for_each(|q| *q *= scale));
        let queries: Vec<Vec<f32>> = (0..self.heads).map(|h| columns(&projected, width, h * d, d)).collect();
        let mut scores = vec![0.0f32; self.heads * rows * padded];
        if let Some(embedding) = embedding {
            let channels = embedding.len() / (rows * m).max(1);
            let by_head: Vec<Vec<f32>> = queries
                .iter()
                .zip(memories)
                .map(|(queries, memory)| {
                    let mut projected = vec![0.0f32; rows * channels];
                    add_product(&mut projected, queries, &memory.relative, d);
                    projected
                })
                .collect();
            relative_scores(&mut scores, &by_head, embedding, [rows, m, padded]);
        }
        let mut read = vec![0.0f32; rows * width];
        let mut part = vec![0.0f32; rows * d];
        for (head, memory) in memories.iter().enumerate() {
            let scores = &mut scores[head * rows * padded..][..rows * padded];
            add_product(scores, &queries[head], &memory.keys, d);
            let mut sums = [0.0f32; ROWS];
            vectorised(|| {
                for (row, sum) in scores.chunks_exact_mut(padded).zip(&mut sums) {
                    let largest = largest(&row[..m]);
                    *sum = exponentials(&mut row[..m], largest);
                }
            });
            part.fill(0.0);
            add_product(&mut part, scores, &memory.values, padded);
            for ((read, part), sum) in read.chunks_exact_mut(width).zip(part.chunks_exact(d)).zip(sums) {
                let scale = 1.0 / sum;
                read[head * d..][..d].iter_mut().zip(part).for_each(|(r, p)| *r = p * scale);
            }
        }
        read
    }
}

/// Products of each head's projected queries `[R, C]` with the embedding's rows `[R, M, C]`, read once for all heads:
/// `[H, R, padded]`.
fn relative_scores(
    scores: &mut [f32],
    projected: &[Vec<f32>],
    embedding: &[f32],
    [rows, m, padded]: [usize; 3],
) {
    let channels = embedding.len() / (rows * m).max(1);
    vectorised(|| {
        for (r, embedding) in embedding.chunks_exact(m * channels).enumerate() {
            let query = |head: usize| &projected[head][r * channels..][..channels];
            for first in (0..projected.len()).step_by(4) {
                let at = |head: usize| (head * rows + r) * padded;
                if first + 4 <= projected.len() {
                    let queries = [first, first + 1, first + 2, first + 3].map(query);
                    for (i, e) in embedding.chunks_exact(channels).enumerate() {
                        let products = dots(queries, e);
                        (0..4).for_each(|h| scores[at(first + h) + i] = products[h]);
                    }
                } else {
                    for head in first..projected.len() {
                        for (i, e) in embedding.chunks_exact(channels).enumerate() {
                            scores[at(head) + i] = dot(query(head), e);
                        }
                    }
                }
            }
        }
    });
}
