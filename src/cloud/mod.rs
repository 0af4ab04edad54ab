//! Recordings from object stores, and results to them: `s3://`, `gs://`.
//!
//! Everything works on files. [`Recordings`] are downloaded before they are read, and a run whose [`Output`] is a URL
//! works in a folder of this machine, whose files are copied when it ends. Downloads and such folders are in the cache
//! (`cache`). This needs the feature `cloud`; without it, URLs are refused.

#[cfg(feature = "cloud")]
mod bucket;
mod cache;
#[cfg(feature = "cloud")]
mod connect;
#[cfg(feature = "cloud")]
mod copy;
mod error;
#[cfg(not(feature = "cloud"))]
mod no_stores;
mod output;
#[cfg(feature = "cloud")]
mod recordings;
#[cfg(feature = "cloud")]
mod redact;
#[cfg(feature = "cloud")]
mod side_by_side;
mod url;

pub use cache::use_cache_dir;
pub use error::{Error, Result};
pub use output::Output;
pub use url::{ObjectUrl, Scheme};

#[cfg(not(feature = "cloud"))]
pub use no_stores::Recordings;
#[cfg(feature = "cloud")]
pub use recordings::Recordings;

/// Whether this build can open URLs.
pub const IS_BUILT: bool = cfg!(feature = "cloud");
