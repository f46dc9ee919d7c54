//! Wheels on real soil: operating points digitised from the literature, `golden/single_wheel.csv`.

use messages::{Header, Sinkage, Soil, Status, Wheel};
use terramechanics::{Config, SoilEstimator};

/// The last answer after the operating points of a set, driven over `times` times.
fn over(set: &str, times: usize) -> Soil {
    let mut config = Config::default();
    let mut points = Vec::new();
    for line in include_str!("../../golden/single_wheel.csv").lines().skip(1) {
        let Some((_, numbers)) = line.split_once(',').filter(|(name, _)| name.starts_with(set)) else {
            continue;
        };
        let g: Vec<f64> = numbers.split(',').map(|cell| cell.parse().unwrap()).collect();
        (config.radius_m, config.width_m, config.grouser_height_m) = (g[0], g[1], g[2]);
        config.shear_modulus_m = g[3];
        let (load_n, slip, sinkage_m, torque_nm) = (g[4], g[5], g[7], g[8]);
        points.push((load_n, slip, (1.0 - sinkage_m / g[0]).acos(), torque_nm));
    }
    assert!(points.len() >= 5);
    let mut estimator = SoilEstimator::new(config);
    let mut last = None;
    for number in 0..times * points.len() {
        let (load_n, slip, entry_rad, torque_nm) = points[number % points.len()];
        let header = Header {
            taken_ns: number as u64 * 100_000_000,
            ..Header::default()
        };
        estimator.observe_wheel(&Wheel {
            header,
            load_n,
            torque_nm,
            angular_velocity_rad_s: f64::NAN,
            linear_velocity_m_s: f64::NAN,
            slip,
        });
        last = Some(estimator.step(&Sinkage {
            entry_rad,
            sinkage_m: 0.0,
            ..Sinkage::unknown(header)
        }));
    }
    last.unwrap()
}

#[test]
fn on_dings_soil_the_lugged_wheel_tells_the_friction_angle_and_not_the_cohesion() {
    for times in [1, 4, 20] {
        let soil = over("ding2011_lug10", times);
        let friction_deg = soil.friction_rad.to_degrees();
        assert!((friction_deg - 31.9).abs() < 4.0, "φ {friction_deg}°");
        assert_eq!(soil.header.status, Status::NOT_OBSERVABLE, "{soil:?}");
    }
}

#[test]
fn wheels_that_do_not_follow_the_model_are_called_so() {
    for set in ["ding2011_smooth", "kls1_smooth", "kls1_lug10"] {
        for times in [1, 4, 20] {
            let soil = over(set, times);
            assert_eq!(soil.header.status, Status::LACK_OF_FIT, "{set} {times} times: {soil:?}");
        }
    }
}
