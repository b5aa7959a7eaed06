# One image for API and workers. `make fleet` builds and runs it.
ARG BASE=python:3.11.14-slim-bookworm
FROM ${BASE} AS packages
RUN apt-get update \
    && apt-get install --no-install-recommends --yes binutils \
    && rm -rf /var/lib/apt/lists/* /var/cache/apt/*
WORKDIR /source
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY app ./app
COPY assets ./assets
COPY planners ./planners
COPY workers ./workers
# What nothing of ours reads is a third of it: headers, the physics engine's sample worlds and its symbols, and a solver's
# second build with another library.
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels . \
    && pip install --no-cache-dir --constraint constraints.txt --root /packages "$(echo /wheels/*.whl)[postgres]" \
    && find /packages -depth \( -path '*/cmeel.prefix/include' -o -name pybullet_data -o -name '_scs_mkl.*' \) \
        -exec rm -r {} + \
    && find /packages -name 'pybullet.*.so' -exec strip --strip-unneeded {} +

FROM ${BASE}
ENV LIFTWRIGHT_DATA_DIR=/data \
    NUMBA_CACHE_DIR=/kernels \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1

# Pinocchio is linked with OpenMP's library, which a slim image lacks.
RUN apt-get update \
    && apt-get install --no-install-recommends --yes libgomp1 \
    && rm -rf /var/lib/apt/lists/* /var/cache/apt/* \
    && useradd --create-home --uid 10001 liftwright \
    && mkdir -p /data /kernels \
    && chown -R liftwright /data /kernels

# The packages are there once, installed: compiled kernels belong to the path of their source.
COPY --from=packages /packages /
USER liftwright
WORKDIR /home/liftwright
# For which processors kernels are compiled, as LLVM names them; empty: for those of the model that this is built on.
# Elsewhere each container would compile them anew. Both are needed, for example x86-64-v3 and +avx2,+fma.
ARG NUMBA_CPU_NAME=""
ARG NUMBA_CPU_FEATURES=""
# As with COMMIT below.
RUN : "${NUMBA_CPU_NAME} ${NUMBA_CPU_FEATURES}"
ENV NUMBA_CPU_NAME=${NUMBA_CPU_NAME} \
    NUMBA_CPU_FEATURES=${NUMBA_CPU_FEATURES}
RUN liftwright warmup
# Not before: what is above is the same for every commit that changes no file of it.
ARG COMMIT=""
# Buildah takes a variable from its cache whatever the argument is, unless something before it ran anew.
RUN : "${COMMIT}"
ENV LIFTWRIGHT_COMMIT=${COMMIT}
# The root file system is read-only when it runs. The compiler refuses a cache that it cannot write to, so that each
# container gets a copy of the kernels.
VOLUME /data /kernels
EXPOSE 8040
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=3s --start-period=60s CMD \
    ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8040/livez', timeout=2)"]
# Inside the container it listens on all of its addresses; it does not start before a key was issued.
CMD ["liftwright", "serve", "--host", "0.0.0.0"]
