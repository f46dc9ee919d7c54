//! Bad input of every kind: a clear error with file and line, an exit code, and nothing left behind.

use crate::recording::{Traverse, is_clean};
use crate::rover::{Rover, program, told};

fn validate(edit: impl Fn(String) -> String) -> (i32, String) {
    told(&["validate", &Rover::new(edit).file()])
}

#[test]
fn the_built_in_system_is_right() {
    let (code, text) = told(&["validate"]);
    assert_eq!(code, 0, "{text}");
}

#[test]
fn a_wrong_system_file_is_refused_with_its_line() {
    for (from, to, words) in [
        ("[system]", "[sytem]", "rover.toml:4: unknown field `sytem`"),
        (
            "rate_hz = 30",
            "rate_hz = -3",
            "`rate_hz` of service `camera` must be 0.1 to 1000, is -3",
        ),
        ("radius_m = 0.15 }", "radius_n = 0.15 }", "unknown field `radius_n`"),
        (
            "exec = [\"terrasense-terrain\"]",
            "exec = [\"terrasense-terain\"]",
            "executable `terrasense-terain`",
        ),
        (
            "inputs = { frames = \"front/frames\" }",
            "inputs = { frames = \"front/fames\" }",
            "nobody writes wire front/fames",
        ),
        (
            "outputs = { soil = \"front/soil\" }",
            "outputs = { soil = \"front/terrain\" }",
            "has two writers",
        ),
        ("deadline_ms = 10000", "deadline_ms = -1", "rover.toml:"),
    ] {
        let (code, text) = validate(|file| file.replace(from, to));
        assert!(code == 78 && text.contains(words), "{to}: {code}: {text}");
        assert!(text.contains("rover.toml:"), "no file and line: {text}");
    }
}

#[test]
fn a_system_file_that_would_lead_elsewhere_or_never_ends_is_refused() {
    let million: String = (0..1_000_000)
        .map(|number| format!("[service.s{number}]\nexec = [\"true\"]\n"))
        .collect();
    for (from, to, words) in [
        (
            "[system]\nname = \"t",
            "[system]\nname = \"../t",
            "the system's name `../t",
        ),
        (
            "\"front/wheel\"",
            "\"../../front/wheel\"",
            "\"../../front/wheel\" makes no wire's name",
        ),
        ("\"front/wheel\"", "\"a\\u0000b\"", "\"a\\0b\" makes no wire's name"),
        (
            "[service.terrain]",
            "[service.\"/etc/terrain\"]",
            "the service's name `/etc/terrain`",
        ),
        (
            "[service.terrain]",
            &(million + "[service.terrain]"),
            "goes on beyond 256 KiB",
        ),
    ] {
        let (code, text) = validate(|file| file.replace(from, to));
        assert!(code == 78 && text.contains(words), "{code}: {text}");
        assert!(text.contains("rover.toml:"), "no file and line: {text}");
    }
}

#[test]
fn a_service_that_is_started_by_hand_follows_no_name_out_of_its_folder() {
    let rover = Rover::new(|file| file.replace("[system]\nname = \"t", "[system]\nname = \"../t"));
    let output = std::process::Command::new(program("terrasense-sinkage"))
        .args([&rover.file(), "sinkage"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(78), "{text}");
    assert!(text.contains("rover.toml:5: `../t"), "{text}");
}

#[test]
fn a_missing_system_file_is_refused_with_the_way_out() {
    let (code, text) = told(&["up", "/nowhere/rover.toml"]);
    assert!(
        code == 78 && text.contains("/nowhere/rover.toml: ") && text.contains("terrasense default-system"),
        "{text}"
    );
}

#[test]
fn a_broken_traverse_is_refused_with_file_and_line() {
    type Case = (&'static str, fn(&Traverse), &'static str);
    let cases: [Case; 8] = [
        (
            "a bad cell",
            |traverse| traverse.edit("wheel.csv", |text| text.replacen("90", "9o", 1)),
            "wheel.csv:2",
        ),
        (
            "a wrong column",
            |traverse| traverse.edit("wheel.csv", |text| text.replace("load_n", "load_kg")),
            "wheel.csv:1",
        ),
        (
            "an infinite value",
            |traverse| traverse.edit("sinkage.csv", |text| text.replacen("0.4", "inf", 1)),
            "sinkage.csv:2",
        ),
        (
            "time going back",
            |traverse| traverse.edit("wheel.csv", |text| text + "0.0,90,3,0.3,0.03\n"),
            "wheel.csv:",
        ),
        (
            "a typing error",
            |traverse| traverse.edit("traverse.toml", |text| text.replace("radius_m", "radios_m")),
            "traverse.toml:2",
        ),
        (
            "no description",
            |traverse| traverse.remove("traverse.toml"),
            "traverse.toml",
        ),
        (
            "a negative radius",
            |traverse| traverse.edit("traverse.toml", |text| text.replace("0.15", "-0.15")),
            "traverse.toml:2",
        ),
        (
            "bytes that are no text",
            |traverse| traverse.write("vibration.csv", &[0xff, 0xfe, 0, 1, 2]),
            "vibration.csv:",
        ),
    ];
    for (what, break_it, words) in cases {
        let traverse = Traverse::without_pictures();
        break_it(&traverse);
        let (code, text) = traverse.replay("out");
        assert!(code == 65 && text.contains(words), "{what}: {code}: {text}");
        assert!(
            is_clean(&traverse.folder.path().join("out")),
            "{what} left something behind"
        );
    }
}

#[test]
fn a_description_that_is_no_file_or_never_ends_is_refused() {
    let traverse = Traverse::without_pictures();
    for target in ["/dev/zero", "/dev"] {
        traverse.remove("traverse.toml");
        std::os::unix::fs::symlink(target, traverse.path("traverse.toml")).unwrap();
        let (code, text) = traverse.replay("out");
        assert!(
            code == 65 && text.contains("traverse.toml: is no file"),
            "{code}: {text}"
        );
    }
}

#[test]
fn an_empty_or_missing_traverse_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for path in [folder.path().to_path_buf(), folder.path().join("nowhere")] {
        let out = folder.path().join("out");
        let (code, text) = told(&["replay", path.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        assert!(code == 65 && text.contains("traverse.toml"), "{code}: {text}");
        assert!(!out.exists());
    }
}

#[test]
fn a_picture_that_cannot_be_read_is_named_and_the_replay_goes_on() {
    let traverse = Traverse::with_pictures(3);
    let whole = std::fs::read(traverse.path("000001.png")).unwrap();
    traverse.write("000001.png", &whole[..whole.len() / 2]);
    // Its header says 10,000 × 10,000.
    let mut huge = whole.clone();
    huge[16..24].copy_from_slice(&[0, 0, 0x27, 0x10, 0, 0, 0x27, 0x10]);
    let checksum = crc32(&huge[12..29]).to_be_bytes();
    huge[29..33].copy_from_slice(&checksum);
    traverse.write("000002.png", &huge);
    std::fs::remove_file(traverse.path("000003.png")).unwrap();
    let (code, text) = traverse.replay("out");
    assert_eq!(code, 0, "{text}");
    for words in [
        "frames.csv:3: 000001.png: the file is cut off",
        "frames.csv:4: 000002.png: 10000x10000 px",
        "000003.png: No such file",
        "3 pictures could not be read",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let table = |name: &str| std::fs::read_to_string(traverse.path("out").join(name)).unwrap();
    let rows = std::fs::read_to_string(traverse.path("frames.csv"))
        .unwrap()
        .lines()
        .count();
    for name in ["frames.csv", "sinkage.csv"] {
        let table = table(name);
        let statuses: Vec<&str> = table.lines().map(|line| line.split(',').nth(2).unwrap()).collect();
        assert_eq!(statuses.len(), rows, "{name}");
        assert_eq!(
            statuses[2..5],
            ["input_rejected", "input_rejected", "no_data"],
            "{name}"
        );
    }
}

/// The checksum of a PNG chunk.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 }
        })
    };
    !bytes.iter().fold(!0, step)
}
