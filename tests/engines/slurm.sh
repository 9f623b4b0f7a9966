#!/bin/bash
# A study of 40 jobs by Slurm, on one node that this script starts: some jobs are killed, and slurmd, too, in the midst.
# In the end nothing is missing, and the table is that of our own engine, byte for byte. Not part of `cargo test`:
#
#   tests/engines/slurm.sh target/release/pathtune
set -euo pipefail
pathtune=$(realpath "${1:?the program}")
skip() { echo "skipped: slurm: $1"; exit 0; }
[ "$(id -u)" = 0 ] || skip "needs root"
for tool in slurmctld slurmd sbatch squeue; do
    command -v $tool >/dev/null || skip "no $tool (Debian: slurmctld slurmd slurm-client)"
done

work=$(mktemp -d /tmp/ptslurm.XXXXXX)
node=$(hostname -s)
export SLURM_CONF=$work/slurm.conf XDG_RUNTIME_DIR=$work/r
mkdir "$work"/{r,state,spool,scratch,slurm.results}
cores=$(nproc)
cat > "$SLURM_CONF" <<CONF
ClusterName=study
SlurmctldHost=$node(127.0.0.1)
SlurmctldPort=26817
SlurmdPort=26818
AuthType=auth/none
CredType=cred/none
SlurmUser=root
SlurmdUser=root
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/affinity
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
ReturnToService=2
SlurmdTimeout=20
JobRequeue=1
MailProg=/bin/true
NodeName=$node NodeAddr=127.0.0.1 CPUs=$cores RealMemory=$(free -m | awk "/^Mem:/ { print \$2 }") State=UNKNOWN
PartitionName=all Nodes=$node Default=YES MaxTime=INFINITE State=UP
CONF
slurmd=
controller=
finish() {
    scancel --user=root >/dev/null 2>&1 || true
    [ -z "$slurmd" ] || kill "$slurmd" 2>/dev/null || true
    [ -z "$controller" ] || kill "$controller" 2>/dev/null || true
    wait 2>/dev/null || true
    "$pathtune" clean >/dev/null 2>&1 || true
    if [ -n "${KEEP:-}" ]; then echo "kept: $work"; else rm -rf "$work"; fi
}
trap finish EXIT
slurmctld -D -c >"$work/controller.out" 2>&1 & controller=$!
slurmd -D -c -N "$node" >"$work/node.out" 2>&1 & slurmd=$!
for _ in $(seq 100); do
    [ "$(sinfo --noheader --format %T 2>/dev/null)" = idle ] && break
    sleep 0.3
done
[ "$(sinfo --noheader --format %T)" = idle ] || { cat "$work"/*.out "$work"/*.log; echo "failed: the node does not come up"; exit 1; }

cd "$work"
cat > study.toml <<'STUDY'
[[jobs]]
maneuver = "lane_change"
episodes = 60
law = ["paper", "stanley"]
seed = "1..20"
STUDY
"$pathtune" sweep plan study.toml
"$pathtune" sweep run study.jsonl --all --quiet
"$pathtune" sweep collect study.jsonl >/dev/null

"$pathtune" sweep slurm study.jsonl --results slurm.results --scratch "$work/scratch" --tries 5 > study.sh
started=$(date +%s)
sbatch --parsable study.sh
jobs_under_way() { pgrep -f "sweep run $work/study.jsonl --index" || true; }
killed=0
node_failed=0
for _ in $(seq 6000); do
    [ -n "$(squeue --noheader 2>/dev/null)" ] || break
    done=$(find slurm.results -name '*.json' ! -name '*.outcome.json' 2>/dev/null | wc -l)
    # One of twenty jobs, spread over the study.
    if ((done >= 10 * killed + 3 && killed < 4)); then
        pid=$(jobs_under_way | shuf -n 1)
        if [ -n "$pid" ] && kill -9 "$pid" 2>/dev/null; then killed=$((killed + 1)); fi
    fi
    if ((done >= 20 && node_failed == 0)); then
        node_failed=1
        kill -9 "$slurmd"
        wait "$slurmd" 2>/dev/null || true
        sleep 3
        slurmd -D -c -N "$node" >>"$work/node.out" 2>&1 & slurmd=$!
    fi
    sleep 0.1
done
"$pathtune" sweep status study.jsonl --results slurm.results
"$pathtune" sweep collect study.jsonl --results slurm.results --out slurm.csv >/dev/null
cmp study.csv slurm.csv
decided() { (cd "$1" && find . -name '*.outcome.json' | sort | xargs sha256sum); }
[ "$(decided study.results)" = "$(decided slurm.results)" ]
echo "passed: 40 jobs by Slurm in $(($(date +%s) - started)) s, $killed killed, slurmd killed $node_failed times: the same bytes"
