//! Points, samples, frames and structure: the preparation on the host.

use unopose_core::{
    config::ModelConfig,
    geometry::{farthest_point_sampling, global_reference_frame},
};
use unopose_pairs::data::CloudInput;

use super::{computed::Computed, inputs::Pair};

/// Computes everything that needs no network.
pub(super) fn compute(out: &mut Computed, pairs: &[Pair], config: &ModelConfig) {
    out.items("radius", &[], pairs.iter().map(|p| [p.reference.radius]));
    let frames = |points: &[[f32; 3]]| global_reference_frame(points, config.quirks.counted_z_sign);
    let all = |f: &dyn Fn(&Pair) -> Vec<[f32; 3]>| -> Vec<Vec<[f32; 3]>> { pairs.iter().map(f).collect() };
    let mut put = |name: &str, clouds: Vec<Vec<[f32; 3]>>| out.clouds(name, clouds.iter().map(Vec::as_slice));
    put("dense_pm", all(&|p| p.query.points.clone()));
    put("dense_po", all(&|p| p.reference.cloud.points.clone()));
    put("pe_in_o", all(&|p| p.reference.cloud.points.clone()));
    put("sparse_pm", all(&|p| gather(&p.query.points, &p.query.sparse)));
    put("sparse_po", all(&|p| gather(&p.reference.cloud.points, &p.reference.cloud.sparse)));
    put("dense_pm_lrf", all(&|p| frames(&p.query_points)));
    put("dense_po_lrf", all(&|p| frames(&p.reference_points)));
    put("sparse_pm_lrf", all(&|p| gather(&frames(&p.query_points), &p.query.sparse)));
    let dense_indices: Vec<Vec<u32>> = pairs
        .iter()
        .map(|p| {
            let (center, scale) = (p.reference.cloud.center, p.reference.radius + 1e-6);
            let normalised: Vec<[f32; 3]> = p
                .reference_points
                .iter()
                .map(|x| std::array::from_fn(|i| (x[i] - center[i]) / scale))
                .collect();
            farthest_point_sampling(&normalised, config.fine_points)
        })
        .collect();
    let structure_points = pairs.iter().zip(&dense_indices).map(|(p, dense)| {
        let frame = frames(&p.reference_points);
        let index = |&i: &u32| if config.quirks.misaligned_reference_grf { i } else { dense[i as usize] };
        gather(&frame, &p.reference.cloud.sparse.iter().map(index).collect::<Vec<u32>>())
    });
    put("sparse_po_lrf", structure_points.collect());
    let (n, m) = (config.fine_points, config.coarse_points);
    out.items("fps_idx_dense_o", &[n], dense_indices);
    out.items("fps_idx_m", &[m], pairs.iter().map(|p| p.query.sparse.clone()));
    out.items("fps_idx_o", &[m], pairs.iter().map(|p| p.reference.cloud.sparse.clone()));
    let (size, k) = (m + 1, config.geo_embedding.angle_k);
    for (letter, pick) in SIDES {
        let structures = || pairs.iter().map(|p| &pick(p).structure);
        out.items(
            format!("geo_d_indices_{letter}"),
            &[size, size],
            structures().map(|s| s.distances.clone()),
        );
        out.items(
            format!("geo_a_indices_{letter}"),
            &[size, size, k],
            structures().map(|s| s.angles.clone()),
        );
    }
}

/// Access to one cloud of a pair.
pub(super) type Pick = fn(&Pair) -> &CloudInput;
/// Both clouds with their letters in the names.
pub(super) const SIDES: [(&str, Pick); 2] = [("m", |p| &p.query), ("o", |p| &p.reference.cloud)];

fn gather(points: &[[f32; 3]], indices: &[u32]) -> Vec<[f32; 3]> {
    indices.iter().map(|&i| points[i as usize]).collect()
}
