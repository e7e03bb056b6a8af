#!/usr/bin/env bash
# What a router and a hub cost under the load of a simulated fleet, each in a process of its own, on this machine.
#
#   benches/fleet.sh NODES SESSIONS SECONDS [ARGUMENTS OF albireo simulate …]
#
# ALBIREO: the program (target/release/albireo). ALBIREO_PYTHON: a Python with eclipse-zenoh, for the router (make python).
# DATABASE: postgres://… in place of a new SQLite file. API=1: ask the hub's interface meanwhile, and report its delays.
# SET_U=5e-4: set it on all nodes after half of the time. RESTART=1: kill the router then, start it again, and report how
# long it takes until all nodes are online. TLS=1: mutual TLS, with certificates made for the run (needs openssl).
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
place=tcp/127.0.0.1:$router_port router_config=config/zenoh-router.json5
hub_zenoh=(ALBIREO_ZENOH__MODE=client "ALBIREO_ZENOH__CONNECT=[\"$place\"]" 'ALBIREO_ZENOH__LISTEN=[]')
if [ -n "${TLS:-}" ]; then
    place=tls/127.0.0.1:$router_port
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj '/CN=a bench' \
        -keyout "$folder/ca.key" -out "$folder/ca.pem" 2> /dev/null
    for name in router hub node; do
        openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj "/CN=$name" \
            -keyout "$folder/$name.key" -out "$folder/$name.csr" 2> /dev/null
        openssl x509 -req -in "$folder/$name.csr" -CA "$folder/ca.pem" -CAkey "$folder/ca.key" -days 2 \
            -extfile <(echo 'subjectAltName=IP:127.0.0.1') -out "$folder/$name.pem" 2> /dev/null
    done
    # The router's configuration with its certificates; a client's for the hub and one for the nodes.
    router_config=$folder/router.json5
    sed "s|^\( *\)// tls: {|\1tls: {|; s|// *root_ca_certificate.*|root_ca_certificate: \"$folder/ca.pem\",|
        s|// *listen_certificate.*|listen_certificate: \"$folder/router.pem\",|
        s|// *listen_private_key.*|listen_private_key: \"$folder/router.key\",|
        s|// *enable_mtls.*|enable_mtls: true,|; s|^\( *\)// },|\1},|" config/zenoh-router.json5 > "$router_config"
    for name in hub node; do
        cat > "$folder/$name.json5" <<- CLIENT
			{ mode: "client", connect: { endpoints: ["$place"], timeout_ms: -1, exit_on_failure: false },
			  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
			  transport: { link: { tls: { root_ca_certificate: "$folder/ca.pem", enable_mtls: true,
			    connect_certificate: "$folder/$name.pem", connect_private_key: "$folder/$name.key" } } } }
		CLIENT
    done
    hub_zenoh=("ALBIREO_ZENOH__CONFIG_FILE=$folder/hub.json5")
    set -- --zenoh-config "$folder/node.json5" "$@"
fi
start_router() {
    ZENOH_RUNTIME='(rx:(worker_threads:4))' "$python" tests/clients/router.py "$place" \
        "$router_config" > "$folder/router.out" &
    router=$!
    until grep -q ready "$folder/router.out"; do sleep 0.1; done
}
# Only what this script started is ended.
end() { kill "${router:-}" "${hub_process:-}" "${watcher:-}" "${simulator:-}" "${meter:-}" 2> /dev/null || true; wait 2> /dev/null || true; rm -rf "$folder"; }
trap end EXIT
start_router
env "${hub_zenoh[@]}" ALBIREO_HTTP__LISTEN=127.0.0.1:18090 \
    ALBIREO_DATABASE__URL="${DATABASE:-sqlite:$folder/hub.db}" "$albireo" hub 2> "$folder/hub.log" &
hub_process=$!
until curl -sf $hub/readyz > /dev/null; do sleep 0.1; done
if [ -n "${API:-}" ]; then
    (until [ -e "$folder/open" ]; do sleep 0.2; done; sleep $((seconds / 3)); "$python" benches/fleet_api.py $hub $((seconds / 2))) &
    watcher=$!
elif [ -n "${SET_U:-}" ]; then
    (until [ -e "$folder/open" ]; do sleep 0.2; done; sleep $((seconds / 2))
     "$albireo" fleet --hub $hub set-u "$SET_U" --select all --wait 30s | tail -n 1) &
    watcher=$!
elif [ -n "${RESTART:-}" ]; then
    (until [ -e "$folder/open" ]; do sleep 0.2; done; sleep $((seconds / 2))
     kill -9 $router; sleep 1; start_router; restarted=$(date +%s%N)
     # The hub's session is one of them; what a session is worth shows in a value that reaches every node.
     until [ "$(ss -Htn state established "( sport = :$router_port )" | wc -l)" -gt "$sessions" ]; do sleep 0.2; done
     echo "after the router's restart: all sessions connected after $((($(date +%s%N) - restarted) / 1000000)) ms"
     "$albireo" fleet --hub $hub set-u 4e-4 --select all --wait 30s | tail -n 1
     trap 'kill $router $!' EXIT TERM; sleep 1000 > /dev/null 2>&1 & wait) &
    watcher=$!
fi
"$albireo" simulate --nodes "$nodes" --sessions "$sessions" --seconds "$seconds" --connect "$place" "$@" \
    2> >(while read -r line; do
        case $line in *'sessions open'*) touch "$folder/open" ;; esac; echo "$line"; done) &
simulator=$!
cpu_s() { awk -v ticks="$(getconf CLK_TCK)" '{ print ($14 + $15) / ticks }' "/proc/$1/stat"; }
# What each costs in the last two thirds of the load: at first all nodes announce themselves.
(until [ -e "$folder/open" ]; do sleep 0.2; done
 sleep $((seconds / 3))
 begun=()
 for one in "hub $hub_process" "router $router" "simulator $simulator"; do begun+=("$one $(cpu_s "${one#* }")"); done
 measured=$((seconds - seconds / 3))
 sleep "$measured"
 for one in "${begun[@]}"; do
     read -r name pid before <<< "$one"
     awk -v name="$name" -v used="$(cpu_s "$pid")" -v before="$before" -v seconds="$measured" \
         '/^VmRSS/ { now = $2 } /^VmHWM/ { most = $2 }
          END { printf "%-16s %.1f %% of a core, %.0f MB, at most %.0f MB\n", name, (used - before) / seconds * 100, now / 1e3, most / 1e3 }' \
         "/proc/$pid/status" || true
 done) &
meter=$!
wait "$simulator" || true
if [ -e "$folder/open" ]; then wait "$meter" || true; fi
if [ -n "${API:-}${SET_U:-}" ]; then wait "$watcher" || true; fi
curl -s $hub/metrics | grep -E '^albireo_hub_(clips_total|commit_p99|acknowledged_after|nodes\{|batches_refused|reports_missing|database_errors|sessions)'
grep -c 'trying again' "$folder/hub.log" | sed 's/^/hub: warnings of a lost session or database: /' || true
# What else it warned of, without times, nodes and numbers.
sed -nE 's/\x1b\[[0-9;]*m//g; s/.* (WARN|ERROR) //p' "$folder/hub.log" | sed -E 's/[0-9]+/N/g' | sort | uniq -c | sort -rn | head -n 5
du -sh "$folder"/hub.db* 2> /dev/null || true
