//! A folder of objects: lists it, and transfers whole files to and from it.
//!
//! Every action is repeated a few times, each time a little later. All of them may be repeated: an upload replaces an
//! object by the same bytes, even if an answer got lost; nothing is created on condition that it is missing.

use super::ObjectUrl;
use super::connect::{connect, runtime};
use super::error::{Error, Result};
use super::redact::redacted;
use crate::files::AtomicFile;
use futures_util::StreamExt;
use object_store::path::Path as Key;
use object_store::{Error as StoreError, ObjectMeta, ObjectStore, ObjectStoreExt, PutPayload};
use std::io::{Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The most attempts at an action.
const N_ATTEMPTS: usize = 6;
/// The wait after the first attempt; it doubles with each.
const FIRST_WAIT: Duration = Duration::from_millis(200);
/// Larger files are sent in parts of at least this size, bytes.
const PART_BYTES: u64 = 16 << 20;
/// The most parts of a file in S3.
const MAX_PARTS: u64 = 10_000;

/// A folder of objects: everything below one URL.
#[derive(Debug, Clone)]
pub(super) struct Bucket {
    store: Arc<dyn ObjectStore>,
    url: ObjectUrl,
}

/// An object, as it was when it was seen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Object {
    /// Its name, relative to the folder.
    pub(super) name: String,
    pub(super) n_bytes: u64,
    /// A tag that changes with its content.
    pub(super) etag: String,
}

impl Bucket {
    pub(super) fn open(url: ObjectUrl) -> Result<Self> {
        Ok(Self { store: connect(&url)?, url })
    }

    pub(super) const fn url(&self) -> &ObjectUrl {
        &self.url
    }

    /// All objects in it, sorted by name.
    pub(super) fn list(&self) -> Result<Vec<Object>> {
        let mut found = self.repeated("list", "", async || {
            let prefix = self.key("")?;
            let mut listed = self.store.list((!prefix.as_ref().is_empty()).then_some(&prefix));
            let mut found = Vec::new();
            while let Some(meta) = listed.next().await {
                found.push(meta?);
            }
            Ok(found)
        })?;
        found.sort_by(|a, b| a.location.cmp(&b.location));
        let objects: Vec<Object> = found.iter().map(|meta| self.object(meta)).collect::<Result<_>>()?;
        let is_folder = |object: &Object| {
            let inside = format!("{}/", object.name);
            let at = objects.partition_point(|other| other.name < inside);
            object.n_bytes == 0 && objects.get(at).is_some_and(|other| other.name.starts_with(&inside))
        };
        // Some tools make empty objects that stand for folders.
        Ok(objects.iter().filter(|object| !object.name.is_empty() && !is_folder(object)).cloned().collect())
    }

    /// The object that the URL itself names, if there is one.
    pub(super) fn itself(&self) -> Result<Option<Object>> {
        let head = async || match self.store.head(&self.key("")?).await {
            Err(StoreError::NotFound { .. }) => Ok(None),
            found => found.map(Some),
        };
        let found = if self.url.key.is_empty() { None } else { self.repeated("read", "", head)? };
        Ok(found.map(|meta| seen(&meta, String::new())))
    }

    /// Downloads an object to the file `to`, whose folder must exist; nothing is there unless it is whole. Returns
    /// whether it is still the one that was listed; nothing is written if it is not.
    pub(super) fn download(&self, listed: &Object, to: &Path) -> Result<bool> {
        self.repeated("read", &listed.name, async || {
            let result = self.store.get(&self.key(&listed.name)?).await?;
            if seen(&result.meta, listed.name.clone()) != *listed {
                return Ok(false);
            }
            let mut file = AtomicFile::create(to).map_err(on_disk)?;
            let mut stream = result.into_stream();
            while let Some(bytes) = stream.next().await {
                file.write_all(&bytes?).map_err(on_disk)?;
            }
            let n_received = file.stamp().n_bytes;
            if n_received != listed.n_bytes {
                let why = format!("{n_received} of {} bytes came", listed.n_bytes);
                return Err(StoreError::Generic { store: "download", source: why.into() });
            }
            file.commit().map_err(on_disk)?;
            Ok(true)
        })
    }

    /// The content of a small object, if it is there.
    pub(super) fn read(&self, name: &str) -> Result<Option<Vec<u8>>> {
        self.repeated("read", name, async || match self.store.get(&self.key(name)?).await {
            Err(StoreError::NotFound { .. }) => Ok(None),
            result => Ok(Some(result?.bytes().await?.to_vec())),
        })
    }

    /// Replaces an object by the content of a file.
    pub(super) fn upload(&self, name: &str, from: &Path) -> Result<()> {
        let n_bytes = fs_err::metadata(from)?.len();
        if n_bytes <= PART_BYTES {
            return self.write(name, fs_err::read(from)?);
        }
        self.repeated("write", name, async || self.send_in_parts(&self.key(name)?, from, n_bytes).await)
    }

    /// Replaces an object by bytes.
    pub(super) fn write(&self, name: &str, bytes: Vec<u8>) -> Result<()> {
        let payload = PutPayload::from(bytes);
        self.repeated("write", name, async || self.store.put(&self.key(name)?, payload.clone()).await.map(drop))
    }

    /// Removes an object, if it is there.
    pub(super) fn remove(&self, name: &str) -> Result<()> {
        self.repeated("remove", name, async || match self.store.delete(&self.key(name)?).await {
            Err(StoreError::NotFound { .. }) => Ok(()),
            done => done,
        })
    }

    async fn send_in_parts(&self, key: &Key, from: &Path, n_bytes: u64) -> object_store::Result<()> {
        let part_bytes = PART_BYTES.max(n_bytes.div_ceil(MAX_PARTS));
        let mut file = fs_err::File::open(from).map_err(on_disk)?;
        let mut upload = self.store.put_multipart(key).await?;
        let sent: object_store::Result<()> = async {
            loop {
                let mut part = Vec::with_capacity(part_bytes as usize);
                (&mut file).take(part_bytes).read_to_end(&mut part).map_err(on_disk)?;
                if part.is_empty() {
                    return Ok(());
                }
                upload.put_part(part.into()).await?;
            }
        }
        .await;
        let done = match sent {
            Ok(()) => upload.complete().await,
            Err(error) => Err(error),
        };
        if done.is_err() {
            // Parts that stay are no object; stores remove them in time if they are so configured.
            let _ = upload.abort().await;
        }
        done.map(drop)
    }

    /// Does something with the object `name` until it succeeds, as often as is worthwhile.
    fn repeated<T>(
        &self,
        doing: &'static str,
        name: &str,
        mut once: impl AsyncFnMut() -> object_store::Result<T>,
    ) -> Result<T> {
        let began = Instant::now();
        let mut wait = FIRST_WAIT;
        let mut n_attempts = 0;
        loop {
            n_attempts += 1;
            let error = match runtime()?.block_on(once()) {
                Ok(done) => return Ok(done),
                Err(error) => error,
            };
            let url = self.url.join(name);
            if is_final(&error) || n_attempts >= N_ATTEMPTS {
                return Err(self.told(doing, url, &error, (n_attempts, began.elapsed())));
            }
            std::thread::sleep(wait);
            wait *= 2;
        }
    }

    fn told(&self, doing: &'static str, url: ObjectUrl, error: &StoreError, tried: (usize, Duration)) -> Error {
        let why = redacted(&all_causes(error));
        match error {
            StoreError::NotFound { .. } if doing == "write" => {
                Error::Missing { url: ObjectUrl { key: String::new(), ..url } }
            }
            StoreError::NotFound { .. } => Error::Missing { url },
            StoreError::InvalidPath { .. } => Error::Unnamable { url },
            error if is_final(error) => Error::Denied { doing, url, why },
            _ => Error::Failed { doing, url, n_attempts: tried.0, seconds: tried.1.as_secs_f64(), why },
        }
    }

    fn key(&self, name: &str) -> object_store::Result<Key> {
        Ok(Key::parse(self.url.join(name).key)?)
    }

    fn object(&self, meta: &ObjectMeta) -> Result<Object> {
        let location = meta.location.as_ref();
        let name = location.strip_prefix(self.url.key.as_str()).unwrap_or(location).trim_start_matches('/');
        let is_plain = |part: &str| !matches!(part, "" | "." | "..") && !part.contains(['\\', '\0']);
        if !name.is_empty() && !name.split('/').all(is_plain) {
            return Err(Error::Unnamable { url: ObjectUrl { key: location.to_owned(), ..self.url.clone() } });
        }
        Ok(seen(meta, name.to_owned()))
    }
}

/// An object as a store describes it.
fn seen(meta: &ObjectMeta, name: String) -> Object {
    // Both kinds of stores give a tag; others may not. Some answers have it in quotes.
    let etag = match &meta.e_tag {
        Some(tag) => tag.trim_start_matches("W/").trim_matches('"').to_owned(),
        None => format!("{} {}", meta.size, meta.last_modified.to_rfc3339()),
    };
    Object { name, n_bytes: meta.size, etag }
}

/// Whether trying again cannot help. Conflicts pass: nothing is written on conditions.
fn is_final(error: &StoreError) -> bool {
    matches!(
        error,
        StoreError::NotFound { .. }
            | StoreError::InvalidPath { .. }
            | StoreError::NotSupported { .. }
            | StoreError::NotImplemented { .. }
            | StoreError::PermissionDenied { .. }
            | StoreError::Unauthenticated { .. }
            | StoreError::UnknownConfigurationKey { .. }
    )
}

/// A full disk may have room a moment later, so that this is tried again like everything else.
fn on_disk(error: std::io::Error) -> StoreError {
    StoreError::Generic { store: "disk", source: error.into() }
}

/// The message, followed by the causes that it does not repeat.
fn all_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let more = error.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use object_store::memory::InMemory;

    #[test]
    fn large_files_go_in_parts_and_come_back_whole() {
        let bucket = Bucket { store: Arc::new(InMemory::new()), url: "s3://bucket/a".parse().unwrap() };
        let dir = tempfile::tempdir().unwrap();
        let (from, to) = (dir.path().join("from"), dir.path().join("to"));
        let bytes: Vec<u8> = (0..2 * PART_BYTES + 1000).map(|idx| (idx % 251) as u8).collect();
        fs_err::write(&from, &bytes).unwrap();
        bucket.upload("b/large", &from).unwrap();
        bucket.write("c", b"small".to_vec()).unwrap();
        // Markers that some tools make for folders are no files.
        bucket.write("b", Vec::new()).unwrap();
        let listed = bucket.list().unwrap();
        assert_eq!(listed.iter().map(|object| object.name.as_str()).collect::<Vec<_>>(), ["b/large", "c"]);
        assert!(bucket.download(&listed[0], &to).unwrap());
        assert!(fs_err::read(&to).unwrap() == bytes);
        bucket.write("b/large", b"another".to_vec()).unwrap();
        fs_err::remove_file(&to).unwrap();
        assert!(!bucket.download(&listed[0], &to).unwrap() && !to.exists(), "it was replaced since it was listed");
        bucket.remove("c").unwrap();
        assert!(bucket.read("c").unwrap().is_none() && bucket.itself().unwrap().is_none());
    }
}
