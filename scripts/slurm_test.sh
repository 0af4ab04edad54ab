#!/usr/bin/env bash
# Runs a pipeline on a real Slurm of two nodes on this machine, loses a worker, has one queued again and drains a node, and compares
# every file but timings and logs with those of `djinn run`. Then two processes train a model, one is lost, and it is compared as well.
#
#     scripts/slurm_test.sh [DJINN] [PIPELINE.toml]
#
# Needs root and Slurm with munge (apt-get install slurmctld slurmd slurm-client munge). Where they are missing it says so and ends
# with 77. It starts daemons of its own on ports of their own below a temporary folder, and ends them.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
djinn="$(realpath "${1:-${CARGO_TARGET_DIR:-target}/debug/djinn}")"
pipeline="$(realpath "${2:-pipelines/quickstart.toml}")"

missing() {
    echo "not run: $1" >&2
    exit 77
}
[ "$(id -u)" = 0 ] || missing "the daemons of Slurm need root"
for program in slurmctld slurmd sbatch scontrol munged mungekey; do
    PATH="$PATH:/usr/sbin" command -v "$program" > /dev/null || missing "$program is not installed"
done
export PATH="$PATH:/usr/sbin"

folder="$(mktemp -d)"
daemons=()
finish() {
    local code=$?
    [ "$code" = 0 ] || tail -n 20 "$folder"/*.log "$folder"/out/*/main/slurm/*.txt >&2 || true
    for pid in "${daemons[@]}"; do kill "$pid" 2> /dev/null || true; done
    # They write their states once more.
    for pid in "${daemons[@]}"; do wait "$pid" 2> /dev/null || true; done
    rm -rf "$folder"
    exit "$code"
}
trap finish EXIT

# A key and a socket of our own: a munge of the system, if there is one, is left alone.
chmod 755 "$folder"
mkdir -p "$folder/munge" "$folder/state"
mungekey --create --keyfile="$folder/munge/key"
chmod 700 "$folder/munge"
munged --foreground --force --key-file="$folder/munge/key" --socket="$folder/munge.socket" --pid-file="$folder/munge/pid" \
    --log-file="$folder/munge.log" --seed-file="$folder/munge/seed" > "$folder/munged.log" 2>&1 &
daemons+=($!)

host="$(hostname -s)"
cat > "$folder/slurm.conf" << END
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=16817
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge.socket
CryptoType=crypto/munge
StateSaveLocation=$folder/state
SlurmctldPidFile=$folder/slurmctld.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdSpoolDir=$folder/spool.%n
SlurmdPidFile=$folder/slurmd.%n.pid
SlurmdLogFile=$folder/slurmd.%n.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
JobRequeue=1
ReturnToService=2
SchedulerParameters=requeue_setup_env_fail
SlurmdParameters=config_overrides
KillWait=10
NodeName=one NodeHostname=$host NodeAddr=127.0.0.1 Port=16821 CPUs=2
NodeName=two NodeHostname=$host NodeAddr=127.0.0.1 Port=16822 CPUs=2
PartitionName=main Nodes=one,two Default=YES MaxTime=INFINITE State=UP
END
export SLURM_CONF="$folder/slurm.conf"
for _ in $(seq 50); do [ -S "$folder/munge.socket" ] && break; sleep 0.1; done
slurmctld -D -f "$SLURM_CONF" > "$folder/slurmctld.out.log" 2>&1 &
daemons+=($!)
for node in one two; do
    mkdir -p "$folder/spool.$node"
    slurmd -D -N "$node" -f "$SLURM_CONF" > "$folder/slurmd.$node.out.log" 2>&1 &
    daemons+=($!)
done
for _ in $(seq 60); do [ "$(sinfo -h -t idle -o %D 2> /dev/null || true)" = 2 ] && break; sleep 1; done
sinfo

out="$folder/out"
common=(--set generate.scenes_per_shard=1 --threads 1)
"$djinn" run "$pipeline" "${common[@]}" --output "$folder/alone" --quiet
name="$(ls "$folder/alone")"
"$djinn" submit "$pipeline" --set generate.scenes_per_shard=1 --set cluster.cpus=1 --output "$out" --engine slurm --workers 3 > "$folder/jobs"
cat "$folder/jobs"
work="$(awk '$1 == "work" { print $2 }' "$folder/jobs")"
last="$(tail -n 1 "$folder/jobs" | cut -f 2)"
run="$out/$name/main"

# Waits until so many shards are sampled.
sampled() {
    for _ in $(seq 1200); do
        [ "$("$djinn" status "$run" --json 2> /dev/null | grep -o '"n_done": [0-9]*' | grep -o '[0-9]*' || echo 0)" -ge "$1" ] && return
        sleep 0.2
    done
    echo "no worker has sampled $1 shards" >&2
    return 1
}
sampled 2
# One worker dies without a word, with the shell around it.
victim="$(pgrep -f -- "--output $out .*--worker 1/3" | head -n 1)"
kill -9 "$victim" && echo "killed worker 1"
sampled 4
scontrol requeue "${work}_2" && echo "queued worker 2 again"
sampled 6
scontrol update NodeName=two State=DRAIN Reason=test && echo "drained node two"
"$djinn" status "$run"

state() { scontrol show job "$1" -o 2> /dev/null | grep -o 'JobState=[A-Z_]*' | head -n 1 | cut -d = -f 2; }
completed() {
    for _ in $(seq 1800); do
        case "$(state "$1")" in
            COMPLETED) return ;;
            FAILED | CANCELLED | TIMEOUT | NODE_FAIL | "") break ;;
        esac
        sleep 0.5
    done
    echo "job $1 ended as $(state "$1")" >&2
    return 1
}
same() { diff -r --exclude=timings.json --exclude=log.txt --exclude=.lock --exclude=slurm "$1" "$2" && echo "same bytes as one process"; }
completed "$last"
"$djinn" status "$run"
same "$folder/alone/$name/main" "$run"
