//! A layer of the matching transformers without gradients: keys and values of the memory, then everything else for a few
//! rows of the queries at a time.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{add_product, row_products, vectorised};

use super::{
    super::{AttentionMaps, TokenMaps},
    rows::{Map, Tail, columns, transposed},
    self_attention::{exponentials, largest},
    tape::{Values, plain},
};

/// Rows of queries whose scores are worked on at a time.
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
    // As few tasks as there are threads: each reads all weights.
    let per_task = (batch * n).div_ceil(rayon::current_num_threads()).clamp(ROWS, n.max(ROWS));
    let mut out = vec![0.0f32; batch * n * width];
    let mut tasks = Vec::with_capacity(batch * n.div_ceil(per_task));
    for (pair, out) in out.chunks_exact_mut((n * width).max(1)).enumerate() {
        let blocks = out.chunks_mut(per_task * width).enumerate();
        tasks.extend(blocks.map(|(block, out)| (pair, pair * n + block * per_task, out)));
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
        let d = width / self.heads;
        let padded = m.next_multiple_of(LANES);
        let scale = (d as f32).powf(-0.5);
        let mut queries = self.query.apply(x);
        vectorised!(queries.iter_mut().for_each(|q| *q *= scale));
        let mut read = vec![0.0f32; queries.len()];
        let mut scores = vec![0.0f32; self.heads * ROWS * padded];
        for (block, (read, queries)) in
            read.chunks_mut(ROWS * width).zip(queries.chunks(ROWS * width)).enumerate()
        {
            let rows = queries.len() / width;
            let queries: Vec<Vec<f32>> = (0..self.heads).map(|h| columns(queries, width, h * d, d)).collect();
            let scores = &mut scores[..self.heads * rows * padded];
            scores.fill(0.0);
            if let Some(embedding) = embedding {
                let per_row = embedding.len() / (x.len() / self.query.inputs());
                let embedding = &embedding[block * ROWS * per_row..][..rows * per_row];
                let projected: Vec<Vec<f32>> = queries
                    .iter()
                    .zip(memories)
                    .map(|(queries, memory)| {
                        let mut projected = vec![0.0f32; rows * per_row / m];
                        add_product(&mut projected, queries, &memory.relative, d);
                        projected
                    })
                    .collect();
                relative_scores(scores, &projected, embedding, [rows, m, padded]);
            }
            let heads = memories.iter().zip(&queries).zip(scores.chunks_exact_mut(rows * padded));
            for (head, ((memory, queries), scores)) in heads.enumerate() {
                let (part, sums) = memory.read(queries, scores, m);
                for ((read, part), sum) in read.chunks_exact_mut(width).zip(part.chunks_exact(d)).zip(sums) {
                    let scale = 1.0 / sum;
                    read[head * d..][..d].iter_mut().zip(part).for_each(|(r, p)| *r = p * scale);
                }
            }
        }
        read
    }
}

impl Memory {
    /// Values `[R, d]` of `m` tokens, weighted by the exponentials of `scores` `[R, columns]` plus the products of queries
    /// `[R, d]` with the keys, and the sums of the weights.
    fn read(&self, queries: &[f32], scores: &mut [f32], m: usize) -> (Vec<f32>, [f32; ROWS]) {
        let padded = m.next_multiple_of(LANES);
        add_product(scores, queries, &self.keys, self.keys.len() / padded);
        let mut sums = [0.0f32; ROWS];
        vectorised!({
            for (row, sum) in scores.chunks_exact_mut(padded).zip(&mut sums) {
                let largest = largest(&row[..m]);
                *sum = exponentials(&mut row[..m], largest);
            }
        });
        let mut read = vec![0.0f32; queries.len()];
        add_product(&mut read, scores, &self.values, padded);
        (read, sums)
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
    for (r, embedding) in embedding.chunks_exact((m * channels).max(1)).enumerate() {
        let mut scores: Vec<&mut [f32]> =
            scores.chunks_exact_mut(rows * padded).map(|head| &mut head[r * padded..][..m]).collect();
        let projected: Vec<&[f32]> = projected.iter().map(|p| &p[r * channels..][..channels]).collect();
        row_products(&mut scores, &projected, embedding);
    }
}
