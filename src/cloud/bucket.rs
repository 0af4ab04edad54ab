//! A folder of objects: lists it, and transfers whole files to and from it.
//!
//! Every action is repeated a few times, each time a little later. All of them may be repeated: an upload replaces an
//! object by the same bytes, even if an answer got lost; nothing is created on condition that it is missing. A download
//! is compared with the length in the listing and, if djinn uploaded it, with the hash that it left beside the object.

use super::ObjectUrl;
use super::connect::{connect, runtime};
use super::error::{Error, Result};
use super::redact::redacted;
use crate::files::{AtomicFile, FileStamp};
use futures_util::StreamExt;
use object_store::path::Path as Key;
use object_store::{
    Attribute, Attributes, Error as StoreError, GetResult, ObjectMeta, ObjectStore, ObjectStoreExt,
    PutMultipartOptions, PutOptions, PutPayload,
};
use std::io::{Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

/// The name of the hash beside an object. Azure allows only letters.
const HASH: Attribute = Attribute::Metadata(std::borrow::Cow::Borrowed("djinnblake3"));
/// Larger files are sent in parts of at least this size, bytes.
const PART_BYTES: u64 = 16 << 20;
/// The most parts of a file in S3.
const MAX_PARTS: u64 = 10_000;

/// A folder of objects: everything below one URL.
#[derive(Debug, Clone)]
pub(super) struct Bucket {
    store: Arc<dyn ObjectStore>,
    url: ObjectUrl,
    patience: Patience,
}

/// How often an action is tried.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    /// The most attempts.
    pub(super) n_attempts: usize,
    /// The wait after the first attempt; it doubles with each.
    pub(super) first_wait: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self { n_attempts: 6, first_wait: Duration::from_millis(200) }
    }
}

/// An object, as it was when it was seen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Object {
    /// Its name, relative to the folder.
    pub(super) name: String,
    /// Its length.
    pub(super) n_bytes: u64,
    /// A tag that changes with its content.
    pub(super) etag: String,
    /// When it was written.
    pub(super) modified: SystemTime,
}

impl Bucket {
    /// The folder at a URL.
    pub(super) fn open(url: &ObjectUrl) -> Result<Self> {
        Ok(Self::in_store(connect(url)?, url.clone(), Patience::default()))
    }

    /// The folder at a URL, in this store.
    pub(super) fn in_store(store: Arc<dyn ObjectStore>, url: ObjectUrl, patience: Patience) -> Self {
        Self { store, url, patience }
    }

    /// Its URL.
    pub(super) const fn url(&self) -> &ObjectUrl {
        &self.url
    }

    /// All objects in the folder `below` in it (empty: all objects), sorted by name.
    ///
    /// # Errors
    /// When a name cannot be that of a file; errors of the store.
    pub(super) fn list(&self, below: &str) -> Result<Vec<Object>> {
        let prefix = self.url.join(below).key;
        let mut found = self.repeated("list", below, async || {
            let prefix = Key::parse(&prefix)?;
            let mut listed = self.store.list((!prefix.as_ref().is_empty()).then_some(&prefix));
            let mut found = Vec::new();
            while let Some(meta) = listed.next().await {
                found.push(meta?);
            }
            Ok(found)
        })?;
        found.sort_by(|a, b| a.location.cmp(&b.location));
        let objects: Vec<Object> = found.iter().map(|meta| self.object(meta, &prefix)).collect::<Result<_>>()?;
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
        let head = async || {
            let key = self.key("")?;
            match self.store.head(&key).await {
                Err(StoreError::NotFound { .. }) => Ok(None),
                found => found.map(Some),
            }
        };
        let found = if self.url.key.is_empty() { None } else { self.repeated("read", "", head)? };
        Ok(found.map(|meta| Object { name: String::new(), ..seen(&meta) }))
    }

    /// Downloads an object to the file `to`, whose folder must exist; nothing is there unless it is whole. Returns the
    /// downloaded object, which may have been replaced since it was listed.
    ///
    /// # Errors
    /// [`Error::Missing`]; errors of the store and the disk.
    pub(super) fn download(&self, expected: &Object, to: &Path) -> Result<Object> {
        self.repeated("read", &expected.name, async || {
            let result = self.store.get(&self.key(&expected.name)?).await?;
            let found = Object { name: expected.name.clone(), ..seen(&result.meta) };
            let hash = result.attributes.get(&HASH).map(|hash| hash.as_ref().to_owned());
            let is_same = found.etag == expected.etag;
            let n_bytes = if is_same { expected.n_bytes } else { found.n_bytes };
            let file = received(result, to).await?;
            let FileStamp { n_bytes: n_received, checksum } = file.stamp();
            if n_received != n_bytes {
                return Err(damaged(format!("{n_received} of {n_bytes} bytes came")));
            }
            if let Some(hash) = hash.filter(|hash| *hash != checksum) {
                return Err(damaged(format!("the BLAKE3 hash is {checksum}, and was {hash} when djinn wrote it")));
            }
            file.commit().map_err(on_disk)?;
            Ok(Object { n_bytes, ..found })
        })
    }

    /// The content of a small object, if it is there.
    pub(super) fn read(&self, name: &str) -> Result<Option<Vec<u8>>> {
        self.repeated("read", name, async || {
            let result = match self.store.get(&self.key(name)?).await {
                Err(StoreError::NotFound { .. }) => return Ok(None),
                result => result?,
            };
            let hash = result.attributes.get(&HASH).map(|hash| hash.as_ref().to_owned());
            let bytes = result.bytes().await?;
            match hash.filter(|hash| *hash != FileStamp::of(&bytes).checksum) {
                None => Ok(Some(bytes.to_vec())),
                Some(hash) => Err(damaged(format!("its BLAKE3 hash is not {hash}, which djinn wrote beside it"))),
            }
        })
    }

    /// Replaces an object by the content of a file.
    pub(super) fn upload(&self, name: &str, from: &Path) -> Result<Object> {
        let n_bytes = fs_err::metadata(from)?.len();
        if n_bytes <= PART_BYTES {
            return self.write(name, &fs_err::read(from)?);
        }
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(fs_err::File::open(from)?)?;
        let attributes = Attributes::from_iter([(HASH, hasher.finalize().to_hex().to_string())]);
        let etag = self.repeated("write", name, async || {
            let options = PutMultipartOptions { attributes: attributes.clone(), ..PutMultipartOptions::default() };
            self.send_in_parts(&self.key(name)?, from, n_bytes, options).await
        })?;
        Ok(Object { name: name.to_owned(), n_bytes, etag, modified: SystemTime::now() })
    }

    /// Replaces an object by bytes.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<Object> {
        let FileStamp { n_bytes, checksum } = FileStamp::of(bytes);
        let payload = PutPayload::from(bytes.to_vec());
        let etag = self.repeated("write", name, async || {
            let attributes = Attributes::from_iter([(HASH, checksum.clone())]);
            let options = PutOptions { attributes, ..PutOptions::default() };
            let put = self.store.put_opts(&self.key(name)?, payload.clone(), options).await?;
            Ok(plain_tag(put.e_tag.as_deref()))
        })?;
        Ok(Object { name: name.to_owned(), n_bytes, etag, modified: SystemTime::now() })
    }

    /// Removes an object, if it is there.
    pub(super) fn remove(&self, name: &str) -> Result<()> {
        self.repeated("remove", name, async || match self.store.delete(&self.key(name)?).await {
            Err(StoreError::NotFound { .. }) => Ok(()),
            done => done,
        })
    }

    async fn send_in_parts(
        &self,
        key: &Key,
        from: &Path,
        n_bytes: u64,
        options: PutMultipartOptions,
    ) -> object_store::Result<String> {
        let part_bytes = PART_BYTES.max(n_bytes.div_ceil(MAX_PARTS));
        let mut file = fs_err::File::open(from).map_err(on_disk)?;
        let mut upload = self.store.put_multipart_opts(key, options).await?;
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
        Ok(plain_tag(done?.e_tag.as_deref()))
    }

    /// Does something with the object `name` until it succeeds, as often as is worthwhile.
    fn repeated<T>(
        &self,
        doing: &'static str,
        name: &str,
        mut once: impl AsyncFnMut() -> object_store::Result<T>,
    ) -> Result<T> {
        let began = Instant::now();
        let mut wait = self.patience.first_wait;
        let mut n_attempts = 0;
        loop {
            n_attempts += 1;
            let error = match runtime()?.block_on(once()) {
                Ok(done) => return Ok(done),
                Err(error) => error,
            };
            let url = self.url.join(name);
            if is_final(&error) || n_attempts >= self.patience.n_attempts {
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

    fn object(&self, meta: &ObjectMeta, prefix: &str) -> Result<Object> {
        let location = meta.location.as_ref();
        let name = location.strip_prefix(prefix).unwrap_or(location).trim_start_matches('/');
        let is_plain = |part: &str| !matches!(part, "" | "." | "..") && !part.contains(['\\', '\0']);
        if !name.is_empty() && !name.split('/').all(is_plain) {
            return Err(Error::Unnamable { url: ObjectUrl { key: location.to_owned(), ..self.url.clone() } });
        }
        Ok(Object { name: name.to_owned(), ..seen(meta) })
    }
}

/// An object as a store describes it, without its name.
fn seen(meta: &ObjectMeta) -> Object {
    let modified = SystemTime::from(meta.last_modified);
    // All three kinds of stores give a tag; others may not.
    let etag = match &meta.e_tag {
        Some(tag) => plain_tag(Some(tag)),
        None => format!("{} {}", meta.size, meta.last_modified.to_rfc3339()),
    };
    Object { name: String::new(), n_bytes: meta.size, etag, modified }
}

/// A tag in its common form: some answers of a store have it in quotes, and others do not.
fn plain_tag(tag: Option<&str>) -> String {
    tag.unwrap_or_default().trim_start_matches("W/").trim_matches('"').to_owned()
}

/// The file `to`, not committed yet, with all received bytes.
async fn received(result: GetResult, to: &Path) -> object_store::Result<AtomicFile> {
    let mut file = AtomicFile::create(to).map_err(on_disk)?;
    let mut stream = result.into_stream();
    while let Some(bytes) = stream.next().await {
        file.write_all(&bytes?).map_err(on_disk)?;
    }
    Ok(file)
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

fn damaged(why: String) -> StoreError {
    StoreError::Generic { store: "download", source: why.into() }
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
