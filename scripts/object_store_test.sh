#!/usr/bin/env bash
# Runs a small pipeline from recordings in an object store to a run folder there, through a proxy that lets one request in ten go wrong, and
# compares every file but timings and logs with those of `djinn run` on disk: by one process, by one that is killed again and again on
# changing machines, and by two workers of which one is killed. Then it reads the corpus from the store, and tries what must be refused.
#
#     scripts/object_store_test.sh [DJINN]
#
# DJINN is a program that was built with `--features cloud`. The store is moto's, of the Python package index, in an environment of its own
# (DJINN_MOTO names one that is there already). Where it cannot be had, the script says so and ends with 77.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
djinn="$(realpath "${1:-${CARGO_TARGET_DIR:-target}/debug/djinn}")"

missing() {
    echo "not run: $1" >&2
    exit 77
}
[ -x "$djinn" ] || missing "there is no program at $djinn"
"$djinn" inspect s3://no-such-bucket --cache-dir /nonexistent 2>&1 | grep -q "built without object stores" &&
    missing "$djinn was built without the feature cloud"

folder="$(mktemp -d)"
servers=()
finish() {
    local code=$?
    [ "$code" = 0 ] || tail -n 20 "$folder"/said/*.txt >&2 || true
    for pid in "${servers[@]}"; do kill "$pid" 2> /dev/null || true; done
    rm -rf "$folder"
    exit "$code"
}
trap finish EXIT
mkdir "$folder/said"

python="${DJINN_MOTO:-$folder/venv}/bin/python"
if [ -z "${DJINN_MOTO:-}" ]; then
    python3 -m venv "$folder/venv"
    "$python" -m pip install --disable-pip-version-check --quiet 'moto[server]==5.2.5' polars==2.1.0 > "$folder/pip.log" 2>&1 ||
        missing "moto cannot be installed: $(tail -n 1 "$folder/pip.log")"
fi

free_port() {
    python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])'
}
store_port="$(free_port)"
proxy_port="$(free_port)"
broken_port="$(free_port)"
export AWS_ACCESS_KEY_ID=djinn-test AWS_SECRET_ACCESS_KEY=nobody-may-read-this AWS_REGION=us-east-1 AWS_ALLOW_HTTP=true
store="http://127.0.0.1:$store_port"
"$python" -m moto.server --host 127.0.0.1 --port "$store_port" > "$folder/moto.log" 2>&1 &
servers+=($!)
python3 scripts/flaky_proxy.py --upstream "$store" --port "$proxy_port" --share 0.1 --seed 1 --count "$folder/faults.json" > "$folder/proxy.log" 2>&1 &
servers+=($!)
python3 scripts/flaky_proxy.py --upstream "$store" --port "$broken_port" --share 1 > "$folder/broken.log" 2>&1 &
servers+=($!)
export AWS_ENDPOINT_URL="http://127.0.0.1:$proxy_port"

# What is in the bucket, past the proxy: bucket NAME FILE puts an object there, fetch PREFIX FOLDER gets all below one.
bucket() {
    "$python" - "$store" "$@" << 'END'
import pathlib, sys, time
import boto3

store, action, name, path = sys.argv[1:]
client = boto3.client("s3", endpoint_url=store)
for attempt in range(100):
    try:
        client.create_bucket(Bucket="traffic")
        break
    except client.exceptions.ClientError:
        break
    except Exception:
        time.sleep(0.3)
if action == "put":
    client.upload_file(path, "traffic", name)
else:
    for page in client.get_paginator("list_objects_v2").paginate(Bucket="traffic", Prefix=name + "/"):
        for item in page.get("Contents", []):
            file = pathlib.Path(path, item["Key"].removeprefix(name + "/"))
            file.parent.mkdir(parents=True, exist_ok=True)
            client.download_file("traffic", item["Key"], str(file))
END
}
recordings=tests/fixtures/recordings/interaction/FIX-multi-v1_2.zip
bucket put "rec/$(basename "$recordings")" "$recordings"

cat > "$folder/small.toml" << 'END'
[run]
seed = 3
[ingest]
dataset = "interaction"
inputs = ["s3://traffic/rec/FIX-multi-v1_2.zip"]
splits = ["train", "val"]
limit = 125
[mine]
behaviors = [{ kind = "cut_in" }]
[train.denoiser]
preset = "tiny"
network = { layers = "TAM", width = 16, n_heads = 2, feed_forward = 16, geometry = { relation_width = 8 } }
steps = 12
batch_size = 2
warmup_steps = 2
evaluate_every = 6
save_every = 3
n_eval_scenes = 2
max_agents = 6
max_lanes = 8
[generate]
sampler = { kind = "heun", n_steps = 4 }
scenes_per_shard = 1
batch_size = 4
[[generate.sweeps]]
name = "as_recorded"
n_scenes = 12
n_samples = 4
[evaluate]
keep = "all"
[report]
n_drawn = 2
n_compared = 4
END

# A command of the machine with this name, which has a cache of its own; what it says is kept.
on() {
    local machine="$1"
    shift
    "$djinn" "$@" --cache-dir "$folder/cache/$machine" --quiet >> "$folder/said/$machine.txt" 2>&1
}
run() {
    local machine="$1" name="$2"
    shift 2
    on "$machine" run "$folder/small.toml" --output s3://traffic/runs --run "$name" "$@"
}
# The same in the place of the shell, so that whoever starts it in the background knows its number.
begin() {
    local machine="$1" name="$2"
    shift 2
    exec "$djinn" run "$folder/small.toml" --output s3://traffic/runs --run "$name" --cache-dir "$folder/cache/$machine" --quiet "$@" \
        >> "$folder/said/$machine.txt" 2>&1
}
# The same, heard.
run_loud() {
    "$djinn" run "$folder/small.toml" --output s3://traffic/runs --cache-dir "$folder/cache/a" "$@"
}
# Compares two folders but for timings, logs and the files that are named.
compare() {
    local a="$1" b="$2" except=(--exclude=timings.json --exclude=log.txt --exclude=.lock)
    shift 2
    for name in "$@"; do except+=("--exclude=$name"); done
    diff -r "${except[@]}" "$a" "$b" > "$folder/said/diff.txt" || { echo "$a and $b differ" >&2; exit 1; }
}
# Ends unless a command ends with this code and says this.
expect() {
    local code="$1" words="$2" found=0
    shift 2
    "$@" > "$folder/said/expected.txt" 2>&1 || found=$?
    [ "$found" = "$code" ] || { echo "expected exit code $code, got $found: $*" >&2; exit 1; }
    grep -q -- "$words" "$folder/said/expected.txt" || { echo "expected to read \"$words\": $*" >&2; exit 1; }
}

echo "on disk"
"$djinn" run "$folder/small.toml" --set "ingest.inputs=[\"$recordings\"]" --output "$folder/disk" --quiet

echo "from the store to the store, by two machines"
run a main
bucket fetch runs/small/main "$folder/main"
# What shows the settings tells where the recordings are.
compare "$folder/disk/small/main" "$folder/main" '*.done.json' run.json config.toml report.html
run b again
bucket fetch runs/small/again "$folder/again"
compare "$folder/main" "$folder/again"
run b main
bucket fetch runs/small/main "$folder/main-again"
compare "$folder/main" "$folder/main-again"

echo "recordings of a prefix"
on a run "$folder/small.toml" --set 'ingest.inputs=["s3://traffic/rec"]' --output "$folder/prefix" --stage ingest
compare "$folder/main/scenes" "$folder/prefix/small/main/scenes"

echo "by one process that is killed"
killed=0
for seconds in 2 4 7; do
    begin "k$((killed % 2))" killed &
    pid=$!
    sleep "$seconds"
    kill -KILL "$pid" 2> /dev/null || true
    wait "$pid" 2> /dev/null && break
    killed=$((killed + 1))
done
run k2 killed
bucket fetch runs/small/killed "$folder/killed"
compare "$folder/main" "$folder/killed"

echo "by workers, of which one is killed ($killed kills before)"
run a shared --stage ingest --stage mine --stage train_denoiser
for stage in generate evaluate; do
    run a shared --stage "$stage" --part plan
    begin b shared --stage "$stage" --part work --worker 1/2 & first=$!
    begin c shared --stage "$stage" --part work --worker 2/2 & second=$!
    sleep 2
    kill -KILL "$second" 2> /dev/null || true
    on d status s3://traffic/runs/small/shared
    wait "$second" 2> /dev/null || run d shared --stage "$stage" --part work --worker 2/2
    wait "$first"
    run a shared --stage "$stage" --part seal
done
run b shared --stage report
bucket fetch runs/small/shared "$folder/shared"
compare "$folder/main" "$folder/shared"

echo "the corpus from the store"
on a corpus validate s3://traffic/runs/small/main/corpus
on a corpus diff s3://traffic/runs/small/main/corpus "$folder/disk/small/main/corpus"
on a report --compare s3://traffic/runs/small/main s3://traffic/runs/small/shared --out "$folder/comparison.html"
"$python" - "$store" "$folder/main/corpus/manifest.json" << 'END'
import json, sys
import polars

options = {"aws_endpoint_url": sys.argv[1], "aws_allow_http": "true", "aws_region": "us-east-1",
           "aws_access_key_id": "djinn-test", "aws_secret_access_key": "x"}
table = polars.scan_parquet("s3://traffic/runs/small/main/corpus/scenarios/**/*.parquet", storage_options=options)
n_rows = table.select(polars.len()).collect().item()
expected = json.load(open(sys.argv[2]))["n_scenarios"]
assert n_rows == expected > 0, (n_rows, expected)
print(f"polars: {n_rows} scenarios")
END

echo "what is refused"
echo "years of work" > "$folder/thesis.doc"
bucket put runs/small/main/corpus/thesis.doc "$folder/thesis.doc"
expect 1 "s3://traffic/runs/small/main/corpus: it holds thesis.doc, which djinn did not write" run_loud --redo evaluate
bucket fetch runs/small/main "$folder/refused"
cmp "$folder/refused/corpus/thesis.doc" "$folder/thesis.doc"
rm "$folder/refused/corpus/thesis.doc"
compare "$folder/main" "$folder/refused"
expect 1 "does not exist" "$djinn" run "$folder/small.toml" --set 'ingest.inputs=["s3://traffic/none"]' --output "$folder/none"
expect 1 "inside the input" "$djinn" run "$folder/small.toml" --set 'ingest.inputs=["s3://traffic/runs"]' --output s3://traffic/runs
AWS_ENDPOINT_URL="http://127.0.0.1:$broken_port" expect 2 "tried 6 times" "$djinn" inspect s3://traffic/runs/small/main --cache-dir "$folder/cache/e"

if grep -rlF "$AWS_SECRET_ACCESS_KEY" "$folder" --include='*' --exclude-dir=venv; then
    echo "a credential was written down" >&2
    exit 1
fi
echo "object stores work: the bytes on disk are those in the bucket, after $(cat "$folder/faults.json")"
