"""An S3 server in this process, with a bucket, and the environment that leads there."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import httpx
import pytest

SECRET = "secret-of-the-test"


@contextmanager
def serving_s3(bucket: str) -> Iterator[str]:
    moto = pytest.importorskip("moto.server")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    address = f"http://{host}:{port}"
    assert httpx.put(f"{address}/{bucket}", timeout=60).status_code == 200
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("AWS_ENDPOINT_URL", address)
        environment.setenv("AWS_ACCESS_KEY_ID", "key")
        environment.setenv("AWS_SECRET_ACCESS_KEY", SECRET)
        environment.setenv("AWS_REGION", "us-east-1")
        yield address
    server.stop()
