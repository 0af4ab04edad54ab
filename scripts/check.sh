#!/usr/bin/env bash
# Formatting, lints and tests: what every change must pass. CI runs this and then a whole pipeline (.ci/run).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

cargo fmt --check
cargo clippy --locked --all-targets -- -D warnings
cargo test --locked
