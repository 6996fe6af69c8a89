# advdiff-sumo from its wheel: make package && docker build -t advdiff-sumo .
# docker run --rm -v "$PWD:/work" advdiff-sumo run --episodes 3 --out runs/first
FROM python:3.11-slim

# What SUMO's wheels need and do not bring along.
RUN apt-get update \
    && apt-get install -y --no-install-recommends libatomic1 libexpat1 libgl1 libx11-6 libxext6 libxrender1 \
    && rm -rf /var/lib/apt/lists/*

COPY build/package/dist/*.whl constraints.txt /tmp/wheel/
RUN pip install --no-cache-dir --constraint /tmp/wheel/constraints.txt /tmp/wheel/*.whl && rm -r /tmp/wheel

WORKDIR /work
ENTRYPOINT ["advdiff-sumo"]
