#!/usr/bin/env bash
# Makes the environment of TU Munich's reactive planner, with the planner kit in it: setup.sh [FOLDER]
# It pins protobuf 3.20, which the rest of advdiff-sumo cannot live with; the kit can.
set -euo pipefail
folder=${1:-build/reactive_planner}
mkdir -p "$folder"
rm -rf "$folder/kit"
advdiff-sumo planner-kit "$folder/kit"
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet --disable-pip-version-check commonroad-reactive-planner==2025.1 "$folder/kit"
here=$(cd "$(dirname "$0")" && pwd)
echo "advdiff-sumo run --target \"exec:$folder/env/bin/python $here/reactive_server.py\""
