//! Is the report whole, self-contained and safe, whatever the names in the recordings?

mod browser;
mod chromium;
mod markup;
mod sample;

use djinn::report::{FigureFile, ReportModel, figures, render};

/// Renders the sample and leaves it in the target folder, where a browser can open it.
fn sample_page() -> String {
    let page = render(&sample::model());
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("report.html");
    fs_err::write(path, &page).unwrap();
    page
}

#[test]
fn every_part_of_the_model_is_on_the_page() {
    let page = sample_page();
    for id in [
        "warnings",
        "outcome",
        "requests",
        "coverage",
        "tradeoffs",
        "metrics",
        "distributions",
        "scenes",
        "more-of-it",
        "training",
        "classifier",
        "rates",
        "mining",
        "data",
        "config",
    ] {
        assert!(page.contains(&format!(r##"<a href="#{id}">"##)), "no entry for {id}");
        assert!(page.contains(&format!(r#"<section id="{id}""#)), "no section {id}");
    }
    for text in [
        "min_scene_ade_m",
        "constant velocity",
        "Wilson",
        "bad_rows.csv:17",
        "α = 2",
        "other cuts in ahead of ego",
        "recorded (v17)",
        "Cost of a verified scenario",
        "observed: upsampling",
        // The first screen, and what limits the drawings.
        "Can you trust it?",
        "report.n_drawn = 12",
    ] {
        assert!(page.contains(text), "“{text}” is missing");
    }
    assert!(!page.contains("NaN") && !page.contains("inf "), "numbers that are not finite are written as a dash");
}

#[test]
fn reasons_are_one_table_with_the_most_frequent_first() {
    let page = sample_page();
    let table = page.split("Why samples are not in the corpus</caption>").nth(1).unwrap();
    let table = &table[..table.find("</table>").unwrap()];
    let places = ["not verified", "not finite", "collision", "near duplicate"].map(|reason| {
        table.find(&format!(r#"<th scope="row">{reason}</th>"#)).unwrap_or_else(|| panic!("no {reason}"))
    });
    assert!(places.is_sorted(), "{places:?}");
    // Seven of the fifteen collisions are left out for nothing else before.
    assert!(table.contains(r#"7<small> of 15</small>"#), "{table}");
}

#[test]
fn a_drawing_of_each_bucket_leads_to_its_scene() {
    let page = sample_page();
    let gallery = page.split(r#"<div class="bucket-gallery">"#).nth(1).unwrap();
    let gallery = &gallery[..gallery.find("</div>").unwrap()];
    assert_eq!(gallery.matches("<figure>").count(), 1);
    assert!(gallery.contains(r##"<a href="#scene-0"><svg"##) && gallery.contains("gap_m 0..5"), "{gallery}");
}

#[test]
fn no_table_has_more_columns_than_a_laptop_shows() {
    let page = sample_page();
    for row in page.split("<thead>").skip(1) {
        let head = &row[..row.find("</thead>").unwrap()];
        assert!(head.matches("<th").count() <= 13, "{head}");
    }
}

#[test]
fn an_empty_model_gives_a_page_without_empty_sections() {
    let page = render(&ReportModel::default());
    markup::check(&page);
    assert_eq!(page.matches("<section").count(), 0);
}

#[test]
fn elements_are_closed_ids_are_unique_and_links_lead_somewhere() {
    markup::check(&sample_page());
}

#[test]
fn nothing_is_loaded_from_elsewhere() {
    let page = sample_page();
    for forbidden in ["http:", "https:", "//cdn", "@import", "url(", "src=", "<link", "<iframe", "<img"] {
        assert!(!page.contains(forbidden), "{forbidden} found");
    }
}

#[test]
fn names_from_recordings_cannot_become_markup() {
    let hostile = r#""><script>alert('x')</script></script><svg/onload=1>&amp;"#;
    let page = render(&sample::model_named(hostile));
    markup::check(&page);
    assert!(!page.contains("<script>alert") && !page.contains("<svg/onload"));
    assert_eq!(page.matches("<script").count(), render(&sample::model()).matches("<script").count());
}

#[test]
fn equal_models_give_equal_bytes() {
    assert_eq!(render(&sample::model()), render(&sample::model()));
}

#[test]
fn figures_are_files_of_their_own() {
    let figures = figures(&sample::model());
    let names: Vec<&str> = figures.iter().map(|figure| figure.name.as_str()).collect();
    for name in ["curve-verified-scenarios.svg", "distribution-speed.svg", "scene-cut_in-2.svg", "scene-masks.svg"] {
        assert!(names.contains(&name), "{name} is not among {names:?}");
    }
    for FigureFile { name, svg } in &figures {
        markup::check_svg(svg);
        assert!(svg.contains("xmlns=") && svg.contains("<style>"), "{name} does not stand alone");
        assert!(!svg.contains("NaN") && !svg.contains("href"), "{name}");
    }
}
