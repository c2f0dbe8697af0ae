"""The program that comes with a package, run by itself: it passes what was exported, and nothing that was touched on the way."""

import base64
import hashlib
import io
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from boresight.platform.audit.signing import SigningKey
from boresight.uplink.package import build_package, make_files
from tests.uplink.packages import make_inputs

Files = dict[str, bytes]


@pytest.fixture
def key(tmp_path: Path) -> SigningKey:
    return SigningKey(tmp_path / "signing.key")


@pytest.fixture
def package(key: SigningKey) -> bytes:
    inputs = make_inputs()
    signature = key.load().sign(make_files(inputs, signed=True)["SHA256SUMS"])
    return build_package(inputs, base64.b64decode(signature))


def _unpacked(content: bytes) -> Files:
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def _packed(files: Mapping[str, bytes], *more: tuple[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as packed:
        for name, content in (*files.items(), *more):
            packed.writestr(name, content)
    return buffer.getvalue()


@pytest.fixture
def run(tmp_path: Path, key: SigningKey, package: bytes) -> Callable[..., Any]:
    program, keys = tmp_path / "verify_package.py", tmp_path / "keys.pem"
    program.write_bytes(_unpacked(package)["verify_package.py"])

    def act(content: bytes, public: str | None = None) -> Any:
        (tmp_path / "package.zip").write_bytes(content)
        keys.write_text("".join(one.pem for one in key.list_public_keys()) if public is None else public)
        command = [sys.executable, "-I", program, tmp_path / "package.zip", keys]  # -I: nothing of Boresight's is found
        return subprocess.run(command, capture_output=True, text=True, check=False)

    return act


def test_a_package_as_it_was_exported_passes_and_its_key_is_named(run, key, package):
    done = run(package)
    assert (done.returncode, done.stderr) == (0, "")
    assert key.list_public_keys()[0].id in done.stdout


def test_a_package_passes_after_a_rotation_with_the_public_half_that_was_kept(run, key, package):
    first = key.list_public_keys()[0].id
    key.rotate()
    done = run(package)
    assert (done.returncode, first in done.stdout) == (0, True)


def _changed(name: str) -> Callable[[Files], bytes]:
    return lambda files: _packed({**files, name: files[name][:-1] + bytes([files[name][-1] ^ 1])})


def _summed_again(files: Files) -> bytes:
    """Change a file and correct the sums, as an attacker without the key would."""
    files = {**files, "parameters.csv": b"f_m,0.02\n"}
    rest = {name: content for name, content in files.items() if not name.startswith("SHA256SUMS")}
    lines = (f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in sorted(rest.items()))
    return _packed({**files, "SHA256SUMS": "".join(lines).encode()})


TAMPERED = {
    "a byte of the parameters": _changed("parameters.csv"),
    "a byte of the way back": _changed("backout/parameters.csv"),
    "a byte of the sums": _changed("SHA256SUMS"),
    "a byte of the signature": _changed("SHA256SUMS.sig"),
    "a file more": lambda files: _packed({**files, "table.bin": b"1"}),
    "a file less": lambda files: _packed({name: files[name] for name in files if name != "c_sd.json"}),
    "a file twice": lambda files: _packed(files, ("parameters.csv", b"f_m,0.02\n")),
    "no signature": lambda files: _packed({name: files[name] for name in files if name != "SHA256SUMS.sig"}),
    "no sums": lambda files: _packed({name: files[name] for name in files if name != "SHA256SUMS"}),
    "sums written again": _summed_again,
    "no ZIP": lambda _: b"PK",
}


@pytest.mark.few(5)
@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("how", TAMPERED)
def test_a_package_that_was_touched_is_refused(run, package, how):
    done = run(TAMPERED[how](_unpacked(package)))
    assert done.returncode == 1
    assert done.stderr.startswith("DO NOT LOAD: ")


def test_a_package_signed_by_another_key_or_by_none_is_refused(run, package, tmp_path):
    other = SigningKey(tmp_path / "other.key")
    other.load()
    assert run(package, other.list_public_keys()[0].pem).returncode == 1
    assert run(package, "").returncode == 1
    assert run(build_package(make_inputs())).returncode == 1


def test_without_its_arguments_it_says_how_it_is_used(tmp_path, package):
    program = tmp_path / "verify_package.py"
    program.write_bytes(_unpacked(package)["verify_package.py"])
    done = subprocess.run([sys.executable, "-I", program], capture_output=True, text=True, check=False)
    assert (done.returncode, "python verify_package.py PACKAGE.zip" in done.stderr) == (1, True)


def test_openssl_verifies_the_signature_too(package, key, tmp_path):
    if (openssl := shutil.which("openssl")) is None:
        pytest.skip("OpenSSL is not here: apt-get install openssl")
    for name in ("SHA256SUMS", "SHA256SUMS.sig"):
        (tmp_path / name).write_bytes(_unpacked(package)[name])
    (tmp_path / "key.pem").write_text(key.list_public_keys()[0].pem)
    command = [openssl, "pkeyutl", "-verify", "-rawin", "-pubin", "-inkey", "key.pem", "-sigfile", "SHA256SUMS.sig"]
    done = subprocess.run([*command, "-in", "SHA256SUMS"], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0


def test_every_file_is_as_without_a_signature_but_the_sums_which_gain_a_line(package):
    signed, plain = _unpacked(package), _unpacked(build_package(make_inputs()))
    assert sorted(signed.keys() - plain.keys()) == ["SHA256SUMS.sig", "verify_package.py"]
    assert [name for name in plain if signed[name] != plain[name]] == ["SHA256SUMS"]
    more = signed["SHA256SUMS"].decode().splitlines()
    assert [line.split()[1] for line in more if line not in plain["SHA256SUMS"].decode()] == ["verify_package.py"]
    assert len(signed["verify_package.py"].splitlines()) <= 60
