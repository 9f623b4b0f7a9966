#!/bin/bash
# A study of 40 jobs by GNU parallel; some are killed, and the whole of it once, then it goes on with --resume-failed. In
# the end nothing is missing, and the table is that of our own engine, byte for byte. Not part of `cargo test`:
#
#   tests/engines/parallel.sh target/release/pathtune
set -euo pipefail
pathtune=$(realpath "${1:?the program}")
skip() { echo "skipped: parallel: $1"; exit 0; }
command -v parallel >/dev/null || skip "no GNU parallel (Debian: parallel)"

work=$(mktemp -d /tmp/ptparallel.XXXXXX)
export XDG_RUNTIME_DIR=$work/r HOME=$work
mkdir "$work"/{r,scratch}
finish() { "$pathtune" clean >/dev/null 2>&1 || true; rm -rf "$work"; }
trap finish EXIT
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

"$pathtune" sweep parallel study.jsonl --results parallel.results --scratch "$work/scratch" > study.sh
done_jobs() { find parallel.results -name '*.json' ! -name '*.outcome.json' 2>/dev/null | wc -l; }
killed=0
interrupted=0
for round in 1 2 3 4 5; do
    setsid bash study.sh >"round$round.out" 2>&1 & engine=$!
    while kill -0 $engine 2>/dev/null; do
        if (($(done_jobs) >= 10 * killed + 3 && killed < 3)); then
            pid=$(pgrep -f "sweep run $work/study.jsonl --index" | shuf -n 1 || true)
            if [ -n "$pid" ] && kill -9 "$pid" 2>/dev/null; then killed=$((killed + 1)); fi
        fi
        if (($(done_jobs) >= 25 && interrupted == 0)); then
            interrupted=1
            kill -9 -- -$engine || true
        fi
        sleep 0.1
    done
    code=0
    wait $engine || code=$?
    echo "round $round: exit code $code, $(done_jobs) of 40 jobs are done"
    [ "$code" = 0 ] && break
done
"$pathtune" sweep status study.jsonl --results parallel.results
"$pathtune" sweep collect study.jsonl --results parallel.results --out parallel.csv >/dev/null
cmp study.csv parallel.csv
decided() { (cd "$1" && find . -name '*.outcome.json' | sort | xargs sha256sum); }
[ "$(decided study.results)" = "$(decided parallel.results)" ]
echo "passed: 40 jobs by GNU parallel, $killed killed, the engine killed $interrupted times: the same bytes"
