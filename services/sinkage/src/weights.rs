//! What each feature of a line counts for. The numbers are data: `weights.txt` beside this file, with their origin.

use crate::contrast::FEATURES;

/// Weights of the features, and what the fit left over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// In the order of [`Weights::NAMES`].
    pub features: [f32; FEATURES],
    /// How much lower than the soil line the largest contrast lies, in outer radii.
    pub bias: f32,
    /// Standard deviation of a right answer, in outer radii.
    pub sigma: f32,
}

impl Weights {
    /// The features' names in the file.
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
        "texture",
        "column_texture",
        "between",
        "likelihood",
        "roughness",
        "above",
    ];
    /// Share of the narrow window's largest step.
    pub const SHARE: usize = 1;
    /// t-like score of the middle window.
    pub const MIDDLE_CONTRAST: usize = 2;
    /// Share of the middle window's largest step.
    pub const MIDDLE_SHARE: usize = 3;
    /// Share of the wide window's largest step.
    pub const WIDE_SHARE: usize = 5;
    /// Square of the tilt.
    pub const TILT: usize = 6;
    /// Sinkage that is less than a wheel has on any soil.
    pub const SHALLOW: usize = 7;
    /// Sinkage that is more than a wheel gets out of.
    pub const DEEP: usize = 8;
    /// Log ratio of the local variances below and above.
    pub const TEXTURE: usize = 9;
    /// The same as a mean over the columns.
    pub const COLUMN_TEXTURE: usize = 10;
    /// Otsu's between-class variance of all above and all below.
    pub const BETWEEN: usize = 11;
    /// Log likelihood of two normal classes of unequal variance over that of one.
    pub const LIKELIHOOD: usize = 12;
    /// Log ratio of the variances of all below and all above.
    pub const ROUGHNESS: usize = 13;
    /// The best contrast of the middle window further up.
    pub const ABOVE: usize = 14;

    /// The fitted weights.
    #[must_use]
    pub fn fitted() -> Self {
        Self::parse(include_str!("weights.txt"))
    }

    /// Reads lines of `name number`; what is not named counts nothing.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        let number = |name: &str| {
            let mut lines = text.lines().filter_map(|line| line.split_once(' '));
            let value = lines.find_map(|(key, value)| (key == name).then(|| value.trim().parse().ok()));
            value.flatten().unwrap_or(0.0)
        };
        Self {
            features: Self::NAMES.map(number),
            bias: number("bias"),
            sigma: number("sigma"),
        }
    }
}
