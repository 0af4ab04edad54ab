//! The recordings in a bucket, and their places on disk once they are downloaded.

use super::ObjectUrl;
use super::bucket::{Bucket, Object};
use super::cache::{Cache, Content, name_of};
use super::error::{Error, Result};
use super::place::cache_dir;
use super::side_by_side::side_by_side;
use crate::files::call;
use std::path::{Path, PathBuf};

/// An object, or all objects below a prefix, as they were when they were listed.
#[derive(Debug)]
pub struct Recordings {
    pub(super) bucket: Bucket,
    /// The objects; one without a name is the URL itself.
    pub(super) objects: Vec<Object>,
}

impl Recordings {
    /// The recordings at a URL; `None` for a path on disk. Nothing is downloaded.
    ///
    /// # Errors
    /// [`Error::Missing`]; errors of the store.
    pub fn at(path: &Path) -> Result<Option<Self>> {
        ObjectUrl::of(path)?.map(|url| Self::in_bucket(Bucket::open(&url)?)).transpose()
    }

    pub(super) fn in_bucket(bucket: Bucket) -> Result<Self> {
        let mut objects = bucket.list("")?;
        if objects.is_empty() {
            objects.extend(bucket.itself()?);
        }
        match objects.is_empty() {
            true => Err(Error::Missing { url: bucket.url().clone() }),
            false => Ok(Self { bucket, objects }),
        }
    }

    /// A tag that changes whenever one of the recordings does.
    pub fn tag(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        for Object { name, n_bytes, etag, .. } in &self.objects {
            for part in [name.as_str(), &n_bytes.to_string(), etag] {
                hasher.update(&(part.len() as u64).to_le_bytes());
                hasher.update(part.as_bytes());
            }
        }
        hasher.finalize().to_hex()[..32].to_owned()
    }

    /// Their paths on disk, in folders named as in the bucket, which give their split. Downloads missing ones.
    ///
    /// # Errors
    /// On errors of the store or the disk, or if one was replaced since it was listed.
    pub fn on_disk(&self) -> Result<PathBuf> {
        self.in_cache(&Cache::of_process(cache_dir())?)
    }

    pub(super) fn in_cache(&self, cache: &Cache) -> Result<PathBuf> {
        let url = self.bucket.url();
        let folder = cache.folder("inputs")?.join(name_of(url, &self.tag())).join(&url.bucket);
        let place = folder.join(&url.key);
        side_by_side(&self.objects, &|object| {
            let to = if object.name.is_empty() { place.clone() } else { place.join(&object.name) };
            if fs_err::metadata(&to).is_ok_and(|metadata| metadata.len() == object.n_bytes) {
                return Ok(());
            }
            let found = cache.bring(&self.bucket, object, &to, Content::Shared)?;
            match found.etag == object.etag {
                true => Ok(()),
                false => Err(Error::Replaced { url: url.join(&object.name) }),
            }
        })?;
        call(&place, url.to_string());
        Ok(place)
    }
}
