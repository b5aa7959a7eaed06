# One image for API and workers. Not built yet; say so in the README until it was.
FROM python:3.11.14-slim-bookworm

ARG COMMIT=""
ENV LIFTWRIGHT_COMMIT=${COMMIT} \
    LIFTWRIGHT_DATA_DIR=/data \
    NUMBA_CACHE_DIR=/opt/liftwright/kernels \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1

WORKDIR /opt/liftwright
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY app ./app
COPY assets ./assets
COPY planners ./planners
COPY workers ./workers
RUN pip install --no-cache-dir --constraint constraints.txt '.[postgres]' \
    && useradd --create-home --uid 10001 liftwright \
    && mkdir -p /data /opt/liftwright/kernels \
    && chown -R liftwright /data /opt/liftwright/kernels

USER liftwright
# The root file system is read-only when it runs: all kernels are compiled here.
RUN liftwright warmup
VOLUME /data
EXPOSE 8040
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=3s --start-period=60s CMD \
    ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8040/livez', timeout=2)"]
# Inside the container it listens on all of its addresses; it does not start before a key was issued.
CMD ["liftwright", "serve", "--host", "0.0.0.0"]
