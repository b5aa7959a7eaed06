# Stands in for Docker's `python` where no registry of images is reached: Debian's Python, by the names that ours expects.
FROM localhost/debian:bookworm-slim
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install --no-install-recommends --yes python3.11 python3-pip python-is-python3 \
    && rm -rf /var/lib/apt/lists/* /var/cache/apt/* /usr/lib/python3.11/EXTERNALLY-MANAGED
