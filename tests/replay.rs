//! A recorded traverse gives the same bytes, however often and however busy the machine is.

use crate::recording::Traverse;
use crate::rover::{contents, told};
use std::sync::Arc;

fn column(text: &str, name: &str) -> Vec<String> {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let index = names
        .iter()
        .position(|other| *other == name)
        .unwrap_or_else(|| panic!("no {name} in {names:?}"));
    lines
        .map(|line| line.split(',').nth(index).unwrap().to_owned())
        .collect()
}

#[test]
fn two_replays_give_the_same_bytes_also_on_a_busy_machine() {
    let traverse = Traverse::with_pictures(4);
    let (code, text) = traverse.replay("first");
    assert_eq!(code, 0, "{text}");
    std::thread::scope(|scope| {
        let replaying = Arc::new(());
        for _ in 0..4 {
            let replaying = Arc::downgrade(&replaying);
            scope.spawn(move || {
                while replaying.strong_count() > 0 {
                    std::hint::spin_loop();
                }
            });
        }
        let (code, text) = traverse.replay("second");
        assert_eq!(code, 0, "{text}");
    });
    let (first, second) = (contents(&traverse.path("first")), contents(&traverse.path("second")));
    let names: Vec<&String> = first.iter().map(|(name, _)| name).collect();
    assert_eq!(
        names,
        [
            "class.csv",
            "frames.csv",
            "sinkage.csv",
            "soil.csv",
            "terrain.csv",
            "vibration.csv",
            "wheel.csv"
        ]
    );
    for ((name, first), (_, second)) in first.iter().zip(&second) {
        assert!(first == second, "{name} differs");
        assert!(first.len() > 200, "{name} is empty");
    }
}

#[test]
fn no_sample_is_lost_and_every_cycle_has_one_of_each() {
    let traverse = Traverse::without_pictures();
    let (code, text) = traverse.replay("out");
    assert_eq!(code, 0, "{text}");
    let read = |name: &str| std::fs::read_to_string(traverse.path("out").join(name)).unwrap();
    let cycles: Vec<String> = (0..200).map(|cycle| cycle.to_string()).collect();
    for name in ["sinkage.csv", "soil.csv", "terrain.csv"] {
        let rows: Vec<String> = column(&read(name), "sequence");
        let states = column(&read(name), "status");
        let measured: Vec<String> = rows
            .into_iter()
            .zip(states)
            .filter(|(_, status)| status != "no_data")
            .map(|(row, _)| row)
            .collect();
        assert!(
            measured.len() >= cycles.len(),
            "{name}: {} of {}",
            measured.len(),
            cycles.len()
        );
    }
    assert_eq!(
        column(&read("wheel.csv"), "status")
            .iter()
            .filter(|status| *status == "ok")
            .count(),
        1000
    );
}

#[test]
fn a_traverse_of_one_part_starts_only_the_services_that_it_feeds() {
    let traverse = Traverse::without_pictures();
    traverse.remove("wheel.csv");
    traverse.remove("sinkage.csv");
    let (code, text) = traverse.replay("out");
    assert_eq!(code, 0, "{text}");
    let names: Vec<String> = contents(&traverse.path("out"))
        .into_iter()
        .map(|(name, _)| name)
        .collect();
    assert_eq!(names, ["class.csv", "vibration.csv"]);
}

#[test]
fn plots_are_drawn_where_asked_for_and_an_earlier_one_does_not_stay() {
    let traverse = Traverse::without_pictures();
    traverse.remove("vibration.csv");
    let (folder, out) = (traverse.folder.path(), traverse.path("out"));
    let arguments = [
        "replay",
        folder.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--plots",
    ];
    let (code, text) = told(&arguments);
    assert_eq!(code, 0, "{text}");
    assert!(text.contains("soil.svg"), "{text}");
    let svg = std::fs::read_to_string(out.join("soil.svg")).unwrap();
    assert!(svg.contains("friction angle [deg]"));
    let (code, text) = told(&arguments[..4]);
    assert_eq!(code, 0, "{text}");
    assert!(!out.join("soil.svg").exists());
}

#[test]
fn pictures_give_figures_and_overlays_where_asked_for() {
    let traverse = Traverse::with_pictures(1);
    let (folder, out) = (traverse.folder.path(), traverse.path("out"));
    let (code, text) = told(&[
        "replay",
        folder.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--plots",
        "--overlay",
    ]);
    assert_eq!(code, 0, "{text}");
    for (figure, words) in [
        ("sinkage.svg", "sinkage on the left"),
        ("interface.svg", "filtered intensity, left"),
    ] {
        let svg = std::fs::read_to_string(out.join(figure)).unwrap();
        assert!(svg.contains(words) && svg.trim_end().ends_with("</svg>"), "{figure}");
    }
    let frames = column(&std::fs::read_to_string(folder.join("frames.csv")).unwrap(), "file");
    for file in &frames {
        let name = std::path::Path::new(file).file_name().unwrap();
        let png = std::fs::read(out.join("overlay").join(name)).unwrap();
        assert!(png.starts_with(b"\x89PNG") && png.len() > 1000, "{file}");
    }
    assert_eq!(std::fs::read_dir(out.join("overlay")).unwrap().count(), frames.len());
}
