//! What each feature of a line counts for. The numbers are data: `weights.txt` beside this file, with their origin.

/// What speaks for or against a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feature {
    /// t-like score of the step across the line, three rows against three.
    Contrast,
    /// That step as a share of the side's largest.
    Share,
    /// The same, six rows against six.
    MiddleContrast,
    /// Its share.
    MiddleShare,
    /// The same, twelve rows against twelve.
    WideContrast,
    /// Its share.
    WideShare,
    /// Square of the tilt.
    Tilt,
    /// Sinkage that is less than a wheel has on any soil.
    Shallow,
    /// Sinkage that is more than a wheel gets out of.
    Deep,
    /// Log ratio of the texture just above the line and that of the free rim.
    RimTexture,
    /// The same just below the line.
    SoilTexture,
    /// Log ratio of the variances just below and just above.
    Spread,
    /// Log likelihood of two textures over that of one.
    TextureLikelihood,
    /// Log ratio of the textures of all below and all above.
    TextureRatio,
    /// Otsu's between-class variance of all above and all below.
    Between,
    /// Log likelihood of two normal classes of unequal variance over that of one.
    Likelihood,
    /// Log ratio of the variances of all below and all above.
    Roughness,
    /// The best contrast of the middle window further up.
    Above,
    /// The best contrast of the middle window further down.
    Below,
    /// Log of the step across the wheel's outer edge just above where the line meets it.
    EdgeAbove,
    /// The same just below.
    EdgeBelow,
    /// The same over all above.
    EdgeFree,
    /// The same over all below.
    EdgeBuried,
    /// Log of the step across the rim's inner edge just above where the line meets it.
    LipAbove,
    /// The same just below.
    LipBelow,
    /// The same over all below.
    LipBuried,
}

/// Number of [`Feature`]s.
pub const FEATURES: usize = Feature::LipBuried as usize + 1;
/// Units of the hidden layer.
pub const UNITS: usize = 12;

/// Names of the features in the file, in order.
pub const NAMES: [&str; FEATURES] = [
    "contrast",
    "share",
    "middle_contrast",
    "middle_share",
    "wide_contrast",
    "wide_share",
    "tilt",
    "shallow",
    "deep",
    "rim_texture",
    "soil_texture",
    "spread",
    "texture_likelihood",
    "texture_ratio",
    "between",
    "likelihood",
    "roughness",
    "above",
    "below",
    "edge_above",
    "edge_below",
    "edge_free",
    "edge_buried",
    "lip_above",
    "lip_below",
    "lip_buried",
];

/// One unit: `out * max(0, bias + weights · features)` is added to a line's score.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// What the unit counts for.
    pub out: f32,
    /// What it begins at.
    pub bias: f32,
    /// One for each feature.
    pub weights: [f32; FEATURES],
}

/// What the fit found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Of each feature.
    pub features: [f32; FEATURES],
    /// What is not proportional to any feature.
    pub units: [Unit; UNITS],
    /// How much lower than the soil line the largest contrast lies, in outer radii.
    pub bias: f32,
    /// Standard deviation of a right answer, in outer radii.
    pub sigma: f32,
    /// The power to which a probability is raised, so that it is true: lines are not independent.
    pub temper: f32,
}

impl Weights {
    /// The fitted weights.
    #[must_use]
    pub fn fitted() -> Self {
        Self::parse(include_str!("weights.txt"))
    }

    /// Reads lines of `name number…`; what is not named counts nothing.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        let number = |name: &str, k: usize| {
            let mut lines = text.lines().map(str::split_whitespace);
            let mut line = lines.find(|line| line.clone().next() == Some(name))?;
            line.nth(k + 1)?.parse().ok()
        };
        let number = |name: &str, k: usize| number(name, k).unwrap_or(0.0);
        Self {
            features: NAMES.map(|name| number(name, 0)),
            units: std::array::from_fn(|unit| Unit {
                out: number("units_out", unit),
                bias: number("units_bias", unit),
                weights: NAMES.map(|name| number(name, 1 + unit)),
            }),
            bias: number("bias", 0),
            sigma: number("sigma", 0),
            temper: number("temper", 0),
        }
    }
}
