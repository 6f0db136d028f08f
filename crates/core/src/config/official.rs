//! The official release's `config.json` as our configuration, with the release's behaviour.

use std::path::Path;

use serde::Deserialize;

use crate::files::read_text;

use super::{
    ColorConfig, Config, ConfigError, OverlapMode, PositionResampling, Quirks, VitConfig, error::UnknownName,
    load::MAX_CONFIG, validate,
};

/// Points of the reference cloud before farthest point sampling; the release has it in its data configuration.
const REFERENCE_POINTS: usize = 5000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OfficialConfig {
    coarse_npoint: usize,
    fine_npoint: usize,
    feature_extraction: FeatureExtraction,
    geo_embedding: GeoEmbedding,
    coarse_point_matching: Stage,
    fine_point_matching: Stage,
}

// Keys that only steer the release's own loading of weights are accepted and ignored.
#[allow(dead_code)]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FeatureExtraction {
    vit_type: String,
    #[serde(default = "linear")]
    up_type: String,
    embed_dim: Option<usize>,
    depth: Option<usize>,
    vit_heads: Option<usize>,
    out_dim: usize,
    #[serde(default = "yes")]
    use_pyramid_feat: bool,
    pretrained: Option<bool>,
    vit_ckpt: Option<String>,
    #[serde(default = "yes")]
    freeze_vit: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GeoEmbedding {
    sigma_d: f32,
    sigma_a: f32,
    angle_k: usize,
    #[serde(default = "max")]
    reduction_a: String,
    hidden_dim: usize,
}

/// Both stages; each has some keys to itself.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stage {
    nblock: usize,
    input_dim: usize,
    hidden_dim: usize,
    out_dim: usize,
    temp: f32,
    #[serde(default = "cosine")]
    sim_type: String,
    #[serde(default = "yes")]
    normalize_feat: bool,
    loss_predator_thres: Option<f32>,
    loss_dis_thres: Option<f32>,
    nproposal1: Option<usize>,
    nproposal2: Option<usize>,
    pe_radius1: Option<f32>,
    pe_radius2: Option<f32>,
    focusing_factor: Option<f32>,
    use_lrf: Option<bool>,
    use_xyz: Option<bool>,
    nsample1: Option<usize>,
    nsample2: Option<usize>,
}

fn linear() -> String {
    "linear".into()
}

fn max() -> String {
    "max".into()
}

fn cosine() -> String {
    "cosine".into()
}

fn yes() -> bool {
    true
}

impl Config {
    /// The `config.json` of the official release.
    pub fn load_official(path: &Path) -> Result<Self, ConfigError> {
        let text = read_text(path, MAX_CONFIG)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        Self::from_official_json(&text, path)
    }

    /// [`Self::load_official`] of a text; `path` is only for messages.
    fn from_official_json(text: &str, path: &Path) -> Result<Self, ConfigError> {
        let official: OfficialConfig = serde_json::from_str(text).map_err(|error| {
            let message = error.to_string();
            let message = UnknownName::in_message(&message).map_or(message, |unknown| unknown.explain());
            ConfigError::Parse { path: path.to_owned(), line: error.line(), message }
        })?;
        let config = official.convert()?;
        validate::validate(&config)?;
        Ok(config)
    }
}

impl OfficialConfig {
    fn convert(self) -> Result<Config, ConfigError> {
        let vit = self.feature_extraction.vit()?;
        let (coarse, fine) = (&self.coarse_point_matching, &self.fine_point_matching);
        require("geo_embedding.reduction_a", &self.geo_embedding.reduction_a, "max")?;
        for (name, stage) in [("coarse_point_matching", coarse), ("fine_point_matching", fine)] {
            require(&format!("{name}.sim_type"), &stage.sim_type, "cosine")?;
            require(&format!("{name}.normalize_feat"), &stage.normalize_feat.to_string(), "true")?;
            require(&format!("{name}.input_dim"), &stage.input_dim.to_string(), &vit.out_dim.to_string())?;
        }
        require("fine_point_matching.use_xyz", &fine.use_xyz.unwrap_or(true).to_string(), "true")?;

        let mut config = Config { name: "unopose".into(), ..Config::default() };
        let model = &mut config.model;
        model.fine_points = self.fine_npoint;
        model.coarse_points = self.coarse_npoint;
        model.reference_points = REFERENCE_POINTS.max(self.fine_npoint);
        model.color = ColorConfig::Vit(vit);
        let embedding = &mut model.geo_embedding;
        embedding.sigma_d = self.geo_embedding.sigma_d;
        embedding.sigma_a = self.geo_embedding.sigma_a;
        embedding.angle_k = self.geo_embedding.angle_k;
        embedding.hidden_dim = self.geo_embedding.hidden_dim;
        for (ours, stage) in [(&mut model.coarse, coarse), (&mut model.fine.matching, fine)] {
            ours.blocks = stage.nblock;
            ours.hidden_dim = stage.hidden_dim;
            ours.out_dim = stage.out_dim;
            ours.temperature = stage.temp;
        }
        fn set<T>(field: &mut T, value: Option<T>) {
            if let Some(value) = value {
                *field = value;
            }
        }
        set(&mut model.fine.pe_radii[0], fine.pe_radius1);
        set(&mut model.fine.pe_radii[1], fine.pe_radius2);
        set(&mut model.fine.pe_samples[0], fine.nsample1);
        set(&mut model.fine.pe_samples[1], fine.nsample2);
        set(&mut model.fine.focusing_factor, fine.focusing_factor);
        set(&mut model.fine.use_lrf, fine.use_lrf);
        set(&mut model.hypotheses.proposals, coarse.nproposal1);
        set(&mut model.hypotheses.kept, coarse.nproposal2);
        model.overlap = OverlapMode::Release;
        model.quirks = Quirks::release();

        set(
            &mut config.loss.overlap_distance,
            same("loss_predator_thres", [coarse, fine], |s| s.loss_predator_thres)?,
        );
        set(&mut config.loss.match_distance, same("loss_dis_thres", [coarse, fine], |s| s.loss_dis_thres)?);
        Ok(config)
    }
}

impl FeatureExtraction {
    /// Sizes by name (timm's `vit_base_patch14_reg4_dinov2`, Meta's `dinov2_vitb14_reg`), overridden by explicit ones.
    fn vit(&self) -> Result<VitConfig, ConfigError> {
        let range = |value: &str, expected: &str| ConfigError::Range {
            field: "feature_extraction.vit_type".into(),
            value: format!("{value:?}"),
            expected: expected.into(),
        };
        let name = self.vit_type.to_lowercase();
        if name.contains("giant") || name.contains("vitg14") {
            return Err(range(
                &self.vit_type,
                "a small, base or large transformer: giant ones have SwiGLU layers, which are not supported",
            ));
        }
        let kinds = [
            (["tiny", "vitt14"], [192, 12, 3]),
            (["small", "vits14"], [384, 12, 6]),
            (["base", "vitb14"], [768, 12, 12]),
            (["large", "vitl14"], [1024, 24, 16]),
        ];
        let sizes = kinds.into_iter().find(|(words, _)| words.iter().any(|word| name.contains(word)));
        let Some((_, [embed_dim, depth, heads])) = sizes else {
            return Err(range(
                &self.vit_type,
                "a name with tiny, small, base or large (timm) or vits14, vitb14, vitl14 (Meta), for example \
                 vit_base_patch14_reg4_dinov2",
            ));
        };
        require("feature_extraction.up_type", &self.up_type, "linear")?;
        require("feature_extraction.use_pyramid_feat", &self.use_pyramid_feat.to_string(), "true")?;
        let patch_size = match name.split_once("patch") {
            None => 14,
            Some((_, rest)) => {
                let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
                digits.parse().map_err(|_| range(&self.vit_type, "a patch size after \"patch\""))?
            }
        };
        let registers = name.contains("reg");
        Ok(VitConfig {
            embed_dim: self.embed_dim.unwrap_or(embed_dim),
            depth: self.depth.unwrap_or(depth),
            heads: self.vit_heads.unwrap_or(heads),
            patch_size,
            register_tokens: if registers { 4 } else { 0 },
            no_embed_class: registers,
            out_dim: self.out_dim,
            weights: None,
            position_resampling: PositionResampling::Release,
            freeze: self.freeze_vit,
        })
    }
}

/// A value that both stages must give alike, if at all.
fn same(
    name: &str,
    [coarse, fine]: [&Stage; 2],
    value: fn(&Stage) -> Option<f32>,
) -> Result<Option<f32>, ConfigError> {
    match (value(coarse), value(fine)) {
        (Some(coarse), Some(fine)) if coarse != fine => Err(ConfigError::Range {
            field: format!("fine_point_matching.{name}"),
            value: fine.to_string(),
            expected: format!("{coarse} as in coarse_point_matching (one value serves both stages)"),
        }),
        (coarse, fine) => Ok(coarse.or(fine)),
    }
}

fn require(field: &str, value: &str, expected: &str) -> Result<(), ConfigError> {
    if value == expected {
        return Ok(());
    }
    Err(ConfigError::Range { field: field.into(), value: value.into(), expected: expected.into() })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"{
        "coarse_npoint": 64, "fine_npoint": 256,
        "feature_extraction": {"vit_type": "tiny_patch14_reg4", "up_type": "linear", "embed_dim": 48, "depth": 4,
            "vit_heads": 3, "out_dim": 32, "use_pyramid_feat": true, "pretrained": false, "vit_ckpt": ""},
        "geo_embedding": {"sigma_d": 0.2, "sigma_a": 15, "angle_k": 3, "reduction_a": "max", "hidden_dim": 32},
        "coarse_point_matching": {"nblock": 2, "input_dim": 32, "hidden_dim": 32, "out_dim": 16, "temp": 0.1,
            "loss_dis_thres": 0.25, "nproposal1": 600, "nproposal2": 60},
        "fine_point_matching": {"nblock": 3, "input_dim": 32, "hidden_dim": 32, "out_dim": 32, "temp": 0.2,
            "pe_radius1": 0.2, "pe_radius2": 0.4, "nsample1": 16, "nsample2": 32}
    }"#;

    fn parse(text: &str) -> Result<Config, String> {
        Config::from_official_json(text, Path::new("c.json")).map_err(|e| e.to_string())
    }

    #[test]
    fn every_size_arrives() {
        let config = parse(TEXT).unwrap();
        let m = &config.model;
        assert_eq!((m.coarse_points, m.fine_points, m.coarse.blocks, m.coarse.out_dim), (64, 256, 2, 16));
        assert_eq!((m.fine.pe_radii, m.fine.pe_samples, m.hypotheses.kept), ([0.2, 0.4], [16, 32], 60));
        assert_eq!((m.fine.matching.temperature, config.loss.match_distance), (0.2, 0.25));
        assert_eq!(m.quirks, Quirks::release());
        let ColorConfig::Vit(vit) = &m.color else { panic!("{:?}", m.color) };
        assert_eq!((vit.embed_dim, vit.depth, vit.heads, vit.patch_size), (48, 4, 3, 14));
        assert_eq!((vit.register_tokens, vit.no_embed_class), (4, true));
    }

    #[test]
    fn what_we_cannot_do_is_named() {
        let error = parse(&TEXT.replace("tiny_patch14_reg4", "resnet50")).unwrap_err();
        assert!(
            error.contains("vit_type") && error.contains("resnet50") && error.contains("vitb14"),
            "{error}"
        );
        let error = parse(&TEXT.replace("tiny_patch14_reg4", "dinov2_vitg14")).unwrap_err();
        assert!(error.contains("SwiGLU"), "{error}");
        let error = parse(&TEXT.replace("\"linear\"", "\"deconv\"")).unwrap_err();
        assert!(error.contains("up_type is deconv, expected linear"), "{error}");
        let error = parse(&TEXT.replace("nsample2", "nsampel2")).unwrap_err();
        assert!(error.contains("nearest valid: `nsample2`") && error.contains("c.json:"), "{error}");
        let error = parse(&TEXT.replace("\"input_dim\": 32", "\"input_dim\": 48")).unwrap_err();
        assert!(error.contains("input_dim is 48, expected 32"), "{error}");
    }
}
