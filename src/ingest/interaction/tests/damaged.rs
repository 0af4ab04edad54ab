//! Damaged tables: the damaged part is rejected, and everything else is read.

use super::*;

#[test]
fn a_flaw_costs_its_case_and_no_other() {
    let good = car("1.0,", 7, 1..=40);
    let broken = [
        ("malformed_row", car("2.0,", 7, 1..=40).replacen(",2,10,0,0,4.5,1.8", "", 1)),
        ("non_finite", car("3.0,", 7, 1..=40).replacen(",2,10,", ",NaN,10,", 1)),
        ("duplicate_frame", car("4.0,", 7, 1..=40) + &car("4.0,", 7, 3..=3).replacen(",10,", ",9,", 1)),
        ("bad_timestamp", car("5.0,", 7, 1..=40).replacen(",100,car", ",150,car", 1)),
        ("frame_out_of_range", car("6.0,", 7, 5..=45)),
    ];
    let text = [V1_2, &good, &broken.clone().map(|(_, rows)| rows).concat(), &car("7.0,", 1, 101..=140)].concat();
    let scenes = scenes_of(&[("train/SIM_A_train.csv", &text)]);
    let mut expected = vec!["interaction/train/SIM_A/1"];
    expected.extend(broken.iter().map(|(reason, _)| *reason));
    expected.push("interaction/train/SIM_A/7");
    assert_eq!(outcomes(&scenes), expected);
    for (scene, line) in scenes[1..].iter().zip([42, 82, 162, 163, 203]) {
        let detail = &scene.as_ref().unwrap_err().detail;
        assert!(detail.starts_with(&format!("train/SIM_A_train.csv:{line}: ")), "{detail}");
    }
}

#[test]
fn tables_without_their_columns_are_rejected() {
    let cases = [
        ("train/SIM_A_train.csv", V1_2.replace(",psi_rad", ""), "no column psi_rad"),
        ("train/SIM_A_train.csv", V1_2.replace(',', ";"), "not `;`"),
        ("SIM_A/vehicle_tracks_000.csv", V1_1_PEDESTRIANS.to_owned(), "no column psi_rad, length, width"),
        ("SIM_A/vehicle_tracks_000.csv", String::new(), "found ``"),
        ("SIM_A/pedestrian_tracks_000.csv", V1_1_PEDESTRIANS.replace(",vy", ""), "no column vy"),
    ];
    for (name, text, expected) in cases {
        let folder = folder_of(&[(name, &text)]);
        let scenes = read_scenes(&config(folder.path()));
        assert_eq!(outcomes(&scenes), ["bad_header"]);
        let detail = &scenes[0].as_ref().unwrap_err().detail;
        assert!(detail.starts_with(name) && detail.contains("line 1") && detail.contains(expected), "{detail}");
    }
    let scenes = scenes_of(&[("train/SIM_A_train.csv", V1_2)]);
    assert_eq!(scenes[0].as_ref().unwrap_err().detail, "train/SIM_A_train.csv: has a header and no rows");
    // A file that is no table does not affect others.
    let table = [V1_2, &car("1.0,", 7, 1..=40)].concat();
    let scenes = scenes_of(&[("notes.csv", "to do:\n"), ("train/SIM_A_train.csv", &table)]);
    assert_eq!(outcomes(&scenes), ["bad_header", "interaction/train/SIM_A/1"]);
}

#[test]
fn a_file_that_breaks_off_is_a_reject() {
    use std::io::Write;
    let text: String = (1..=50).map(|case| car(&format!("{case}.0,"), 7, 1..=40)).collect();
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all([V1_2, &text].concat().as_bytes()).unwrap();
    let bytes = encoder.finish().unwrap();
    let folder = tempfile::tempdir().unwrap();
    fs_err::write(folder.path().join("SIM_A_val.csv.gz"), &bytes[..bytes.len() / 2]).unwrap();
    fs_err::write(folder.path().join("SIM_B_val.csv"), [V1_2, &car("1.0,", 7, 1..=40)].concat()).unwrap();
    let scenes = read_scenes(&config(folder.path()));
    let outcomes = outcomes(&scenes);
    assert_eq!(outcomes[outcomes.len() - 2..], ["unreadable", "interaction/val/SIM_B/1"]);
    assert!(outcomes[..outcomes.len() - 2].iter().all(|id| id.starts_with("interaction/val/SIM_A/")));
    assert!(scenes[outcomes.len() - 2].as_ref().unwrap_err().detail.starts_with("SIM_A_val.csv"));
}
