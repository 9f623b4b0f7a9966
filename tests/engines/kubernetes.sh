#!/bin/bash
# The manifest of a study for Kubernetes, held against the schemas that PyPI's kubernetes-validate carries; and a mistake in
# it, so that it is known to be seen. Not part of `cargo test`:
#
#   pip install kubernetes-validate && tests/engines/kubernetes.sh target/release/pathtune
set -euo pipefail
pathtune=$(realpath "${1:?the program}")
validate=${KUBERNETES_VALIDATE:-kubernetes-validate}
command -v "$validate" >/dev/null || { echo "skipped: kubernetes: no kubernetes-validate (PyPI)"; exit 0; }

work=$(mktemp -d /tmp/ptkubernetes.XXXXXX)
trap 'rm -rf "$work"' EXIT
cd "$work"
cat > 'my study.toml' <<'STUDY'
[[jobs]]
maneuver = "lane_change"
law = ["paper", "stanley"]
seed = "1..20"
STUDY
"$pathtune" sweep plan 'my study.toml'
"$pathtune" sweep kubernetes 'my study.jsonl' > study.yaml
# Per-index retries are of 1.29; the newest that the package knows comes last.
versions="1.29 $("$validate" --help | grep -oE '\b1\.[0-9]+\b' | sort -t . -k 2 -n | tail -1)"
for version in $versions; do
    "$validate" --strict -k "$version" study.yaml
    sed 's/completionMode/completionMod/' study.yaml > wrong.yaml
    if "$validate" --strict -k "$version" wrong.yaml >/dev/null 2>&1; then
        echo "failed: a wrong key is not seen by version $version"
        exit 1
    fi
done
echo "passed: a manifest for Kubernetes $versions"
