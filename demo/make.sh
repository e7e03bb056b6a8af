#!/usr/bin/env bash
# Makes road.tar from the four clips that README.md names, which lie in the folder given: every frame, 640x360, JPEG, a
# folder for each clip, in the order in which they are played. Needs ffmpeg and GNU tar.
set -euo pipefail
media=$(realpath "${1:?usage: demo/make.sh FOLDER_WITH_THE_CLIPS}")
cd "$(dirname "$0")"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
clips=(busy:highway_busy sparse:highway_restored two-near:highway_two_near empty-then-car:highway_empty_then_car)
for clip in "${clips[@]}"; do
    mkdir "$work/${clip%%:*}"
    # highway_two_near.mp4 is a cut whose edit list hides its first 16 frames: they are road like the others.
    ffmpeg -v error -ignore_editlist 1 -i "$media/${clip##*:}.mp4" -fps_mode passthrough -vf "scale=640:360:flags=area" \
        -pix_fmt yuvj420p -q:v 7 "$work/${clip%%:*}/%04d.jpg"
done
# The same pictures give the same bytes.
for clip in "${clips[@]}"; do (cd "$work" && ls "${clip%%:*}"/*.jpg); done > "$work/names"
tar --create --file road.tar --directory "$work" --format=ustar --mtime=@0 --owner=0 --group=0 --numeric-owner --mode=644 \
    --files-from "$work/names"
ls -l road.tar
