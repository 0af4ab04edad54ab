//! The tracks that play the parts of a behavior.

use super::TrackId;
use serde::{Deserialize, Serialize};
use std::ops::Deref;

/// The tracks that play a part in an event, as (role, track), in the behavior's order of roles.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Roles(Vec<(String, TrackId)>);

impl Roles {
    /// An empty set of roles.
    pub const fn none() -> &'static Self {
        static NONE: Roles = Roles(Vec::new());
        &NONE
    }

    /// The track in this role.
    pub fn track(&self, role: &str) -> Option<&TrackId> {
        self.iter().find(|(name, _)| name == role).map(|(_, track)| track)
    }

    /// The role of this track.
    pub fn role_of(&self, track: &TrackId) -> Option<&str> {
        self.iter().find(|(_, id)| id == track).map(|(role, _)| role.as_str())
    }

    /// The names of the roles, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.iter().map(|(role, _)| role.as_str())
    }

    /// The tracks, in the order of their roles.
    pub fn tracks(&self) -> impl Iterator<Item = &TrackId> {
        self.iter().map(|(_, track)| track)
    }
}

impl Deref for Roles {
    type Target = [(String, TrackId)];

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl FromIterator<(String, TrackId)> for Roles {
    fn from_iter<I: IntoIterator<Item = (String, TrackId)>>(roles: I) -> Self {
        Self(roles.into_iter().collect())
    }
}

impl<const N: usize> From<[(&str, &str); N]> for Roles {
    fn from(roles: [(&str, &str); N]) -> Self {
        roles.into_iter().map(|(role, track)| (role.to_owned(), track.into())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_and_tracks_are_found_by_each_other() {
        let roles = Roles::from([("ego", "7"), ("other", "3")]);
        assert_eq!((roles.track("other"), roles.role_of(&"7".into())), (Some(&"3".into()), Some("ego")));
        assert_eq!((roles.track("third"), roles.role_of(&"8".into())), (None, None));
        assert_eq!(serde_json::to_string(&roles).unwrap(), r#"[["ego","7"],["other","3"]]"#);
    }
}
