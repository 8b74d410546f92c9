# docker build -t slamcmp . && docker run --rm -v "$PWD:/home/researcher/experiments" slamcmp run quickstart
FROM python:3.12-slim

# bubblewrap: one of the walls around hand-ins that slamcmp grade judges; git: the commit in manifests.
RUN apt-get update \
 && apt-get install --yes --no-install-recommends bubblewrap git \
 && rm -rf /var/lib/apt/lists/*

COPY . /opt/slamcmp
RUN python -m pip install --no-cache-dir --disable-pip-version-check \
      -c /opt/slamcmp/constraints.txt /opt/slamcmp

RUN useradd --create-home researcher
USER researcher
ENV OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 MPLCONFIGDIR=/tmp/matplotlib
WORKDIR /home/researcher/experiments
ENTRYPOINT ["slamcmp"]
CMD ["--help"]
