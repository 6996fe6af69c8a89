#!/usr/bin/env bash
# Makes the environment of one of TU Munich's planners, with the planner kit in it: setup.sh reactive|frenetix [FOLDER]
# Both pin protobuf 3.20, which the rest of advdiff-sumo cannot live with; the kit can.
set -euo pipefail
case ${1:-} in
    reactive) packages="commonroad-reactive-planner==2025.1" ;;
    frenetix) packages="frenetix==0.4 commonroad-drivability-checker==2025.4.0" ;;
    *) echo "usage: setup.sh reactive|frenetix [FOLDER]" >&2; exit 2 ;;
esac
folder=${2:-build/tum_planners/$1}
mkdir -p "$folder"
rm -rf "$folder/kit"
advdiff-sumo planner-kit "$folder/kit"
python3 -m venv "$folder/env"
# shellcheck disable=SC2086 - one word each
"$folder/env/bin/pip" install --quiet --disable-pip-version-check $packages scipy==1.17.1 "$folder/kit"
here=$(cd "$(dirname "$0")" && pwd)
echo "advdiff-sumo run --target \"exec:$folder/env/bin/python $here/$1_server.py\""
