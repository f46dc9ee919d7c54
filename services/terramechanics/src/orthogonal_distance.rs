//! The distance of a row from the model, when all that was measured has errors.
//!
//! The row's true entry angle and slip are unknowns beside the soil's parameters. The row is linearised at where they most likely
//! are, and they are eliminated: what is left is a quadratic cost in the parameters alone.

use crate::Row;
use crate::cost::{Cost, Vector};
use crate::model::Model;
use crate::stresses::{Contact, PARAMETERS, Parameters, Rim};
use nalgebra::{Matrix2, SMatrix, Vector2};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Latent values stay where the model has a meaning.
const ENTRY_RANGE_RAD: (f64, f64) = (0.02, 1.5);
const SLIP_RANGE: (f64, f64) = (-0.2, 0.99);

/// A row with its latent values.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct Tracked {
    pub(crate) row: Row,
    /// Entry angle and slip as they most likely were.
    pub(crate) entry_rad: f64,
    pub(crate) slip: f64,
    /// Load as the model has it there.
    pub(crate) load_n: f64,
    /// Squared distance from the model in units of the expected variance; two degrees of freedom.
    pub(crate) distance: f64,
    /// How much it counts, 0 to 1.
    pub(crate) weight: f64,
}

/// A row's residual (load, torque) as a linear function of the parameters, with its variance.
pub(crate) struct Linear {
    pub(crate) by: SMatrix<f64, 2, PARAMETERS>,
    pub(crate) residual: Vector2<f64>,
    pub(crate) variance: Matrix2<f64>,
    inverse: Matrix2<f64>,
}

impl Tracked {
    /// The latent values are as measured so far.
    pub(crate) fn new(row: &Row) -> Self {
        Self {
            row: *row,
            entry_rad: row.entry_rad,
            slip: row.slip,
            load_n: row.load_n,
            weight: 1.0,
            ..Self::default()
        }
    }

    /// Mean pressure p on the contact: W / (r b θ1).
    pub(crate) fn pressure_pa(&self, rim: &Rim) -> f64 {
        self.load_n / (rim.radius_m * rim.width_m * self.entry_rad)
    }

    /// Linearises the row at its latent values, and moves these to where they now most likely are.
    pub(crate) fn linearize(&mut self, parameters: &Parameters, model: &Model) -> Linear {
        let row = &self.row;
        let contact = Contact {
            entry_rad: self.entry_rad.clamp(ENTRY_RANGE_RAD.0, ENTRY_RANGE_RAD.1),
            exit_rad: row.exit_rad,
            slip: self.slip.clamp(SLIP_RANGE.0, SLIP_RANGE.1),
        };
        let forces = model.rim.forces(&contact, parameters);
        let [[a, b], [c, d]] = forces.by_contact;
        let by_contact = Matrix2::new(a, b, c, d);
        let off = Vector2::new(row.entry_rad - contact.entry_rad, row.slip - contact.slip);
        let residual = Vector2::new(row.load_n, row.torque_nm) - Vector2::from(forces.values) - by_contact * off;
        let contact_variance = Matrix2::from_diagonal(&Vector2::new(
            row.entry_sigma_rad.powi(2),
            model.slip_sigma.powi(2) * row.variance_share,
        ));
        // Of the predicted forces, not of the measured: a row that happens to read low must not count more.
        let forces_variance = Matrix2::from_diagonal(&Vector2::new(
            (model.load_sigma * forces.values[0]).powi(2) * row.variance_share,
            (model.torque_sigma * forces.values[1]).powi(2) * row.variance_share,
        ));
        let variance = forces_variance + by_contact * contact_variance * by_contact.transpose();
        let inverse = variance.try_inverse().unwrap_or_default();

        let step = off + contact_variance * by_contact.transpose() * (inverse * residual);
        self.load_n = forces.values[0] + a * step[0] + b * step[1];
        self.entry_rad = (contact.entry_rad + step[0]).clamp(ENTRY_RANGE_RAD.0, ENTRY_RANGE_RAD.1);
        self.slip = (contact.slip + step[1]).clamp(SLIP_RANGE.0, SLIP_RANGE.1);
        self.distance = residual.dot(&(inverse * residual));
        Linear {
            by: SMatrix::from_fn(|force, parameter| forces.by_parameters[force][parameter]),
            residual,
            variance,
            inverse,
        }
    }
}

impl Linear {
    /// The row's cost around the parameters at which it was linearised.
    pub(crate) fn cost(&self, weight: f64, parameters: &Parameters) -> Cost {
        let target = self.residual + self.by * Vector::from(*parameters);
        let weighted = self.by.transpose() * self.inverse * weight;
        Cost {
            matrix: (weighted * self.by).into(),
            vector: (weighted * target).into(),
            constant: weight * target.dot(&(self.inverse * target)),
            rows: weight,
        }
    }
}
