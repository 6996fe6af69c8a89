#!/usr/bin/env bash
# Builds wheel and sdist, installs the wheel into an empty environment, and runs the main verbs there with no repository
# around: what the Dockerfile does, for machines without docker.
#
# Usage: tools/check_package.sh [FOLDER]    FOLDER receives dist/, the environment and the runs; default: a temporary one
set -euo pipefail
cd "$(dirname "$0")/.."

most_bytes=18000000
python=${PYTHON:-.venv/bin/python}
folder=${1:-$(mktemp -d)}
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)

rm -rf "$folder/dist"
"$python" -m build --outdir "$folder/dist" . >"$folder/build.log" 2>&1 || { tail -20 "$folder/build.log"; exit 1; }
for file in "$folder"/dist/*; do
    size=$(stat -c %s "$file")
    echo "$(basename "$file"): $size bytes"
    [ "$size" -lt "$most_bytes" ] || { echo "larger than $most_bytes bytes"; exit 1; }
done

"$python" -m venv --clear --without-pip "$folder/env"
"$python" -m pip --python "$folder/env/bin/python" install --quiet --disable-pip-version-check --constraint constraints.txt "$folder"/dist/*.whl
cp scenarios/sweeps/quick.toml constraints.txt "$folder"
cd "$folder"
rm -rf runs
unset PYTHONPATH
export PATH="$folder/env/bin:$PATH"
advdiff-sumo --version
advdiff-sumo run --target lane_graph --background diffusion --episodes 1 --horizon 4 --out runs/one --quiet
advdiff-sumo run --target "exec:python -m advdiff_sumo.planner_kit advdiff_sumo.planners.lane_graph:LaneGraphPlanner --read-road advdiff_sumo.maps:RoadMap.read" \
    --episodes 1 --horizon 4 --out runs/remote --json
advdiff-sumo sweep quick.toml --limit 2 --workers 1 --out runs/quick --quiet
advdiff-sumo report runs/one
python -c "import advdiff_sumo as ads; print(ads.load('runs/one').summary())"
echo "the wheel works in $folder/env"
