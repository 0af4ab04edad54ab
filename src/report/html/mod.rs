//! The page: its sections in their order, and the frame around them.

mod coverage;
mod data;
mod drives;
mod outcome;
mod plain;
mod quality;
mod rates;
mod request_gallery;
mod request_grid;
mod requests;
mod scenes;
mod summary;
mod tradeoffs;
mod training;
mod verdict;

pub use drives::render_drives;

use super::distinguishability;
use super::model::{Fact, ReportModel};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use std::borrow::Cow;

const STYLE: &str = include_str!("style.css");
const DRAWING_STYLE: &str = include_str!("../svg/drawing.css");
const PLAYER: &str = include_str!("player.js");
const FILTERS: &str = include_str!("filters.js");
const SCATTER: &str = include_str!("scatter.js");
const COURSES: &str = include_str!("courses.js");
const TABLES: &str = include_str!("tables.js");

/// A part of the page with an entry in the table of contents.
struct Section {
    id: Cow<'static, str>,
    title: Cow<'static, str>,
    body: Markup,
}

impl Section {
    fn new(id: impl Into<Cow<'static, str>>, title: impl Into<Cow<'static, str>>, body: Markup) -> Self {
        Self { id: id.into(), title: title.into(), body }
    }
}

/// The report as one self-contained HTML file: equal models give equal bytes.
pub fn render(model: &ReportModel) -> String {
    let first = [
        warnings(model),
        scenes::section(model),
        outcome::section(model),
        requests::section(model),
        verdict::section(model),
        distinguishability::section(&model.evaluation).as_ref().map(plain::section),
        coverage::section(model),
        tradeoffs::section(model),
        quality::metrics(model),
        quality::distributions(model),
    ];
    let last = [
        training::networks(model),
        training::classifier(model),
        rates::section(model),
        data::mining(model),
        data::ingest(model),
        config(model),
    ];
    let more = model.more.iter().map(|section| Some(plain::section(section)));
    let sections: Vec<Section> = first.into_iter().chain(more).chain(last).flatten().collect();
    let scripts = (!model.scenes.is_empty())
        .then(|| html! { script { @for part in [COURSES, PLAYER, SCATTER, FILTERS] { (PreEscaped(part)) } } });
    page(&model.title, &head(model), &sections, &scripts.unwrap_or_default())
}

/// The part before the contents: the run at a glance, and its facts.
fn head(model: &ReportModel) -> Markup {
    html! {
        (summary::summary(model))
        @if !model.facts.is_empty() { details { summary { "About this run" } (facts(&model.facts)) } }
    }
}

/// A whole page: its frame around the sections.
fn page(title: &str, head: &Markup, sections: &[Section], scripts: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) " – djinn report" }
                style { (PreEscaped(STYLE)) (PreEscaped(DRAWING_STYLE)) }
            }
            body {
                a class="skip" href="#main" { "Skip to the content" }
                header {
                    h1 { (title) }
                    (head)
                }
                nav aria-label="Contents" {
                    ol { @for section in sections { li { a href=(format!("#{}", section.id)) { (section.title) } } } }
                }
                main id="main" {
                    @for section in sections {
                        section id=(section.id) aria-labelledby=(format!("{}-title", section.id)) {
                            h2 id=(format!("{}-title", section.id)) { (section.title) }
                            (section.body)
                        }
                    }
                }
                footer {
                    p {
                        "Written by djinn " (env!("CARGO_PKG_VERSION"))
                        ". Lengths in meters, times in seconds, angles in radians unless a heading says otherwise."
                    }
                }
                script { (PreEscaped(TABLES)) }
                (scripts)
            }
        }
    };
    page.into_string()
}

/// The section; `None` without warnings, which the summary states.
fn warnings(model: &ReportModel) -> Option<Section> {
    (!model.warnings.is_empty()).then(|| {
        let body = html! {
            ul class="warnings" {
                @for warning in &model.warnings { li { strong { (warning.stage) } " " (warning.message) } }
            }
        };
        Section::new("warnings", "Warnings", body)
    })
}

fn config(model: &ReportModel) -> Option<Section> {
    (!model.config.is_empty()).then(|| {
        let body = html! {
            p { "The resolved configuration. Running it again with the same program and inputs gives the same bytes." }
            details { summary { "All settings" } pre tabindex="0" { code { (model.config) } } }
        };
        Section::new("config", "Configuration", body)
    })
}

/// Names and values in two columns.
fn facts(facts: &[Fact]) -> Markup {
    html! {
        @if !facts.is_empty() {
            dl class="facts" { @for fact in facts { div { dt { (fact.name) } dd { (fact.value) } } } }
        }
    }
}

/// A table with these rows in its `head` and `body`. A script rearranges it if the page is too narrow; without scripts
/// it scrolls.
fn table(caption: &str, head: &Markup, body: &Markup) -> Markup {
    html! {
        div class="scroll" tabindex="0" role="region" aria-label=(caption) {
            table {
                caption { (caption) }
                thead { (head) }
                tbody { (body) }
            }
        }
    }
}
