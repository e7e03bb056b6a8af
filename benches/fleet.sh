#!/usr/bin/env bash
# What a router and a hub cost under the load of a simulated fleet, each in a process of its own, on this machine.
#
#   benches/fleet.sh NODES SESSIONS SECONDS [ARGUMENTS OF albireo simulate …]
#
# ALBIREO: the program (target/release/albireo). ALBIREO_PYTHON: a Python with eclipse-zenoh, for the router (make python).
# DATABASE: postgres://… in place of a new SQLite file. API=1: ask the hub's interface meanwhile, and tell its delays.
# SET_U=5e-4: set it on all nodes after half of the time. RESTART=1: kill the router then, and start it anew.
set -euo pipefail
cd "$(dirname "$0")/.."
albireo=${ALBIREO:-target/release/albireo}
python=${ALBIREO_PYTHON:-.cache/python/bin/python}
nodes=$1 sessions=$2 seconds=$3
shift 3
folder=$(mktemp -d)
router_port=17447 hub=http://127.0.0.1:18090
# A session is an open file; what the system does not allow shows as refused sessions.
ulimit -n "$(ulimit -Hn)" 2> /dev/null || true
start_router() {
    ZENOH_RUNTIME='(rx:(worker_threads:4))' "$python" tests/clients/router.py tcp/127.0.0.1:$router_port \
        config/zenoh-router.json5 > "$folder/router.out" &
    router=$!
    until grep -q ready "$folder/router.out"; do sleep 0.1; done
}
# Only what this script started is ended.
end() { kill "${router:-}" "${hub_process:-}" "${watcher:-}" 2> /dev/null || true; wait 2> /dev/null || true; rm -rf "$folder"; }
trap end EXIT
start_router
ALBIREO_ZENOH__MODE=client ALBIREO_ZENOH__CONNECT="[\"tcp/127.0.0.1:$router_port\"]" ALBIREO_ZENOH__LISTEN='[]' \
    ALBIREO_HTTP__LISTEN=127.0.0.1:18090 ALBIREO_PRESENCE__TOKENS=false \
    ALBIREO_DATABASE__URL="${DATABASE:-sqlite:$folder/hub.db}" "$albireo" hub 2> "$folder/hub.log" &
hub_process=$!
until curl -sf $hub/readyz > /dev/null; do sleep 0.1; done
if [ -n "${API:-}" ]; then
    (sleep $((seconds / 3 + 2)); "$python" benches/fleet_api.py $hub $((seconds / 2))) &
    watcher=$!
elif [ -n "${SET_U:-}" ]; then
    (sleep $((seconds / 2)); until [ -e "$folder/open" ]; do sleep 0.2; done
     "$albireo" fleet --hub $hub set-u "$SET_U" --select all --wait 30s | tail -n 1) &
    watcher=$!
elif [ -n "${RESTART:-}" ]; then
    (sleep $((seconds / 2)); kill -9 $router; sleep 1; start_router; trap 'kill $router' EXIT TERM; sleep 1000 & wait) &
    watcher=$!
fi
touch "$folder/open"
"$albireo" simulate --nodes "$nodes" --sessions "$sessions" --for "$seconds" --connect tcp/127.0.0.1:$router_port \
    --pid hub=$hub_process --pid router=$router "$@" || true
if [ -n "${API:-}${SET_U:-}" ]; then wait "$watcher" || true; fi
curl -s $hub/metrics | grep -E '^albireo_hub_(clips_total|commit_p99|acknowledged_after|nodes\{|batches_refused|reports_missing|database_errors|statuses_overrun|sessions)'
grep -c 'trying again' "$folder/hub.log" | sed 's/^/hub: warnings of a lost session or database: /' || true
du -sh "$folder"/hub.db* 2> /dev/null || true
