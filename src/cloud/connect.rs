//! Connects to a store, with the variables that its own tools read from the environment.

use super::error::{Error, Result};
use super::redact::redacted;
use super::{ObjectUrl, Scheme};
use object_store::aws::AmazonS3Builder;
use object_store::gcp::GoogleCloudStorageBuilder;
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// Requests that a client repeats by itself, each a little later. [`Bucket`](super::bucket::Bucket) repeats the actions
/// of which they are a part.
const N_RETRIES: usize = 3;
const RETRIES_TAKE: Duration = Duration::from_secs(60);
/// Time limit of one request, which carries 16 MiB at most, or fetches a whole file.
const REQUEST_TAKES: Duration = Duration::from_secs(600);
/// Until a server answers at all.
const CONNECT_TAKES: Duration = Duration::from_secs(10);

/// The store that holds the bucket of a URL. Nothing is sent yet.
pub(super) fn connect(url: &ObjectUrl) -> Result<Arc<dyn ObjectStore>> {
    // It fails if there is one already, which serves as well.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let retry = RetryConfig {
        backoff: BackoffConfig { max_backoff: Duration::from_secs(5), ..BackoffConfig::default() },
        max_retries: N_RETRIES,
        retry_timeout: RETRIES_TAKE,
    };
    let options = ClientOptions::default().with_timeout(REQUEST_TAKES).with_connect_timeout(CONNECT_TAKES);
    let bucket = url.bucket.as_str();
    let store: object_store::Result<Arc<dyn ObjectStore>> = match url.scheme {
        Scheme::S3 => {
            let builder = AmazonS3Builder::from_env().with_client_options(allowing_http(options, "AWS_ALLOW_HTTP"));
            builder
                .with_bucket_name(bucket)
                .with_disable_bulk_delete(true)
                .with_retry(retry)
                .build()
                .map(|store| Arc::new(store) as _)
        }
        Scheme::Gs => {
            let builder = GoogleCloudStorageBuilder::from_env();
            let builder = builder.with_client_options(allowing_http(options, "GOOGLE_ALLOW_HTTP"));
            builder.with_bucket_name(bucket).with_retry(retry).build().map(|store| Arc::new(store) as _)
        }
    };
    store.map_err(|error| Error::Denied { doing: "open", url: url.clone(), why: redacted(&error.to_string()) })
}

/// The options replace those from the environment, so this one has to be set again.
fn allowing_http(options: ClientOptions, variable: &str) -> ClientOptions {
    options.with_allow_http(std::env::var(variable).is_ok_and(|value| matches!(value.as_str(), "true" | "1")))
}

/// A key that distinguishes the stores that could be behind one URL: the address from the environment.
pub(super) fn endpoint(url: &ObjectUrl) -> String {
    let variables: &[&str] = match url.scheme {
        Scheme::S3 => &["AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"],
        Scheme::Gs => &["GOOGLE_BASE_URL"],
    };
    let values = variables.iter().filter_map(|name| std::env::var(name).ok());
    values.collect::<Vec<_>>().join(" ")
}

/// The threads on which requests are carried; made once, with the first request.
pub(super) fn runtime() -> Result<&'static Runtime> {
    static RUNTIME: OnceLock<Runtime> = OnceLock::new();
    if let Some(runtime) = RUNTIME.get() {
        return Ok(runtime);
    }
    let runtime = Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    Ok(RUNTIME.get_or_init(|| runtime))
}
