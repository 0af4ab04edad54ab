//! What does `--help` teach beyond the list of options?

/// Help after the options of the program itself.
pub(super) const TOP: &str = "\
Examples:
  djinn init first                       make a folder with the quickstart and what it reads
  cd first && djinn run quickstart.toml  run all its stages, on bundled recordings
  djinn run quickstart.toml --dry-run    show what would run
  djinn inspect output/quickstart/main   show the results

Running the same command again resumes an interrupted run and redoes only what changed. djinn never removes or \
replaces a file that it did not write.

Exit codes:
  0  done
  1  bad input: arguments, configuration, recordings
  2  program or machine failure: a bug, a full disk, a damaged file of djinn's
  3  everything ran, but a quality gate failed
  75 stopped by SIGTERM or SIGUSR1, or waiting for other work: the same command continues
Other signals end the program with 128 and their number; it prints what is kept and how to continue.";

/// Help after the options of `init`.
pub(super) const INIT: &str = "\
Writes the pipeline, and the bundled models and recordings that it reads. Its first lines say what it is for, and \
which recordings you have to bring.

Examples:
  djinn init first
  djinn init mine cut_in_request";

/// Help after the options of `run`.
pub(super) const RUN: &str = "\
A pipeline file has one section per stage: [ingest], [mine], [train.denoiser], [train.distill], [train.classifier], \
[train.baseline], [generate], [evaluate], [report]. Stages with a section run, in this order. Relative paths are \
relative to the file, those of the command line to the current directory. A bundled pipeline may be called by its \
name (`djinn run quickstart`). Results go to <output>/<pipeline>/<run>/. A stage runs again only if its \
configuration or inputs changed. A model that took more than ten minutes to train is retrained only if its own section \
changed, or with --redo; the old model is moved aside. Several workers can share generation and evaluation. \
Recordings may be in object stores (s3://, gs://), and results are copied there at the end if --output is a URL; \
credentials come from the environment (pipelines/CLUSTER.md).

Examples:
  djinn run pipelines/cut_in_corpus.toml
  djinn run pipelines/cut_in_corpus.toml --redo train_denoiser
  djinn run pipelines/cut_in_corpus.toml --run more --set run.seed=1
  djinn run pipelines/cut_in_corpus.toml --stage ingest --stage mine
  djinn run pipelines/cut_in_corpus.toml --stage generate --part work --worker 3/100
  djinn run pipelines/cut_in_corpus.toml --output s3://traffic/runs --cache-dir /scratch/djinn
  djinn run pipelines/cut_in_corpus.toml --set 'ingest.inputs=[\"/data/INTERACTION-v1_2.zip\"]'";

/// Help after the options of `submit`.
pub(super) const SUBMIT: &str = "\
The jobs: `prepare` runs the stages before generation, `plan` decides what is sampled, `work` samples shards, \
`seal` publishes the samples. With several workers, `evaluate-plan`, `evaluate-work` and `evaluate-seal` do the same \
for evaluation. `finish` runs the remaining stages. Each job checks for itself that its inputs exist. Submitting again \
fills in what is missing. [cluster] sets what jobs need: partition, time, cpus, gpus, memory, container, retries, \
further lines of the scripts (pipelines/CLUSTER.md).

Examples:
  djinn submit pipelines/quickstart.toml --engine slurm --workers 100 --dry-run
  djinn submit pipelines/quickstart.toml --engine json | jq -r '.jobs[].command | join(\" \")'";

/// Help after the options of `status`.
pub(super) const STATUS: &str = "\
Reads only the run folder: it asks no engine and works on any machine that can see the folder. A shard counts as \
running if a worker started it recently, so a killed worker shows only after a while.

Examples:
  djinn status output/quickstart/main
  djinn status output/quickstart/main --json | jq .shards.n_missing";

/// Help after the options of `ingest`.
pub(super) const INGEST: &str = "\
Recordings are read as downloaded: folders, .zip, .tar, .tar.gz, .gz and plain files.

Examples:
  djinn ingest forecasting_train.tar.gz hd_maps.tar.gz --dataset argoverse1 -o output/argoverse1
  djinn ingest --config pipelines/cut_in_corpus.toml --set ingest.limit=1000 --output output/try
  djinn ingest own_folder --config configs/ngsim.toml --explain=scene.svg";

/// Help after the options of `mine`.
pub(super) const MINE: &str = "\
Examples:
  djinn mine --config pipelines/cut_in_corpus.toml --output output/try
  djinn mine --set 'mine.behaviors=[{ kind = \"near_miss\" }]' --output output/argoverse1";

/// Help after the options of `train denoiser`.
pub(super) const TRAIN_DENOISER: &str = "\
Examples:
  djinn train denoiser --config pipelines/cut_in_corpus.toml --output output/try
  djinn train denoiser --set train.denoiser.preset=tiny --output output/argoverse1";

/// Help after the options of `train distill`.
pub(super) const TRAIN_DISTILL: &str = "\
The distilled network has the same architecture and samples in few evaluations. To use it in a sweep, set \
model = \"distilled\" and sampler = { kind = \"euler\", n_steps = 2, grid = … } as in train.distill.method.

Examples:
  djinn train distill --config pipelines/few_evaluations.toml --output output/try
  djinn train distill --denoiser checkpoints/small --output output/argoverse1";

/// Help after the options of `train classifier`.
pub(super) const TRAIN_CLASSIFIER: &str = "\
Example:
  djinn train classifier --config pipelines/cut_in_corpus.toml --output output/try";

/// Help after the options of `train baseline`.
pub(super) const TRAIN_BASELINE: &str = "\
Examples:
  djinn train baseline --config pipelines/scene_transformer.toml --output output/try
  djinn train baseline --set train.baseline.preset=tiny --output output/argoverse1";

/// Help after the options of `rates`.
pub(super) const RATES: &str = "\
Writes modeled_rates.parquet, the rates that closed loops of the unguided model have, and modeled.json, which compares \
them with recorded ones: no rate is given where they differ by more than a factor of 1.5.

Example:
  djinn rates --set rates.loops=1000 --output output/cut_in_request/main";

/// Help after the options of `situations`.
pub(super) const SITUATIONS: &str = "\
Writes situations/, scenes like those of recordings, from which requests of [generate] begin when recorded ones do not \
suffice.

Example:
  djinn situations --set situations.populated=200 --output output/cut_in_request/main";

/// Help after the options of `generate`.
pub(super) const GENERATE: &str = "\
Example:
  djinn generate --config pipelines/cut_in_corpus.toml --denoiser checkpoints/small -o output/try";

/// Help after the options of `evaluate`.
pub(super) const EVALUATE: &str = "\
Exits with code 3 if a gate of [evaluate.gates] fails. The outputs are written either way.

Example:
  djinn evaluate --config pipelines/cut_in_corpus.toml --output output/try";

/// Help after the options of `report`.
pub(super) const REPORT: &str = "\
Writes report.html, a single file that works offline, and figures/ with its charts and scenes as SVG.

Example:
  djinn report --from output/cut_in_corpus/main --output output/try";

/// Help after the options of `export`.
pub(super) const EXPORT: &str = "\
index.tsv and tracks.tsv map the files back to the corpus. NOTICE.txt names the sources and their terms, which apply \
to the export too. What a format cannot represent is left out; export.json counts it by reason.

Examples:
  djinn export openscenario output/quickstart/main/corpus --only-verified --out output/xosc
  djinn export commonroad output/quickstart/main/corpus --limit 10 --out output/commonroad
  python scripts/check_exports.py output/xosc        reads an export with the readers of its format";

/// Help after the options of `drive`.
pub(super) const DRIVE: &str = "\
Drives every accepted scenario for some seconds in a closed loop: every half second all others plan anew, from where \
everybody really is. The event goes as in the scenario until it is over; then the model drives its agents, too. A \
planner is a command, as in a shell, that reads observations and writes actions, one JSON object a line \
(pipelines/DRIVE.md). One that is slow, dies or answers nonsense fails its scenario and nothing else; one that never \
runs is refused. The careful driver of UN Regulation No. 157 \
drives the same scenarios: what it survives and the planner does not is listed, hardest first.

Writes drives.parquet, driven.parquet (all states), drive.json, planner.log (stderr) and, with --save-at, states/. \
What an interrupted drive has done is kept in OUT.drives: the same command goes on.

Examples:
  djinn drive output/quickstart/main/corpus --ego idm --out output/idm
  djinn drive output/quickstart/main/corpus --ego ./planner.py --limit 20 --out output/mine
  djinn drive output/quickstart/main/corpus --ego model --save-at event --out output/model
  djinn drive output/quickstart/main/corpus --ego idm --from STATE.json --out output/fork";

/// Help after the options of `score`.
pub(super) const SCORE: &str = "\
For trajectories, without a planner to run: everybody else does what the scenario has. Beside the planned states, \
drives.parquet has the careful driver, the scenario's own ego, and what was recorded.

Example:
  djinn score output/quickstart/main/corpus planned.parquet --max-avoidable 0 --out output/score";

/// Help after the options of `corpus validate`.
pub(super) const CORPUS_VALIDATE: &str = "\
Checks sizes, checksums, schemas, counts and unique ids; that states, lanes and recordings belong to scenarios; that \
values are finite and physically possible; and that no stray file would be read by a query. Findings go to stdout with \
file and row (from 0). The exit code is 1 if the corpus is damaged; remarks do not count as damage.

Examples:
  djinn corpus validate output/quickstart/main/corpus
  djinn corpus validate output/quickstart/main/corpus --json | jq .by_check";

/// Help after the options of `corpus merge`.
pub(super) const CORPUS_MERGE: &str = "\
A scenario in several corpora is written once; if its content differs between them, the merge fails. Recordings, maps, \
metrics of scenarios and the terms of all sources are merged too.

Example:
  djinn corpus merge output/cut_ins/main/corpus output/near_misses/main/corpus --out output/all";

/// Help after the options of `corpus filter`.
pub(super) const CORPUS_FILTER: &str = "\
A condition is a column of `scenarios`, one of =, !=, <, <=, > and >=, and a value. A flag may stand alone: \
verified. A missing value fails every comparison. For any other choice, select ids by SQL and pipe them in: --ids -.

Examples:
  djinn corpus filter output/all --where verified --where \"gap_m < 5\" --out output/tight
  djinn corpus filter output/all --top 100 --by pair_min_ttc_s --least --out output/hardest
  djinn corpus filter output/all --ids ids.txt --out output/listed";

/// Help after the options of `regenerate`.
pub(super) const REGENERATE: &str = "\
Reads samples/, scenes/ and the models of the run folder and checks their fingerprints. Then it denoises the \
scenario's batch again (the last digits depend on the batch), mines the result and compares every column bit by bit. \
The number of threads does not matter.

Exits with code 0 if the scenario is identical, 1 if it differs or one of its inputs changed, 2 if an input is missing.

Examples:
  djinn regenerate 0f3a5b1c9d2e4f60 --from output/cut_in_request/main
  djinn regenerate 0f3a5b1c9d2e4f60 --corpus output/cut_in_request/main/corpus --out again.parquet";

/// Help after the options of `inspect`.
pub(super) const INSPECT: &str = "\
Examples:
  djinn inspect output/quickstart/main
  djinn inspect output/cut_in_request/main/samples    show the results of requests by bucket
  djinn inspect output/quickstart/main/scenes --json | jq .n_scenes";

/// Help after the options of `list`.
pub(super) const LIST: &str = "\
Examples:
  djinn list behaviors
  djinn list metrics | grep collision";

/// Help after the options of `man`.
pub(super) const MAN: &str = "\
Examples:
  djinn man pages && man pages/djinn.1";

/// Help after the options of `completions`.
pub(super) const COMPLETIONS: &str = "\
Examples:
  djinn completions bash > ~/.local/share/bash-completion/completions/djinn
  djinn completions zsh > ~/.zfunc/_djinn";
