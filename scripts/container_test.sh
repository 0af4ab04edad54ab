#!/usr/bin/env bash
# Tries the container recipe: the quickstart by a user without rights, in a root that holds the program and a C library.
#
#     scripts/container_test.sh [DJINN]
#
# With DJINN_BUILDER=podman (or buildah, docker) it builds the target `smoke` of the Containerfile, for which the images that it names must
# be at hand. Else, with DJINN or the program that was built last, it makes a root of what the final image holds, of Debian's
# packages, and does there what that target does. Needs root and apt-get; where these are missing it says so and ends with 77.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [ -n "${DJINN_BUILDER:-}" ]; then
    "$DJINN_BUILDER" build --file Containerfile --target smoke .
    echo "the quickstart ran in an image built by $DJINN_BUILDER"
    exit
fi

missing() {
    echo "not run: $1" >&2
    exit 77
}
djinn="$(realpath "${1:-${CARGO_TARGET_DIR:-target}/debug/djinn}")"
[ -x "$djinn" ] || missing "there is no program at $djinn"
for program in apt-get dpkg-deb unshare strip; do
    command -v "$program" > /dev/null || missing "$program is not installed"
done
unshare --mount --pid --net --ipc --uts --fork --kill-child --mount-proc true 2> /dev/null || missing "a root of our own needs root"

folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
root="$folder/root"
home="$root/home/nonroot"
mkdir -p "$root"/{usr/local/bin,tmp,proc} "$home/tests/fixtures"
(cd "$folder" && apt-get download libc6 libgcc-s1) > "$folder/log" 2>&1 || missing "Debian's packages cannot be fetched: $(tail -n 1 "$folder/log")"
for package in "$folder"/*.deb; do dpkg-deb --extract "$package" "$root"; done
cp "$djinn" "$root/usr/local/bin/djinn"
strip "$root/usr/local/bin/djinn"
cp -R pipelines "$home/pipelines"
cp -R tests/fixtures/recordings "$home/tests/fixtures/recordings"
chown -R 65532:65532 "$home"
chmod 1777 "$root/tmp"

# Neither the variables nor the processes of this machine, and no network.
inside() {
    env -i PATH=/usr/local/bin HOME=/home/nonroot "$(command -v unshare)" --mount --pid --net --ipc --uts --fork --kill-child --mount-proc \
        --root "$root" --wd /home/nonroot --setgid 65532 --setuid 65532 /usr/local/bin/djinn "$@"
}
if ! said="$(inside --version 2>&1)"; then
    case "$said" in
        *"shared librar"* | *GLIBC*) echo "$said" >&2; exit 1 ;;
        *) missing "nothing can be started in a root of our own: $said" ;;
    esac
fi
inside run pipelines/quickstart.toml --quiet
inside corpus validate output/quickstart/main/corpus
echo "the quickstart ran as the image would run it, in a root of $(du -sm --exclude=home --exclude=proc "$root" | cut -f 1) MB"
