"""Links with certificates: made by the commands of the page, wanted on both ends, refused by halves."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from distributed import Security

from boresight.errors import RefusedInputError
from boresight.settings import read_settings
from boresight.workers.connection import Connection
from boresight.workers.security import security_of
from services import Services, free_port, loops

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "deployment.md").read_text()
MADE, EXPORTS = re.findall(r"^```sh certificates\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """Make an authority and a certificate by the commands of the page; returns the settings that name them."""
    folder = tmp_path_factory.mktemp("certificates")
    subprocess.run(["sh", "-ec", MADE], check=True, cwd=folder, capture_output=True)
    named = dict(re.findall(r"^export BORESIGHT_(\w+)=(\S+)$", EXPORTS, re.MULTILINE))
    files = {name: str(folder / value) for name, value in named.items() if name.startswith("TLS")}
    return {name.lower(): value for name, value in files.items()}


def settings(**given: str):
    """Return settings of these."""
    return read_settings({f"BORESIGHT_{name.upper()}": value for name, value in given.items()})


def test_a_worker_and_a_client_join_a_scheduler_that_all_have_certificates_and_a_stranger_does_not(
    certificates, tmp_path
):
    address = f"tls://127.0.0.1:{free_port()}"
    services, before = Services(tmp_path, data_folder=str(tmp_path), **certificates), loops()
    try:
        services.start("scheduler", "--port", address.rpartition(":")[2])
        services.start("worker", scheduler=address)
        security = security_of(settings(scheduler=address, **certificates))
        with Connection(address, security=security, timeout=120, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=120)
            assert client.submit(sum, [1, 2], pure=False).result(60) == 3
        stranger = Security(tls_ca_file=certificates["tls_authority"], require_encryption=True)
        with pytest.raises((OSError, TypeError)):
            Connection(address, security=stranger, timeout=5, set_as_default=False)
        assert loops() <= before
    finally:
        services.stop()


def test_links_without_certificates_are_plain():
    assert security_of(settings(scheduler="tcp://127.0.0.1:1")) is None


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"scheduler": "tls://127.0.0.1:1"}, "wants certificates"),
        ({"scheduler": "tls://127.0.0.1:1", "tls_certificate": __file__}, "BORESIGHT_TLS_AUTHORITY='' is no file"),
        (
            {"tls_authority": __file__, "tls_certificate": "nowhere.pem"},
            "BORESIGHT_TLS_CERTIFICATE='nowhere.pem' is no",
        ),
        ({"scheduler": "tcp://127.0.0.1:1", "tls_authority": __file__, "tls_certificate": __file__}, "is a plain link"),
    ],
)
def test_half_of_what_it_takes_is_refused_in_a_sentence(given, sentence):
    with pytest.raises(RefusedInputError, match=sentence):
        security_of(settings(**given))
