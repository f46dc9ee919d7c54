//! Sensors that fail on the way: the estimate stays near or says that it does not know.

use crate::oracle::SOILS;
use crate::oracle::traverse::{Excitation, GOOD, Measured, Plan, Random, Segment, WHEEL};
use messages::{Soil, Status};
use terramechanics::SoilEstimator;

const ROWS: usize = 300;
/// Where faults begin and end.
const FAULT: std::ops::Range<usize> = 120..180;

fn plan(seed: u64, excitation: Excitation) -> Plan {
    Plan {
        segments: vec![Segment {
            soil: SOILS[0],
            rows: ROWS,
        }],
        wheel: WHEEL,
        noise: GOOD,
        excitation,
        load_n: [35.0, 150.0],
        slip: [0.05, 0.6],
        shear_modulus_error: 1.1,
        rate_hz: 10.0,
        seed,
    }
}

fn drive(plan: &Plan, spoil: impl Fn(usize, &mut Measured)) -> Vec<Soil> {
    let mut estimator = SoilEstimator::new(plan.config());
    let mut rows = plan.rows();
    let step = |(number, row): (usize, &mut Measured)| {
        spoil(number, row);
        estimator.observe_wheel(&row.wheel);
        estimator.step(&row.sinkage)
    };
    rows.iter_mut().enumerate().map(step).collect()
}

fn friction_error_deg(soil: &Soil) -> f64 {
    (soil.friction_rad.to_degrees() - SOILS[0].friction_deg).abs()
}

/// Drives through a fault three times: no answer without numbers, every faulty row left out for `reason`, and φ good afterwards.
fn stays_near(reason: u32, spoil: impl Fn(usize, &mut Measured)) {
    for seed in 1..=3 {
        let soils = drive(&plan(seed, Excitation::Walk), &spoil);
        for (number, soil) in soils.iter().enumerate() {
            let has_numbers = soil.cohesion_pa.is_finite() && soil.friction_rad.is_finite();
            assert!(has_numbers || !soil.header.status.is_answer(), "row {number}: {soil:?}");
            // The first rows of a stuck angle are not yet known to be.
            if FAULT.contains(&number) && number > FAULT.start + 40 {
                assert_eq!(
                    Soil::reason_word(soil.reason),
                    Soil::reason_word(reason),
                    "row {number}"
                );
                assert_eq!(soil.header.status, Status::INPUT_REJECTED);
            }
        }
        let error_deg = friction_error_deg(soils.last().unwrap());
        assert!(error_deg < 4.0, "seed {seed}: φ is {error_deg}° off");
    }
}

#[test]
fn missing_numbers_are_left_out() {
    stays_near(Soil::LOAD, |number, row| {
        if FAULT.contains(&number) {
            row.wheel.torque_nm = f64::NAN;
        }
    });
    stays_near(Soil::NO_SINKAGE, |number, row| {
        if FAULT.contains(&number) {
            row.sinkage.entry_rad = [f64::NAN, f64::INFINITY, 1e300][number % 3];
        }
    });
}

#[test]
fn hard_ground_and_a_stopped_wheel_are_left_out() {
    stays_near(Soil::HARD_GROUND, |number, row| {
        if FAULT.contains(&number) {
            row.sinkage.entry_rad = 0.002;
        }
    });
    stays_near(Soil::STOPPED, |number, row| {
        if FAULT.contains(&number) {
            row.wheel.angular_velocity_rad_s = 0.0;
            row.wheel.linear_velocity_m_s = 0.0;
        }
    });
}

#[test]
fn a_slip_column_that_contradicts_the_velocities_is_left_out() {
    stays_near(Soil::SLIP, |number, row| {
        let computed = 1.0 - row.wheel.linear_velocity_m_s / (0.15 * row.wheel.angular_velocity_rad_s);
        row.wheel.slip = if FAULT.contains(&number) {
            computed + 0.12
        } else {
            computed
        };
    });
}

#[test]
fn an_angle_that_sticks_is_found_and_taken_out_again() {
    let stuck_rad = plan(1, Excitation::Walk).rows()[FAULT.start].sinkage.entry_rad;
    stays_near(Soil::STUCK_ANGLE, |number, row| {
        if FAULT.contains(&number) {
            row.sinkage.entry_rad = stuck_rad;
        }
    });
}

#[test]
fn spikes_do_not_move_the_estimate() {
    for seed in 1..=3 {
        let soils = drive(&plan(seed, Excitation::Random), |number, row| {
            let mut random = Random(number as u64);
            if random.uniform(0.0, 1.0) < 0.1 {
                let factor = [0.1, 0.3, 3.0, 10.0][number % 4];
                match number % 3 {
                    0 => row.wheel.load_n *= factor,
                    1 => row.wheel.torque_nm *= factor,
                    _ => row.sinkage.entry_rad *= factor,
                }
            }
        });
        let last = soils.last().unwrap();
        assert!(friction_error_deg(last) < 3.0, "{last:?}");
        assert_eq!(last.resets, 0);
        assert!(last.rows_rejected > 10);
    }
}

#[test]
fn a_torque_offset_is_found_and_allowed_for() {
    for seed in 1..=3 {
        let soils = drive(&plan(seed, Excitation::Random), |_, row| row.wheel.torque_nm += 0.6);
        let last = soils.last().unwrap();
        assert_eq!(last.header.status, Status::SENSOR_FAULT, "{last:?}");
        assert!(friction_error_deg(last) < 4.0, "{last:?}");
    }
}

#[test]
fn at_one_operating_point_the_strength_is_known_and_its_parts_are_not() {
    let soil = SOILS[0];
    for seed in 1..=5 {
        let plan = Plan {
            shear_modulus_error: 1.0,
            ..plan(seed, Excitation::Constant)
        };
        let soils = drive(&plan, |_, _| ());
        let last = soils.last().unwrap();
        assert_eq!(last.header.status, Status::NOT_OBSERVABLE, "{last:?}");
        let strength_pa = soil.cohesion_pa + last.pressure_pa * soil.friction_deg.to_radians().tan();
        assert!((last.strength_pa / strength_pa - 1.0).abs() < 0.03, "{last:?}");
        assert!((last.strength_pa - strength_pa).abs() < 1.96 * last.strength_sigma_pa);
    }
}

#[test]
fn a_change_of_soil_is_found_within_sixty_rows() {
    for (before, after) in [(0, 8), (8, 0), (4, 6), (1, 4), (5, 0)] {
        let segment = |index: usize| Segment {
            soil: SOILS[index],
            rows: ROWS / 2,
        };
        let plan = Plan {
            segments: vec![segment(before), segment(after)],
            ..plan(7, Excitation::Random)
        };
        let soils = drive(&plan, |_, _| ());
        let found: Vec<usize> = (1..ROWS)
            .filter(|row| soils[*row].resets > soils[*row - 1].resets)
            .collect();
        assert!(
            matches!(found[..], [row] if (ROWS / 2..ROWS / 2 + 60).contains(&row)),
            "{} to {}: at {found:?}",
            SOILS[before].name,
            SOILS[after].name
        );
    }
}

#[test]
fn no_input_makes_it_panic_or_answer_without_numbers() {
    let odd = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        0.0,
        -0.0,
        -1.0,
        1e-300,
        1e300,
        f64::MAX,
        1e-9,
        0.5,
    ];
    for seed in 0..40 {
        let mut random = Random(seed);
        let mut pick = |share: f64, value: &mut f64| {
            if random.uniform(0.0, 1.0) < share {
                *value = odd[random.uniform(0.0, odd.len() as f64) as usize];
            }
        };
        let plan = plan(seed, Excitation::Random);
        let mut estimator = SoilEstimator::new(plan.config());
        let share = [0.02, 0.2, 0.9][seed as usize % 3];
        for row in &mut plan.rows() {
            pick(share, &mut row.wheel.load_n);
            pick(share, &mut row.wheel.torque_nm);
            pick(share, &mut row.wheel.angular_velocity_rad_s);
            pick(share, &mut row.wheel.linear_velocity_m_s);
            pick(share, &mut row.wheel.slip);
            pick(share, &mut row.sinkage.entry_rad);
            pick(share, &mut row.sinkage.entry_sigma_rad);
            pick(share, &mut row.sinkage.exit_rad);
            estimator.observe_wheel(&row.wheel);
            let soil = estimator.step(&row.sinkage);
            let numbers = [
                soil.cohesion_pa,
                soil.cohesion_sigma_pa,
                soil.friction_rad,
                soil.strength_pa,
                soil.strength_sigma_pa,
            ];
            let has_numbers = numbers.iter().all(|number| number.is_finite());
            assert!(has_numbers || !soil.header.status.is_answer(), "seed {seed}: {soil:?}");
        }
    }
}
