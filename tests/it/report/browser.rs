//! Does the page work in a browser: do scenes play, do filters filter, and is nothing wrong on the console?

use super::chromium::Page;
use super::{markup, sample};
use djinn::report::{ReportModel, render};
use serde_json::json;

const STEP: &str = "Number(document.querySelector('#scene-0 .player input').value)";
const SHOWN_IDS: &str =
    "[...document.querySelectorAll('article.card')].filter((card) => card.checkVisibility()).map((card) => card.id)";
const SHOWN: &str = "[...document.querySelectorAll('article.card')].filter((card) => card.checkVisibility()).length";

/// How the car of track `id` is drawn in a panel of a scene.
fn drawn(scene: usize, panel: usize, id: &str, attribute: &str) -> String {
    format!(
        "[...document.querySelectorAll('#scene-{scene} figure')][{panel}].querySelector('[data-sample=\"0\"]')\
         .querySelectorAll('.now').values() \
         .find((car) => car.textContent.endsWith('track {id}')).getAttribute('{attribute}')"
    )
}

#[test]
fn scenes_play_and_filters_filter_without_an_error() {
    let Some(mut page) = Page::open(&render(&sample::model())) else { return };

    // The keyboard plays the first scene. The car of track 3 drives 12.5 m/s from the origin at step 9.
    page.come_to("scene-0");
    page.value("document.querySelector('#scene-0 .panels').focus()");
    assert_eq!(page.value(STEP), json!(9));
    page.press("ArrowRight");
    assert_eq!(page.value(STEP), json!(10));
    assert_eq!(page.value(&drawn(0, 1, "3", "transform")), json!("translate(1.25 0) rotate(0)"));
    page.press(" ");
    page.wait_until(&format!("{STEP} >= 14"));
    page.press("Home");
    assert_eq!(page.value(STEP), json!(0), "whoever takes over stops it");
    page.press("End");
    assert_eq!(page.value(&drawn(0, 1, "3", "transform")), json!("translate(37.5 0) rotate(0)"));
    // At the end the other car is in the ego's lane where it was generated to be, and in its own in the recording.
    assert_eq!(page.value(&drawn(0, 0, "v17", "transform")), json!("translate(37.5 -3.5) rotate(0)"));
    assert_eq!(page.value(&drawn(0, 1, "v17", "transform")), json!("translate(37.5 0) rotate(0)"));
    let result = page.value("document.querySelector('#scene-0 .player output').textContent");
    assert_eq!(result, json!("3.0 s, step 40 of 40"));

    // Speed and distance over time are under the drawings, with a mark at the step that is shown.
    assert_eq!(
        page.value("[...document.querySelectorAll('#scene-0 .courses svg')].map((plot) => plot.ariaLabel)"),
        json!(["Speed (m/s) over time", "Distance (m) over time", "Time to collision (s) over time"])
    );
    let marks = "[...document.querySelectorAll('#scene-0 .cursor')].map((mark) => mark.getAttribute('transform'))";
    assert_eq!(page.value(marks), json!(vec!["translate(296 0)"; 3]));
    // The accepted scenario leads to its scene, and its table can be sorted.
    assert_eq!(page.value("document.querySelector('.sortable tbody a').hash"), json!("#scene-0"));
    page.value("document.querySelector('.sortable th button').click()");
    assert_eq!(page.value("document.querySelector('.sortable th').ariaSort"), json!("ascending"));
    let points = "document.querySelectorAll('#scatter circle').length";
    assert_eq!(page.value(points), json!(2));

    // Which states were given can be seen: of the third scene every fifth, and everything in its recording.
    page.come_to("scene-2");
    assert_eq!(page.value("document.querySelectorAll('#scene-2 .now').length"), json!(6 + 3 * 6));
    page.value("document.querySelector('#scene-2 .panels').focus()");
    assert_eq!(page.value(&drawn(2, 1, "3", "class")), json!("now"));
    page.press("ArrowRight");
    assert_eq!(page.value(&drawn(2, 1, "3", "class")), json!("now made"));
    assert_eq!(page.value(&drawn(2, 0, "3", "class")), json!("now"));
    let choose =
        "(choice => { choice.value = '1'; choice.onchange(); })(document.querySelector('#scene-2 .player select'))";
    page.value(choose);
    assert_eq!(
        page.value("document.querySelector('#scene-2 figure + figure [data-sample=\"0\"]').style.display"),
        json!("none")
    );

    // Filters choose, announce and write into the address; the address chooses.
    assert_eq!(page.value(SHOWN), json!(3));
    let set = |name: &str, value: &str| {
        format!(
            "(field => {{ field.value = '{value}'; field.dispatchEvent(new Event('input', {{ bubbles: true }})); }})\
             (document.querySelector('#filters [name=\"{name}\"]'))"
        )
    };
    page.value(&set("sweep", "masks"));
    assert_eq!(page.value(SHOWN), json!(1));
    assert_eq!(page.value("document.querySelector('#found').textContent"), json!("1 of 3 scenes are shown."));
    assert_eq!(page.value("location.hash"), json!("#scenes&sweep=masks"));
    page.value("document.querySelector('#show-all').click()");

    // Decisions: accepted, rejected, and rejected for a reason. What nothing was decided of is neither.
    for (decision, shown) in
        [("accepted", json!(["scene-0"])), ("rejected", json!(["scene-1"])), ("rejected.yaw_rate", json!(["scene-1"]))]
    {
        page.value(&set("decision", decision));
        assert_eq!(page.value(SHOWN_IDS), shown, "{decision}");
    }
    assert_eq!(page.value("location.hash"), json!("#scenes&decision=rejected.yaw_rate"));
    page.value("document.querySelector('#show-all').click()");
    assert_eq!(page.value(SHOWN), json!(3));

    // Ranges are in groups, which are closed at first and say how many of their fields are set.
    let groups = "[...document.querySelectorAll('#filters summary')].map((title) => title.textContent)";
    assert_eq!(page.value(groups), json!(["The event 1 figure ", "How valid 1 figure "]));
    assert_eq!(page.value("document.querySelectorAll('#filters details[open]').length"), json!(0));
    page.value(&set("gap_m.min", "4.5"));
    assert_eq!(page.value(groups), json!(["The event 1 figure 1 set", "How valid 1 figure "]));
    assert_eq!(page.value("document.querySelector('#scene-1').checkVisibility()"), json!(true));
    assert_eq!(page.value(SHOWN), json!(1));
    page.value("location.hash = '#scenes&verdict=new&gap_m.max=4.5'");
    page.wait_until(
        "document.querySelector('#scene-0').checkVisibility() && document.querySelector('#filters details').open",
    );
    assert_eq!(page.value(SHOWN), json!(1));
    page.value("location.hash = '#scenes&gap_m.min=99'");
    page.wait_until(&format!("{SHOWN} === 0"));
    page.value("dispatchEvent(new Event('beforeprint'))");
    assert_eq!(page.errors(), [""; 0]);
}

#[test]
fn thousands_of_scenes_are_light() {
    let scenes: Vec<_> = (0..2000).map(|i| sample::card(i, "v17", (i % 10) as f64 / 10.0, 0.001 * i as f64)).collect();
    let page = render(&ReportModel { scenes, ..ReportModel::default() });
    markup::check(&page);
    let per_scene = page.len() / 2000;
    assert!(per_scene < 6000, "{per_scene} bytes a scene");
    fs_err::write(std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("report-2000.html"), &page).unwrap();
    let Some(mut page) = Page::open(&page) else { return };
    page.come_to("scene-0");
    let n_elements = page.value("document.querySelectorAll('*').length").as_u64().unwrap();
    assert!(n_elements < 30_000, "{n_elements} elements");
    // A card that comes into view is drawn, and one that is far away is taken down again.
    page.come_to("scene-1500");
    page.wait_until("document.querySelector('#scene-0 .player') === null");
    assert!(page.value("document.querySelectorAll('.player').length").as_u64().unwrap() < 30);
    page.value("location.hash = '#scenes&verdict=not_verified'");
    page.wait_until(&format!("{SHOWN} === 1000"));
    assert_eq!(page.errors(), [""; 0]);
}

#[test]
fn pages_without_scenes_have_the_script_of_tables_alone() {
    let Some(mut page) = Page::open(&render(&ReportModel::default())) else { return };
    assert_eq!(page.value("document.scripts.length"), json!(1));
    assert_eq!(page.errors(), [""; 0]);
}

#[test]
fn tables_hide_nothing_on_a_narrow_page() {
    let Some(mut page) = Page::open(&render(&sample::model())) else { return };
    for width in ["73rem", "24rem"] {
        page.value(&format!("document.body.style.width = '{width}'; dispatchEvent(new Event('resize'))"));
        let hiding = "[...document.querySelectorAll('.scroll')].filter((e) => e.scrollWidth > e.clientWidth).length";
        assert_eq!(page.value(hiding), json!(0), "at a width of {width}");
    }
    // The label of a cell stands beside it.
    assert!(page.value("document.querySelectorAll('.cards').length").as_u64().unwrap() > 0);
    assert_eq!(page.value("document.querySelectorAll('.cards td:not([data-label])').length"), json!(0));
    assert_eq!(page.errors(), [""; 0]);
}
