//! A page in a headless browser, controlled and watched over the DevTools protocol, through two named pipes.

use crate::skipped::skipped;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

const NAMES: [&str; 4] = ["chromium", "chromium-browser", "chromium-headless-shell", "google-chrome"];
const PATIENCE: Duration = Duration::from_secs(60);

/// An open page. The errors that it reports are collected.
pub(crate) struct Page {
    browser: Child,
    requests: fs_err::File,
    messages: Receiver<Value>,
    session: Option<String>,
    n_requests: u64,
    errors: Vec<String>,
    _folder: tempfile::TempDir,
}

impl Page {
    /// Opens a page and waits until it is loaded. `None` where there is no browser, which is reported.
    pub(crate) fn open(html: &str) -> Option<Self> {
        let Some(name) = NAMES.into_iter().find(|name| is_there(name)) else {
            skipped("browser", &format!("none of {NAMES:?} is there"));
            return None;
        };
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        fs_err::write(path("page.html"), html).unwrap();
        assert!(Command::new("mkfifo").args([path("in"), path("out")]).status().unwrap().success());
        // The browser reads requests from its third and writes messages to its fourth file descriptor.
        let script = format!(
            "exec {name} --headless --no-sandbox --disable-gpu --disable-quic --no-first-run \
             --disable-background-networking --disable-component-update --disable-sync --disable-dev-shm-usage \
             --window-size=1400,1000 --user-data-dir='{}' --remote-debugging-pipe 3<'{}' 4>'{}'",
            path("profile"),
            path("in"),
            path("out"),
        );
        let browser =
            Command::new("sh").args(["-c", &script]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let requests = fs_err::OpenOptions::new().write(true).open(path("in")).unwrap();
        let answers = fs_err::File::open(path("out")).unwrap();
        let (sender, messages) = channel();
        std::thread::spawn(move || {
            for message in BufReader::new(answers).split(0) {
                let Ok(message) = message else { return };
                if sender.send(serde_json::from_slice(&message).unwrap()).is_err() {
                    return;
                }
            }
        });
        let mut page =
            Self { browser, requests, messages, session: None, n_requests: 0, errors: vec![], _folder: folder };
        let target = page.call("Target.createTarget", &json!({ "url": "about:blank" }));
        let attached = page.call("Target.attachToTarget", &json!({ "targetId": target["targetId"], "flatten": true }));
        page.session = Some(attached["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Runtime", "Log", "Page"] {
            page.call(&format!("{domain}.enable"), &json!({}));
        }
        let url = format!("file://{}", Path::new(&page._folder.path().join("page.html")).display());
        page.call("Page.navigate", &json!({ "url": url }));
        page.wait_until("document.readyState === 'complete'");
        Some(page)
    }

    /// The value of an expression on the page. Fails when it throws.
    #[track_caller]
    pub(crate) fn value(&mut self, expression: &str) -> Value {
        let answer = self.call("Runtime.evaluate", &json!({ "expression": expression, "returnByValue": true }));
        assert!(answer.get("exceptionDetails").is_none(), "{expression}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].clone()
    }

    /// Fails when the expression does not become true.
    #[track_caller]
    pub(crate) fn wait_until(&mut self, expression: &str) {
        let began = Instant::now();
        while self.value(expression) != json!(true) {
            assert!(began.elapsed() < PATIENCE, "{expression} did not become true; errors: {:?}", self.errors);
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Scrolls to a scene and waits until it is drawn.
    #[track_caller]
    pub(crate) fn come_to(&mut self, scene: &str) {
        let scroll = format!("document.querySelector('#{scene}').scrollIntoView()");
        self.wait_until(&format!("({scroll}, document.querySelectorAll('#{scene} .player').length === 1)"));
    }

    /// Presses a key, as a person would.
    pub(crate) fn press(&mut self, key: &str) {
        let text = if key == " " { " " } else { "" };
        for kind in ["keyDown", "keyUp"] {
            self.call("Input.dispatchKeyEvent", &json!({ "type": kind, "key": key, "text": text }));
        }
    }

    /// Errors, exceptions and warnings of the page so far.
    pub(crate) fn errors(&mut self) -> &[String] {
        // An answer comes after all events before it.
        self.value("0");
        &self.errors
    }

    fn call(&mut self, method: &str, parameters: &Value) -> Value {
        self.n_requests += 1;
        let mut request = json!({ "id": self.n_requests, "method": method, "params": parameters });
        if let Some(session) = &self.session {
            request["sessionId"] = json!(session);
        }
        self.requests.write_all(format!("{request}\0").as_bytes()).unwrap();
        loop {
            let mut message = match self.messages.recv_timeout(PATIENCE) {
                Ok(message) => message,
                Err(RecvTimeoutError::Timeout) => panic!("the browser does not answer {method}"),
                Err(RecvTimeoutError::Disconnected) => panic!("the browser ended before it answered {method}"),
            };
            if message["id"] == json!(self.n_requests) {
                assert!(message.get("error").is_none(), "{method}: {}", message["error"]);
                return message["result"].take();
            }
            self.take_note(&message);
        }
    }

    fn take_note(&mut self, event: &Value) {
        let parameters = &event["params"];
        let is_bad = match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => true,
            Some("Runtime.consoleAPICalled") => {
                ["error", "warning", "assert"].contains(&parameters["type"].as_str().unwrap())
            }
            Some("Log.entryAdded") => ["error", "warning"].contains(&parameters["entry"]["level"].as_str().unwrap()),
            _ => false,
        };
        if is_bad {
            self.errors.push(parameters.to_string());
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.browser.kill();
        let _ = self.browser.wait();
    }
}

fn is_there(program: &str) -> bool {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).any(|folder| folder.join(program).is_file())
}
