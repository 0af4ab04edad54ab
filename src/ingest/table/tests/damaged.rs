//! Bad rows and agents, and what they cost.

use super::*;

#[test]
fn damaged_tables_are_rejects() {
    // What was left out may explain why too little is left.
    let short = plain(42).replace("\n7,0,0,2", "\n7,0,,2").replace("\n7,0.1,1,2", "").replace("\n7,0.2,2,2", "");
    let far = drive("id,t,x,y", 60, |_, t, x| format!("7,{t},{},2", 1e3 * x));
    let nobody = drive("id,t,x,y", 60, |_, t, x| format!(",{t},{x},2"));
    for (text, expected) in [
        (short, "; 1 rows left out, the first: "),
        (far, "where no vehicle comes from the rows around"),
        (nobody, "column id is blank in all rows"),
        ("id,t,x,y\n".to_owned(), "the table has no rows"),
    ] {
        let found = rejects(file("a.csv", &text).path(), PLAIN);
        assert!(found.contains(expected), "{expected}: {found}");
    }
}

#[test]
fn what_is_bad_costs_no_more_than_itself_and_is_counted() {
    // Four cars side by side.
    let row = |i: usize, t: f64, x: f64| {
        (1..=4).map(|id| format!("{id},{t},{x},{},4.5,1.8,car", 4 * id)).collect::<Vec<_>>().join("\n")
            + if i == 30 { "\n,3,9,9,,,\n-1,3,9,9,,,\n-1,3,99,9,,,nan" } else { "" }
    };
    let whole = drive("id,t,x,y,l,w,c", 100, row);
    let mapping = "
        columns = { track = 'id', x = 'x', y = 'y', time = 't', length = 'l', width = 'w', class = 'c' }
        classes = { car = 'vehicle' }";
    let of_agent = |id: usize, cell: &str, by: &str| {
        let own =
            |line: &str| if line.starts_with(&format!("{id},")) { line.replace(cell, by) } else { line.to_owned() };
        whole.lines().map(own).collect::<Vec<_>>().join("\n")
    };
    let is_kept = |text: &str, what: &str, n: u64, said: &str, n_states: [usize; 4]| {
        let folder = file("a.csv", text);
        let (scenes, report) = read(&config(folder.path(), mapping)).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert_eq!(report.warnings["rows_without_track"].count, 3);
        if n > 0 {
            let found = report.warnings.get(what).unwrap_or_else(|| panic!("{what}: {:?}", report.warnings));
            assert!(found.count == n && found.examples[0].contains(said), "{found:?}");
        }
        let of = |id: usize| {
            let track = scenes[0].tracks.iter().find(|track| track.id.0 == id.to_string());
            track.map_or(0, |track| track.trajectory.n_valid())
        };
        assert_eq!([1, 2, 3, 4].map(of), n_states, "{what} {said}");
    };
    let all = [40; 4];
    is_kept(&whole, "", 0, "", all);
    for (from, to, what, said) in [
        ("2,1.2,12,8,", "2,1.2,,8,", "rows_left_out", "line 51: column x is blank or NaN"),
        ("2,1.2,12,8,", "2,1e9,12,8,", "rows_out_of_range", "line 51: is 1000000000 s after the first row"),
        ("2,1.2,12,8,", "2,1.2,52,8,", "rows_out_of_place", "line 51: track 2 is at (52.0, 8.0) m"),
        ("2,1.2,12,8,4.5,", "2,1.2,12,8,-4.5,", "", ""),
    ] {
        assert!(whole.contains(from));
        is_kept(&whole.replacen(from, to, 1), what, u64::from(!what.is_empty()), said, all);
    }
    let at_once = whole.replacen("2,1.2,12,8,", "2,1.3,52,8,", 1);
    // Two of three rows are elsewhere.
    let row = |(i, line): (usize, &str)| match line.starts_with("2,") && i % 3 != 2 {
        true => line.replacen(",8,", &format!(",{i}e3,"), 1),
        false => line.to_owned(),
    };
    let mostly_elsewhere = whole.lines().enumerate().map(row).collect::<Vec<_>>().join("\n");
    let is_seen = |line: &&str| !line.starts_with("2,") || line.starts_with("2,0,") || line.starts_with("2,9.9,");
    let seldom = whole.lines().filter(is_seen).collect::<Vec<_>>().join("\n");
    for (text, what, said) in [
        (of_agent(2, ",car", ",e-scooter"), "agents_of_unlisted_class", "line 3: column c is \"e-scooter\""),
        (of_agent(2, ",car", ","), "agents_of_unlisted_class", "line 3: column c is \"\""),
        (of_agent(2, ",4.5,1.8", ",-4.5,1.8"), "agents_with_bad_values", "line 3: track 2 is -4.5 by 1.8 m"),
        (at_once, "agents_at_two_places_at_one_time", "track 2 is at two positions at one time"),
        (mostly_elsewhere, "agents_with_bad_values", "track 2 is at ("),
        (seldom, "agents_with_rows_far_apart", "the rows of track 2 are 9.900 s apart"),
    ] {
        is_kept(&text, what, 1, said, [40, 0, 40, 40]);
    }
}
