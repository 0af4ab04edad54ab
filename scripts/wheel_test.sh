#!/usr/bin/env bash
# Tries the wheel: pip installs it where nothing of the repository is, the program makes a folder and begins a run there, and
# the Python package reads a corpus.
#
#     scripts/wheel_test.sh [PROFILE]      # of cargo: dev; `pip install .` builds with release
#
# maturin comes from the package index, for the last part pyarrow, too. Where that cannot be reached it says so and ends with 77.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root="$PWD"

missing() {
    echo "not run: $1" >&2
    exit 77
}
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/build"
"$folder/build/bin/pip" install --disable-pip-version-check --quiet 'maturin>=1.10,<2' > "$folder/log" 2>&1 \
    || missing "maturin cannot be fetched: $(tail -n 1 "$folder/log")"
"$folder/build/bin/maturin" build --profile "${1:-dev}" --out "$folder/wheels"

python3 -m venv "$folder/own"
"$folder/own/bin/pip" install --disable-pip-version-check --quiet --no-index "$folder"/wheels/djinn_traffic-*.whl
export PATH="$folder/own/bin:$PATH"
cd "$folder"
python -c 'import djinn.drive, importlib.metadata as metadata; print("djinn-traffic", metadata.version("djinn-traffic"))'
djinn --version
djinn init first
cd first
djinn run quickstart.toml --dry-run > plan.toml       # names all that is read, and fails if it is not there
djinn run quickstart.toml --stage ingest --stage mine
ls -l "$folder"/wheels

# Where pyarrow is missing, that is what is said; with it, arrays hold what the tables hold.
python -c 'import djinn.corpus' 2> "$folder/log" && exit 1
grep -q 'pip install pyarrow numpy' "$folder/log"
"$folder/own/bin/pip" install --disable-pip-version-check --quiet numpy pyarrow > "$folder/log" 2>&1 \
    || missing "djinn.corpus, as pyarrow cannot be fetched: $(tail -n 1 "$folder/log")"
cp -r "$root/tests/fixtures/corpus/cut_ins" "$folder/corpus"
python "$root/scripts/check_corpus_package.py" "$folder/corpus" "$folder"
