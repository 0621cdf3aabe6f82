# mantle with its solver stack: docker build -t mantle . && docker run --rm -v "$PWD:/work" mantle run case.yaml
# Where ranks exchange much, give them room: --shm-size=2g
# The base never changes by itself; docs/howto/administrators.md tells how to renew it.
# `--build-arg BASE=dolfinx/dolfinx:v0.11.0` (or v0.10.0) takes DOLFINx from its own image, the rest by pip: not tested.
ARG BASE=debian:trixie-slim@sha256:a29215f6a35e51e22adffa17f89e9d2ef06214e64a2bad10d765c46aea49f11f
FROM ${BASE}

COPY packages.txt /tmp/packages.txt
RUN if python3 -c 'import dolfinx' 2>/dev/null; then \
        sed -n 's/^[^#].*# wheel \([^;]*\).*/\1/p' /tmp/packages.txt | tr ' ' '\n' \
           | grep -Ev '^(dolfinx-solver|gmsh|numpy)' | xargs python3 -m pip install --no-cache-dir; \
    else \
        apt-get update \
        && sed 's/#.*//' /tmp/packages.txt \
           | DEBIAN_FRONTEND=noninteractive xargs apt-get install -y --no-install-recommends \
        && rm -rf /var/lib/apt/lists/*; \
    fi && rm /tmp/packages.txt

COPY . /opt/mantle
RUN ln -s /opt/mantle/mantle /usr/local/bin/mantle \
    && useradd --create-home --shell /bin/bash mantle \
    && mkdir /work \
    && chown mantle:mantle /work

# Forms of three shipped cases are compiled now: the first run waits for no compiler. Root alone can
# write them; whoever runs copies them into a cache of their own.
RUN cd /tmp && export XDG_CACHE_HOME=/var/cache/mantle OMP_NUM_THREADS=1 \
    && for case in stance cure cylinders; do \
       /opt/mantle/mantle run /opt/mantle/configs/$case.yaml -o /tmp/out --force \
       --set mesh.size='8 mm' --set mesh.far_size='16 mm' --set output.fields=false || exit 1; done \
    && rm -rf /tmp/out /var/cache/mantle/mantle/meshes \
    && find /var/cache/mantle \( -name '*.o' -o -name '*lock' \) -delete \
    && chmod -R a+rX,go-w /var/cache/mantle

USER mantle
WORKDIR /work
# One thread per rank: more make MPI runs slower. No module in /work comes instead of the program's.
ENV OMP_NUM_THREADS=1 PYTHONSAFEPATH=1 PYTHONPATH=/opt/mantle
ENTRYPOINT ["mantle"]
