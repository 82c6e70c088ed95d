#!/usr/bin/env bash
# Trains the architectures nnpp, edge and unseen one after another, on a GPU where there is one.
#
#   bash examples/train_all.sh TRAIN_TILES VAL_TILES OUT      (two folders of .tif, and a new one)
#
# Stopped, the same line goes on. MINUTES of each training, MAPS of each data set, BATCH: queries a
# step. A rehearsal on two cores: MINUTES=1 MAPS=500 BATCH=32. CUDA_VISIBLE_DEVICES= hides a GPU.
set -euo pipefail
train=$1
val=$2
out=$3

one() { # NAME "OPTIONS OF ITS DATA SETS" OPTIONS OF ITS TRAINING...
    nnpp-edge dataset "$train"/*.tif -o "$out/$1-set" --maps "${MAPS:-70000}" \
        --seed 1 --synthetic-share 0.05 $2
    nnpp-edge dataset "$val"/*.tif -o "$out/$1-val" --maps 128 --seed 2 --synthetic-share 0 $2
    nnpp-edge train "$out/$1-set" --validation "$out/$1-val" -o "$out/$1" --architecture "$1" \
        --batch "${BATCH:-256}" --time-limit "${MINUTES:-10}" "${@:3}"
    nnpp-edge export "$out/$1/best.pt" -o "$out/$1.onnx" --dataset "$out/$1-set"
}

mkdir -p "$out"
one nnpp --papers-maps --target path --learning-rate 0.0012
one edge "" --learning-rate 0.002
one unseen "--known 4,8,16" --learning-rate 0.002
