"""Links with certificates: made by the commands of the page, wanted on both ends, refused by halves."""

from __future__ import annotations

import logging
import os
import re
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from distributed import Security
from services import Services, loops

from benchmarks.servers import free_port
from boresight.errors import RefusedInputError
from boresight.settings import read_settings
from boresight.workers.cluster import SchedulerClient
from boresight.workers.security import issue, make_security
from tests.refusals import has_code

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "deployment.md").read_text()
MADE, EXPORTS = re.findall(r"^```sh certificates\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """Make an authority and a certificate by the commands of the page; returns the settings that name them."""
    folder = tmp_path_factory.mktemp("certificates")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    subprocess.run(["sh", "-ec", MADE], check=True, cwd=folder, capture_output=True, env=os.environ | {"PATH": path})
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
        security = make_security(settings(scheduler=address, **certificates))
        with SchedulerClient(address, security=security, timeout=120, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=120)
            assert client.submit(sum, [1, 2], pure=False).result(60) == 3
        stranger = Security(tls_ca_file=certificates["tls_authority"], require_encryption=True)
        with pytest.raises((OSError, TypeError)):
            SchedulerClient(address, security=stranger, timeout=5, set_as_default=False)
        assert loops() <= before
    finally:
        services.stop()


def test_links_without_certificates_are_plain():
    assert make_security(settings(scheduler="tcp://127.0.0.1:1")) is None


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"scheduler": "tls://127.0.0.1:1"}, "needs certificates"),
        ({"scheduler": "tls://127.0.0.1:1", "tls_certificate": __file__}, "BORESIGHT_TLS_AUTHORITY='' is not a file"),
        (
            {"tls_authority": __file__, "tls_certificate": "nowhere.pem"},
            "BORESIGHT_TLS_CERTIFICATE='nowhere.pem' is no",
        ),
        ({"scheduler": "tcp://127.0.0.1:1", "tls_authority": __file__, "tls_certificate": __file__}, "is a plain link"),
    ],
)
def test_half_of_what_it_takes_is_refused_in_a_sentence(given, sentence):
    with pytest.raises(RefusedInputError, match=sentence):
        make_security(settings(**given))


@pytest.mark.parametrize("address", ["tcp://10.1.2.3:8786", "tcp://scheduler:8786", "tcp://[fd00::1]:8786"])
def test_a_plain_link_off_this_machine_is_refused_unless_its_network_is_closed(address):
    with pytest.raises(RefusedInputError, match=r"BORESIGHT_TLS_AUTHORITY.*BORESIGHT_CLUSTER_NETWORK_CLOSED=1"):
        make_security(settings(scheduler=address))
    assert make_security(settings(scheduler=address, cluster_network_closed="1")) is None


@pytest.mark.parametrize("address", ["tcp://127.9.8.7:8786", "tcp://localhost:8786", "tcp://[::1]:8786"])
def test_a_plain_link_within_this_machine_is_not_refused(address):
    assert make_security(settings(scheduler=address)) is None


def changed(certificates, folder, *, ends=None, mode=0o600, drop=""):
    """Return settings of a certificate that is not as it should be."""
    made = issue() if ends is None else issue(ends=ends)
    (folder / "machine.pem").write_text({"key": made.certificate, "": made.certificate + made.key}[drop])
    (folder / "machine.pem").chmod(mode)
    given = certificates | {"tls_certificate": str(folder / "machine.pem")}
    return settings(scheduler="tls://127.0.0.1:1", **given)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"ends": datetime(2020, 1, 1, tzinfo=UTC)}, "has expired on 2020-01-01"),
        ({"mode": 0o644}, "can be read by every user"),
        ({"drop": "key"}, "does not contain a certificate and its key"),
    ],
)
def test_a_certificate_that_cannot_serve_is_refused_at_the_start(certificates, tmp_path, wrong, sentence):
    with pytest.raises(RefusedInputError, match=sentence):
        make_security(changed(certificates, tmp_path, **wrong))


def test_a_certificate_that_will_soon_expire_is_told(certificates, tmp_path, caplog):
    caplog.set_level(logging.WARNING)
    assert make_security(changed(certificates, tmp_path, ends=datetime.now(UTC) + timedelta(days=20))) is not None
    assert "expires on" in caplog.text
    caplog.clear()
    assert make_security(settings(scheduler="tls://127.0.0.1:1", **certificates)) is not None
    assert not caplog.text  # those of the command


def test_an_authority_that_is_none_is_refused(certificates):
    given = certificates | {"tls_authority": __file__}
    with pytest.raises(RefusedInputError, match="BORESIGHT_TLS_AUTHORITY=", check=has_code("unreadable-certificate")):
        make_security(settings(scheduler="tls://127.0.0.1:1", **given))
