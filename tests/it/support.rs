//! Helpers that the tests of the program share: a way to run it, a small pipeline, and folders compared byte by byte.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The output of a finished program.
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) code: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Outcome {
    /// Runs a command to its end.
    pub(crate) fn of(command: &mut Command) -> Self {
        let output = command.output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Self { code: output.status.code().unwrap_or(-1), stdout: text(output.stdout), stderr: text(output.stderr) }
    }

    /// Checks the exit code; a difference shows what the program said.
    #[track_caller]
    pub(crate) fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, code, "stdout:\n{}\nstderr:\n{}", self.stdout, self.stderr);
        self
    }
}

pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A file of the repository.
pub(crate) fn read(name: &str) -> String {
    fs_err::read_to_string(root().join(name)).unwrap()
}

/// Finds the files below a folder that have this extension.
pub(crate) fn files_below(folder: &Path, extension: &str, found: &mut Vec<PathBuf>) {
    for entry in fs_err::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files_below(&path, extension, found);
        } else if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
    found.sort();
}

/// The program in the root of the repository, where the paths of the bundled pipelines lead.
pub(crate) fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_djinn"));
    command.args(args).current_dir(env!("CARGO_MANIFEST_DIR")).env("NO_COLOR", "1");
    command
}

/// Runs the program to its end.
pub(crate) fn djinn(args: &[&str]) -> Outcome {
    Outcome::of(&mut command(args))
}

/// Starts the program without waiting for it.
pub(crate) fn start(args: &[&str]) -> Child {
    command(args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Waits for a shard, or another file beside the shards, of a stage that processes are at work on in the run folder
/// `root`.
pub(crate) fn wait_for_part(root: &Path, stage: &str, file: &str) {
    let plans = root.join(format!("{stage}.parts"));
    let is_there =
        || fs_err::read_dir(&plans).is_ok_and(|mut plans| plans.any(|plan| plan.unwrap().path().join(file).exists()));
    let began = Instant::now();
    while !is_there() {
        assert!(began.elapsed() < Duration::from_secs(120), "{file} does not appear");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A whole pipeline that takes seconds; its models learn next to nothing.
pub(crate) const SMALL_PIPELINE: &str = include_str!("../pipelines/small.toml");

/// A folder for a test, with the small pipeline in it.
pub(crate) struct Workspace {
    folder: tempfile::TempDir,
}

impl Workspace {
    pub(crate) fn new() -> Self {
        Self::of(SMALL_PIPELINE)
    }

    /// A folder with this pipeline of `tests/pipelines` in its place.
    pub(crate) fn of(pipeline: &str) -> Self {
        let workspace = Self { folder: tempfile::tempdir().unwrap() };
        workspace.put("small.toml", pipeline);
        workspace
    }

    /// Writes a pipeline that would lie in `tests/pipelines`.
    pub(crate) fn put(&self, name: &str, pipeline: &str) {
        let pipeline = pipeline.replace("\"../", concat!("\"", env!("CARGO_MANIFEST_DIR"), "/tests/"));
        fs_err::write(self.path(name), pipeline).unwrap();
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The path as an argument.
    pub(crate) fn arg(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    /// Runs the small pipeline into `output`.
    pub(crate) fn run(&self, output: &str, more: &[&str]) -> Outcome {
        djinn(&self.run_args(output, more).iter().map(String::as_str).collect::<Vec<_>>())
    }

    /// The arguments of such a run.
    pub(crate) fn run_args(&self, output: &str, more: &[&str]) -> Vec<String> {
        let mut args = vec!["run".to_owned(), self.arg("small.toml"), "--output".to_owned(), self.arg(output)];
        args.extend(more.iter().map(|arg| (*arg).to_owned()));
        args
    }

    pub(crate) fn run_folder(&self, output: &str) -> PathBuf {
        self.path(output).join("small/main")
    }
}

/// Runs a script of ours, which must succeed, and returns what it prints. A missing Python is a failure.
#[track_caller]
pub(crate) fn python(args: &[&str]) -> String {
    let python = std::env::var("DJINN_PYTHON").unwrap_or("python3".to_owned());
    let output = Command::new(&python).args(args).current_dir(env!("CARGO_MANIFEST_DIR")).output();
    let output =
        output.unwrap_or_else(|error| panic!("`{python}`, which DJINN_PYTHON can name, does not run: {error}"));
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{stdout}\n{stderr}");
    stdout.into_owned()
}

/// Every file below `root` by its name, except those that may differ between equal runs.
pub(crate) fn files(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs_err::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().to_str().unwrap().to_owned();
                if !["timings.json", "log.txt", ".lock"].contains(&name.as_str()) {
                    found.insert(name, fs_err::read(&path).unwrap());
                }
            }
        }
    }
    found
}

/// The content of a file in JSON.
#[track_caller]
pub(crate) fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs_err::read(path).unwrap()).unwrap()
}

/// Writes files below a folder.
pub(crate) fn write_all(files: &BTreeMap<String, Vec<u8>>, to: &Path) {
    for (name, bytes) in files {
        fs_err::create_dir_all(to.join(name).parent().unwrap()).unwrap();
        fs_err::write(to.join(name), bytes).unwrap();
    }
}

/// Demands the same files with the same bytes.
#[track_caller]
pub(crate) fn assert_same(a: &BTreeMap<String, Vec<u8>>, b: &BTreeMap<String, Vec<u8>>) {
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    let different: Vec<&String> = a.iter().filter(|(name, bytes)| b[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(different.is_empty(), "different bytes: {different:?}");
}
