#!/usr/bin/env bash
# What a real node sends over its uplink, in bytes per camera and day: a hub and a node, each a process, the synthetic dashcam at
# 10 frames/s, clips of 40 s, TCP's payload by ss (so what TLS and IP add is not in it).
#
#   benches/uplink.sh MINUTES [SETTINGS OF THE NODE, ALBIREO_…=… …]
#
# The first minute is not counted: sessions, full statuses, and the first report, which goes at once. What is counted ends with a
# batch, so that nothing is half in it: let MINUTES be long enough for several.
# ALBIREO: the program (target/release/albireo). Needs ss (Debian's iproute2) and what make demo needs.
set -euo pipefail
cd "$(dirname "$0")/.."
albireo=$(realpath "${ALBIREO:-target/release/albireo}")
export ORT_DYLIB_PATH=${ORT_DYLIB_PATH:-$PWD/.cache/onnxruntime}
minutes=$1
shift
folder=$(mktemp -d)
end() { jobs -p | xargs --no-run-if-empty kill 2> /dev/null || true; wait 2> /dev/null || true; rm -rf "$folder"; }
trap end EXIT

env ALBIREO_HTTP__LISTEN=127.0.0.1:18091 'ALBIREO_ZENOH__LISTEN=["tcp/127.0.0.1:17448"]' \
    ALBIREO_DATABASE__URL="sqlite:$folder/hub.db" "$albireo" hub 2> "$folder/hub.log" &
cat > "$folder/node.toml" <<- NODE
	node.name = "car-7"
	node.state_dir = "$folder/state"
	http.listen = "127.0.0.1:18092"
	zenoh.listen = ["tcp/127.0.0.1:17449"]
	uplink.connect = ["tcp/127.0.0.1:17448"]
	detector.model = "$PWD/models/yolox_nano.onnx"
		[[camera]]
	name = "front"
NODE
env "$@" "$albireo" node --config "$folder/node.toml" 2> "$folder/node.log" &
node=$!
until curl -sf http://127.0.0.1:18092/readyz > /dev/null; do
    kill -0 $node || { cat "$folder/node.log"; exit 1; }
    sleep 0.2
done
"$albireo" replay demo --rate 10 --loop --no-clip --node car-7 --camera front --connect tcp/127.0.0.1:17449 \
    > /dev/null 2> "$folder/replay.log" &

sent() { ss -tinHO state established "dport = :17448" | grep -o 'bytes_sent:[0-9]*' | cut -d: -f2 | sort -n | tail -n 1; }
stored() { curl -sf 'http://127.0.0.1:18091/api/v1/clips?limit=1000' | grep -o '"report":' | wc -l; }
now() { date +%s.%N; }
at_least() { until [ "$(stored)" -gt "$1" ]; do sleep 0.5; done; }

sleep 60
at_least 0
reports=$(stored)
at_least "$reports" # the end of a batch
sleep 2
reports=$(stored) bytes=$(sent) began=$(now)
until=$((SECONDS + minutes * 60))
while [ $SECONDS -lt $until ]; do
    last=$(stored)
    at_least "$last"
    sleep 2
    awk -v bytes=$(($(sent) - bytes)) -v reports=$(($(stored) - reports)) -v began="$began" -v now="$(now)" 'BEGIN {
        seconds = now - began
        printf "%.0f s, %d reports: %d bytes sent; %.3f MB per day\n", seconds, reports, bytes, bytes / seconds * 86400 / 1e6 }'
done
