#!/usr/bin/env bash
# Trains on several ranks of one machine; the same call goes on from OUT/last.ckpt.
#   RANKS=2 DATA=data_cache/mine OUT=runs/mine bash examples/cluster/torchrun.sh --steps 20000
set -euo pipefail
torchrun --standalone --nproc-per-node "${RANKS:-2}" \
  -m riemlayer pretrain "${DATA:?folder of prepared shapes}" -o "${OUT:-runs/mine}" \
  --trainer.strategy ddp --trainer.devices "${RANKS:-2}" "$@"
