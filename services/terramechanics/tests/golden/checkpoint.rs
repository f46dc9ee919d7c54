//! The state survives its process bit for bit, and nothing else passes for one.

use crate::oracle::SOILS;
use crate::oracle::traverse::{Excitation, GOOD, Plan, Segment, WHEEL};
use allocation_counter::measure;
use messages::Resumable;
use terramechanics::{Checkpoint, Config, Estimator, SoilEstimator};
use zerocopy::{FromBytes, IntoBytes};

/// Two soils, so that a change is found on the way.
fn plan() -> Plan {
    let segment = |soil| Segment { soil, rows: 150 };
    Plan {
        segments: vec![segment(SOILS[0]), segment(SOILS[8])],
        wheel: WHEEL,
        noise: GOOD,
        excitation: Excitation::Walk,
        load_n: [35.0, 150.0],
        slip: [0.05, 0.6],
        shear_modulus_error: 0.9,
        rate_hz: 10.0,
        seed: 5,
    }
}

#[test]
fn a_restored_estimator_goes_on_bit_for_bit() {
    let rows = plan().rows();
    for estimator in [Estimator::Full, Estimator::Linear] {
        let config = Config {
            estimator,
            ..plan().config()
        };
        let mut first = SoilEstimator::new(config.clone());
        let mut second = SoilEstimator::new(config.clone());
        for (number, row) in rows.iter().enumerate() {
            if number % 7 == 3 {
                let bytes = first.checkpoint().as_bytes().to_vec();
                second = SoilEstimator::new(config.clone());
                second.restore(&Checkpoint::read_from_bytes(&bytes).unwrap()).unwrap();
            }
            for estimator in [&mut first, &mut second] {
                estimator.observe_wheel(&row.wheel);
            }
            let (one, other) = (first.step(&row.sinkage), second.step(&row.sinkage));
            assert!(number < 3 || one.as_bytes() == other.as_bytes(), "row {number}");
        }
    }
}

#[test]
fn what_is_no_checkpoint_is_refused_and_changes_nothing() {
    let rows = plan().rows();
    let mut estimator = SoilEstimator::new(plan().config());
    for row in &rows {
        estimator.observe_wheel(&row.wheel);
        estimator.step(&row.sinkage);
    }
    let good = estimator.checkpoint();
    let before = good.as_bytes().to_vec();
    for (position, why) in [
        (0, "version"),
        (8, "configuration"),
        (1000, "damaged"),
        (before.len() - 1, "damaged"),
    ] {
        let mut bytes = before.clone();
        bytes[position] ^= 0x40;
        let refusal = estimator
            .restore(&Checkpoint::read_from_bytes(&bytes).unwrap())
            .unwrap_err();
        assert!(refusal.contains(why), "{refusal} at byte {position}");
    }
    for fill in [0x00, 0xff, 0x7f] {
        let bytes = vec![fill; before.len()];
        estimator
            .restore(&Checkpoint::read_from_bytes(&bytes).unwrap())
            .unwrap_err();
    }
    let other = Config {
        radius_m: 0.2,
        ..plan().config()
    };
    SoilEstimator::new(other).restore(&good).unwrap_err();
    assert_eq!(estimator.checkpoint().as_bytes(), before);
}

#[test]
fn a_step_allocates_nothing() {
    let rows = plan().rows();
    for estimator in [Estimator::Full, Estimator::Linear] {
        let mut estimator = SoilEstimator::new(Config {
            estimator,
            ..plan().config()
        });
        let mut state = vec![0; estimator.state_bytes()];
        let allocations = measure(|| {
            for row in &rows {
                estimator.observe_wheel(&row.wheel);
                estimator.step(&row.sinkage);
                estimator.save(&mut state);
            }
        });
        assert_eq!(allocations.count_total, 0);
    }
}
