//! Makes a view available to all code that reads and writes files.

use super::bucket::Bucket;
use super::cache::{Cache, name_of};
use super::error::{Error, Result};
use super::view::View;
use super::{Access, ObjectUrl};
use crate::files::{self, Lock, mirror, unmirror};
use std::path::Path;
use std::sync::Arc;

/// A view that code for files finds by its path.
#[derive(Debug)]
pub(super) struct Mirrored {
    pub(super) view: Arc<View>,
    /// Excludes other processes of this machine that would write there.
    _alone: Option<Lock>,
}

impl Mirrored {
    /// Shows the content of a URL to all code that reads and writes files.
    ///
    /// # Errors
    /// [`Error::Busy`] when another process of this machine writes there; as [`View::open`].
    pub(super) fn open(url: &ObjectUrl, access: Access, cache_dir: Option<&Path>) -> Result<Self> {
        Self::of(Bucket::open(url)?, Cache::of_process(cache_dir)?, access)
    }

    /// The view of a bucket that is open.
    pub(super) fn of(bucket: Bucket, cache: Cache, access: Access) -> Result<Self> {
        let alone = (access == Access::Write).then(|| lock(&cache, bucket.url())).transpose()?;
        let view = Arc::new(View::open(bucket, cache, access)?);
        mirror(&view.root, view.bucket.url().to_string(), Arc::<View>::clone(&view));
        Ok(Self { view, _alone: alone })
    }

    /// Its path.
    pub(super) fn path(&self) -> &Path {
        &self.view.root
    }

    /// Pushes all remaining changes, unless the store has failed before.
    pub(super) fn finish(&self) -> Result<()> {
        let state = &mut *self.view.state();
        if self.view.access == Access::Write && !state.is_broken { self.view.push(state) } else { Ok(()) }
    }
}

impl Drop for Mirrored {
    fn drop(&mut self) {
        unmirror(&self.view.root);
    }
}

/// Excludes other processes of this machine from a folder of objects.
fn lock(cache: &Cache, url: &ObjectUrl) -> Result<Lock> {
    let place = cache.folder("locks")?.join(name_of(url, ""));
    Lock::beside(&place).map_err(|error| match error {
        files::Error::Busy { holder, .. } => Error::Busy { url: url.clone(), holder },
        error => error.into(),
    })
}
