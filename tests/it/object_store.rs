//! Recordings from an object store and results to one: a server of S3's protocol, which begins with the test and lets
//! one request in ten go wrong.

use crate::support::{Outcome, Workspace, assert_same, command, files};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

const RECORDINGS: &str = "tests/fixtures/recordings/interaction/FIX-multi-v1_2.zip";

/// The objects of a bucket, and what goes wrong.
#[derive(Debug, Default)]
struct Bucket {
    objects: BTreeMap<String, Vec<u8>>,
    /// Writes to names that end like this are forbidden.
    forbidden: Option<&'static str>,
    n_requests: usize,
    n_faults: usize,
    n_writes: usize,
}

type Store = Arc<Mutex<Bucket>>;

/// A request: method, key, the parameters as they are in the address, first byte, body.
struct Request {
    method: String,
    key: String,
    query: BTreeMap<String, String>,
    from: Option<usize>,
    body: Vec<u8>,
}

/// Begins to serve an empty bucket, for as long as the test runs. Returns it with the address.
fn serve() -> (Store, String) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let store = Store::default();
    let served = Arc::clone(&store);
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let store = Arc::clone(&served);
            std::thread::spawn(move || answer_all(stream.unwrap(), &store));
        }
    });
    (store, address)
}

/// Answers the requests of a connection until it ends.
fn answer_all(mut stream: TcpStream, store: &Store) -> Option<()> {
    let mut reader = BufReader::new(stream.try_clone().ok()?);
    loop {
        let request = read(&mut reader)?;
        let bucket = &mut *store.lock().unwrap();
        bucket.n_requests += 1;
        let fault = (bucket.n_requests % 10 == 0).then(|| bucket.n_requests / 10 % 3);
        bucket.n_faults += usize::from(fault.is_some());
        let is_head = request.method == "HEAD";
        // A fault before the request is done, or after it, when its answer is lost.
        if fault == Some(0) {
            let _ = stream.write_all(b"HTTP/1.1 503 Slow Down\r\ncontent-length: 0\r\n\r\n");
            continue;
        }
        let (status, headers, body) = answer(bucket, &request);
        let head = format!("HTTP/1.1 {status}\r\ncontent-length: {}\r\n{headers}\r\n", body.len());
        let n_sent = if is_head { 0 } else { body.len() };
        match fault {
            Some(1) => return None,
            Some(_) => {
                let _ = stream.write_all(&[head.as_bytes(), &body[..n_sent / 2]].concat());
                return None;
            }
            None => stream.write_all(&[head.as_bytes(), &body[..n_sent]].concat()).ok()?,
        }
    }
}

fn read(reader: &mut impl BufRead) -> Option<Request> {
    let mut line = String::new();
    let mut next = || {
        line.clear();
        (reader.read_line(&mut line).ok()? > 0).then(|| line.trim_end().to_owned())
    };
    let first = next()?;
    let (method, rest) = first.split_once(' ')?;
    let (path, query) = rest.split_once(' ')?.0.split_once('?').unwrap_or((rest.split_once(' ')?.0, ""));
    let (mut n_bytes, mut from) = (0, None);
    loop {
        let header = next()?.to_ascii_lowercase();
        let Some((name, value)) = header.split_once(": ") else { break };
        match name {
            "content-length" => n_bytes = value.parse().ok()?,
            "range" => from = value.strip_prefix("bytes=")?.split_once('-')?.0.parse().ok(),
            _ => {}
        }
    }
    let mut body = vec![0; n_bytes];
    reader.read_exact(&mut body).ok()?;
    let parts = query.split('&').map(|part| part.split_once('=').unwrap_or((part, "")));
    let query = parts.map(|(name, value)| (name.to_owned(), decoded(value))).collect();
    let key = decoded(path.strip_prefix("/traffic")?.trim_start_matches('/'));
    Some(Request { method: method.to_owned(), key, query, from, body })
}

/// The text without percent-encoding.
fn decoded(text: &str) -> String {
    let mut parts = text.split('%');
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| {
        text + &char::from(u8::from_str_radix(&part[..2], 16).unwrap()).to_string() + &part[2..]
    })
}

/// Status, headers and body of the answer.
fn answer(bucket: &mut Bucket, request: &Request) -> (&'static str, String, Vec<u8>) {
    let Request { method, key, query, from, body } = request;
    let tag = |bytes: &[u8]| format!("\"{}\"", &blake3::hash(bytes).to_hex()[..32]);
    match method.as_str() {
        "GET" if query.contains_key("list-type") => {
            // Twenty to a page: an attempt to list them all should meet few faults.
            let (prefix, after) = (&query["prefix"], query.get("continuation-token").cloned().unwrap_or_default());
            let mut rest = bucket.objects.iter().filter(|(key, _)| key.starts_with(prefix) && **key > after);
            let page: Vec<_> = rest.by_ref().take(20).collect();
            let more = rest.next().map_or(String::new(), |_| {
                format!("<NextContinuationToken>{}</NextContinuationToken>", page[page.len() - 1].0)
            });
            let items: String = page
                .iter()
                .map(|(key, bytes)| {
                    let (tag, n_bytes) = (tag(bytes).replace('"', "&quot;"), bytes.len());
                    format!(
                        "<Contents><Key>{key}</Key><LastModified>2026-01-01T00:00:00.000Z</LastModified>\
                         <ETag>{tag}</ETag><Size>{n_bytes}</Size></Contents>"
                    )
                })
                .collect();
            ("200 OK", String::new(), format!("<ListBucketResult>{items}{more}</ListBucketResult>").into_bytes())
        }
        "GET" | "HEAD" => {
            let Some(bytes) = bucket.objects.get(key) else { return ("404 Not Found", String::new(), Vec::new()) };
            let about = format!("etag: {}\r\nlast-modified: Thu, 01 Jan 2026 00:00:00 GMT\r\n", tag(bytes));
            match from {
                None => ("200 OK", about, bytes.clone()),
                Some(from) => {
                    let range = format!("{about}content-range: bytes {from}-{}/{}\r\n", bytes.len() - 1, bytes.len());
                    ("206 Partial Content", range, bytes[*from..].to_vec())
                }
            }
        }
        "PUT" if bucket.forbidden.is_some_and(|ending| key.ends_with(ending)) => {
            ("403 Forbidden", String::new(), b"<Error><Code>AccessDenied</Code></Error>".to_vec())
        }
        "PUT" => {
            bucket.n_writes += 1;
            bucket.objects.insert(key.clone(), body.clone());
            ("200 OK", format!("etag: {}\r\n", tag(body)), Vec::new())
        }
        "DELETE" => {
            bucket.objects.remove(key);
            ("204 No Content", String::new(), Vec::new())
        }
        _ => ("501 Not Implemented", String::new(), Vec::new()),
    }
}

/// Runs the small pipeline from the store to the store.
fn run(workspace: &Workspace, address: &str, more: &[&str]) -> Outcome {
    let (pipeline, cache) = (workspace.arg("small.toml"), workspace.arg("cache"));
    let inputs = "ingest.inputs=['s3://traffic/rec/FIX-multi-v1_2.zip']";
    let args = ["run", &pipeline, "--output", "s3://traffic/runs", "--cache-dir", &cache, "--set", inputs];
    let mut command = command(&[&args[..], more].concat());
    let variables =
        [("ENDPOINT_URL", address), ("ACCESS_KEY_ID", "djinn"), ("REGION", "us-east-1"), ("ALLOW_HTTP", "true")];
    command.envs(variables.map(|(name, value)| (format!("AWS_{name}"), value)));
    let outcome = Outcome::of(command.env("AWS_SECRET_ACCESS_KEY", "nobody-may-read-this"));
    assert!(!outcome.stderr.contains("nobody-may-read-this"));
    outcome
}

/// The results in the store that do not say where recordings are, nor when they were made.
fn results(store: &Store) -> BTreeMap<String, Vec<u8>> {
    let objects = &store.lock().unwrap().objects;
    let names = objects.iter().filter_map(|(key, bytes)| Some((key.strip_prefix("runs/small/main/")?, bytes)));
    comparable(names.map(|(name, bytes)| (name.to_owned(), bytes.clone())).collect())
}

fn comparable(mut files: BTreeMap<String, Vec<u8>>) -> BTreeMap<String, Vec<u8>> {
    let about = ["run.json", "config.toml", "report.html", "timings.json", "log.txt", ".djinn-copied.json"];
    files.retain(|name, _| !about.contains(&name.as_str()) && !name.ends_with(".done.json"));
    files
}

#[test]
fn results_in_a_store_are_those_on_disk_and_never_half_of_them() {
    let workspace = Workspace::new();
    workspace.run("disk", &[]).expect(0);
    let expected = comparable(files(&workspace.run_folder("disk")));
    let (store, address) = serve();
    let recordings = fs_err::read(concat!(env!("CARGO_MANIFEST_DIR"), "/").to_owned() + RECORDINGS).unwrap();
    store.lock().unwrap().objects.insert("rec/FIX-multi-v1_2.zip".to_owned(), recordings);
    // Neither a name that begins alike nor the objects of others count.
    store.lock().unwrap().objects.insert("runs/small/main-of-others/x".to_owned(), b"theirs".to_vec());
    let is_whole = |name: &str| name.ends_with(".done.json") || name.ends_with("manifest.json") || name == "run.json";
    let declared = || {
        let names: Vec<String> = store.lock().unwrap().objects.keys().cloned().collect();
        let names = names.iter().filter_map(|key| key.strip_prefix("runs/small/main/")).filter(|name| is_whole(name));
        names.map(str::to_owned).collect::<Vec<_>>()
    };

    store.lock().unwrap().forbidden = Some("main/metrics.parquet");
    let said = run(&workspace, &address, &[]).expect(1).stderr;
    for part in
        ["cannot write s3://traffic/runs/small/main/metrics.parquet", "the results are whole in", "same command"]
    {
        assert!(said.contains(part), "{said}");
    }
    assert_eq!(declared(), Vec::<String>::new(), "nothing is declared whole");

    store.lock().unwrap().forbidden = None;
    let said = run(&workspace, &address, &[]).expect(0).stderr;
    assert!(said.contains("everything is up to date"), "{said}");
    assert!(said.contains("copied to s3://traffic/runs/small/main"), "{said}");
    assert_same(&results(&store), &expected);
    assert!(declared().contains(&"corpus/manifest.json".to_owned()) && declared().contains(&"run.json".to_owned()));
    let n_writes = store.lock().unwrap().n_writes;
    run(&workspace, &address, &[]).expect(0);
    // The log, the times, and the list before and after them; some twice, if an answer was lost.
    let n_writes = store.lock().unwrap().n_writes - n_writes;
    assert!(n_writes < 8, "what is there is not written again, but {n_writes} objects were");

    // Another corpus comes, and is cut off: what is left does not count, and goes when the next copy is through.
    store.lock().unwrap().forbidden = Some("main/metrics.parquet");
    store.lock().unwrap().objects.remove("runs/small/main/metrics.parquet");
    run(&workspace, &address, &["--set", "evaluate.keep=verified"]).expect(1);
    let left = declared();
    assert!(!left.contains(&"corpus/manifest.json".to_owned()) && !left.contains(&"evaluate.done.json".to_owned()));
    assert!(left.contains(&"ingest.done.json".to_owned()), "{left:?}");
    store.lock().unwrap().forbidden = None;
    run(&workspace, &address, &[]).expect(0);
    assert_same(&results(&store), &expected);

    let before = store.lock().unwrap().objects.clone();
    store.lock().unwrap().objects.insert("runs/small/main/corpus/thesis.doc".to_owned(), b"years of work".to_vec());
    let said = run(&workspace, &address, &["--set", "run.seed=4"]).expect(1).stderr;
    assert!(said.contains("s3://traffic/runs/small/main/corpus/thesis.doc was not written by djinn"), "{said}");
    store.lock().unwrap().objects.remove("runs/small/main/corpus/thesis.doc");
    assert!(store.lock().unwrap().objects == before, "nothing was changed");
    let said = run(&workspace, &address, &["--set", "ingest.inputs=['s3://traffic/none']"]).expect(1).stderr;
    assert!(said.contains("s3://traffic/none does not exist"), "{said}");
    let Bucket { n_faults, n_requests, .. } = *store.lock().unwrap();
    assert!(n_faults > 10 && n_faults * 11 > n_requests, "{n_faults} of {n_requests} requests went wrong");
}
