#!/bin/sh
# The main job end to end: record in the four scenes, prove every file by replaying it, learn, smooth, look.
set -eu
BIN=${BIN:-.venv/bin}
OUT=${1:-demo}
run() { printf '\n\033[1m$ coordlog %s\033[0m\n' "$*"; "$BIN/coordlog" "$@"; }

if [ -e "$OUT" ]; then
  echo "$OUT exists and is not overwritten; move it away or run: make demo DEMO=another-folder" >&2
  exit 2
fi
for scene in free spheres table shelf; do
  run record --scene "$scene" --episodes 8 --noise 0.1 --out "$OUT/logs/$scene"
done
run check "$OUT/logs"
run info "$OUT/logs"

# Episodes with more noise show how to come back from mistakes. A good policy takes 512 of them and 10 000 updates: this short training
# shows the way, not the destination.
run record --scene table --episodes 64 --noise 0.3 --seed 1 --no-display --out "$OUT/logs/table-noisy"
run train --from "$OUT/logs/table" --from "$OUT/logs/table-noisy" --updates 1000 --eval-every 1000 --eval-episodes 16 --out "$OUT/run"
run record --policy "$OUT/run" --split test --episodes 8 --out "$OUT/logs/policy"

run smooth "$OUT/logs/table" "$OUT/logs/shelf" --out "$OUT/smoothed" || [ $? -eq 3 ] # 3: some were kept raw, and named
run check "$OUT/smoothed"
raw=$(ls "$OUT"/logs/table/*.mcap | head -n 1)
smoothed=$(find "$OUT/smoothed" -name "$(basename "$raw")")
run view "$raw" --with "$smoothed" --ghosts --save "$OUT/episode.rrd"
run view "$OUT/logs" --save "$OUT/overview.rrd"
run plot "$smoothed" --out "$OUT/joints.png"
run scenes --picture "$OUT/scenes"

printf '\nMade in %s/:\n' "$OUT"
cat <<EOF
  logs/           episodes       coordlog info $OUT/logs
  run/            a policy       coordlog record --policy $OUT/run --split test
  smoothed/       smooth paths   coordlog view $smoothed
  episode.rrd     raw against smoothed     rerun $OUT/episode.rrd
  overview.rrd    the whole folder         rerun $OUT/overview.rrd
  joints.png      knots against splines
  scenes/         the scenes
EOF
