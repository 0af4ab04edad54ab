//! Parses URLs such as `s3://bucket/key`, and tells them from paths.

use crate::files::PathRelation;
use crate::settings::Unreadable;
use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// The kinds of object stores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Scheme {
    /// Amazon S3, and whatever speaks its protocol.
    S3,
    /// Google Cloud Storage.
    Gs,
}

impl Scheme {
    const ALL: [Self; 2] = [Self::S3, Self::Gs];

    const fn prefix(self) -> &'static str {
        match self {
            Self::S3 => "s3://",
            Self::Gs => "gs://",
        }
    }
}

/// An object, or a prefix that serves as a folder.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObjectUrl {
    /// The kind of store.
    pub scheme: Scheme,
    /// The bucket.
    pub bucket: String,
    /// The key after the bucket, without slashes at its ends; empty for the whole bucket.
    pub key: String,
}

impl ObjectUrl {
    /// The URL in a path; `None` for a path on disk.
    ///
    /// # Errors
    /// When it begins like a URL and is not a valid one.
    pub fn of(path: &Path) -> Result<Option<Self>, Unreadable> {
        if !Self::is_meant(path) {
            return Ok(None);
        }
        path.to_str().ok_or_else(|| "the URL is not valid UTF-8".into()).and_then(str::parse).map(Some)
    }

    /// Whether the path begins as a URL of an object store.
    pub fn is_meant(path: &Path) -> bool {
        let text = path.to_string_lossy();
        Scheme::ALL.iter().any(|scheme| text.starts_with(scheme.prefix()))
    }

    /// The relation of this URL to `other`, if they overlap. Prefixes are folders: `a/b` contains `a/b/c` and not
    /// `a/bc`.
    pub fn relation_to(&self, other: &Self) -> Option<PathRelation> {
        let contains = |outer: &str, inner: &str| {
            outer.is_empty() || inner.strip_prefix(outer).is_some_and(|rest| rest.starts_with('/'))
        };
        match (self.scheme, &self.bucket) == (other.scheme, &other.bucket) {
            true if self.key == other.key => Some(PathRelation::Same),
            true if contains(&other.key, &self.key) => Some(PathRelation::Inside),
            true if contains(&self.key, &other.key) => Some(PathRelation::Contains),
            _ => None,
        }
    }

    /// The object below this one under a relative name; this one itself for an empty name.
    #[must_use]
    pub fn join(&self, name: &str) -> Self {
        let parts = [self.key.as_str(), name].into_iter().filter(|part| !part.is_empty());
        Self { key: parts.collect::<Vec<_>>().join("/"), ..self.clone() }
    }
}

impl FromStr for ObjectUrl {
    type Err = Unreadable;

    fn from_str(text: &str) -> Result<Self, Unreadable> {
        let split = Scheme::ALL.into_iter().find_map(|scheme| Some((scheme, text.strip_prefix(scheme.prefix())?)));
        let Some((scheme, rest)) = split else {
            return Err("expected a URL such as s3://bucket/folder or gs://bucket/folder".into());
        };
        let (bucket, key) = rest.split_once('/').unwrap_or((rest, ""));
        // A refused name is not shown: it may be a password.
        if bucket.is_empty() || !bucket.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._-".contains(&byte)) {
            let message = format!(
                "expected {}bucket/folder: a bucket of letters, digits, dots and dashes, and no credentials; they come \
                 from the environment",
                scheme.prefix()
            );
            return Err(Unreadable(message));
        }
        let key = key.trim_matches('/');
        if !key.is_empty() && key.split('/').any(|part| matches!(part, "" | "." | "..")) {
            return Err("a URL of an object store has no empty parts, and none called `.` or `..`".into());
        }
        if key.chars().any(|c| c.is_control() || matches!(c, '\\' | '?' | '#')) {
            return Err("a URL of an object store has no control characters, and none of `\\`, `?` and `#`".into());
        }
        Ok(Self { scheme, bucket: bucket.to_owned(), key: key.to_owned() })
    }
}

impl fmt::Display for ObjectUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let slash = if self.key.is_empty() { "" } else { "/" };
        write!(f, "{}{}{slash}{}", self.scheme.prefix(), self.bucket, self.key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn url(text: &str) -> ObjectUrl {
        text.parse().unwrap()
    }

    #[test]
    fn urls_are_told_from_paths() {
        for path in ["output", "/data/s3/x.zip", "./s3:/x", "https://host/x", "s3:/bucket/x"] {
            assert_eq!(ObjectUrl::of(Path::new(path)).unwrap(), None, "{path}");
        }
        for (text, bucket, key, shown) in [
            ("s3://b", "b", "", "s3://b"),
            ("gs://b-1.x/", "b-1.x", "", "gs://b-1.x"),
            ("gs://b/a/c d.zip", "b", "a/c d.zip", "gs://b/a/c d.zip"),
            ("s3://b/a/", "b", "a", "s3://b/a"),
        ] {
            let found = ObjectUrl::of(Path::new(text)).unwrap().unwrap();
            assert_eq!((found.bucket.as_str(), found.key.as_str(), found.to_string().as_str()), (bucket, key, shown));
        }
        assert_eq!(url("s3://b").join("a/b"), url("s3://b/a/b"));
        assert_eq!(url("s3://b/a").join(""), url("s3://b/a"));
    }

    #[test]
    fn what_is_no_url_is_refused_and_passwords_are_not_repeated() {
        for text in ["s3://", "s3:///x", "s3://b/a//c", "s3://b/../c", "s3://b/a?x=1", "gs://b/a\u{7}"] {
            assert!(ObjectUrl::of(Path::new(text)).is_err(), "{text}");
        }
        let error = ObjectUrl::of(Path::new("s3://key:hunter2@b/x")).unwrap_err().to_string();
        assert!(error.contains("no credentials") && !error.contains("hunter2"), "{error}");
    }

    #[test]
    fn prefixes_overlap_like_folders() {
        for (a, b, expected) in [
            ("s3://b/x", "s3://b/x/", Some(PathRelation::Same)),
            ("s3://b/x/y", "s3://b/x", Some(PathRelation::Inside)),
            ("s3://b/x/y", "s3://b", Some(PathRelation::Inside)),
            ("s3://b", "s3://b/x", Some(PathRelation::Contains)),
            ("s3://b/x", "s3://b/xy", None),
            ("s3://b/x", "s3://c/x", None),
            ("s3://b/x", "gs://b/x", None),
        ] {
            assert_eq!(url(a).relation_to(&url(b)), expected, "{a} {b}");
        }
    }
}
