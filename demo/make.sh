#!/usr/bin/env bash
# Makes road.tar from the four clips that README.md names, which lie in the folder given: 10 frames a second, 640x360,
# JPEG, a folder for each clip, in the order in which they are played. Needs ffmpeg and GNU tar.
set -euo pipefail
media=$(realpath "${1:?usage: demo/make.sh FOLDER_WITH_THE_CLIPS}")
cd "$(dirname "$0")"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
clips=(busy:highway_busy sparse:highway_mostly_empty empty-then-car:highway_empty_then_car night:road_night_empty)
for clip in "${clips[@]}"; do
    mkdir "$work/${clip%%:*}"
    ffmpeg -v error -i "$media/${clip##*:}.mp4" -vf "fps=10:round=down:start_time=0,scale=640:360:flags=area" \
        -pix_fmt yuvj420p -q:v 4 "$work/${clip%%:*}/%04d.jpg"
done
# The same pictures give the same bytes.
for clip in "${clips[@]}"; do (cd "$work" && ls "${clip%%:*}"/*.jpg); done > "$work/names"
tar --create --file road.tar --directory "$work" --format=ustar --mtime=@0 --owner=0 --group=0 --numeric-owner --mode=644 \
    --files-from "$work/names"
ls -l road.tar
