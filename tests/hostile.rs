//! A foreign process that may open a wire writes what it likes: no service dies, and its samples are marked.

use crate::rover::Rover;
use messages::{Frame, Message, Sinkage, Soil, TerrainClass, Vibration, Wheel};
use shell::{Domain, Output, SystemFile, Termination};
use zerocopy::FromBytes;

/// Bytes without a pattern, the same each time.
fn noise(length: usize, seed: u64) -> Vec<u8> {
    let mut state = seed;
    let mut next = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        state.to_le_bytes()[6]
    };
    (0..length).map(|_| next()).collect()
}

/// Writes random samples, and keeps the wire open: who only looks now and then must get to see them.
fn flood<T: Message>(domain: &Domain, wire: &str, seed: u64) -> Output<T> {
    let output = domain.output::<T>(wire, &Termination::listen().unwrap()).unwrap();
    for round in 0..20 {
        let bytes = noise(size_of::<T>(), seed + round);
        output
            .send_with(|sample| {
                sample.as_mut_bytes().copy_from_slice(&bytes);
                Ok(())
            })
            .unwrap();
    }
    output
}

#[test]
fn random_bytes_on_every_wire_kill_no_service_and_are_marked() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let pids = rover.pids();
    let domain = Domain::enter(&SystemFile::read(&rover.file()).unwrap(), "intruder").unwrap();
    let _open = (
        flood::<Frame>(&domain, "front/frames", 1),
        flood::<Wheel>(&domain, "front/wheel", 2),
        flood::<Vibration>(&domain, "body/vibration", 3),
        flood::<Sinkage>(&domain, "front/sinkage", 4),
        flood::<Soil>(&domain, "front/soil", 5),
        flood::<TerrainClass>(&domain, "body/class", 6),
    );
    let cycles = rover.row("terrain")["published"].as_u64().unwrap();
    rover.until("cycles go on", |rows| {
        rows.iter()
            .any(|row| row["service"] == "terrain" && row["published"].as_u64().unwrap() > cycles + 20)
    });
    assert_eq!(rover.pids(), pids, "{}", rover.log());
    assert!(
        rover.row("terrain")["rejected"].as_u64() >= Some(20),
        "{:#?}",
        rover.rows()
    );
    for wire in [
        "front/frames",
        "front/wheel",
        "body/vibration",
        "front/sinkage",
        "front/soil",
        "body/class",
    ] {
        rover.until_said(&format!("wire {wire}: bad sample 1: "));
    }
}

#[test]
fn a_sample_of_random_bytes_is_a_value_and_is_not_believed() {
    for seed in 0..200 {
        assert!(
            Sinkage::read_from_bytes(&noise(size_of::<Sinkage>(), seed))
                .unwrap()
                .check()
                .is_err()
        );
        assert!(
            Wheel::read_from_bytes(&noise(size_of::<Wheel>(), seed))
                .unwrap()
                .check()
                .is_err()
        );
    }
}
