# Server, scheduler and worker are one image; the command says which. Nothing is compiled but the kernels, at the first start,
# for the processor they run on, into the data folder.

# The documentation, built with tools that the server does without.
FROM python:3.11-slim AS documentation
WORKDIR /opt/boresight
COPY requirements-docs.lock ./
RUN pip install --require-hashes --only-binary :all: --no-deps --requirement requirements-docs.lock
COPY frontend frontend
RUN npm ci --prefix frontend --ignore-scripts
COPY pyproject.toml hatch_build.py README.md CHANGELOG.md LICENSE ./
COPY backend backend
COPY migrations migrations
COPY docs docs
RUN pip install --no-deps . && python -m sphinx --quiet --fail-on-warning docs build/documentation

FROM python:3.11-slim

ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1 PYTHONUNBUFFERED=1
WORKDIR /opt/boresight

# What it runs on, by version and hash; and what a site wants besides, as locked for the tests.
COPY requirements.lock requirements-dev.lock ./
RUN awk '/^[a-z0-9-]+==/ {wanted = /^(psycopg|psycopg-binary|obstore)==/} wanted' requirements-dev.lock > requirements-site.lock \
 && pip install --require-hashes --only-binary :all: --no-deps --requirement requirements.lock \
 && pip install --require-hashes --only-binary :all: --no-deps --requirement requirements-site.lock

COPY pyproject.toml hatch_build.py README.md LICENSE ./
COPY backend backend
COPY frontend frontend
COPY migrations migrations
COPY docs/glossary.md docs/glossary.md
COPY --from=documentation /opt/boresight/build/documentation build/documentation
RUN pip install --no-deps .

# A user of its own, who owns nothing but the data folder.
RUN useradd --system --uid 10001 --no-create-home boresight \
 && install --directory --owner boresight --mode 0700 /var/lib/boresight
USER boresight
ENV BORESIGHT_DATA_FOLDER=/var/lib/boresight
VOLUME /var/lib/boresight
WORKDIR /var/lib/boresight
CMD ["boresight", "serve", "--host", "0.0.0.0"]
