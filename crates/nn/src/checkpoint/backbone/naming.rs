//! The names that DINOv2's tensors have in files of its three distributors, and ours, which are timm's.

use std::fmt;

/// Who wrote a backbone file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Naming {
    /// `facebookresearch/dinov2`: `register_tokens`, `mask_token`.
    Meta,
    /// timm: `reg_token`.
    Timm,
    /// Hugging Face transformers: `embeddings.*`, `encoder.layer.N.*`.
    HuggingFace,
}

impl fmt::Display for Naming {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Meta => "Meta (facebookresearch/dinov2)",
            Self::Timm => "timm",
            Self::HuggingFace => "Hugging Face transformers",
        })
    }
}

/// What becomes of a stored tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Target {
    /// A parameter of ours.
    Whole(String),
    /// The query, key or value rows (0, 1, 2) of our joint projection.
    Third(String, usize),
    /// Part of a SwiGLU feed-forward layer.
    SwiGlu,
    /// Not part of the network (mask token, heads).
    Unused,
    /// Not a name of this naming.
    Unknown,
}

impl Naming {
    /// The naming that these names follow. Meta's and timm's differ in the tokens only: Meta's files hold a mask token,
    /// which timm drops.
    pub(super) fn of<'a>(mut names: impl Iterator<Item = &'a str> + Clone) -> Self {
        if names.clone().any(|n| n.starts_with("embeddings.") || n.starts_with("encoder.layer.")) {
            Self::HuggingFace
        } else if names.any(|n| n == "register_tokens" || n == "mask_token") {
            Self::Meta
        } else {
            Self::Timm
        }
    }

    /// Our place of the tensor that this naming calls `name`.
    pub(super) fn target(self, name: &str) -> Target {
        match self {
            Self::HuggingFace => hugging_face(name),
            Self::Meta | Self::Timm => meta_or_timm(name),
        }
    }
}

fn whole(name: impl Into<String>) -> Target {
    Target::Whole(name.into())
}

fn meta_or_timm(name: &str) -> Target {
    match name {
        "register_tokens" | "reg_token" => return whole("reg_token"),
        "cls_token" | "pos_embed" | "patch_embed.proj.weight" | "patch_embed.proj.bias" => {
            return whole(name);
        }
        "norm.weight" | "norm.bias" => return whole(name),
        "mask_token" => return Target::Unused,
        _ => {}
    }
    if ["head.", "fc_norm.", "dino_head.", "ibot_head."].iter().any(|part| name.starts_with(part)) {
        return Target::Unused;
    }
    let Some((index, rest)) = name.strip_prefix("blocks.").and_then(|rest| rest.split_once('.')) else {
        return Target::Unknown;
    };
    // Meta's training code stores blocks in chunks, `blocks.CHUNK.INDEX`, with the index still that of the block.
    let (index, rest) = match rest.split_once('.') {
        Some((second, rest)) if is_number(second) => (second, rest),
        _ => (index, rest),
    };
    if rest.starts_with("mlp.w12.") || rest.starts_with("mlp.w3.") {
        return Target::SwiGlu;
    }
    const MEMBERS: [&str; 8] =
        ["norm1.", "norm2.", "attn.qkv.", "attn.proj.", "mlp.fc1.", "mlp.fc2.", "ls1.gamma", "ls2.gamma"];
    let known = is_number(index) && MEMBERS.iter().any(|member| rest.starts_with(member));
    if known { whole(format!("blocks.{index}.{rest}")) } else { Target::Unknown }
}

fn hugging_face(name: &str) -> Target {
    const TOP: [(&str, &str); 7] = [
        ("embeddings.cls_token", "cls_token"),
        ("embeddings.register_tokens", "reg_token"),
        ("embeddings.position_embeddings", "pos_embed"),
        ("embeddings.patch_embeddings.projection.weight", "patch_embed.proj.weight"),
        ("embeddings.patch_embeddings.projection.bias", "patch_embed.proj.bias"),
        ("layernorm.weight", "norm.weight"),
        ("layernorm.bias", "norm.bias"),
    ];
    const MEMBERS: [(&str, &str); 7] = [
        ("norm1.", "norm1."),
        ("norm2.", "norm2."),
        ("attention.output.dense.", "attn.proj."),
        ("mlp.fc1.", "mlp.fc1."),
        ("mlp.fc2.", "mlp.fc2."),
        ("layer_scale1.lambda1", "ls1.gamma"),
        ("layer_scale2.lambda1", "ls2.gamma"),
    ];
    if let Some((_, ours)) = TOP.iter().find(|(theirs, _)| *theirs == name) {
        return whole(*ours);
    }
    if name == "embeddings.mask_token" || name.starts_with("classifier.") || name.starts_with("pooler.") {
        return Target::Unused;
    }
    let Some((index, rest)) = name.strip_prefix("encoder.layer.").and_then(|rest| rest.split_once('.'))
    else {
        return Target::Unknown;
    };
    if !is_number(index) {
        return Target::Unknown;
    }
    if rest.starts_with("mlp.weights_in.") || rest.starts_with("mlp.weights_out.") {
        return Target::SwiGlu;
    }
    if let Some(rest) = rest.strip_prefix("attention.attention.") {
        let third = ["query.", "key.", "value."]
            .iter()
            .enumerate()
            .find_map(|(part, name)| rest.strip_prefix(name).map(|kind| (part, kind)));
        return match third {
            Some((part, kind)) => Target::Third(format!("blocks.{index}.attn.qkv.{kind}"), part),
            None => Target::Unknown,
        };
    }
    let member = MEMBERS.iter().find_map(|(theirs, ours)| Some((ours, rest.strip_prefix(theirs)?)));
    member.map_or(Target::Unknown, |(ours, kind)| whole(format!("blocks.{index}.{ours}{kind}")))
}

/// What Hugging Face calls the rows of a joint projection: `blocks.3.attn.qkv.weight` and 1 to
/// `encoder.layer.3.attention.attention.key.weight`.
pub(super) fn name_of_third(ours: &str, part: usize) -> String {
    let name = ["query", "key", "value"][part];
    ours.replacen("blocks.", "encoder.layer.", 1).replacen(
        "attn.qkv",
        &format!("attention.attention.{name}"),
        1,
    )
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())
}
