# Stands in for Docker's `postgres` where no registry of images is reached: Debian's server, set up by the same variables.
FROM localhost/debian:bookworm-slim
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install --no-install-recommends --yes postgresql-15 \
    && rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/lib/postgresql/15 \
    && install --directory --owner postgres --group postgres --mode 700 /var/lib/postgresql/data \
    && install --directory --owner postgres --group postgres --mode 3777 /run/postgresql
COPY --chmod=755 postgres_entry.sh /usr/local/bin/
ENV PATH=/usr/lib/postgresql/15/bin:$PATH PGDATA=/var/lib/postgresql/data
USER postgres
VOLUME /var/lib/postgresql/data
STOPSIGNAL SIGINT
ENTRYPOINT ["postgres_entry.sh"]
