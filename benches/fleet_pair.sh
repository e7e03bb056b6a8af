#!/usr/bin/env bash
# The way past one machine, run small: two routers in a mesh, two hubs on one PostgreSQL, half of the nodes at each router,
# and a hub that is killed with -9 half-way. In the end every report made must be a row, and none two.
#
#   benches/fleet_pair.sh NODES SESSIONS SECONDS          NODES and SESSIONS at each router
#
# ALBIREO and ALBIREO_PYTHON as in benches/fleet.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
albireo=${ALBIREO:-target/release/albireo}
python=${ALBIREO_PYTHON:-.cache/python/bin/python}
nodes=$1 sessions=$2 seconds=$3
folder=$(mktemp -d)
ulimit -n "$(ulimit -Hn)" 2> /dev/null || true
. benches/postgres.sh
started=()
end() { kill "${started[@]}" 2> /dev/null || true; wait 2> /dev/null || true; stop_postgres; rm -rf "$folder"; }
trap end EXIT
for router in 1 2; do
    other=$((3 - router))
    sed "s|connect: { endpoints: \[\] }|connect: { endpoints: [\"tcp/127.0.0.1:1744$other\"], timeout_ms: -1, exit_on_failure: false }|" \
        config/zenoh-router.json5 > "$folder/router$router.json5"
    ZENOH_RUNTIME='(rx:(worker_threads:4))' "$python" tests/clients/router.py tcp/127.0.0.1:1744$router \
        "$folder/router$router.json5" > "$folder/router$router.out" &
    started+=($!)
done
for router in 1 2; do until grep -q ready "$folder/router$router.out"; do sleep 0.1; done; done
for hub in 1 2; do
    ALBIREO_ZENOH__MODE=client ALBIREO_ZENOH__CONNECT="[\"tcp/127.0.0.1:1744$hub\"]" ALBIREO_ZENOH__LISTEN='[]' \
        ALBIREO_DATABASE__URL="$DATABASE" ALBIREO_HTTP__LISTEN=127.0.0.1:1809$hub \
        "$albireo" hub 2> "$folder/hub$hub.log" &
    started+=($!)
    eval "hub$hub=$!"
    until curl -sf http://127.0.0.1:1809$hub/readyz > /dev/null; do sleep 0.1; done
done
for router in 1 2; do
    "$albireo" simulate --nodes "$nodes" --sessions "$sessions" --seconds "$seconds" --name "at$router-" --drain 60 \
        --connect tcp/127.0.0.1:1744$router > "$folder/simulate$router.out" 2>&1 &
    eval "playing$router=$!"
    started+=($!)
done
sleep $((seconds / 2))
kill -9 $hub1
echo "hub 1 killed after $((seconds / 2)) s"
wait $playing1 || true
wait $playing2 || true
cat "$folder/simulate1.out" "$folder/simulate2.out"
psql=("$postgres_tools/psql" -h 127.0.0.1 -p 15432 -U hub -At fleet)
echo "rows: $("${psql[@]}" -c 'select count(*) from clips'), of them different: $("${psql[@]}" -c \
    'select count(distinct report_id) from clips')"
