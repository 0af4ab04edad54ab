//! The drawings of a report as files, for papers.

use super::card::{CardKey, SceneCard, Verdict};
use super::model::ReportModel;
use super::svg::{chart_file, distribution_file, scene_file};
use super::tradeoffs::tradeoffs;
use crate::scene::{GuidanceLevel, Roles, Scene};
use std::collections::BTreeSet;

/// The most scenes that become files: the first ones on the page.
const MAX_SCENES: usize = 40;

/// A figure as a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FigureFile {
    /// Its name, such as `curve-verified-scenarios.svg`; unique among the figures of a report.
    pub name: String,
    /// Its content.
    pub svg: String,
}

/// A recorded scene from above.
pub fn drawing_of_recording(scene: &Scene) -> String {
    let title = format!("recorded, {}", scene.id);
    let key = CardKey {
        sweep: String::new(),
        behavior: None,
        bucket: None,
        place: scene.source.place.clone(),
        verdict: Verdict::NotAsked,
        acceptance: None,
        level: GuidanceLevel::UNGUIDED,
        values: Vec::new(),
    };
    scene_file(&SceneCard::new((scene.id.0.clone(), title), key, Vec::new(), scene, &[], &Roles::default()))
}

/// The curves over guidance strength, the distributions, the curves of training, and the first scenes.
pub fn figures(model: &ReportModel) -> Vec<FigureFile> {
    let mut files = Files::default();
    for chart in tradeoffs(&model.evaluation) {
        files.add(&["curve", &chart.title], chart_file(&chart));
    }
    for distribution in &model.distributions {
        files.add(&["distribution", &distribution.title], distribution_file(distribution));
    }
    for network in &model.training {
        for chart in &network.charts {
            files.add(&["training", &network.name, &chart.title], chart_file(chart));
        }
    }
    for section in &model.more {
        for chart in &section.charts {
            files.add(&[&section.id, &chart.title], chart_file(chart));
        }
    }
    for card in model.scenes.iter().take(MAX_SCENES) {
        files.add(&["scene", &card.key.sweep], scene_file(card));
    }
    files.found
}

#[derive(Default)]
struct Files {
    taken: BTreeSet<String>,
    found: Vec<FigureFile>,
}

impl Files {
    /// Adds a figure; a duplicate name gets a number.
    fn add(&mut self, words: &[&str], svg: String) {
        let stem = words.iter().map(|word| file_name(word)).collect::<Vec<_>>().join("-");
        let numbered = (2..).map(|n| format!("{stem}-{n}.svg"));
        let mut names = std::iter::once(format!("{stem}.svg")).chain(numbered);
        if let Some(name) = names.find(|name| !self.taken.contains(name)) {
            self.taken.insert(name.clone());
            self.found.push(FigureFile { name, svg });
        }
    }
}

/// The text as a part of a file name: letters, digits and single hyphens.
fn file_name(text: &str) -> String {
    let mut name = String::new();
    for c in text.to_lowercase().chars() {
        if c.is_ascii_alphanumeric() || c == '_' {
            name.push(c);
        } else if !name.is_empty() && !name.ends_with('-') {
            name.push('-');
        }
    }
    name.trim_end_matches('-').chars().take(60).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_safe_and_unique() {
        let mut files = Files::default();
        for title in ["Vehicles off the road", "../../etc: α = 2", "Vehicles, off the road"] {
            files.add(&["curve", title], String::new());
        }
        let names: Vec<&str> = files.found.iter().map(|file| file.name.as_str()).collect();
        assert_eq!(names, ["curve-vehicles-off-the-road.svg", "curve-etc-2.svg", "curve-vehicles-off-the-road-2.svg"]);
    }
}
