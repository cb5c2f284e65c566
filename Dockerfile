# One image for every service: `docker run IMAGE COMMAND`, where COMMAND is a command of `vemlight`.
# The base is whatever the tag means today; a digest fixes it (docs/containers.md).
ARG BASE=python:3.11-slim-bookworm
FROM ${BASE}

RUN apt-get update -qq \
 && apt-get install -y -qq --no-install-recommends libegl1 libgl1 libgl1-mesa-dri \
 && rm -rf /var/lib/apt/lists/*

ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /vemlight
COPY requirements.lock requirements-build.lock ./
# Without the packages' own tests, which have 65 MB.
RUN pip install --quiet --only-binary :all: --require-hashes -r requirements.lock -r requirements-build.lock \
 && find "$(python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')" -type d -name tests -prune -exec rm -rf {} +

COPY . ./
RUN pip install --quiet --no-deps --no-build-isolation --editable . \
 && useradd --uid 10001 --no-create-home --shell /usr/sbin/nologin vemlight \
 && install -d -o vemlight -g vemlight -m 700 /keys

# The bundled sequence runs through all services once, so that an image that cannot draw fails to build, and numba's compiled code stays in
# the image, with that of what a run of it does not need: a rig of cameras, fixtures, films. 48 frames, because some code is needed only
# after a second; small pictures, because they are deleted.
RUN printf '[renderer]\nwidth = 64\nheight = 48\n' > /tmp/small.toml \
 && export NUMBA_CACHE_DIR=/var/cache/vemlight \
 && vemlight run /tmp/small.toml --frames 48 --out /tmp/warm \
 && python -m vemlight.commands.precompile \
 && rm -r /tmp/small.toml /tmp/warm

# numba does not read a cache that it cannot write, so each container copies it to /tmp, the only place where it may write.
USER 10001:10001
ENV HOME=/tmp NUMBA_CACHE_DIR=/tmp/numba OPENBLAS_NUM_THREADS=1
ENTRYPOINT ["/bin/sh", "-c", "cp -rT /var/cache/vemlight /tmp/numba && exec vemlight \"$@\"", "vemlight"]
CMD ["run"]
