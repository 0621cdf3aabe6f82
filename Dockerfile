# mantle with its solver stack: docker build -t mantle . && docker run --rm -v "$PWD:/work" mantle run case.yaml
# Where ranks exchange much, give them room: --shm-size=2g
FROM debian:trixie-slim

COPY packages.txt /tmp/packages.txt
RUN apt-get update \
    && sed 's/#.*//' /tmp/packages.txt \
       | DEBIAN_FRONTEND=noninteractive xargs apt-get install -y --no-install-recommends \
    && rm -rf /var/lib/apt/lists/* /tmp/packages.txt

# Everything it depends on is installed; without an index nothing else can come in.
COPY . /opt/mantle
RUN pip install --no-deps --no-build-isolation --no-index --break-system-packages --no-cache-dir /opt/mantle \
    && rm -rf /opt/mantle \
    && useradd --create-home --shell /bin/bash mantle \
    && mkdir /work \
    && chown mantle:mantle /work \
    && mkdir -m 1777 /var/cache/mantle

# What the shipped cases need is compiled and meshed now: the first run waits for no compiler. Who
# runs later is somebody else, who adds to it.
RUN cd /tmp && XDG_CACHE_HOME=/var/cache/mantle OMP_NUM_THREADS=1 python3 -m mantle.simulation.precompile \
    && find /var/cache/mantle -name '*.o' -delete -o -name '*.lock' -delete \
    && chmod -R a+rwX /var/cache/mantle/fenics /var/cache/mantle/mantle

USER mantle
WORKDIR /work
# One thread per rank: more make MPI runs slower. The caches serve whatever user `--user` names. No
# module in /work comes instead of the program's.
ENV OMP_NUM_THREADS=1 PYTHONSAFEPATH=1 XDG_CACHE_HOME=/var/cache/mantle MPLCONFIGDIR=/var/cache/mantle/matplotlib
ENTRYPOINT ["mantle"]
