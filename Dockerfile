# Build stage: wheels for the project and what it needs.
FROM python:3.12-slim AS build
WORKDIR /src
COPY pyproject.toml constraints.txt README.md ./
COPY app ./app
COPY migrations ./migrations
RUN python -m venv /opt/roomfix \
 && /opt/roomfix/bin/pip install --no-cache-dir --constraint constraints.txt '.[faces,postgresql,scans,sfm]'

FROM python:3.12-slim
COPY --from=build /opt/roomfix /opt/roomfix
# A number, so that a platform can see that it isn't root; the one that volumes of earlier images belong to.
RUN groupadd --system --gid 999 roomfix \
 && useradd --system --uid 999 --gid 999 --create-home --home-dir /var/lib/roomfix roomfix
USER 999:999
# A volume that is mounted here belongs to the same user.
RUN mkdir /var/lib/roomfix/uploads
ENV PATH=/opt/roomfix/bin:$PATH \
    ROOMFIX_HOST=0.0.0.0 \
    ROOMFIX_DATA_DIR=/var/lib/roomfix \
    OMP_NUM_THREADS=1 \
    PYTHONUNBUFFERED=1
VOLUME /var/lib/roomfix
EXPOSE 8000
HEALTHCHECK --interval=15s --timeout=5s --start-period=30s \
  CMD python -c "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/readyz', timeout=4)"
# ROOMFIX_ADMIN_KEY must be set: beyond loopback the server never runs open.
CMD ["roomfix", "serve"]
