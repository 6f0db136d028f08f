//! Votes of the query's point pairs for local coordinates: a model point and a turn about its normal.

use std::f64::consts::TAU;

use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;
use unopose_core::geometry::Pose;

use super::features::{AlignedPoints, PairTable};

/// A pose (reference to query camera) with its votes.
#[derive(Clone, Copy, Debug)]
pub struct VotedPose {
    pub pose: Pose,
    pub votes: f64,
}

/// For every `step`-th query point the local coordinates with the most votes (Drost et al., sections 3.3 and 3.4).
pub fn vote(table: &PairTable, model: &AlignedPoints, query: &AlignedPoints, step: usize) -> Vec<VotedPose> {
    let angle_step = table.angle_step();
    let turns = (TAU / angle_step).round().max(1.0) as usize;
    (0..query.points.len())
        .into_par_iter()
        .step_by(step.max(1))
        .filter_map(|i| {
            let mut votes = vec![0u32; model.points.len() * turns];
            for j in (0..query.points.len()).filter(|&j| j != i) {
                let angle = query.angle(i, j);
                for pair in table.similar(query, i, j) {
                    // The turn that brings the model pair's second point to the query pair's.
                    let turn = (angle - f64::from(pair.angle)).rem_euclid(TAU);
                    votes[pair.first as usize * turns + (turn / angle_step) as usize % turns] += 1;
                }
            }
            let (best, &count) =
                votes.iter().enumerate().max_by_key(|&(index, &v)| (v, std::cmp::Reverse(index)))?;
            let turn = (((best % turns) as f64) + 0.5) * angle_step;
            let about_normal = Pose::new(*Rotation3::new(Vector3::x() * turn).matrix(), Vector3::zeros());
            let pose = query.to_origin[i].inverse() * about_normal * model.to_origin[best / turns];
            (count > 0).then_some(VotedPose { pose, votes: f64::from(count) })
        })
        .collect()
}
