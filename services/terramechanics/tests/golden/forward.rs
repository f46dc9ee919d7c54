//! The oracle against the golden forward model.

use crate::oracle::{SOILS, WheelModel, entry_for, forces};

fn forward_rows() -> Vec<(String, Vec<f64>)> {
    include_str!("../../golden/terramechanics_forward.csv")
        .lines()
        .skip(1)
        .map(|line| {
            let (name, numbers) = line.split_once(',').unwrap();
            (
                name.to_owned(),
                numbers.split(',').map(|cell| cell.parse().unwrap()).collect(),
            )
        })
        .collect()
}

#[test]
fn the_oracle_reproduces_the_golden_forward_model() {
    let rows = forward_rows();
    assert_eq!(rows.len(), 60);
    for (name, g) in &rows {
        let soil = SOILS.iter().find(|soil| soil.name == name).unwrap();
        let wheel = WheelModel {
            radius_m: g[0],
            width_m: g[1],
        };
        let entry_rad = entry_for(soil, &wheel, g[10], g[11], 0.0).unwrap();
        assert!(
            (entry_rad / g[12] - 1.0).abs() < 1e-9,
            "{name}: {entry_rad} is not {}",
            g[12]
        );
        let forces = forces(soil, &wheel, g[12], 0.0, g[11]);
        for (got, wanted) in [
            (forces.load_n, g[10]),
            (forces.torque_nm, g[13]),
            (forces.drawbar_n, g[14]),
        ] {
            assert!(
                (got - wanted).abs() < 1e-9 * wanted.abs(),
                "{name}: {got} is not {wanted}"
            );
        }
    }
}
