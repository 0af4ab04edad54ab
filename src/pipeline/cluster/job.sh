retries=@RETRIES@
child=
told=

# Time is up soon, or the node is wanted: the program saves what is done and ends with 75.
trap 'told=1; [ -z "$child" ] || kill -TERM "$child" 2>/dev/null' USR1 TERM
@COMMAND@ &
child=$!
[ -z "$told" ] || kill -TERM "$child"
while :; do
    wait "$child"
    code=$?
    # A signal ends the waiting, not the program.
    kill -0 "$child" 2>/dev/null || break
done

# 0: done, 1: bad input, 3: a quality gate failed. 75 was stopped or waits; anything else died.
case "$code" in
    0 | 1 | 3) exit "$code" ;;
esac
job="$SLURM_JOB_ID"
[ -z "${SLURM_ARRAY_TASK_ID:-}" ] || job="${SLURM_ARRAY_JOB_ID}_${SLURM_ARRAY_TASK_ID}"
if [ "${SLURM_RESTART_COUNT:-0}" -lt "$retries" ]; then
    echo "djinn ended with $code: job $job is queued again" >&2
    scontrol requeue "$job"
fi
exit "$code"
