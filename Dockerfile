# The tuner with ROS 2 from Python wheels, for a machine or a cluster without either:
#   docker build --tag bo_tuner . && docker run --rm --network host -v "$PWD/runs:/runs" bo_tuner --attach
# As scheduler and workers of a cluster (docs/cluster.md): --entrypoint dask.
FROM python:3.12-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends git make \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/bo_tuner
COPY . .
RUN make setup
ENV PATH=/opt/bo_tuner/.venv/bin:$PATH RMW_IMPLEMENTATION=rmw_fastrtps_cpp
# Runs are written to runs/ below it.
WORKDIR /
ENTRYPOINT ["tune"]
