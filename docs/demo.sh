#!/bin/sh
# The main job end to end: record in the four scenes, prove every file by replaying it, look at what there is.
set -eu
BIN=${BIN:-.venv/bin}
OUT=${1:-demo}
say() { printf '\n\033[1m%s\033[0m\n' "$*"; }

if [ -e "$OUT" ]; then
  echo "$OUT exists and is not overwritten; move it away or run: make demo DEMO=another-folder" >&2
  exit 2
fi
for scene in free spheres table shelf; do
  say "coordlog record --scene $scene --episodes 8 --noise 0.1 --out $OUT/logs/$scene"
  "$BIN/coordlog" record --scene "$scene" --episodes 8 --noise 0.1 --out "$OUT/logs/$scene"
done
say "coordlog check $OUT/logs        (simulates every file again and compares every number)"
"$BIN/coordlog" check "$OUT/logs"
say "coordlog info $OUT/logs"
"$BIN/coordlog" info "$OUT/logs"
