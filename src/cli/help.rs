//! What does `--help` teach beyond the list of options?

/// Of the program.
pub(super) const TOP: &str = "\
Examples:
  djinn run pipelines/quickstart.toml                 the whole job on the recordings that the project carries
  djinn run pipelines/quickstart.toml --dry-run       what it would do
  djinn inspect output/quickstart/main                what came of it

The same command again resumes where it was interrupted, and redoes only what changed. Files that djinn did not
write are never removed or replaced.

Exit codes:
  0  done
  1  the input is at fault: arguments, configuration, recordings, files given
  2  the program or the machine is at fault: a bug, a full disk, a damaged file of ours
  3  everything ran, but a quality gate of the configuration was not met
Ended by a signal (in a shell 130, 143 or 129), it says what stays and how to go on.";

/// Of `run`.
pub(super) const RUN: &str = "\
A pipeline file has one section a stage: [ingest], [mine], [train.denoiser], [train.distill],
[train.classifier], [train.baseline], [generate], [evaluate], [report]. The stages whose sections are there run, in this order. Relative paths in it are relative to the
current directory. Results go to <output>/<pipeline>/<run>/; stages whose configuration and inputs did not change are
not run again. A model that took more than ten minutes to train is trained again only for a changed setting of its own
section, or by --redo; the earlier one is moved aside.

Examples:
  djinn run pipelines/cut_in_corpus.toml
  djinn run pipelines/cut_in_corpus.toml --redo train_denoiser
  djinn run pipelines/cut_in_corpus.toml --run more --set run.seed=1 --set generate.sweeps.0.n_samples=8
  djinn run pipelines/cut_in_corpus.toml --set 'ingest.inputs=[\"/data/INTERACTION-v1_2.zip\"]' --dry-run";

/// Of `ingest`.
pub(super) const INGEST: &str = "\
Recordings are read as downloaded: folders, .zip, .tar, .tar.gz, .gz and plain files.

Examples:
  djinn ingest forecasting_train.tar.gz hd_maps.tar.gz --dataset argoverse1 --output output/argoverse1
  djinn ingest --config pipelines/cut_in_corpus.toml --set ingest.limit=1000 --output output/try";

/// Of `mine`.
pub(super) const MINE: &str = "\
Examples:
  djinn mine --config pipelines/cut_in_corpus.toml --output output/try
  djinn mine --scenes output/argoverse1/scenes --set 'mine.behaviors=[{ kind = \"near_miss\" }]' --output output/try";

/// Of `train denoiser`.
pub(super) const TRAIN_DENOISER: &str = "\
Examples:
  djinn train denoiser --config pipelines/cut_in_corpus.toml --output output/try
  djinn train denoiser --scenes output/argoverse1/scenes --set train.denoiser.preset=tiny --output output/try";

/// Of `train distill`.
pub(super) const TRAIN_DISTILL: &str = "\
The result has the same network, and samples in one to three evaluations. Sweeps of it have
model = \"distilled\" and the sampler of train.distill.method: { kind = \"euler\", n_steps = 2, grid = … }
after { kind = \"steps\", n_steps = 2, grid = … }, else { kind = \"consistency\", levels = [0.8] }.

Examples:
  djinn train distill --config pipelines/few_evaluations.toml --output output/try
  djinn train distill --denoiser checkpoints/small --scenes output/argoverse1/scenes --output output/try";

/// Of `train classifier`.
pub(super) const TRAIN_CLASSIFIER: &str = "\
Example:
  djinn train classifier --config pipelines/cut_in_corpus.toml --output output/try";

/// Of `train baseline`.
pub(super) const TRAIN_BASELINE: &str = "\
Examples:
  djinn train baseline --config pipelines/scene_transformer.toml --output output/try
  djinn train baseline --scenes output/argoverse1/scenes --set train.baseline.preset=tiny --output output/try";

/// Of `generate`.
pub(super) const GENERATE: &str = "\
Example:
  djinn generate --config pipelines/cut_in_corpus.toml --denoiser checkpoints/small --output output/try";

/// Of `evaluate`.
pub(super) const EVALUATE: &str = "\
Ends with exit code 3 if a gate of [evaluate.gates] is not met; its outputs are written all the same.

Example:
  djinn evaluate --config pipelines/cut_in_corpus.toml --output output/try";

/// Of `report`.
pub(super) const REPORT: &str = "\
Writes report.html, one file that needs no network, and figures/ with its charts and scenes as SVG. A comparison needs two
run folders: settings that differ, yield, metrics and realism side by side.

Examples:
  djinn report --from output/cut_in_corpus/main --output output/try
  djinn report --compare output/cut_in_corpus/main output/cut_in_corpus/more --out comparison.html";

/// Of `export`.
pub(super) const EXPORT: &str = "\
Beside the files, index.tsv and tracks.tsv lead back to the corpus, and NOTICE.txt names the sources and their terms, which
hold for the export, too. What a format cannot hold is left out, counted by reason in export.json, and told.

Examples:
  djinn export openscenario output/quickstart/main/corpus --only-verified --out output/xosc
  djinn export commonroad output/quickstart/main/corpus --limit 10 --out output/commonroad
  python scripts/check_exports.py output/xosc        reads an export with the readers of its format";

/// Of `corpus validate`.
pub(super) const CORPUS_VALIDATE: &str = "\
Checks sizes, checksums, schemas and counts, that ids are unique, that states, lanes and recordings belong to scenarios,
that numbers are numbers and possible, and that no file is there that queries would read by mistake. Findings go to
stdout with file and row (from 0); the exit code is 1 when the corpus is damaged. Remarks are no damage.

Examples:
  djinn corpus validate output/quickstart/main/corpus
  djinn corpus validate output/quickstart/main/corpus --json | jq .by_check";

/// Of `corpus merge`.
pub(super) const CORPUS_MERGE: &str = "\
A scenario that several corpora hold comes once; one that differs between them is refused. Recordings, maps, metric values
of scenarios and the terms of all sources come along. Corpora of earlier versions are read, too, and become present ones.

Example:
  djinn corpus merge output/cut_ins/main/corpus output/near_misses/main/corpus --out output/all";

/// Of `corpus filter`.
pub(super) const CORPUS_FILTER: &str = "\
A condition is a column of `scenarios`, an operator and a value. Operators: =, !=, <, <=, >, >=, in (a, b), not in (a, b),
is missing, is present. A flag may stand alone: verified, not recorded_event. A missing value fulfils no comparison.

Examples:
  djinn corpus filter output/quickstart/main/corpus --where verified --where \"gap_m < 5\" --out output/tight
  djinn corpus filter output/all --where \"behavior in (cut_in, near_miss)\" --where \"place != PIT\" --out output/some";

/// Of `corpus sample`.
pub(super) const CORPUS_SAMPLE: &str = "\
The same seed draws the same scenarios, whatever their order, and a larger number draws more beside them. With --by, each
value of the column gets the same number of scenarios as far as it has so many.

Examples:
  djinn corpus sample output/all --n 1000 --out output/thousand
  djinn corpus sample output/all --n 60 --by behavior --seed 7 --out output/balanced";

/// Of `corpus diff`.
pub(super) const CORPUS_DIFF: &str = "\
Counts by behavior and place, scenarios that only one corpus holds or that changed and in which columns, and shifts of
distributions. The comparison goes to stdout; the exit code is 0 whether or not there are differences.

Examples:
  djinn corpus diff output/quickstart/before/corpus output/quickstart/main/corpus
  djinn corpus diff output/a output/b --json | jq .n_changed";

/// Of `regenerate`.
pub(super) const REGENERATE: &str = "\
Needs what the run folder holds: samples/ with its plan and settings, scenes/, and the models. First their fingerprints
are compared with those of the run. Then the batch that the scenario was denoised in is denoised again (the last digits
depend on the batch), the miner judges it again, and every column is compared, bit by bit. The number of threads does not
matter.

Ends with exit code 0 if it is identical, 1 if it differs or something it was made from changed, 2 if something that it
needs is missing.

Examples:
  djinn regenerate 0f3a5b1c9d2e4f60 --from output/cut_in_request/main
  djinn regenerate 0f3a5b1c9d2e4f60 --corpus output/cut_in_request/main/corpus --out again.parquet";

/// Of `inspect`.
pub(super) const INSPECT: &str = "\
Examples:
  djinn inspect output/quickstart/main
  djinn inspect output/cut_in_request/main/samples    what a request got, bucket by bucket
  djinn inspect output/quickstart/main/scenes --json | jq .n_scenes";
