//! Is the comparison of two runs a whole page, from models and from the command line?

use super::{markup, sample};
use crate::support::djinn;
use djinn::report::{ComparedRun, Comparison, Fact, render_comparison};

fn run(name: &str) -> ComparedRun {
    let model = sample::model_named(name);
    ComparedRun {
        name: name.into(),
        facts: vec![Fact::new("Seed", name)],
        settings: [("run.seed".to_owned(), name.to_owned())].into(),
        mining: model.mining,
        evaluation: model.evaluation,
    }
}

#[test]
fn every_part_of_both_runs_is_on_the_page() {
    let mut b = run("v17");
    b.name = "other".into();
    b.settings.insert("run.seed".into(), "21".into());
    let comparison = Comparison { a: run("v17"), b };
    let page = render_comparison(&comparison);
    markup::check(&page);
    for id in ["settings", "outcome", "tradeoffs", "realism", "mining"] {
        assert!(page.contains(&format!(r#"<section id="{id}""#)), "no section {id}");
    }
    assert!(page.contains(">21<") && page.contains("A: cut_in") && page.contains("B: cut_in"));
    assert_eq!(page, render_comparison(&comparison));
    assert!(!page.contains("NaN") && !page.contains("http"));
    markup::check(&render_comparison(&Comparison::default()));
}

#[test]
fn the_command_compares_two_folders_and_refuses_what_is_none() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for (run, seed) in [("a", 1), ("b", 2)] {
        fs_err::create_dir(path(run)).unwrap();
        let config = format!("[run]\nseed = {seed}\n");
        fs_err::write(folder.path().join(run).join("config.toml"), config).unwrap();
        let manifest = format!(
            r#"{{"djinn_version":"0.1.0","revision":null,"pipeline":"p","seed":{seed},"device":"cpu","inputs":{{}},"stages":{{}}}}"#
        );
        fs_err::write(folder.path().join(run).join("run.json"), manifest).unwrap();
    }
    let page = path("pages/ab.html");
    let outcome = djinn(&["report", "--compare", &path("a"), &path("b"), "--out", &page]).expect(0);
    assert!(outcome.stdout.is_empty() && outcome.stderr.contains("ab.html"), "{}", outcome.stderr);
    let text = fs_err::read_to_string(&page).unwrap();
    markup::check(&text);
    assert!(text.contains("run.seed"));

    let outcome = djinn(&["report", "--compare", &path("a"), &path("pages")]).expect(1);
    assert!(outcome.stderr.contains("is not a run folder") && outcome.stderr.contains("hint: "), "{}", outcome.stderr);
    djinn(&["report", "--compare", &path("a")]).expect(1);
    djinn(&["report", "--out", &page]).expect(1);
}
