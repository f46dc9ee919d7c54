//! The wheel, its sensors, and what is assumed of the soil.

use serde::Deserialize;

/// Everything that the estimator is told; what is left out has the default of the simulated rover.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Which estimator runs.
    pub estimator: Estimator,
    /// Radius r of the wheel's rim.
    pub radius_m: f64,
    /// Width b of the wheel.
    pub width_m: f64,
    /// Height of the grousers; 0 for a smooth wheel. They count as part of the radius.
    pub grouser_height_m: f64,
    /// Shear deformation modulus k of the soil, as assumed.
    pub shear_modulus_m: f64,
    /// Standard deviation of the load, relative.
    pub load_sigma: f64,
    /// Standard deviation of the torque, relative.
    pub torque_sigma: f64,
    /// Standard deviation of the entry angle, where the sinkage sample does not say its own.
    pub entry_sigma_rad: f64,
    /// Standard deviation of the slip.
    pub slip_sigma: f64,
    /// Where the contact ends behind the wheel.
    pub exit_angle: ExitAngle,
    /// A wheel reading older than this when the sinkage is taken does not describe the same instant.
    pub wheel_age_max_s: f64,
    /// Wheel readings since the last sinkage are averaged over at most this span.
    pub averaging_s: f64,
}

/// The estimators.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Estimator {
    /// The paper's, on its linear stresses, Eq. (14).
    Linear,
    /// On the full stresses, with every measurement's error.
    #[default]
    Full,
}

/// Where the contact is taken to end behind the wheel, θ2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ExitAngle {
    /// Below the axle, as in the paper. A camera sees how high the soil lies behind the wheel, not where it stops to press.
    #[default]
    Zero,
    /// As the sinkage sample says.
    Measured,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            estimator: Estimator::Full,
            radius_m: 0.15,
            width_m: 0.16,
            grouser_height_m: 0.0,
            shear_modulus_m: 0.025,
            load_sigma: 0.03,
            torque_sigma: 0.03,
            entry_sigma_rad: 0.01745,
            slip_sigma: 0.02,
            exit_angle: ExitAngle::Zero,
            wheel_age_max_s: 0.25,
            averaging_s: 0.05,
        }
    }
}

impl Config {
    /// Whether the method makes sense with these values.
    ///
    /// # Errors
    /// The key, and what is wrong with its value and what would be right.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let ranges = [
            ("radius_m", self.radius_m, 0.01, 5.0),
            ("width_m", self.width_m, 0.005, 5.0),
            ("grouser_height_m", self.grouser_height_m, 0.0, 0.5),
            ("shear_modulus_m", self.shear_modulus_m, 1e-4, 0.5),
            ("load_sigma", self.load_sigma, 1e-4, 0.5),
            ("torque_sigma", self.torque_sigma, 1e-4, 0.5),
            ("entry_sigma_rad", self.entry_sigma_rad, 1e-5, 0.5),
            ("slip_sigma", self.slip_sigma, 1e-5, 0.5),
            ("wheel_age_max_s", self.wheel_age_max_s, 0.0, 60.0),
            ("averaging_s", self.averaging_s, 0.0, 10.0),
        ];
        for (key, value, low, high) in ranges {
            // Also refuses NaN, which no comparison holds for.
            if !(value >= low && value <= high) {
                return Err((key, format!("must be {low} to {high}, is {value}")));
            }
        }
        Ok(())
    }

    /// Radius out to the tips of the grousers.
    pub(crate) fn effective_radius_m(&self) -> f64 {
        self.radius_m + self.grouser_height_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_a_bad_value_is_named() {
        assert_eq!(Config::default().validate(), Ok(()));
        for bad in [-1.0, 0.0, f64::NAN, f64::INFINITY] {
            let config = Config {
                radius_m: bad,
                ..Config::default()
            };
            assert_eq!(config.validate().unwrap_err().0, "radius_m");
        }
        let config = Config {
            slip_sigma: -0.1,
            ..Config::default()
        };
        let (key, why) = config.validate().unwrap_err();
        assert_eq!((key, why.as_str()), ("slip_sigma", "must be 0.00001 to 0.5, is -0.1"));
    }
}
