# syntax=docker/dockerfile:1
# The front-end: where clients start. Keeps nothing.
# Build it from the root of the repository:  docker build -f deploy/docker/frontend.Dockerfile -t stampede-rt/frontend .

FROM docker.io/library/python:3.11-slim-bookworm AS build

# Downloads trust the authorities of the system's store. A network with an authority of its own needs only a mount of
# that store during the build (--volume /etc/ssl/certs:/etc/ssl/certs:ro). The image keeps nothing of the store.
ENV PIP_CERT=/etc/ssl/certs/ca-certificates.crt \
    PIP_NO_CACHE_DIR=1 \
    UV_COMPILE_BYTECODE=1 \
    UV_LINK_MODE=copy \
    UV_NO_CACHE=1 \
    UV_PROJECT_ENVIRONMENT=/opt/stampede \
    UV_PYTHON_DOWNLOADS=never \
    UV_SYSTEM_CERTS=1
RUN python3 -m venv /opt/uv && /opt/uv/bin/pip install --quiet uv==0.13.8

WORKDIR /src
# Install the dependencies first, because they seldom change. uv checks the version and hash of each against uv.lock.
COPY pyproject.toml uv.lock ./
COPY client/pyproject.toml client/
COPY services/runtime/pyproject.toml services/runtime/
COPY services/channel_host/pyproject.toml services/channel_host/
COPY services/supernode/pyproject.toml services/supernode/
COPY services/frontend/pyproject.toml services/frontend/
COPY deploy/local_cluster/pyproject.toml deploy/local_cluster/
COPY demos/pyproject.toml demos/
COPY benchmarks/pyproject.toml benchmarks/
COPY web/pyproject.toml web/
RUN /opt/uv/bin/uv sync --quiet --frozen --no-dev --no-install-workspace --python python3 --package stampede-rt-frontend

COPY client/src client/src
COPY services/runtime/src services/runtime/src
COPY services/frontend/src services/frontend/src
RUN /opt/uv/bin/uv sync --quiet --frozen --no-dev --no-editable --python python3 --package stampede-rt-frontend


FROM docker.io/library/python:3.11-slim-bookworm

# A number, not only a name, because Kubernetes' runAsNonRoot can check only a number.
RUN groupadd --gid 10001 stampede \
    && useradd --uid 10001 --gid 10001 --no-create-home --home-dir /var/lib/stampede --shell /usr/sbin/nologin stampede \
    && install --directory --owner=10001 --group=10001 --mode=0700 /var/lib/stampede
COPY --from=build /opt/stampede /opt/stampede
USER 10001:10001
WORKDIR /var/lib/stampede

ENV PATH=/opt/stampede/bin:/usr/local/bin:/usr/bin:/bin \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1 \
    STAMPEDE_LISTEN=0.0.0.0:7580
EXPOSE 7580

# The service listens beyond the container. Without certificates it does so only with STAMPEDE_ALLOW_INSECURE_ANYWHERE=true,
# which is for a network of the cluster's own. Otherwise it does not start, and says why.
HEALTHCHECK --interval=10s --timeout=5s --start-period=20s --retries=3 \
    CMD ["python3", "-m", "stampede_rt_runtime.health_check"]

# Exec form: the service is process 1, SIGTERM reaches it, and it drains before it ends.
STOPSIGNAL SIGTERM
ENTRYPOINT ["python3", "-m", "stampede_rt_frontend"]
