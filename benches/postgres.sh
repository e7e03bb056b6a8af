#!/usr/bin/env bash
# A PostgreSQL for a bench: `. benches/postgres.sh` makes a new server on port 15432 and says DATABASE. It ends with the
# shell, or by stop_postgres. The server does not run as root: then it is the user postgres's.
postgres_tools=$(dirname "$(readlink -f "$(command -v initdb || ls /usr/lib/postgresql/*/bin/initdb | tail -n 1)")")
as_postgres() { if [ "$(id -u)" = 0 ]; then (cd / && setpriv --reuid postgres --regid postgres --init-groups "$@"); else "$@"; fi; }
postgres_data=$(mktemp -d)
stop_postgres() {
    as_postgres "$postgres_tools/pg_ctl" -D "$postgres_data/data" -m immediate stop > /dev/null 2>&1 || true
    rm -rf "$postgres_data"
}
trap stop_postgres EXIT
[ "$(id -u)" != 0 ] || chown postgres "$postgres_data"
as_postgres "$postgres_tools/initdb" -D "$postgres_data/data" -A trust -U hub -E UTF8 --locale=C > /dev/null
as_postgres "$postgres_tools/pg_ctl" -D "$postgres_data/data" -w -l "$postgres_data/log" \
    -o "-p 15432 -k $postgres_data -c listen_addresses=127.0.0.1" start > /dev/null
as_postgres "$postgres_tools/createdb" -h 127.0.0.1 -p 15432 -U hub fleet
DATABASE=postgres://hub@127.0.0.1:15432/fleet
export DATABASE
