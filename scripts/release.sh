#!/usr/bin/env bash
# Builds what a release consists of: archives of the program for each target, the wheel, checksums.
#
#     scripts/release.sh OUT [TARGET ...]      # without targets, for this machine
#
# The commit must be tagged v<version of Cargo.toml> and the changelog must date that version. An archive holds the program, man pages,
# completions of shells, licenses, README and changelog. Other targets need what links for them: a C compiler, and
# `rustup target add TARGET`; zig serves as one for all (`pip install cargo-zigbuild ziglang`; then DJINN_CARGO="cargo zigbuild"). The wheel
# needs maturin, the image `podman` or `docker`; without, it says what it leaves out.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

out="${1:?where to: scripts/release.sh OUT [TARGET ...]}"
shift
host="$(rustc -vV | sed -n 's/^host: //p')"
targets=("${@:-$host}")
version="$(sed -n '0,/^version = "\(.*\)"/s//\1/p' Cargo.toml)"
fail() {
    echo "error: $1" >&2
    exit 1
}
[ -z "$(git status --porcelain)" ] || fail "there are changes that are in no commit"
git tag --points-at HEAD | grep -qx "v$version" || fail "this commit has no tag v$version: git tag v$version"
grep -q "^## $version, 20[0-9][0-9]-[0-9][0-9]-[0-9][0-9]$" CHANGELOG.md || fail "CHANGELOG.md has no section \`## $version, YYYY-MM-DD\`"
[ ! -e "$out" ] || fail "$out exists: name a new folder"
DJINN_REVISION="$(git rev-parse HEAD)"
export DJINN_REVISION SOURCE_DATE_EPOCH
SOURCE_DATE_EPOCH="$(git log -1 --format=%ct)"

mkdir -p "$out"
out="$(realpath "$out")"
stage="$(mktemp -d)"
trap 'rm -rf "$stage"' EXIT
built="${CARGO_TARGET_DIR:-target}"
# What is in every archive comes from a program that runs here.
cargo build --release --locked
djinn="$built/release/djinn"
mkdir -p "$stage/common/man" "$stage/common/completions"
"$djinn" man "$stage/man" --quiet
cp "$stage"/man/*.1 "$stage/common/man"
for shell in bash zsh fish elvish powershell; do
    "$djinn" completions "$shell" > "$stage/common/completions/djinn.$shell"
done
cp README.md CHANGELOG.md LICENSE-APACHE LICENSE-MIT "$stage/common"
for target in "${targets[@]}"; do
    if [ "$target" = "$host" ]; then
        program="$djinn"
    else
        ${DJINN_CARGO:-cargo build} --release --locked --target "$target"
        program="$(ls "$built/$target/release/djinn" "$built/$target/release/djinn.exe" 2> /dev/null | head -n 1)"
    fi
    name="djinn-$version-$target"
    cp -r "$stage/common" "$stage/$name"
    cp "$program" "$stage/$name"
    [ "$target" != "$host" ] || strip "$stage/$name/djinn"
    tar --create --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" --directory "$stage" "$name" | gzip -n > "$out/$name.tar.gz"
done
if command -v maturin > /dev/null; then
    maturin build --release --locked --out "$out"
else
    echo "not built: the wheel, which needs maturin" >&2
fi
if engine="$(command -v podman || command -v docker)" && "$engine" info > /dev/null 2>&1; then
    "$engine" build --file Containerfile --target cpu --build-arg DJINN_REVISION="$DJINN_REVISION" --tag "djinn:$version" .
    "$engine" save "djinn:$version" | gzip -n > "$out/djinn-$version-image.tar.gz"
else
    echo "not built: the image, which needs podman or docker" >&2
fi
(cd "$out" && sha256sum -- * > "$stage/SHA256SUMS" && mv "$stage/SHA256SUMS" .)
ls -l "$out"
