#!/usr/bin/env bash
# Formatting, lints and tests: what every change must pass. CI runs this and then a whole pipeline (.ci/run).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

cargo fmt --check
cargo clippy --locked --all-targets -- -D warnings

# Tests that want what is not here say so in the file that DJINN_SKIPPED names (tests/skipped.rs): .ci/run's, or one of our own.
if [ -z "${DJINN_SKIPPED:-}" ]; then
    DJINN_SKIPPED="$(mktemp)"
    export DJINN_SKIPPED
    trap '[ ! -s "$DJINN_SKIPPED" ] || { echo; echo "skipped, for want of:"; sort -u "$DJINN_SKIPPED" | sed "s/^/  /"; }; rm -f "$DJINN_SKIPPED"' EXIT
fi
cargo test --locked
