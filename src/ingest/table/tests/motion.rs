//! Positions and headings of agents that are recorded without headings.

use super::*;

#[test]
fn who_stands_at_first_points_where_it_goes_and_does_not_jump() {
    // North, 4 m long: a car waits for 5 s and speeds up, another brakes to a halt, a third never moves.
    let row = |_: usize, t: f64, _: f64| {
        let start = if t < 5.0 { 0.0 } else { (t - 5.0).powi(2) };
        let stop = if t < 4.0 { 16.0 - (4.0 - t).powi(2) } else { 16.0 };
        [(1, 0.0, start), (2, 9.0, stop), (3, 18.0, 0.0)].map(|(id, x, y)| format!("{id},{t},{x},{y},4,2")).join("\n")
    };
    let folder = file("a.csv", &drive("id,t,x,y,l,w", 120, row));
    let columns = "columns = { track = 'id', x = 'x', y = 'y', time = 't', length = 'l', width = 'w' }";
    for (position, ahead_m) in [("center", 0.0), ("front", -2.0), ("rear", 2.0)] {
        let mapping = format!("position = '{position}'\n{columns}");
        let (scenes, report) = read(&config(folder.path(), &mapping)).unwrap();
        assert_eq!(scenes.len(), 3);
        let (unknown, warnings) = (&report.warnings["headings_unknown"], report.warnings.len());
        assert_eq!((warnings, unknown.count, unknown.examples.len()), (1, 3, 3), "one a scene");
        assert!(unknown.examples[0].contains("track 3 never moves, and no lane tells its heading"), "{unknown:?}");
        for (scene, begin) in scenes.iter().zip([0, 40, 80]) {
            for track in &scene.tracks {
                let derivation = track.trajectory.derivation().expect("no heading is recorded");
                for (i, state) in track.trajectory.valid() {
                    let (state, t) = (state.transformed(&scene.world_from_scene), (begin + i) as f64 / 10.0);
                    let (deg, y, stands) = match track.id.0.as_str() {
                        "1" => (90.0, if t < 5.0 { 0.0 } else { (t - 5.0).powi(2) }, t <= 5.5),
                        "2" => (90.0, if t < 4.0 { 16.0 - (4.0 - t).powi(2) } else { 16.0 }, t >= 4.5),
                        _ => (0.0, -ahead_m, true),
                    };
                    let at = Vec2::new(9.0 * (track.id.0.parse::<f64>().unwrap() - 1.0), y + ahead_m);
                    assert!(state.position.distance(at) < 1e-6, "{position} {} {t}: {state:?}", track.id);
                    let off_rad = angle_difference(state.heading_rad, f64::to_radians(deg));
                    assert!(off_rad.abs() < 1e-9, "{position} {} {t}: {state:?}", track.id);
                    assert!(derivation.held_headings[i] || !stands, "{position} {} {t}", track.id);
                }
            }
        }
    }
}
