//! A store that fails now and then, as networks and servers do, and one whose client is killed.

use crate::seed::Seed;
use async_trait::async_trait;
use futures_util::stream::{self, BoxStream};
use futures_util::{StreamExt, TryStreamExt};
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, Result, UploadPart,
};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A way in which a request fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// The server has too much to do; nothing was done.
    Busy,
    /// Everything was done, but the answer got lost.
    Reset,
    /// Another client was writing the object at that moment.
    Conflict,
    /// The content ends early.
    Truncated,
    /// The content ends early, and its announced length fits.
    QuietlyTruncated,
}

/// When requests fail.
#[derive(Debug, Clone, Copy)]
pub(super) enum Failing {
    /// This share of requests, at random.
    Sometimes(f64),
    /// All requests, before anything is done.
    Always,
    /// All writing requests from this number on: the client was killed.
    WritesFrom(u64),
}

/// See the module.
#[derive(Debug, Clone)]
pub(super) struct Flaky {
    pub(super) inner: Arc<InMemory>,
    failing: Failing,
    n_requests: Arc<AtomicU64>,
    n_writes: Arc<AtomicU64>,
    n_faults: Arc<AtomicU64>,
}

impl Flaky {
    pub(super) fn new(inner: Arc<InMemory>, failing: Failing) -> Self {
        Self { inner, failing, n_requests: Arc::default(), n_writes: Arc::default(), n_faults: Arc::default() }
    }

    pub(super) fn n_requests(&self) -> u64 {
        self.n_requests.load(Ordering::Relaxed)
    }

    pub(super) fn n_writes(&self) -> u64 {
        self.n_writes.load(Ordering::Relaxed)
    }

    pub(super) fn n_faults(&self) -> u64 {
        self.n_faults.load(Ordering::Relaxed)
    }

    /// The fault of the next request, among those possible.
    fn fault(&self, possible: &[Fault]) -> Option<Fault> {
        let number = self.n_requests.fetch_add(1, Ordering::Relaxed);
        let is_write = possible.contains(&Fault::Reset);
        let n_writes = if is_write { self.n_writes.fetch_add(1, Ordering::Relaxed) } else { 0 };
        let mut rng = Seed(11).derive("fault", &[number]).rng();
        let fault = match self.failing {
            Failing::Sometimes(share) => (rng.uniform() < share).then(|| possible[rng.below(possible.len())]),
            Failing::Always => Some(Fault::Busy),
            Failing::WritesFrom(first) => (is_write && n_writes >= first).then_some(Fault::Busy),
        };
        self.n_faults.fetch_add(u64::from(fault.is_some()), Ordering::Relaxed);
        fault
    }
}

const ON_WRITE: &[Fault] = &[Fault::Busy, Fault::Reset, Fault::Conflict];
const ON_READ: &[Fault] = &[Fault::Busy, Fault::Truncated, Fault::QuietlyTruncated];

fn told(fault: Fault) -> Error {
    match fault {
        Fault::Conflict => {
            Error::AlreadyExists { path: "x".to_owned(), source: "409 Conflict: OperationAborted".into() }
        }
        fault => Error::Generic { store: "flaky", source: format!("{fault:?}").into() },
    }
}

impl fmt::Display for Flaky {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Flaky({})", self.inner)
    }
}

#[async_trait]
impl ObjectStore for Flaky {
    async fn put_opts(&self, location: &Path, payload: PutPayload, opts: PutOptions) -> Result<PutResult> {
        match self.fault(ON_WRITE) {
            None => self.inner.put_opts(location, payload, opts).await,
            Some(Fault::Reset) => {
                self.inner.put_opts(location, payload, opts).await?;
                Err(told(Fault::Reset))
            }
            Some(fault) => Err(told(fault)),
        }
    }

    async fn put_multipart_opts(&self, location: &Path, opts: PutMultipartOptions) -> Result<Box<dyn MultipartUpload>> {
        match self.fault(&[Fault::Busy]) {
            Some(fault) => Err(told(fault)),
            None => {
                let inner = self.inner.put_multipart_opts(location, opts).await?;
                Ok(Box::new(FlakyUpload { inner, store: self.clone() }))
            }
        }
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        let fault = self.fault(ON_READ);
        if fault == Some(Fault::Busy) {
            return Err(told(Fault::Busy));
        }
        let result = self.inner.get_opts(location, options).await?;
        if fault.is_none() || result.meta.size < 2 || result.range.is_empty() {
            return Ok(result);
        }
        let GetResult { payload, mut meta, range, attributes, extensions } = result;
        let whole = GetResult {
            payload,
            meta: meta.clone(),
            range: range.clone(),
            attributes: attributes.clone(),
            extensions: extensions.clone(),
        };
        let bytes = whole.bytes().await?;
        let n_kept = bytes.len() / 2;
        let payload: BoxStream<'static, Result<_>> = match fault {
            Some(Fault::QuietlyTruncated) => {
                meta.size = n_kept as u64;
                stream::iter([Ok(bytes.slice(..n_kept))]).boxed()
            }
            _ => stream::iter([Ok(bytes.slice(..n_kept)), Err(told(Fault::Truncated))]).boxed(),
        };
        Ok(GetResult { payload: GetResultPayload::Stream(payload), meta, range, attributes, extensions })
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        match self.fault(ON_WRITE) {
            None => self.inner.delete_stream(locations),
            Some(Fault::Reset) => {
                let done = self.inner.delete_stream(locations);
                done.and_then(|_| async { Err(told(Fault::Reset)) }).boxed()
            }
            Some(fault) => stream::iter([Err(told(fault))]).boxed(),
        }
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        let found = self.inner.list(prefix);
        match self.fault(&[Fault::Busy]) {
            None => found,
            // It fails between two pages.
            Some(fault) => found.take(1).chain(stream::iter([Err(told(fault))])).boxed(),
        }
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.inner.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.inner.copy_opts(from, to, options).await
    }
}

#[derive(Debug)]
struct FlakyUpload {
    inner: Box<dyn MultipartUpload>,
    store: Flaky,
}

#[async_trait]
impl MultipartUpload for FlakyUpload {
    fn put_part(&mut self, data: PutPayload) -> UploadPart {
        match self.store.fault(&[Fault::Busy]) {
            None => self.inner.put_part(data),
            Some(fault) => Box::pin(async move { Err(told(fault)) }),
        }
    }

    async fn complete(&mut self) -> Result<PutResult> {
        match self.store.fault(ON_WRITE) {
            None => self.inner.complete().await,
            Some(Fault::Reset) => {
                self.inner.complete().await?;
                Err(told(Fault::Reset))
            }
            Some(fault) => Err(told(fault)),
        }
    }

    async fn abort(&mut self) -> Result<()> {
        self.inner.abort().await
    }
}
