//! The forward model against values that were computed independently of it.

use messages::{Frame, Message};
use simulation::{Config, Rover, SOILS, Soil, WheelModel};
use zerocopy::{FromZeros, IntoBytes};

fn relative(value: f64, truth: f64) -> f64 {
    ((value - truth) / truth).abs()
}

#[test]
fn the_forward_model_agrees_with_adaptive_quadrature() {
    let text = include_str!("../golden/terramechanics_forward.csv");
    let mut rows = 0;
    for line in text.lines().skip(1) {
        let cells: Vec<f64> = line.split(',').skip(1).map(|cell| cell.parse().unwrap()).collect();
        let soil = Soil {
            cohesion_pa: cells[2],
            friction_rad: cells[3].to_radians(),
            cohesive_modulus: cells[4],
            frictional_modulus: cells[5],
            sinkage_exponent: cells[6],
            shear_modulus_m: cells[7],
            peak: [cells[8], cells[9]],
            ..SOILS[0]
        };
        let contact = WheelModel::new(cells[0], cells[1]).contact(&soil, cells[10], cells[11]);
        let errors = [
            (contact.entry_rad, cells[12]),
            (contact.torque_nm, cells[13]),
            (contact.drawbar_pull_n, cells[14]),
        ];
        for (value, truth) in errors {
            assert!(relative(value, truth) < 1e-6, "{line}: {value} for {truth}");
        }
        rows += 1;
    }
    assert_eq!(rows, 60);
}

#[test]
fn the_soil_carries_the_load_on_the_whole_route() {
    let rover = Rover::new(Config::default());
    let wheel = WheelModel::new(rover.radius_m(), rover.width_m());
    let mut soils = std::collections::BTreeSet::new();
    for tick in 0..200 {
        let state = rover.state(f64::from(tick) * 0.1);
        let contact = wheel.at(&rover.soils()[state.soil], state.entry_rad, state.slip);
        assert!(relative(contact.load_n, state.load_n) < 1e-9);
        assert!((0.05..0.8).contains(&state.slip) && (20.0..200.0).contains(&state.load_n));
        soils.insert(state.soil);
    }
    assert_eq!(soils.len(), 3);
}

#[test]
fn the_same_seed_and_time_give_the_same_sample_in_any_order() {
    let (first, second) = (Rover::new(Config::default()), Rover::new(Config::default()));
    let times: Vec<f64> = (0..50).map(|tick| f64::from(tick) * 0.37).collect();
    let forward: Vec<_> = times
        .iter()
        .map(|time| (first.wheel(*time).load_n, first.vibration(*time)))
        .collect();
    let backward: Vec<_> = times
        .iter()
        .rev()
        .map(|time| (second.wheel(*time).load_n, second.vibration(*time)))
        .collect();
    assert_eq!(forward, backward.into_iter().rev().collect::<Vec<_>>());
    let other = Rover::new(Config {
        seed: 2,
        ..Config::default()
    });
    assert_ne!(first.wheel(1.0).load_n, other.wheel(1.0).load_n);
}

#[test]
fn soils_differ_in_the_level_of_their_vibration() {
    let rover = Rover::new(Config {
        noise: 0.0,
        ..Config::default()
    });
    let level = |from_s: f64| {
        let samples = (0..600).map(|tick| f64::from(rover.vibration(from_s + f64::from(tick) * 0.01)[2]) - 9.81);
        (samples.map(|sample| sample * sample).sum::<f64>() / 600.0).sqrt()
    };
    let levels = [level(0.3), level(7.0), level(13.7)];
    assert!(levels[1] < 0.8 * levels[0] && levels[0] < 0.8 * levels[2], "{levels:?}");
}

#[test]
fn the_same_seed_and_time_give_the_same_picture_in_any_order_and_over_any_older_one() {
    let (first, second) = (Rover::new(Config::default()), Rover::new(Config::default()));
    let mut frame = Frame::new_box_zeroed().unwrap();
    let times = [0.0, 0.1, 7.3, 0.1, 19.9];
    let mut forward = Vec::new();
    for time in times {
        first.render(time, &mut frame);
        forward.push((frame.image().to_vec(), frame.homography.map(f64::to_bits)));
    }
    frame.as_mut_bytes().fill(0xa5);
    for (time, expected) in times.iter().zip(&forward).rev() {
        second.render(*time, &mut frame);
        assert!(frame.image() == expected.0 && frame.homography.map(f64::to_bits) == expected.1);
    }
    assert!(forward[1].0 != forward[2].0 && forward[1] == forward[3]);
}

#[test]
fn no_time_and_no_seed_panics_or_makes_an_impossible_sample() {
    let mut frame = Frame::new_box_zeroed().unwrap();
    for seed in [0, 1, u64::MAX] {
        let rover = Rover::new(Config {
            seed,
            ..Config::default()
        });
        for time_s in [f64::NAN, f64::NEG_INFINITY, -5.0, 0.0, 1e9, 1e300, f64::INFINITY] {
            rover.render(time_s, &mut frame);
            assert_eq!(frame.check(), Ok(()));
            assert_eq!(rover.wheel(time_s).check(), Ok(()));
            assert!(rover.vibration(time_s).iter().all(|value| value.is_finite()));
        }
    }
}
