# advdiff-sumo from its wheel: make package && docker build -t advdiff-sumo .
# docker run --rm -v "$PWD:/work" advdiff-sumo run --episodes 3 --out runs/first
FROM python:3.11-slim

COPY build/package/dist/*.whl constraints.txt /tmp/wheel/
RUN pip install --no-cache-dir --constraint /tmp/wheel/constraints.txt /tmp/wheel/*.whl && rm -r /tmp/wheel

WORKDIR /work
ENTRYPOINT ["advdiff-sumo"]
