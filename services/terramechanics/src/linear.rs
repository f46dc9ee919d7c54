//! The paper's linear stresses: one row of measurements as one equation in c and tan φ, Eqs. (11)–(14).

use crate::Row;

/// One row as y = c + x tan φ + s c tan φ.
///
/// This is Eq. (14) with two repairs. As printed it has the wrong sign before κ1 and returns −φ. And the paper's "additional
/// simplification" drops the term in c tan φ, which moves c by about 0.5 % and φ by 0.26°; with s = 0 it is dropped here too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearForm {
    /// κ2/κ3 of Eq. (14).
    pub y_pa: f64,
    /// −κ1/κ3 of Eq. (14).
    pub x_pa: f64,
    /// What the paper drops.
    pub s: f64,
}

impl LinearForm {
    /// The row's equation for θm = θ1/2 and θ2 = 0, with the radius, the width and the shear modulus k of the wheel and the soil.
    #[must_use]
    pub fn new(row: &Row, radius_m: f64, width_m: f64, shear_modulus_m: f64) -> Self {
        let (load, torque, entry) = (row.load_n, row.torque_nm, row.entry_rad);
        let half = entry / 2.0;
        let a = shear_fraction(row, radius_m, shear_modulus_m);
        // sin²(θ1/4) for (1 − cos(θ1/2))/2: no cancellation at small angles.
        let q = (entry / 4.0).sin().powi(2);
        let area = radius_m * radius_m * width_m;
        // Eqs. (12)–(13), divided by −κ3.
        let y_pa = 4.0 * torque / (area * entry * (1.0 + 2.0 * a));
        let x_pa = a * (entry * entry * load * radius_m - 16.0 * torque * half.sin() * q)
            / (4.0 * entry * area * (1.0 + 2.0 * a) * half.cos() * q);
        // Eq. (11): the term in c that the paper drops.
        let s = -a * (entry + entry.sin() - 4.0 * half.sin()) / (4.0 * (1.0 + 2.0 * a) * half.cos() * q);
        Self { y_pa, x_pa, s }
    }
}

/// A: what the shear stress has built up to at θm = θ1/2, as a fraction of the strength; Eq. (5).
#[must_use]
fn shear_fraction(row: &Row, radius_m: f64, shear_modulus_m: f64) -> f64 {
    let half = row.entry_rad / 2.0;
    let sheared_m = radius_m * (half - (1.0 - row.slip) * (row.entry_rad.sin() - half.sin())); // Eq. (6)
    -(-sheared_m / shear_modulus_m).exp_m1() // Eq. (5)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rows of `terramechanics_kappa.csv`, as columns named in its first line.
    fn golden() -> Vec<Vec<f64>> {
        include_str!("../golden/terramechanics_kappa.csv")
            .lines()
            .skip(1)
            .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
            .collect()
    }

    fn row_of(golden: &[f64]) -> Row {
        Row {
            load_n: golden[3],
            torque_nm: golden[4],
            entry_rad: golden[5],
            slip: golden[6],
            ..Row::default()
        }
    }

    fn assert_close(got: f64, wanted: f64) {
        assert!((got - wanted).abs() <= 1e-9 * wanted.abs(), "{got} is not {wanted}");
    }

    /// κ1, κ2, κ3 as the paper prints them, Eqs. (12)–(13).
    fn printed_kappas(row: &Row, r: f64, b: f64, a: f64) -> [f64; 3] {
        let (w, t, e) = (row.load_n, row.torque_nm, row.entry_rad);
        let m = e / 2.0;
        [
            a * (e * e * w * r + 4.0 * t * e.sin() - 8.0 * t * m.sin()),
            4.0 * t * (e.cos() - 2.0 * m.cos() + 1.0),
            e * r * r * b * (e.cos() - 2.0 * m.cos() + 2.0 * a * e.cos() - 4.0 * a * m.cos() + 2.0 * a + 1.0),
        ]
    }

    #[test]
    fn the_form_agrees_with_the_golden_rows() {
        let rows = golden();
        assert_eq!(rows.len(), 24);
        for g in &rows {
            let row = row_of(g);
            let form = LinearForm::new(&row, g[0], g[1], g[2]);
            assert_close(shear_fraction(&row, g[0], g[2]), g[7]);
            assert_close(form.y_pa, g[11] * 1e3);
            assert_close(form.x_pa, g[12] * 1e3);
            assert_close(form.s, g[13]);
        }
    }

    #[test]
    fn the_form_is_the_quotient_of_the_printed_kappas() {
        for g in &golden() {
            let row = row_of(g);
            let [k1, k2, k3] = [g[8], g[9], g[10]];
            let printed = printed_kappas(&row, g[0], g[1], g[7]);
            let form = LinearForm::new(&row, g[0], g[1], g[2]);
            for (kappa, wanted) in printed.iter().zip([k1, k2, k3]) {
                // The printed forms cancel at small angles; so does this comparison.
                assert!((kappa - wanted).abs() <= 1e-8 * wanted.abs(), "{kappa} is not {wanted}");
            }
            assert_close(form.y_pa, k2 / k3);
            assert_close(form.x_pa, -k1 / k3);
        }
    }
}
