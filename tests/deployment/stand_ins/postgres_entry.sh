#!/bin/sh
# Makes a cluster on the first start, as Docker's image does, then serves.
set -eu
if [ ! -s "$PGDATA/PG_VERSION" ]; then
    printf %s "$POSTGRES_PASSWORD" | initdb --encoding UTF8 --locale C.UTF-8 --username "$POSTGRES_USER" \
        --pwfile /dev/stdin --auth-host scram-sha-256 >/dev/null
    echo 'host all all all scram-sha-256' >> "$PGDATA/pg_hba.conf"
    printf 'CREATE DATABASE "%s" OWNER "%s";\n' "$POSTGRES_DB" "$POSTGRES_USER" | postgres --single postgres >/dev/null
fi
exec postgres -c 'listen_addresses=*' -c unix_socket_directories=/run/postgresql
