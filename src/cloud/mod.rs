//! Recordings, run folders and corpora in object stores: `s3://`, `gs://`, `az://`.
//!
//! Everything else works on files. A [`Place`] is a folder on disk that the user named, or one that shows the content
//! of a bucket: the objects are downloaded into a cache and opened as files, and written files go to the bucket when
//! they are whole. This needs the feature `cloud`; without it, URLs are refused.
//!
//! # Why a kill does no harm
//!
//! The only copy that counts is the one in the bucket. Every process begins with a new view of it (`view`) and nothing
//! else, so the files of a killed process, on any machine, are forgotten. The bucket must always be a state that a run
//! folder could have after a kill, because the pipeline resumes from each of these:
//!
//! - **An object is whole.** A PUT, and the completion of an upload in parts, are atomic; a lost answer only leads to
//!   the same PUT again. So a name in the bucket is as final as one on disk after `AtomicFile`.
//! - **Workers** push each file when it gets its name: first the shard, then its record. They only add to the folder of
//!   their plan, as on disk. That several may make one shard costs time and nothing else: the bytes are the same. Marks
//!   of tries that two machines make at once may replace each other; then a shard that crashes its worker is tried more
//!   often. Nothing is claimed: conditional writes are not idempotent when they are repeated.
//! - **A stage at work** pushes its commits in their order, at most every 30 seconds (`push`). Every moment in the
//!   bucket was one on disk; a kill costs at most what came after it.
//! - **Finished outputs** replace earlier ones name by name, which takes a while: a journal says what belongs together
//!   if that is cut off (`journal`).
//!
//! # Whose files are touched
//!
//! A push writes and removes what the pipeline wrote and removed in the view. There, the rules for folders on disk
//! hold: files that no list of ours names are not touched, and since a view of a writing command shows every object,
//! the refusal comes before anything is written. Objects that others put into the bucket later are noticed by their
//! tags, and are not replaced.

#[cfg(feature = "cloud")]
mod bucket;
#[cfg(feature = "cloud")]
mod cache;
#[cfg(feature = "cloud")]
mod connect;
mod error;
#[cfg(feature = "cloud")]
mod journal;
#[cfg(feature = "cloud")]
mod mirrored;
#[cfg(not(feature = "cloud"))]
mod no_stores;
mod place;
#[cfg(feature = "cloud")]
mod push;
#[cfg(feature = "cloud")]
mod recordings;
#[cfg(feature = "cloud")]
mod redact;
#[cfg(feature = "cloud")]
mod side_by_side;
#[cfg(test)]
#[cfg(feature = "cloud")]
mod tests;
mod url;
#[cfg(feature = "cloud")]
mod view;

pub use error::{Error, Result};
pub use place::{Access, Place, use_cache_dir};
pub use url::{ObjectUrl, Scheme};

#[cfg(not(feature = "cloud"))]
pub use no_stores::Recordings;
#[cfg(feature = "cloud")]
pub use recordings::Recordings;

/// Whether this build can open URLs.
pub const IS_BUILT: bool = cfg!(feature = "cloud");
