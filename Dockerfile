# astray on a CPU: `docker build -t astray . && docker run --rm -v "$PWD:/home/mouse/mine" astray list`
FROM python:3.13-slim AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE constraints.txt ./
COPY src src
RUN pip install --no-cache-dir --constraint constraints.txt build \
    && python -m build --wheel --outdir /wheels

FROM python:3.13-slim
# Torch's own index has builds without a GPU's libraries, which are ten times smaller.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
COPY constraints.txt /wheels/
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir --constraint /wheels/constraints.txt --index-url "$TORCH_INDEX" \
        --extra-index-url https://pypi.org/simple torch \
    && pip install --no-cache-dir --constraint /wheels/constraints.txt "$(ls /wheels/*.whl)[train]" \
    && rm -r /wheels
RUN useradd --create-home mouse
USER mouse
WORKDIR /home/mouse
# Compiled once into the image, so that containers begin at once.
RUN astray evaluate maze-corner --levels 200000:200010 > /dev/null
ENTRYPOINT ["astray"]
CMD ["--help"]
