//! The fusion against a table of cycles written by hand, and the strength against arithmetic of 50 digits.

use messages::{Header, Message, Resumable, Sinkage, Soil, Status, Terrain, TerrainClass, label};
use terrain::{Config, TerrainFusion};

#[test]
fn every_cycle_says_what_is_valid_and_how_old_it_is() {
    let mut fusion = TerrainFusion::new(Config::default());
    for (index, row) in rows(include_str!("../golden/cycles.csv")).enumerate() {
        let [taken_s, sinkage, soil, class, status, valid, ages @ .., why] = &row[..] else {
            panic!("a row of cycles.csv has too few cells");
        };
        let taken_ns = nanoseconds(taken_s);
        let header = |word: &str| Header {
            taken_ns,
            sequence: index as u64,
            generation: 3,
            published_ns: 5,
            status: status_of(word),
        };
        if !sinkage.is_empty() {
            fusion.observe_sinkage(&sinkage_sample(header(sinkage)));
        }
        if let Some(class) = class_sample(class, header) {
            fusion.observe_class(&class);
        }
        let terrain = fusion.step(&soil_sample(header(soil)));

        assert_eq!(terrain.check(), Ok(()), "at {taken_s} s");
        assert_eq!(
            terrain.header,
            header("ok").answer(status_of(status)),
            "status at {taken_s} s: {why}"
        );
        assert_eq!(valid_words(terrain.valid), *valid, "valid at {taken_s} s: {why}");
        let age_ns = [terrain.sinkage_age_ns, terrain.soil_age_ns, terrain.class_age_ns];
        for (age_ns, expected) in age_ns.into_iter().zip(ages) {
            assert_eq!(age_ns, nanoseconds(expected), "ages at {taken_s} s: {why}");
        }
        assert_eq!(terrain.soil_status, status_of(soil), "at {taken_s} s");
    }
}

#[test]
fn the_strength_and_its_sigma_follow_from_cohesion_friction_and_pressure() {
    for row in rows(include_str!("../golden/strength.csv")) {
        let row: Vec<f64> = row.iter().map(|cell| cell.parse().expect("a number")).collect();
        let [
            cohesion_pa,
            cohesion_sigma_pa,
            friction_rad,
            friction_sigma_rad,
            covariance,
            pressure_pa,
            strength_pa,
            sigma_pa,
        ] = row[..]
        else {
            panic!("a row of strength.csv has another number of cells");
        };
        let soil = Soil {
            cohesion_pa,
            cohesion_sigma_pa,
            friction_rad,
            friction_sigma_rad,
            cohesion_friction_covariance_pa_rad: covariance,
            pressure_pa,
            ..Soil::unknown(Header::default())
        };
        let terrain = TerrainFusion::new(Config::default()).step(&soil);
        assert!((terrain.strength_pa / strength_pa - 1.0).abs() < 1e-12, "{soil:?}");
        assert!((terrain.strength_sigma_pa / sigma_pa - 1.0).abs() < 1e-9, "{soil:?}");
        assert_eq!(valid_words(terrain.valid), "soil strength");
    }
}

#[test]
fn a_step_allocates_nothing() {
    let mut fusion = TerrainFusion::new(Config::default());
    let mut state = vec![0; fusion.state_bytes()];
    let statuses = (0..=Status::ENDED.0).map(Status);
    let samples: Vec<_> = statuses
        .map(|status| {
            let header = Header {
                taken_ns: 1_000_000_000 * u64::from(status.0),
                sequence: status.0.into(),
                status,
                ..Header::default()
            };
            let mut class = TerrainClass::undecided(header);
            (class.class, class.class_count, class.labels[1]) = (1, 2, label("sand"));
            (sinkage_sample(header), class, soil_sample(header))
        })
        .collect();
    let counted = allocation_counter::measure(|| {
        for (sinkage, class, soil) in &samples {
            fusion.observe_sinkage(sinkage);
            fusion.observe_class(class);
            std::hint::black_box(fusion.step(soil));
            fusion.save(&mut state);
        }
    });
    assert_eq!(counted.count_total, 0);
}

fn rows(table: &'static str) -> impl Iterator<Item = Vec<&'static str>> {
    table.lines().skip(1).map(|line| line.split(',').collect())
}

fn nanoseconds(seconds: &str) -> u64 {
    match seconds {
        "never" => Terrain::NEVER_NS,
        _ => (seconds.parse::<f64>().expect("seconds or `never`") * 10.0).round() as u64 * 100_000_000,
    }
}

fn status_of(word: &str) -> Status {
    (0..32)
        .map(Status)
        .find(|status| status.word() == Some(word))
        .expect("the word of a status")
}

fn valid_words(valid: u32) -> String {
    let parts = [
        (Terrain::SINKAGE, "sinkage"),
        (Terrain::SOIL, "soil"),
        (Terrain::STRENGTH, "strength"),
        (Terrain::CLASS, "class"),
    ];
    let words: Vec<&str> = parts
        .iter()
        .filter(|(bit, _)| valid & bit != 0)
        .map(|(_, word)| *word)
        .collect();
    words.join(" ")
}

/// What a stage sends with this status: values where it is an answer, else NaN.
fn sinkage_sample(header: Header) -> Sinkage {
    let unknown = Sinkage::unknown(header);
    if !header.status.is_answer() {
        return unknown;
    }
    Sinkage {
        entry_rad: 0.5,
        sinkage_m: 0.018,
        ..unknown
    }
}

fn soil_sample(header: Header) -> Soil {
    let mut soil = Soil::unknown(header);
    if header.status.is_answer() {
        (soil.cohesion_pa, soil.friction_rad, soil.pressure_pa) = (1000.0, 0.5, 6000.0);
    }
    if header.status == Status::NOT_OBSERVABLE {
        (soil.strength_pa, soil.pressure_pa) = (4000.0, 6000.0);
    }
    soil
}

/// From a cell such as `ok 9.2`: status, and start of the window.
fn class_sample(cell: &str, header: impl Fn(&str) -> Header) -> Option<TerrainClass> {
    let (word, start_s) = cell.split_once(' ').unwrap_or((cell, ""));
    if word.is_empty() {
        return None;
    }
    let mut class = TerrainClass::undecided(header(word));
    if !start_s.is_empty() {
        (class.class, class.class_count, class.unknown) = (1, 2, u32::from(word == "unknown_terrain"));
        class.labels[1] = label("sand");
        class.probability[1] = 0.9;
        (class.start_ns, class.window_ns) = (nanoseconds(start_s), 1_000_000_000);
    }
    Some(class)
}
