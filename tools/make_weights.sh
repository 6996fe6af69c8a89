#!/usr/bin/env bash
# Makes the weights "closed-loop" from nothing: windows of made-up traffic, then the stages of their training.
# The same command goes on where it was stopped.
#
# Usage: tools/make_weights.sh [FOLDER]    FOLDER (build/weights) receives windows, trainings and closed-loop.safetensors
# From the environment: WINDOWS (102000) and DRIVEN (1800), WORKERS (all cores), DEVICE (auto),
#   LOADERS (0; 8 is good beside a GPU)
set -euo pipefail
cd "$(dirname "$0")/.."

folder=${1:-build/weights}
run=${ADVDIFF:-.venv/bin/advdiff-sumo}
common=(--data "$folder/windows" --seed 18 --device "${DEVICE:-auto}" --loaders "${LOADERS:-0}" --judge 0)
common+=(--set jitter.mirror=0.5 --set held_out=0.02 --set held_out_windows=256)
mkdir -p "$folder"

windows() { # OUT WINDOWS OPTIONS...
    local out=$1 count=$2
    shift 2
    "$run" data simulate --out "$folder/$out" --windows "$count" --map-view far --workers "${WORKERS:-$(nproc)}" "$@"
}

stage() { # NAME OUT OPTIONS...
    local name=$1 out=$2 resume=()
    shift 2
    [ ! -e "$folder/$out/checkpoint.safetensors" ] || resume=(--resume)
    "$run" train "$name" --out "$folder/$out" "${common[@]}" "${resume[@]}" "$@"
}

windows windows "${WINDOWS:-102000}" --seed 911 --random-share 0.6

networks='{decoder="closed-loop", hidden=160, message=96, decoder_layers=2, neighbours=12, denoiser_layers=2, channels=[32, 48, 64]}'
stage traffic traffic --set "model=$networks" --set epochs=5 --set batch_size=32 --set elbo.samples=1 \
    --set elbo.kl_anneal_share=0.2 --set decoder.vehicles=2 --set decoder.road=2
stage denoiser denoiser --init "$folder/traffic" --set epochs=2 --set batch_size=64 --set learning_rate=1.5e-3
# what to do where their own traffic leads
windows driven "${DRIVEN:-1800}" --seed 4001 --driven-by "$folder/denoiser/weights.safetensors"
stage denoiser informed --init "$folder/denoiser" --data "$folder/driven" --set model.denoiser_situation=true \
    --set denoiser.information=1 --set denoiser.standing=3 --set driven_share=0.3 --set epoch_windows=76800 \
    --set epochs=1 --set batch_size=64 --set learning_rate=1e-3
# and as often as SUMO's drivers do it, in as few steps as a plan takes
stage denoiser scored --init "$folder/informed" --data "$folder/driven" --set denoiser.samples=2 --set ema_decay=0.99 \
    --set denoiser.information=1 --set denoiser.standing=3 --set driven_share=0.4 --set epoch_windows=4800 \
    --set epochs=1 --set batch_size=16 --set learning_rate=4e-4
stage decoder decoder --init "$folder/scored" --data "$folder/driven" --set decoder.vehicles=4 --set decoder.road=2 \
    --set driven_share=0.2 --set epoch_windows=17600 --set epochs=1 --set batch_size=16 --set learning_rate=3e-4
stage reward reward --init "$folder/decoder" --set epochs=1 --set reward.transitions=1

"${PYTHON:-.venv/bin/python}" - "$folder" <<'END'
import sys
from pathlib import Path

from advdiff_sumo.models.bundle import halve_bundle

folder = Path(sys.argv[1])
halve_bundle(folder / "reward" / "weights.safetensors", folder / "closed-loop.safetensors")
print(folder / "closed-loop.safetensors")
END
