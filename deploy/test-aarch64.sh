#!/usr/bin/env bash
# Runs the node for aarch64 that `TARGET=aarch64-unknown-linux-gnu make dist` made, under qemu-user: it loads ONNX Runtime for that
# machine with its CPU provider, takes frames over Zenoh, answers health, and stops by a signal.
#
#   deploy/test-aarch64.sh [PROGRAM]
#
# ALBIREO: a program for this machine, which plays the frames (target/release/albireo). Needs qemu-aarch64 (Debian: qemu-user) and the
# libraries of gcc-aarch64-linux-gnu and g++-aarch64-linux-gnu. What qemu cannot show: speed, a GPU, power meters.
set -euo pipefail
cd "$(dirname "$0")/.."
program=${1:-$(find target/dist -name "albireo-node-*-aarch64" | sort | tail -n 1)}
albireo=$(realpath "${ALBIREO:-target/release/albireo}")
folder=$(mktemp -d)
end() { jobs -p | xargs --no-run-if-empty kill 2> /dev/null || true; wait 2> /dev/null || true; rm -rf "$folder"; }
trap end EXIT
http=127.0.0.1:18093 zenoh=tcp/127.0.0.1:17450

ONNXRUNTIME_MACHINE=aarch64 bash deploy/fetch-onnxruntime.sh "$folder/onnxruntime"
cat > "$folder/node.toml" <<- NODE
	http.listen = "$http"
	zenoh.listen = ["$zenoh"]
	detector.model = "$PWD/models/yolox_nano.onnx"
	power.source = "none"
	# Emulated, a run of the model takes seconds.
	detector.timeout_ms = 60000
	[[camera]]
	name = "front"
	delivery = "every"
NODE
# ONNX Runtime asks the system for the processor, and crashes on another architecture's answer: qemu-user passes on the
# host's. A separate mount namespace shows it a Cortex-A72 (a Raspberry Pi 4).
for core in 0 1; do
    printf 'processor\t: %s\nFeatures\t: fp asimd evtstrm crc32 cpuid\nCPU implementer\t: 0x41\nCPU architecture: 8\n' $core
    printf 'CPU variant\t: 0x0\nCPU part\t: 0xd08\nCPU revision\t: 3\n\n'
done > "$folder/cpuinfo"
apart=(unshare --mount)
[ "$(id -u)" = 0 ] || apart+=(--map-root-user)
# A program that starts itself once more would do so without qemu.
export ORT_DISABLE_TELEMETRY=1 ORT_DYLIB_PATH="$folder/onnxruntime" QEMU_CPU=cortex-a72
# shellcheck disable=SC2016
run=("${apart[@]}" bash -c 'mount --bind "$0" /proc/cpuinfo && exec qemu-aarch64 -L /usr/aarch64-linux-gnu "$@"' "$folder/cpuinfo" "$program")
"${run[@]}" --version
"${run[@]}" check "$folder/node.toml"
"${run[@]}" node --config "$folder/node.toml" 2> "$folder/node.log" &
node=$!
for _ in $(seq 240); do
    curl -sf "http://$http/readyz" > /dev/null && break
    kill -0 $node || { cat "$folder/node.log"; exit 1; }
    sleep 0.5
done
curl -sSf "http://$http/readyz"
echo
"$albireo" replay demo --frames 6 --every --camera front --connect "$zenoh" 2> "$folder/replay.log" || { cat "$folder/replay.log"; tail -n 20 "$folder/node.log"; exit 1; }
# A frame is taken before it is answered.
for _ in $(seq 120); do
    curl -sSf "http://$http/api/v1/cameras/front" > "$folder/front.json"
    grep -q '"frames":6,' "$folder/front.json" && break
    sleep 0.5
done
python3 - "$folder/front.json" <<- 'CHECK'
	import json, sys
	front = json.load(open(sys.argv[1]))
	print({name: front[name] for name in ("policy", "frames", "skip_rate")})
	assert front["frames"] == 6, front
CHECK
grep -i 'provider' "$folder/node.log" | head -n 1
kill -TERM $node
wait $node
echo "the node for aarch64 took 6 frames and stopped by the signal"
