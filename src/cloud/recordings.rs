//! The recordings in a bucket, and their places on disk once they are downloaded.

use super::ObjectUrl;
use super::bucket::{Bucket, Object};
use super::cache::{hash_of, place_of};
use super::error::{Error, Result};
use super::side_by_side::side_by_side;
use crate::files::call;
use std::path::{Path, PathBuf};

/// An object, or all objects below a prefix, as they were when they were listed.
#[derive(Debug)]
pub struct Recordings {
    bucket: Bucket,
    /// The objects; one without a name is the URL itself.
    objects: Vec<Object>,
}

impl Recordings {
    /// The recordings at a URL; `None` for a path on disk. Nothing is downloaded.
    ///
    /// # Errors
    /// [`Error::Missing`]; errors of the store.
    pub fn at(path: &Path) -> Result<Option<Self>> {
        ObjectUrl::of(path)?.map(|url| Self::in_bucket(Bucket::open(url)?)).transpose()
    }

    fn in_bucket(bucket: Bucket) -> Result<Self> {
        let mut objects = bucket.list()?;
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
        let lengths: Vec<String> = self.objects.iter().map(|object| object.n_bytes.to_string()).collect();
        let parts =
            self.objects.iter().zip(&lengths).flat_map(|(object, n_bytes)| [&object.name, n_bytes, &object.etag]);
        hash_of(parts.map(String::as_str))
    }

    /// Their paths on disk, in folders named as in the bucket, which give their split. Downloads missing ones.
    ///
    /// # Errors
    /// On errors of the store or the disk, or if one was replaced since it was listed.
    pub fn on_disk(&self) -> Result<PathBuf> {
        let url = self.bucket.url();
        let place = place_of("inputs", url, &self.tag())?;
        side_by_side(&self.objects, &|object: &Object| {
            let to = if object.name.is_empty() { place.clone() } else { place.join(&object.name) };
            // Files have their final names only when they are whole.
            if fs_err::metadata(&to).is_ok_and(|metadata| metadata.len() == object.n_bytes) {
                return Ok(());
            }
            fs_err::create_dir_all(to.parent().unwrap_or(&place))?;
            match self.bucket.download(object, &to)? {
                true => Ok(()),
                false => Err(Error::Replaced { url: url.join(&object.name) }),
            }
        })?;
        call(&place, url.to_string());
        Ok(place)
    }
}
