//! What does `--help` teach beyond the list of options?

/// Of the program.
pub(super) const TOP: &str = "\
Examples:
  djinn run pipelines/quickstart.toml                 the whole job on the recordings that the project carries
  djinn run pipelines/quickstart.toml --dry-run       what it would do
  djinn inspect output/quickstart/main                what came of it

The same command again resumes where it was interrupted, and redoes only what changed.

Exit codes:
  0  done
  1  the input is at fault: arguments, configuration, recordings, files given
  2  the program or the machine is at fault: a bug, a full disk, a damaged file of ours
  3  everything ran, but a quality gate of the configuration was not met";

/// Of `run`.
pub(super) const RUN: &str = "\
A pipeline file has one section a stage: [ingest], [mine], [train.denoiser], [train.classifier],
[train.baseline], [generate], [evaluate], [report]. The stages whose sections are there run, in this order. Relative paths in it are relative to the
current directory. Results go to <output>/<pipeline>/<run>/; stages whose configuration and inputs did not change are
not run again.

Examples:
  djinn run pipelines/cut_in_corpus.toml
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
Example:
  djinn report --from output/cut_in_corpus/main --output output/try";

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
  djinn inspect output/quickstart/main/scenes --json | jq .n_scenes";
