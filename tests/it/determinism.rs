//! Are the results the same bytes whatever the number of threads, and however often the run was killed?

use crate::support::{Workspace, assert_same, files, start};
use std::time::{Duration, Instant};

#[test]
fn the_same_bytes_on_one_thread_on_two_and_after_being_killed() {
    let workspace = Workspace::new();
    let began = Instant::now();
    workspace.run("one", &["--threads", "1"]).expect(0);
    let expected = files(&workspace.run_folder("one"));
    assert!(expected.contains_key("corpus/manifest.json") && expected.contains_key("report.html"));
    workspace.run("two", &["--threads", "2"]).expect(0);
    assert_same(&expected, &files(&workspace.run_folder("two")));
    let typical = began.elapsed() / 2;

    // Moments that fall into different stages, as fractions of an undisturbed run.
    for (attempt, moments) in [[0.05, 0.3, 0.3, 0.4], [0.5, 0.12, 0.2, 0.2], [0.22, 0.45, 0.02, 0.6]].iter().enumerate()
    {
        let output = format!("killed{attempt}");
        let args = workspace.run_args(&output, &[]);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        for share in moments {
            let mut child = start(&args);
            std::thread::sleep(Duration::from_secs_f64(typical.as_secs_f64() * share));
            child.kill().unwrap();
            child.wait().unwrap();
        }
        workspace.run(&output, &[]).expect(0);
        assert_same(&expected, &files(&workspace.run_folder(&output)));
    }
}
