//! Which facts of an event can a request name? Its parameters, the place, attributes of coverage, and classes of its
//! agents.

use super::config::{Divisions, Requirement};
use crate::behavior::{BehaviorEntry, BehaviorEvent};
use crate::coverage::{ATTRIBUTES, Attribute, Tags};
use crate::scene::{AgentClass, Scene};
use crate::settings::{self, Issue};

/// The place of a scene.
const PLACE: &str = "place";
/// The parameter whose numbers have names: +1 is the left side, -1 the right one.
pub(super) const SIDE: &str = "side";
const SIDES: [&str; 2] = ["left", "right"];
/// By how much later the careful driver could react in place of whom the event happens to, seconds.
pub(super) const CAREFUL_MARGIN: &str = "careful_margin_s";
/// The suffix of a role that names the class of its agent.
const CLASS_SUFFIX: &str = "_class";

/// Everything that a request for this behavior can name.
pub(super) fn known_names(behavior: &BehaviorEntry) -> Vec<String> {
    let parameters = behavior.parameters.iter().map(|name| (*name).to_owned());
    let classes = behavior.roles.iter().map(|role| format!("{role}{CLASS_SUFFIX}"));
    let attributes = ATTRIBUTES.iter().map(|attribute| attribute.name.to_owned());
    parameters.chain(classes).chain(attributes).chain([PLACE, CAREFUL_MARGIN].map(str::to_owned)).collect()
}

/// Refuses a name that is unknown, or that is used with numbers although its values are texts.
pub(super) fn check_name(behavior: &BehaviorEntry, name: &str, texts: Option<&[String]>) -> settings::Result {
    let refuse = |why: String| Err(Issue::new(name, why));
    let known = known_names(behavior);
    if !known.iter().any(|known| known == name) {
        let mut nearest = known;
        nearest.sort_by_key(|known| strsim::damerau_levenshtein(known, name));
        nearest.truncate(3);
        return refuse(format!("is not a parameter of {}; similar: {}", behavior.id, nearest.join(", ")));
    }
    let is_parameter = behavior.parameters.contains(&name) || name == CAREFUL_MARGIN;
    let Some(texts) = texts else {
        return if is_parameter { Ok(()) } else { refuse("holds text; give a list of strings".to_owned()) };
    };
    let values: Option<Vec<&str>> = match name {
        PLACE => None,
        SIDE => Some(SIDES.to_vec()),
        _ if is_parameter => return refuse("is a number; give numbers instead of strings".to_owned()),
        _ if attribute(name).is_some() => attribute(name).map(|(_, attribute)| attribute.values.to_vec()),
        _ => Some(AgentClass::ALL.into_iter().map(AgentClass::name).collect()),
    };
    let unknown = texts.iter().find(|text| values.as_ref().is_some_and(|values| !values.contains(&text.as_str())));
    match (unknown, values) {
        (Some(unknown), Some(values)) => {
            refuse(format!("cannot be `{unknown}`, expected one of {}", values.join(", ")))
        }
        _ => Ok(()),
    }
}

/// The attribute of coverage of this name, with its position.
fn attribute(name: &str) -> Option<(usize, &'static Attribute)> {
    ATTRIBUTES.iter().enumerate().find(|(_, attribute)| attribute.name == name)
}

/// The text of this name that all events of a scene have: its place, or a tag.
pub(super) fn text_of_scene<'a>(name: &str, scene: &'a Scene) -> Option<&'a str> {
    match attribute(name) {
        Some((idx, _)) => Some(Tags::of(scene).each()[idx].value()),
        None => (name == PLACE).then_some(scene.source.place.as_str()),
    }
}

/// The word for a side: +1 is the left one.
pub(super) const fn side(value: f64) -> &'static str {
    SIDES[(value < 0.0) as usize]
}

/// An event in the scene it was found in.
#[derive(Debug, Clone, Copy)]
pub(super) struct Facts<'a> {
    pub(super) scene: &'a Scene,
    pub(super) event: &'a BehaviorEvent,
    /// See [`CAREFUL_MARGIN`]; `None` also if nobody asks for it.
    pub(super) careful_margin_s: Option<f64>,
}

impl Facts<'_> {
    /// The part that the event belongs to. `None` if it belongs to none, or lacks the parameter.
    pub(super) fn part(&self, name: &str, divisions: &Divisions) -> Option<usize> {
        match divisions {
            Divisions::Edges(edges) => {
                let value = self.number(name)?;
                edges.windows(2).position(|edges| (edges[0]..edges[1]).contains(&value))
            }
            Divisions::Texts(texts) => {
                let own = self.text(name)?;
                texts.iter().position(|text| *text == own)
            }
        }
    }

    /// Whether the event satisfies a condition; false if the event lacks the parameter.
    pub(super) fn satisfies(&self, name: &str, condition: &Requirement) -> bool {
        match condition {
            Requirement::Range([least, most]) => {
                self.number(name).is_some_and(|value| (*least..=*most).contains(&value))
            }
            Requirement::Texts(texts) => self.text(name).is_some_and(|own| texts.iter().any(|text| *text == own)),
        }
    }

    fn number(&self, name: &str) -> Option<f64> {
        match name {
            CAREFUL_MARGIN => self.careful_margin_s,
            _ => self.event.parameters.get(name).copied(),
        }
    }

    fn text(&self, name: &str) -> Option<&str> {
        match name {
            SIDE => Some(side(self.number(SIDE)?)),
            _ if text_of_scene(name, self.scene).is_some() => text_of_scene(name, self.scene),
            _ => {
                let track = self.event.track(name.strip_suffix(CLASS_SUFFIX)?)?;
                Some(self.scene.tracks[self.scene.track_idx(track)?].class.name())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{self, EventLabel};
    use crate::scene::testing::{Drive, scene};

    fn cut_in() -> &'static BehaviorEntry {
        behavior::ALL.iter().find(|entry| entry.id == "cut_in").unwrap()
    }

    #[test]
    fn names_and_texts_are_checked_and_the_nearest_are_told() {
        let texts = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        let refusal = |name: &str, of: Option<&[String]>| check_name(cut_in(), name, of).unwrap_err().to_string();
        assert!(refusal("gap", None).contains("gap_m"), "{}", refusal("gap", None));
        assert!(refusal("relativ_speed_mps", None).contains("similar: relative_speed_mps"));
        assert!(refusal("place", None).contains("holds text"));
        assert!(refusal("gap_m", Some(&texts(&["small"]))).contains("is a number"));
        assert!(refusal("side", Some(&texts(&["above"]))).contains("left, right"));
        assert!(refusal("ego_class", Some(&texts(&["lorry"]))).contains("vehicle"));
        assert!(refusal("junction", Some(&texts(&["bridge"]))).contains("roundabout"));
        for (name, of) in [("gap_m", None), ("side", None)] {
            check_name(cut_in(), name, of).unwrap();
        }
        for (name, of) in [("side", "left"), ("place", "anywhere"), ("other_class", "bus"), ("junction", "merge")] {
            check_name(cut_in(), name, Some(&texts(&[of]))).unwrap();
        }
    }

    #[test]
    fn intervals_hold_their_lower_edge_and_conditions_both() {
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 5.0), Drive::straight(0.0, 4.0, 0.0, 5.0)]);
        let event = BehaviorEvent::new(("cut_in", cut_in().roles), &scene, EventLabel::Positive, &[0, 1], 5..=7)
            .with("gap_m", 5.0)
            .with("side", -1.0);
        let facts = Facts { scene: &scene, event: &event, careful_margin_s: Some(0.4) };
        let texts = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        let edges = |edges: &[f64]| Divisions::Edges(edges.to_vec());
        assert_eq!(facts.part("gap_m", &edges(&[0.0, 5.0, 10.0])), Some(1));
        assert_eq!(facts.part("gap_m", &edges(&[0.0, 4.0, 5.0])), None);
        assert_eq!(facts.part("ttc_s", &edges(&[0.0, 100.0])), None, "absent");
        assert_eq!(facts.part("side", &Divisions::Texts(texts(&["left", "right"]))), Some(1));
        assert_eq!(facts.part("side", &edges(&[-2.0, 0.0, 2.0])), Some(0));
        assert_eq!(facts.part(CAREFUL_MARGIN, &edges(&[0.0, 0.3, 1.0])), Some(1));
        let place = scene.source.place.clone();
        assert_eq!(facts.part("place", &Divisions::Texts(vec!["elsewhere".into(), place])), Some(1));
        assert_eq!(facts.part("junction", &Divisions::Texts(texts(&["merge", "none"]))), Some(1));
        assert!(facts.satisfies("gap_m", &Requirement::Range([5.0, 6.0])));
        assert!(facts.satisfies("gap_m", &Requirement::Range([4.0, 5.0])));
        assert!(!facts.satisfies("gap_m", &Requirement::Range([5.1, 6.0])));
        assert!(!facts.satisfies("side", &Requirement::Texts(texts(&["left"]))));
        assert!(facts.satisfies("other_class", &Requirement::Texts(texts(&["bus", "vehicle"]))));
    }
}
