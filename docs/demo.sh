#!/bin/sh
# The whole path: record with the policies that ship and with the expert, prove every file by replaying it, learn, evaluate, smooth, look.
set -eu
BIN=${BIN:-.venv/bin}
OUT=${1:-demo}
BEGAN=$(date +%s)
step() { printf '\n\033[1;36m== %s\033[0m (%s s so far)\n' "$*" "$(($(date +%s) - BEGAN))"; }
run() { printf '\n\033[1m$ coordlog %s\033[0m\n' "$*"; "$BIN/coordlog" "$@"; }
first() { find "$@" -name '*.mcap' | sort | head -n 1; }

if [ -e "$OUT" ]; then
  echo "$OUT exists and is not overwritten; move it away or run: make demo DEMO=another-folder" >&2
  exit 2
fi

step '1 of 7: record, with the policies that ship and with the scripted expert, in four scenes'
for scene in free spheres table shelf; do
  run record --scene "$scene" --policy pretrained --split test --episodes 8 --out "$OUT/logs/pretrained/$scene"
  run record --scene "$scene" --episodes 4 --noise 0.1 --out "$OUT/logs/expert/$scene"
done
# Episodes with more noise show how to come back from mistakes: what a policy learns from, but no pleasure to look at.
run record --scene table --episodes 192 --noise 0.3 --seed 1 --no-display --out "$OUT/logs/expert/table-noisy"

step '2 of 7: check, by simulating every file again from nothing but itself'
run check "$OUT/logs"
run info "$OUT/logs/pretrained"

step '3 of 7: train, from the logs of the expert'
run train --from "$OUT/logs/expert/table" --from "$OUT/logs/expert/table-noisy" --preset quick --eval-episodes 32 --out "$OUT/run"

step '4 of 7: evaluate what was learnt, on problems that neither training nor its evaluations have seen'
run record --policy "$OUT/run" --split test --seed 1 --episodes 64 --out "$OUT/logs/learnt"

step '5 of 7: smooth, and check that, too'
run smooth "$OUT/logs/pretrained/table" "$OUT/logs/pretrained/shelf" --out "$OUT/smoothed" || [ $? -eq 3 ] # 3: some were kept raw, and named
run check "$OUT/smoothed"

step '6 of 7: look'
raw=$(first "$OUT/logs/pretrained/table")
smoothed=$(find "$OUT/smoothed" -name "$(basename "$raw")")
run view "$raw" --with "$smoothed" --ghosts --save "$OUT/episode.rrd"
run view "$OUT/logs/pretrained/table" --save "$OUT/overview.rrd"
run plot "$smoothed" --out "$OUT/joints.png"
run scenes --picture "$OUT/scenes"
run view "$raw" --with "$smoothed" --screenshot "$OUT/viewer.png" || echo 'No picture of the viewer then; everything else is there.'

step "7 of 7: made in $OUT/"
show() { [ ! -e "$OUT/$1" ] || printf '  %-24s %-44s %s\n' "$1" "$2" "$3"; }
show logs/pretrained 'episodes of the policies that ship' "coordlog info $OUT/logs/pretrained"
show logs/expert 'episodes to learn from' "coordlog view $(first "$OUT/logs/expert/shelf")"
show run 'a policy, and how it came about' "coordlog record --policy $OUT/run --split test --out more"
show logs/learnt 'its evaluation' "coordlog view $OUT/logs/learnt"
show smoothed 'the same motions, smooth' "coordlog view $smoothed"
show episode.rrd 'raw and smooth, in one recording' "rerun $OUT/episode.rrd"
show overview.rrd 'a whole folder in one recording' "rerun $OUT/overview.rrd"
show joints.png 'knots against splines' "xdg-open $OUT/joints.png"
show viewer.png 'the viewer, photographed' "xdg-open $OUT/viewer.png"
show scenes 'the scenes' "xdg-open $OUT/scenes/shelf.png"
printf '\nCommands are in %s: put it on your PATH, or write %s/coordlog.\n' "$BIN" "$BIN"
