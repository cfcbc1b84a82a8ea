//! The focus measures: their names, their papers and what they need.

use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// A focus measure: a number that is largest where the picture is sharpest.
///
/// Sums are taken over the pixels whose whole neighbourhood lies inside the region (no border is invented) and divided by
/// their count, so a value does not depend on the region's size. I(x, y) is the grey value, μ its mean, ⟨·⟩ the mean over pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// ⟨(I − μ)²⟩.
    Variance,
    /// ⟨(I − μ)²⟩ / μ: steady when the lamp is not. 0 for a black picture.
    NormalisedVariance,
    /// ⟨Gx² + Gy²⟩ of the 3x3 Sobel operator.
    #[default]
    Tenengrad,
    /// ⟨(I(x+2, y) − I(x, y))²⟩.
    Brenner,
    /// ⟨|2I − I(x−1, y) − I(x+1, y)| + |2I − I(x, y−1) − I(x, y+1)|⟩.
    SumModifiedLaplacian,
    /// Variance of the Laplacian [0 1 0; 1 −4 1; 0 1 0].
    VarianceOfLaplacian,
    /// ⟨L²⟩ of the Laplacian [1 4 1; 4 −20 4; 1 4 1].
    EnergyOfLaplacian,
    /// ⟨I(x, y) · I(x+1, y)⟩ − ⟨I(x, y) · I(x+2, y)⟩, both over the x that have all three.
    VollathF4,
    /// ⟨I(x, y) · I(x+1, y)⟩ − ⟨I(x, y)⟩ · ⟨I(x+1, y)⟩ over the x that have both: adding a constant to the picture changes nothing.
    VollathF5,
    /// −Σ p log₂ p of the histogram, one bin a grey level: bits.
    Entropy,
    /// Largest minus smallest grey value.
    Range,
    /// ⟨max(I − ⌊μ⌋, 0)⟩: what lies above the threshold, the mean.
    ThresholdContent,
    /// Energy of the three high bands over that of the low band, one level of Haar wavelets on 2x2 blocks. 0 for a black picture.
    WaveletRatio,
}

impl Measure {
    /// All of them.
    pub const ALL: [Self; 13] = [
        Self::Variance,
        Self::NormalisedVariance,
        Self::Tenengrad,
        Self::Brenner,
        Self::SumModifiedLaplacian,
        Self::VarianceOfLaplacian,
        Self::EnergyOfLaplacian,
        Self::VollathF4,
        Self::VollathF5,
        Self::Entropy,
        Self::Range,
        Self::ThresholdContent,
        Self::WaveletRatio,
    ];

    /// The name by which it is chosen, as in `--measure tenengrad`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Variance => "variance",
            Self::NormalisedVariance => "normalised-variance",
            Self::Tenengrad => "tenengrad",
            Self::Brenner => "brenner",
            Self::SumModifiedLaplacian => "sum-modified-laplacian",
            Self::VarianceOfLaplacian => "variance-of-laplacian",
            Self::EnergyOfLaplacian => "energy-of-laplacian",
            Self::VollathF4 => "vollath-f4",
            Self::VollathF5 => "vollath-f5",
            Self::Entropy => "entropy",
            Self::Range => "range",
            Self::ThresholdContent => "threshold-content",
            Self::WaveletRatio => "wavelet-ratio",
        }
    }

    /// Where it was published.
    pub fn paper(self) -> &'static str {
        match self {
            Self::Variance | Self::NormalisedVariance => {
                "F. C. A. Groen, I. T. Young, G. Ligthart: A comparison of different focus functions for use in \
                 autofocus algorithms. Cytometry 6 (1985) 81-91"
            }
            Self::Tenengrad => {
                "J. M. Tenenbaum: Accommodation in computer vision. PhD thesis, Stanford University (1970); \
                 E. Krotkov: Focusing. International Journal of Computer Vision 1 (1987) 223-237"
            }
            Self::Brenner => {
                "J. F. Brenner et al.: An automated microscope for cytologic research: a preliminary evaluation. \
                 Journal of Histochemistry and Cytochemistry 24 (1976) 100-111"
            }
            Self::SumModifiedLaplacian => {
                "S. K. Nayar, Y. Nakagawa: Shape from focus. IEEE Transactions on Pattern Analysis and Machine \
                 Intelligence 16 (1994) 824-831"
            }
            Self::VarianceOfLaplacian => {
                "J. L. Pech-Pacheco et al.: Diatom autofocusing in brightfield microscopy: a comparative study. \
                 International Conference on Pattern Recognition (2000) vol. 3, 314-317"
            }
            Self::EnergyOfLaplacian => {
                "M. Subbarao, T.-S. Choi, A. Nikzad: Focusing techniques. Optical Engineering 32 (1993) 2824-2836"
            }
            Self::VollathF4 => {
                "D. Vollath: Automatic focusing by correlative methods. Journal of Microscopy 147 (1987) 279-288"
            }
            Self::VollathF5 => {
                "D. Vollath: The influence of the scene parameters and of noise on the behaviour of automatic focusing \
                 algorithms. Journal of Microscopy 151 (1988) 133-146"
            }
            Self::Entropy | Self::Range => {
                "L. Firestone et al.: Comparison of autofocus methods for automated microscopy. Cytometry 12 (1991) \
                 195-206"
            }
            Self::ThresholdContent => {
                "M. L. Mendelsohn, B. H. Mayall: Computer-oriented analysis of human chromosomes III: focus. \
                 Computers in Biology and Medicine 2 (1972) 137-150"
            }
            Self::WaveletRatio => {
                "H. Xie, W. Rong, L. Sun: Wavelet-based focus measure and 3-D surface reconstruction method for \
                 microscopy images. IEEE/RSJ International Conference on Intelligent Robots and Systems (2006) 229-234"
            }
        }
    }

    /// Columns and rows that a region must have at least.
    pub fn least(self) -> (usize, usize) {
        match self {
            Self::Variance | Self::NormalisedVariance | Self::Entropy | Self::Range | Self::ThresholdContent => (1, 1),
            Self::VollathF5 => (2, 1),
            Self::WaveletRatio => (2, 2),
            Self::Brenner | Self::VollathF4 => (3, 1),
            Self::Tenengrad | Self::SumModifiedLaplacian | Self::VarianceOfLaplacian | Self::EnergyOfLaplacian => {
                (3, 3)
            }
        }
    }
}

impl fmt::Display for Measure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A name that is no measure's.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("'{0}' is no focus measure: choose one of {names}", names = Measure::ALL.map(Measure::name).join(", "))]
pub struct UnknownMeasure(String);

impl FromStr for Measure {
    type Err = UnknownMeasure;

    /// Takes the name in any case, with `_` for `-` and American spelling.
    fn from_str(s: &str) -> Result<Self, UnknownMeasure> {
        let name = s.to_ascii_lowercase().replace('_', "-").replace("normalized", "normalised");
        Self::ALL.into_iter().find(|m| m.name() == name).ok_or_else(|| UnknownMeasure(s.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_measure_is_found_by_its_name_here_and_in_json() {
        for (i, measure) in Measure::ALL.into_iter().enumerate() {
            assert_eq!(measure.to_string().parse(), Ok(measure));
            assert_eq!(serde_json::to_value(measure).unwrap(), measure.name());
            assert_eq!(Measure::ALL.iter().position(|m| *m == measure), Some(i), "no measure twice");
        }
        assert_eq!("Normalized_Variance".parse(), Ok(Measure::NormalisedVariance));
        let message = "sharpness".parse::<Measure>().unwrap_err().to_string();
        assert!(message.contains("'sharpness'") && message.contains("vollath-f5"), "{message}");
        assert_eq!(Measure::default(), Measure::Tenengrad);
    }
}
