//! What cannot be, or hardly: sizes, classes, headings and jumps.

use super::*;

/// The warnings by name, with their counts and first examples, and the scenes.
fn doubts(text: &str, mapping: &str) -> (BTreeMap<String, (u64, String)>, Vec<Scene>) {
    let (scenes, report) = read(&config(file("a.csv", text).path(), mapping)).unwrap_or_else(|e| panic!("{e}"));
    let found = report.warnings.into_iter().map(|(what, found)| (what, (found.count, found.examples[0].clone())));
    (found.collect(), scenes)
}

fn track<'s>(scene: &'s Scene, id: &str) -> &'s Track {
    scene.tracks.iter().find(|track| track.id.0 == id).unwrap_or_else(|| panic!("no track {id}"))
}

const SIZED: &str = "columns = { track = 'id', x = 'x', y = 'y', time = 't', length = 'l', width = 'w', class = 'c' }
    classes = { car = 'vehicle', truck = 'bus', walker = 'pedestrian' }";

#[test]
fn size_and_class_are_those_of_most_rows() {
    // A car that is a truck at first and blank then, that grows into the image, and is 40 m long in one row.
    let row = |i: usize, t: f64, x: f64| {
        let length = if i == 30 { 40.0 } else { 4.5_f64.min(0.5 + 0.5 * i as f64) };
        let class = ["truck", ""].get(i).unwrap_or(&"car");
        // The sizes of two others are not known.
        format!("1,{t},{x},0,{length},1.8,{class}\n2,{t},0,{t},0,0,walker\n3,{t},5,{t},,,walker")
    };
    let (found, scenes) = doubts(&drive("id,t,x,y,l,w,c", 40, row), SIZED);
    let car = track(&scenes[0], "1");
    assert_eq!((car.class, car.extent.map(|extent| extent.length_m)), (AgentClass::Vehicle, Some(4.5)));
    assert_eq!(["2", "3"].map(|id| track(&scenes[0], id).extent), [None; 2]);
    // More than a quarter off: 0.5 to 3 m, and 40 m.
    let (n, said) = &found["rows_of_another_size"];
    assert!(*n == 7 && said.contains("line 2: track 1 is 0.50 by 1.80 m; its median, 4.50 by 1.80"), "{n} {said}");
    let (n, said) = &found["rows_of_another_class"];
    assert!(*n == 2 && said.contains("track 1 is \"truck\"; most often \"car\""), "{n} {said}");
}

#[test]
fn who_is_no_car_by_its_size_is_named() {
    let row = |_: usize, t: f64, x: f64| {
        format!("1,{t},{x},0,4.5,1.8,car\n3,{t},{x},4,4.5,1.8,car\n2,{t},0,{},0.5,0.5,car", 0.13 * x)
    };
    let (found, _) = doubts(&drive("id,t,x,y,l,w,c", 60, row), SIZED);
    let (n, said) = &found["agents_of_unusual_size"];
    assert!(*n == 1 && said.contains("track 2 is a vehicle of 0.50 by 0.50 m") && said.contains("its class"), "{said}");
}

#[test]
fn headings_that_cannot_be_are_blank_and_follow_from_the_motion() {
    // North: 8 m/s for 3 s, a stop of 3 s, and on; beside it a car that never moves.
    let y = |t: f64| if t < 3.0 { 8.0 * t } else { 24.0 + 8.0 * f64::max(0.0, t - 6.0) };
    let stands = |t: f64| (3.0..=6.0).contains(&t);
    let mapping = "heading = 'degrees'\ncolumns = { track = 'id', x = 'x', y = 'y', time = 't', heading = 'h' }";
    type Heading<'a> = &'a dyn Fn(usize, f64) -> f64;
    let cases: [(Heading<'_>, Heading<'_>, &str, u64); 9] = [
        (&|_, _| 90.0, &|_, _| 90.0, "", 0),
        (&|_, _| 450.0, &|_, _| 450.0, "", 0),
        // Added up over turns.
        (&|i, _| 810.0 + 1e-10 * i as f64, &|_, _| 1170.0 + 1e-10, "", 0),
        (&|i, _| if (20..29).contains(&i) { 999.0 } else { 90.0 }, &|_, _| 90.0, "headings_beyond_a_circle", 9),
        (&|i, _| if i.is_multiple_of(3) { -9999.0 } else { 90.0 }, &|_, _| 90.0, "headings_beyond_a_circle", 30),
        (&|i, _| if i < 9 { 999.0 } else { 90.0 }, &|_, _| 90.0, "headings_beyond_a_circle", 9),
        (&|i, _| if i % 7 == 3 { -90.0 } else { 90.0 }, &|_, _| 90.0, "headings_that_no_vehicle_turns_to", 13),
        (&|_, t| if stands(t) { 0.0 } else { 90.0 }, &|_, _| 90.0, "headings_that_no_vehicle_turns_to", 31),
        (&|_, _| 90.0, &|i, _| if i % 9 == 0 { -90.0 } else { 90.0 }, "headings_that_no_vehicle_turns_to", 10),
    ];
    for (case, (moving, standing, what, n)) in cases.into_iter().enumerate() {
        let row = |i: usize, t: f64, _: f64| format!("1,{t},0,{},{}\n2,{t},9,5,{}", y(t), moving(i, t), standing(i, t));
        let (found, scenes) = doubts(&drive("id,t,x,y,h", 90, row), mapping);
        let counts: Vec<(&str, u64)> = found.iter().map(|(what, (n, _))| (what.as_str(), *n)).collect();
        assert_eq!(counts, if n > 0 { vec![(what, n)] } else { vec![] }, "{case}: {found:?}");
        for (scene, id) in scenes.iter().flat_map(|scene| [(scene, "1"), (scene, "2")]) {
            for (i, state) in track(scene, id).trajectory.valid() {
                let state = state.transformed(&scene.world_from_scene);
                let off_rad = angle_difference(state.heading_rad, std::f64::consts::FRAC_PI_2);
                assert!(off_rad.abs() < 1e-9, "{case} {id} {i}: {state:?}");
            }
        }
    }
    // Where most of a track is wrong, its headings stay, and are named.
    let wrong = |i: usize, t: f64, x: f64| format!("1,{t},{x},0,{}", if i.is_multiple_of(3) { 0.0 } else { 180.0 });
    let (found, _) = doubts(&drive("id,t,x,y,h", 90, wrong), mapping);
    assert!(
        found["tracks_that_turn_at_once"].1.contains("line 3: track 1 turns at once, as no vehicle does, and most"),
        "{found:?}"
    );
}

#[test]
fn small_jumps_are_left_out_or_named_and_large_ones_end_a_track() {
    for (rows, by_m, what, ids) in [
        (25..26, 3.0, "rows_out_of_place", &["1"][..]),
        (25..90, 3.0, "rows_off_the_motion_before", &["1"]),
        (25..90, 6.0, "ids_of_another_agent", &["1", "1#2"]),
    ] {
        let row = |i: usize, t: f64, x: f64| format!("1,{t},{x},{}", if rows.contains(&i) { by_m } else { 0.0 });
        let (found, scenes) = doubts(&drive("id,t,x,y", 90, row), PLAIN);
        let (n, said) = found.get(what).unwrap_or_else(|| panic!("{what}: {found:?}"));
        assert!(*n == 1 && said.contains("a.csv, line 27: track 1 "), "{said}");
        let found: std::collections::BTreeSet<&str> =
            scenes.iter().flat_map(|scene| &scene.tracks).map(|track| track.id.0.as_str()).collect();
        assert!(found.into_iter().eq(ids.iter().copied()), "{what}");
        for (i, state) in track(&scenes[0], "1").trajectory.valid() {
            let at = scenes[0].world_from_scene.point(state.position);
            let y = if i >= 25 && what == "rows_off_the_motion_before" { by_m } else { 0.0 };
            assert!(at.distance(Vec2::new(i as f64, y)) < 1e-6, "{what} {i}: {at:?}");
        }
    }
}

#[test]
fn gaps_are_filled_as_far_as_they_can_be_driven() {
    // Half a second is missing, and the car goes on so far aside.
    for (aside_m, what, ids) in
        [(2.0, "gaps_filled", 1), (8.0, "ids_of_another_agent", 2), (12.0, "ids_of_another_agent", 2)]
    {
        let rows = |i: usize, t: f64, x: f64| match i {
            0..45 => format!("1,{t},{x},0"),
            _ => format!("1,{},{},{aside_m}", t + 0.4, x + 4.0),
        };
        let (found, scenes) = doubts(&drive("id,t,x,y", 90, rows), PLAIN);
        assert_eq!(found.keys().collect::<Vec<_>>(), [what], "{found:?}");
        assert!(found[what].0 == 1);
        assert!(ids == 1 || found[what].1.contains("line 47: track 1 goes on as 1#2: no vehicle"));
        let names: std::collections::BTreeSet<&str> =
            scenes.iter().flat_map(|scene| &scene.tracks).map(|track| track.id.0.as_str()).collect();
        assert_eq!(names.len(), ids, "{names:?}");
        for track in scenes.iter().flat_map(|scene| &scene.tracks) {
            let fastest_mps = track.trajectory.valid().map(|(_, state)| state.velocity.norm()).fold(0.0, f64::max);
            assert!(fastest_mps < 13.0, "{aside_m}: {} at {fastest_mps} m/s", track.id);
        }
    }
    // Who is not seen for three seconds is there before and after.
    let hidden = |i: usize, t: f64, x: f64| {
        let [more_s, more_m] = if i < 45 { [0.0, 0.0] } else { [3.0, 30.0] };
        format!("1,{},{},0\n2,{t},{x},4", t + more_s, x + more_m)
    };
    let (found, scenes) = doubts(&drive("id,t,x,y", 90, hidden), PLAIN);
    assert_eq!((found.len(), [0, 2].map(|i| track(&scenes[i], "1").trajectory.n_valid())), (0, [40; 2]), "{found:?}");
}

#[test]
fn a_course_of_0_at_rest_is_none() {
    // North on a compass is 0, and so is the course of who never moves: on a lane to the west it points west.
    let road = |y: f64| {
        format!(
            "<OpenDRIVE><road id='1' length='90'><planView><geometry s='0' x='60' y='{y}' hdg='3.141592653589793' \
             length='90'><line/></geometry></planView><lanes><laneSection s='0'><right><lane id='-1' type='driving'>\
             <width sOffset='0' a='3.5' b='0' c='0' d='0'/></lane></right></laneSection></lanes></road></OpenDRIVE>"
        )
    };
    let row = |_: usize, t: f64, x: f64| format!("1,{t},{},0,270\n2,{t},9,0,0", 40.0 - x / 2.0);
    let folder = file("a.csv", &drive("id,t,x,y,h", 60, row));
    let mapping = "heading = 'compass_degrees'\nplace = 'm'
        columns = { track = 'id', x = 'x', y = 'y', time = 't', heading = 'h' }";
    for (y, toward_deg, kinds) in [(-1.75, 180.0, 1), (30.0, 90.0, 3)] {
        fs_err::write(folder.path().join("m.xodr"), road(y)).unwrap();
        let maps = crate::ingest::MapsConfig::Required;
        let (scenes, report) = read(&IngestConfig { maps, ..config(folder.path(), mapping) }).unwrap();
        assert!(report.warnings["headings_of_0_at_rest"].examples[0].contains("track 2 never moves"));
        assert_eq!(report.warnings.len(), kinds, "{:?}", report.warnings);
        for (_, state) in track(&scenes[0], "2").trajectory.valid() {
            let heading_rad = state.transformed(&scenes[0].world_from_scene).heading_rad;
            assert!(angle_difference(heading_rad, f64::to_radians(toward_deg)).abs() < 1e-9, "{y}: {heading_rad}");
        }
    }
}
